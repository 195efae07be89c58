"""Writes the greatest torque of a joint into an MJCF: where it is stated, in whichever words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from pupper_analysis.diagnostics import diagnose
from pupper_analysis.models.digits import SAME
from pupper_analysis.models.efforts import effort_limit
from pupper_analysis.models.transmission import actuator_gear, drives_of
from pupper_analysis.models.xml_bytes import Element
from pupper_analysis.sync.frames import Key

if TYPE_CHECKING:
    from pupper_analysis.sync.mjcf_side import MjcfSide


def write_effort(side: MjcfSide, key: Key) -> None:
    """Notes the changes that give a joint another greatest torque.

    It is the least of what the joint's ``actuatorfrcrange``, the actuators' ``forcerange`` and the
    ``ctrlrange`` of plain motors allow: whichever is stated and is not right, is changed.
    """
    name, model = key[1], side.model
    wanted = side.wanted.joints[name].effort
    joint = model.joint(name).id
    element = side.joint_in_file(name)
    drives = drives_of(model, joint)
    motors = side.elements.drives(name)
    if element is None or len(motors) != len(drives):
        side.left[key] = diagnose("actuators-are-copies")
        return
    bounds = _Bounds(side, key, element, motors, drives)
    if not 0 < wanted < math.inf:  # a URDF's effort of 0 is none
        bounds.lift()
        return
    now = effort_limit(model, joint)
    if (
        bounds.of_joint is not None
        and abs(bounds.of_joint - wanted) > SAME * wanted
        and (bounds.of_joint < wanted or bounds.of_joint <= now)
    ):
        bounds.write_joint(wanted)
    if len(drives) == 1:
        bounds.write_motor(wanted, now)
    elif drives and now < wanted and bounds.of_joint != now:
        side.left[key] = diagnose("actuators-share-it")
    elif bounds.of_joint is None:
        bounds.write_joint(wanted)


class _Bounds:
    """What bounds the torque of a joint with one actuator at most."""

    def __init__(
        self, side: MjcfSide, key: Key, joint: Element, motors: list[Element], drives: list[int]
    ) -> None:
        self.side, self.key, self.joint = side, key, joint
        self.motors, self.drives = motors, drives
        model, index = side.model, side.model.joint(key[1]).id
        self.of_joint: float | None = None
        if model.jnt_actfrclimited[index]:
            self.of_joint = float(np.abs(model.jnt_actfrcrange[index]).max())

    def lift(self) -> None:
        """Takes the bounds away: ranges stay, and are said to be no limits."""
        model = self.side.model
        if self.of_joint is not None:
            self.joint.set("actuatorfrclimited", "false")
        for motor, index in zip(self.motors, self.drives, strict=True):
            if model.actuator_forcelimited[index]:
                motor.set("forcelimited", "false")
            if model.actuator_ctrllimited[model.actuator_ctrladr[index]] and self._gain(index):
                motor.set("ctrllimited", "false")
        self.side.notes[self.key] = diagnose("limit-switched-off")

    def _gain(self, index: int) -> float:
        """Returns the torque at the joint per unit of control of a plain motor; 0 of others."""
        model = self.side.model
        plain = (
            model.actuator_biastype[index] == mujoco.mjtBias.mjBIAS_NONE.value
            and model.actuator_gaintype[index] == mujoco.mjtGain.mjGAIN_FIXED.value
        )
        gear = abs(float(actuator_gear(model, index)[0]))
        return abs(float(model.actuator_gainprm[index, 0])) * gear if plain else 0.0

    def write_joint(self, wanted: float) -> None:
        """Writes the joint's actuatorfrcrange."""
        index = self.side.model.joint(self.key[1]).id
        limited = self.side.robot.description.mjcf.joint(self.key[1]).actfrclimited
        old = np.array(self.side.model.jnt_actfrcrange[index]) if self.of_joint else None
        self._write(self.joint, "actuatorfrcrange", old, wanted)
        self._limit(self.joint, "actuatorfrclimited", limited)

    def write_motor(self, wanted: float, now: float) -> None:
        """Writes the forcerange or the ctrlrange of the one actuator."""
        model, index = self.side.model, self.drives[0]
        motor = self.motors[0]
        gear = abs(float(actuator_gear(model, index)[0]))
        if gear == 0:
            self.side.left[self.key] = diagnose("gear-is-zero")
            return
        gain = self._gain(index)
        stated = []
        if model.actuator_forcelimited[index]:
            stated.append(("forcerange", np.array(model.actuator_forcerange[index]), gear))
        control = int(model.actuator_ctrladr[index])
        if model.actuator_ctrllimited[control] and gain:
            stated.append(("ctrlrange", np.array(model.actuator_ctrlrange[control]), gain))
        for attribute, old, factor in stated:
            bound = float(np.abs(old).max()) * factor
            # What is looser than the least bound does no harm, unless it is below what is wanted.
            if abs(bound - wanted) <= SAME * max(wanted, bound):
                continue
            if bound < wanted or bound <= now * (1 + SAME):
                self._write(motor, attribute, old, wanted / factor)
        if not stated and self.of_joint is None:
            self._write(motor, "forcerange", None, wanted / gear)
            spec = self.side.robot.description.mjcf
            limited = next(a.forcelimited for a in spec.actuators if a.target == self.key[1])
            self._limit(motor, "forcelimited", limited)

    def _write(
        self, element: Element, attribute: str, old: np.ndarray | None, value: float
    ) -> None:
        pair = np.array([-value, value])
        if old is not None and abs(old[0] + old[1]) > SAME and np.abs(old).max() > 0:
            pair = old * (value / float(np.abs(old).max()))
        words = (element.get(attribute) or "").split()
        text = self.side.digits.words(words, pair)
        if text is not None:
            kind = "joint" if element is self.joint else "actuator"
            self.side.note_class(self.key, element, kind, attribute)
            element.set(attribute, text)

    def _limit(self, element: Element, attribute: str, limited: int) -> None:
        automatic = limited == mujoco.mjtLimited.mjLIMITED_AUTO.value
        on = limited == mujoco.mjtLimited.mjLIMITED_TRUE.value
        if not on and not (automatic and self.side.elements.autolimits):
            element.set(attribute, "true")
