"""Writes the greatest torque of a joint into an MJCF: where it is stated, in whichever words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.models.efforts import (
    EffortStatement,
    effort_limit,
    stated_by_actuator,
    stated_by_joint,
)
from pupper_analysis.models.transmission import actuator_gear, drives_of
from pupper_analysis.models.xml_bytes import Element
from pupper_analysis.models.xml_text import SAME
from pupper_analysis.tools.sync.frames import Key

if TYPE_CHECKING:
    from pupper_analysis.tools.sync.mjcf_side import MjcfSide

_LIMITED = {
    "actuatorfrcrange": "actuatorfrclimited",
    "forcerange": "forcelimited",
    "ctrlrange": "ctrllimited",
}
"""{range: what says whether it is one}."""


def write_effort(side: MjcfSide, key: Key) -> None:
    """Notes the changes that give a joint another greatest torque.

    It is the least of what the joint's ``actuatorfrcrange``, the actuators' ``forcerange`` and the
    ``ctrlrange`` of plain motors allow: whichever is stated and is not right, is changed.
    """
    name, model, spec = key[1], side.model, side.robot.description.mjcf
    wanted = side.wanted.joints[name].effort
    joint = model.joint(name).id
    element = side.joint_in_file(name)
    drives, motors = drives_of(model, joint), side.elements.drives(name)
    if element is None or len(motors) != len(drives):
        side.left[key] = diagnose("actuators-are-copies")
        return
    of_joint = [(element, one) for one in stated_by_joint(model, joint)]
    of_motors = [
        (motor, one)
        for motor, drive in zip(motors, drives, strict=True)
        for one in stated_by_actuator(model, drive)
        if one.factor
    ]
    if not 0 < wanted < math.inf:  # a URDF's effort of 0 is none
        for owner, one in (*of_joint, *of_motors):
            side.elements.write(owner, _LIMITED[one.attribute], "false")
        side.notes[key] = diagnose("limit-switched-off")
        return
    now = effort_limit(model, joint)
    for owner, one in (*of_joint, *(of_motors if len(drives) == 1 else ())):
        # What is looser than the least bound does no harm, unless it is below what is wanted.
        off = abs(one.greatest - wanted) > SAME * max(wanted, one.greatest)
        if off and (one.greatest < wanted or one.greatest <= now * (1 + SAME)):
            _write(side, key, owner, one.attribute, wanted / abs(one.factor), one)
    if len(drives) == 1:
        gear = abs(float(actuator_gear(model, drives[0])[0]))
        if gear == 0:
            side.left[key] = diagnose("gear-is-zero")
        elif not (of_motors or of_joint):
            motor = next(actuator for actuator in spec.actuators if actuator.target == name)
            _write(side, key, motors[0], "forcerange", wanted / gear)
            _limit(side, motors[0], "forcelimited", motor.forcelimited)
    elif drives and now < wanted and not any(one.greatest == now for _, one in of_joint):
        side.left[key] = diagnose("actuators-share-it")
    elif not of_joint:
        _write(side, key, element, "actuatorfrcrange", wanted)
        _limit(side, element, "actuatorfrclimited", spec.joint(name).actfrclimited)


def _write(
    side: MjcfSide,
    key: Key,
    element: Element,
    attribute: str,
    value: float,
    stated: EffortStatement | None = None,
) -> None:
    """Writes a range whose greater end is a value; one that is not symmetric keeps its shape."""
    pair, old = np.array([-value, value]), np.array((0.0, 0.0) if stated is None else stated.stated)
    if abs(old.sum()) > SAME:
        pair = old * (value / float(np.abs(old).max()))
    side.write(key, element, attribute, pair)


def _limit(side: MjcfSide, element: Element, attribute: str, limited: int) -> None:
    """Says that a new range is one, where that does not follow from its being there."""
    automatic = limited == mujoco.mjtLimited.mjLIMITED_AUTO.value and side.elements.autolimits
    if limited != mujoco.mjtLimited.mjLIMITED_TRUE.value and not automatic:
        side.elements.write(element, attribute, "true")
