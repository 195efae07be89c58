"""What an MJCF's options switch off, or change, for whoever simulates it: said, not mended."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from pupper_analysis.models.conversion import gravity

_EARTH = np.array([0.0, 0.0, -9.81])

_NEAR = 0.05
"""Gravity that differs from 9.81 m/s^2 downwards by more is not the Earth's, or not upright: from
pole to equator it changes by 0.05."""

_DISABLE = mujoco.mjtDisableBit

_FLAGS = (
    (_DISABLE.mjDSBL_CONTACT, "contact", "nothing touches the ground"),
    (_DISABLE.mjDSBL_CONSTRAINT, "constraint", "nothing touches the ground"),
    (_DISABLE.mjDSBL_ACTUATION, "actuation", "no motor holds anything"),
)


def options_in_words(model: mujoco.MjModel) -> Iterator[str]:
    """Yields what a model's options make other than a robot on the Earth expects."""
    acts = gravity(model)
    if float(np.linalg.norm(acts - _EARTH)) > _NEAR:
        numbers = ", ".join(f"{value:g}" for value in acts)
        yield f"gravity is the MJCF's: ({numbers}) m/s^2"
    for bit, word, what in _FLAGS:
        if model.opt.disableflags & bit.value:
            yield f'the MJCF\'s <flag {word}="disable"/> switches off what holds a robot: {what}'
    groups = model.actuator_group
    off = [
        model.actuator(motor).name or f"#{motor}"
        for motor in range(model.nactuator)
        if 0 <= groups[motor] < 31 and int(model.opt.disableactuator) >> int(groups[motor]) & 1
    ]
    if off:
        yield f"the MJCF's actuatorgroupdisable switches off {len(off)} actuators: {off[0]}" + (
            f" and {len(off) - 1} others" if len(off) > 1 else ""
        )
