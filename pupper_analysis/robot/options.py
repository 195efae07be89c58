"""What an MJCF's options switch off, or change, for whoever simulates it: said, not mended."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from pupper_analysis.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.conversion import acting_gravity

_EARTH = np.array([0.0, 0.0, -9.81])

_NEAR = 0.05
"""Gravity that differs from 9.81 m/s^2 downwards by more is not the Earth's, or not upright: from
pole to equator it changes by 0.05."""

_DISABLE = mujoco.mjtDisableBit

_FLAGS = (
    (_DISABLE.mjDSBL_CONTACT, "contact"),
    (_DISABLE.mjDSBL_CONSTRAINT, "constraint"),
    (_DISABLE.mjDSBL_ACTUATION, "actuation"),
)
"""What holds a robot."""


def option_notes(model: mujoco.MjModel) -> Iterator[Diagnostic]:
    """Yields what a model's options make other than a robot on the Earth expects."""
    acts = acting_gravity(model)
    if float(np.linalg.norm(acts - _EARTH)) > _NEAR:
        yield diagnose("gravity-not-the-earths", gravity=acts)
    for bit, word in _FLAGS:
        if model.opt.disableflags & bit.value:
            yield diagnose("flag-disables", flag=word, motors=word == "actuation")
    groups = model.actuator_group
    off = [
        model.actuator(motor).name or f"#{motor}"
        for motor in range(model.nactuator)
        if 0 <= groups[motor] < 31 and int(model.opt.disableactuator) >> int(groups[motor]) & 1
    ]
    if off:
        yield diagnose("actuators-switched-off", actuators=off)
