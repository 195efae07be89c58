"""Electrical energy of motors as text, for documents of simulated motions."""

from __future__ import annotations

from collections.abc import Iterable

from pupper_analysis.models.motors.energy import MotorEnergy
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text


def describe_motor_energy(energy: MotorEnergy | None) -> Iterable[doc.Words]:
    """Yield a text on the electrical energy of simulated motors; nothing if ``energy`` is None."""
    if energy is None:
        return
    if energy.unknown or energy.power is None:
        numbers = join_words([doc.Name(number) for number in energy.unknown])
        yield text("motor-energy-unknown", numbers=numbers)
        return
    yield text(
        "motor-energy",
        power=f"{energy.power:.3g}",
        electrical=f"{energy.electrical:.3g}",
        time=f"{energy.duration:.3g}",
        work=f"{energy.work:.3g}",
        copper=f"{energy.copper:.3g}",
        friction=f"{energy.friction:.3g}",
    )
