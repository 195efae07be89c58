"""Torque limits of motors at their joints, from all statements of a URDF and an MJCF.

A torque limit has four sources: the URDF's ``effort``, and in an MJCF the joint's
``actuatorfrcrange``, an actuator's ``forcerange`` times its gear, and the ``ctrlrange`` of a plain
motor times its gain and gear. MuJoCo clamps a torque by all of them, one after the other, so the
smallest limit counts.

A limit of zero is a motor without torque, and a negative limit is an error; ``EffortCode`` names
both. A joint for which no file states a limit has an unknown limit, which is no unlimited motor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.results import Result
from pupper_analysis.models.attributes import UNSTATED
from pupper_analysis.models.transmission import actuator_gear, list_joint_actuators

if TYPE_CHECKING:
    from pupper_analysis.models.mjcf_file import MjcfFile

_HOLDING = (
    mujoco.mjtDyn.mjDYN_NONE.value,
    mujoco.mjtDyn.mjDYN_FILTER.value,
    mujoco.mjtDyn.mjDYN_FILTEREXACT.value,
)
"""Dynamics through which a force is never more than that of the greatest command."""


class EffortCode(StrEnum):
    """Meaning of the torque limit of a joint."""

    STATED = "stated"
    ZERO = "zero"
    NEGATIVE = "negative"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class EffortStatement(Result):
    """One place where a file says what a joint's motor can give.

    Attributes:
        file: ``URDF`` or ``MJCF``; ``""`` of a limit that was asked for in place of theirs.
        element: ``joint`` or ``actuator``.
        name: The element's; of several actuators at a joint theirs, with commas.
        attribute: ``effort``, ``actuatorfrcrange``, ``forcerange`` or ``ctrlrange``.
        stated: The lower and the upper end of the range as the file has it, an effort's with both
            signs; of several actuators those at the joint.
        factor: What one of it is at the joint: the gear, times the gain of a ``ctrlrange``.
        lower: At the joint (N m; N of a joint that slides).
        upper: Likewise.
    """

    file: str
    element: str
    name: str
    attribute: str
    stated: tuple[float, float] = field(metadata={"unit": "varies"})
    factor: float = field(metadata={"unit": "varies"})
    lower: float = field(metadata={"unit": "N m"})
    upper: float = field(metadata={"unit": "N m"})

    @staticmethod
    def of(
        file: str,
        element: str,
        name: str,
        attribute: str,
        stated: Sequence[float],
        factor: float = 1.0,
    ) -> EffortStatement:
        """Returns a statement, worked out at the joint."""
        low, high = (float(end) for end in stated)
        ends = sorted((factor * low, factor * high))
        return EffortStatement(file, element, name, attribute, (low, high), factor, *ends)

    @staticmethod
    def empty(
        file: str, element: str, name: str, attribute: str, stated: Sequence[float]
    ) -> EffortStatement:
        """Return the statement of a range from zero to zero, or of an inverted one: no torque."""
        low, high = (float(end) + 0.0 for end in stated)  # + 0.0: no -0.0
        return EffortStatement(file, element, name, attribute, (low, high), 1.0, 0.0, 0.0)

    @property
    def greatest(self) -> float:
        """What the motor can give one way at the most (N m)."""
        return max(abs(self.lower), abs(self.upper))

    @property
    def least(self) -> float:
        """What the motor can give either way (N m): the lesser of the two ends; 0 if one is 0."""
        return max(0.0, min(-self.lower, self.upper))


@dataclass(frozen=True)
class EffortLimit(Result):
    """What a joint's motor can give.

    Attributes:
        joint: The joint.
        lower: The greatest torque the one way (N m), negative; -inf without a limit.
        upper: The other way; inf without a limit.
        origin: The statement that is the least; None without a limit.
        stated: All statements of both files.
        code: Meaning of the limit: ``unknown`` if no file states one, ``zero`` and ``negative`` if
            the motor has no torque, else ``stated``.
    """

    _reported: ClassVar[tuple[str, ...]] = ("code",)

    joint: str
    lower: float = field(metadata={"unit": "N m"})
    upper: float = field(metadata={"unit": "N m"})
    origin: EffortStatement | None
    stated: tuple[EffortStatement, ...]

    @property
    def code(self) -> EffortCode:
        """Meaning of the limit."""
        if self.origin is None:
            return EffortCode.UNKNOWN
        if self.lower < 0 or self.upper > 0:
            return EffortCode.STATED
        low, high = self.origin.stated
        return EffortCode.NEGATIVE if low > high else EffortCode.ZERO

    @property
    def without_torque(self) -> bool:
        """Whether the limit is zero or negative: the motor gives no torque."""
        return self.code in (EffortCode.ZERO, EffortCode.NEGATIVE)

    @property
    def positive_statement(self) -> EffortStatement | None:
        """The smallest positive limit that another statement has; None without one."""
        positive = [statement for statement in self.stated if statement.least > 0]
        return min(positive, key=lambda statement: statement.least, default=None)

    @property
    def least(self) -> float:
        """What it can give either way (N m)."""
        return max(0.0, min(-self.lower, self.upper))


def resolve_effort_limit(
    model: mujoco.MjModel,
    joint: int,
    effort: float | None = None,
    *,
    name: str = "",
    drives: Sequence[int] | None = None,
    null: EffortStatement | None = None,
) -> EffortLimit:
    """Return the torque limit of a joint by both files.

    Args:
        model: MuJoCo's model of the MJCF.
        joint: The id of a hinge or slide in it.
        effort: The URDF's for the joint (N m); None or infinite if it states none.
        name: The joint's in the URDF; by default as in the MJCF.
        drives: Its actuators, where they are known.
        null: An empty range of the MJCF, which its compiled model lacks: ``null_efforts``.
    """
    own = str(model.joint(joint).name)
    drives = list_joint_actuators(model, joint) if drives is None else drives
    stated = _stated(model, joint, drives)
    if null is not None:
        stated.append(null)
    if effort is not None and effort < UNSTATED:
        # First: of two that say the same, the one that says it of the joint.
        range_ = (-effort, effort)
        make = EffortStatement.of if effort > 0 else EffortStatement.empty
        stated.insert(0, make("URDF", "joint", name or own, "effort", range_))
    return EffortLimit(
        joint=name or own,
        lower=max((one.lower for one in stated), default=-math.inf),
        upper=min((one.upper for one in stated), default=math.inf),
        origin=min(stated, key=lambda one: one.least, default=None),
        stated=tuple(stated),
    )


def _stated(model: mujoco.MjModel, joint: int, drives: Sequence[int]) -> list[EffortStatement]:
    """Returns what an MJCF states of a joint's effort, each worked out at the joint.

    Several actuators at a joint add up: what bounds their sum is one statement.
    """
    found = read_joint_effort(model, joint)
    if len(drives) == 1:
        return found + read_actuator_efforts(model, drives[0])
    each = [read_actuator_efforts(model, actuator) for actuator in drives]
    if drives and all(each):
        lower = sum(max(one.lower for one in own) for own in each)
        upper = sum(min(one.upper for one in own) for own in each)
        names = ", ".join(own[0].name for own in each)
        least = min(each[0], key=lambda one: one.least)
        found.append(EffortStatement.of("MJCF", "actuator", names, least.attribute, (lower, upper)))
    return found


def null_efforts(file: MjcfFile) -> dict[str, EffortStatement]:
    """Return the force ranges of an MJCF that are empty: from 0 to 0, or inverted.

    MuJoCo ignores such a range without a message, so a compiled model has no limit there. Of a
    ``ctrlrange``, only that of a torque motor bounds a torque.

    Returns:
        {joint: statement}, of joints that have a name.
    """
    found: dict[str, EffortStatement] = {}
    by_joint: dict[str, list[EffortStatement | None]] = {}
    for actuator in file.spec.actuators:
        if actuator.trntype in _SPEC_JOINTS:
            by_joint.setdefault(actuator.target, []).append(_empty_range(file, actuator))
    for joint, statements in by_joint.items():
        first = statements[0]
        if first is not None and all(statements):  # several actuators add up
            found[joint] = first
    for joint in file.spec.joints:
        name, range_ = joint.name, joint.actfrcrange
        switch = joint.actfrclimited
        if name and _is_empty(file, "joint", name, "actuatorfrcrange", range_, switch):
            found[name] = EffortStatement.empty("MJCF", "joint", name, "actuatorfrcrange", range_)
    return found


_SPEC_JOINTS = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


def _empty_range(file: MjcfFile, actuator: mujoco.MjsActuator) -> EffortStatement | None:
    """Return the empty force range of an actuator; None without one."""
    name = actuator.name or actuator.target
    ranges = [("forcerange", actuator.forcerange, actuator.forcelimited)]
    if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE and actuator.gainprm[0] != 0:
        ranges.append(("ctrlrange", actuator.ctrlrange, actuator.ctrllimited))
    for attribute, range_, switch in ranges:
        ends = np.ravel(range_)[:2].tolist()
        if _is_empty(file, "actuator", name, attribute, ends, switch):
            return EffortStatement.empty("MJCF", "actuator", name, attribute, ends)
    return None


def _is_empty(
    file: MjcfFile, kind: str, name: str, attribute: str, range_: Sequence[float], switch: int
) -> bool:
    """Return True if a range is in force by its numbers alone, is stated, and contains nothing."""
    low, high = (float(end) for end in range_)
    if switch != mujoco.mjtLimited.mjLIMITED_AUTO or low < high:
        return False
    return low > high or file.stated(kind, name, (attribute,)) is not None


def read_joint_effort(model: mujoco.MjModel, joint: int) -> list[EffortStatement]:
    """Returns what a joint's own attribute states."""
    unknown = model.jnt_actfrcrange[joint, 1] >= UNSTATED  # MuJoCo's import of such a URDF
    if unknown or not model.jnt_actfrclimited[joint]:
        return []
    name, range_ = str(model.joint(joint).name), model.jnt_actfrcrange[joint]
    return [EffortStatement.of("MJCF", "joint", name, "actuatorfrcrange", range_)]


def find_max_effort(model: mujoco.MjModel, joint: int) -> float:
    """Returns the greatest force or torque that a joint's actuators can give; inf if unlimited."""
    limit = resolve_effort_limit(model, joint)
    return max(abs(limit.lower), abs(limit.upper))


def read_actuator_efforts(model: mujoco.MjModel, actuator: int) -> list[EffortStatement]:
    """Returns what an actuator's own attributes state."""
    found, name = [], str(model.actuator(actuator).name)
    gear = float(actuator_gear(model, actuator)[0])
    if model.actuator_forcelimited[actuator]:
        found.append(
            EffortStatement.of(
                "MJCF", "actuator", name, "forcerange", model.actuator_forcerange[actuator], gear
            )
        )
    plain = (
        model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE.value
        and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED.value
        and model.actuator_dyntype[actuator] in _HOLDING
    )
    control = int(model.actuator_ctrladr[actuator])
    if plain and model.actuator_ctrllimited[control]:
        factor = float(model.actuator_gainprm[actuator, 0]) * gear
        found.append(
            EffortStatement.of(
                "MJCF", "actuator", name, "ctrlrange", model.actuator_ctrlrange[control], factor
            )
        )
    return found


MAX_TORQUE_PER_LINK_MASS = 250.0
"""N m that no motor with its gear gives for each of its kg: the best give 150. Of 1500 joints in
use none is above 117 that has a motor in one of the two links it joins; tendons may come from afar.
"""

MAX_TORQUE_PER_ROBOT_MASS = 90.0
"""N m that all motors of a robot give together for each kg of it: 150 each, and motors are not more
than six tenths of it. Robots in use have 2 to 55."""

MAX_ROTOR_ACCELERATION = 1e5
"""rad/s^2 that no motor gives its own rotor, effort / armature: 100 rad/s within 1 ms. Robots in
use have 350 to 25,000."""


@dataclass(frozen=True)
class Motor:
    """What an effort is held against.

    Attributes:
        joint: A hinge.
        effort: What a file says that it can give (N m).
        mass: Of the two links that it joins, one of which has the motor, and what is fixed to them
            (kg).
        armature: kg m^2; 0 where none is stated.
    """

    joint: str
    effort: float
    mass: float
    armature: float = 0.0


def placeholder_efforts(
    motors: Sequence[Motor], total: float
) -> Iterator[tuple[tuple[str, ...], Diagnostic]]:
    """Yields which efforts nobody can have meant: they are written where a number has to be.

    A round one (1, 2 or 5 times 10^n, from 100) that is beyond any motor of its links' mass; one
    beyond any motor of its armature; and all the others where they are, together, beyond what
    motors of a robot of that mass give.

    Args:
        motors: All hinges with a limit.
        total: The robot's mass (kg).

    Yields:
        Joints, the one to look at first, and what is wrong with their efforts.
    """
    stated = [one for one in motors if 0 < one.effort < math.inf]
    found: dict[tuple[str, float], list[Motor]] = {}
    for one in stated:
        weighed = one.mass > 1e-3 * total and one.effort > MAX_TORQUE_PER_LINK_MASS * one.mass
        if weighed and _is_round(one.effort):
            found.setdefault(("effort-beyond-links", one.effort), []).append(one)
        elif one.armature > 0 and one.effort > MAX_ROTOR_ACCELERATION * one.armature:
            found.setdefault(("effort-beyond-armature", one.effort), []).append(one)
    for (code, effort), several in found.items():
        names, limit = tuple(one.joint for one in several), Quantity(effort, "N m")
        if code == "effort-beyond-links":
            mass = Quantity(min(one.mass for one in several), "kg")
            message = diagnose("effort-beyond-links", more=names[1:], effort=limit, mass=mass)
        else:
            armature = min(one.armature for one in several)
            message = diagnose(
                "effort-beyond-armature",
                more=names[1:],
                effort=limit,
                armature=Quantity(armature, "kg m^2"),
                quick=effort / armature,
            )
        yield names, message
    named = {one.joint for several in found.values() for one in several}
    rest = [one for one in stated if one.joint not in named]
    share = sum(one.effort for one in rest) / total if total > 0 else 0.0
    if share > MAX_TORQUE_PER_ROBOT_MASS:
        rest.sort(key=lambda one: -one.effort / max(one.mass, 1e-3 * total))
        efforts = [one.effort for one in rest]
        names = tuple(one.joint for one in rest)
        yield (
            names,
            diagnose(
                "efforts-beyond-robot",
                others=len(rest) - 1,
                own=Quantity(efforts[0], "N m"),
                least=Quantity(min(efforts), "N m"),
                effort=Quantity(max(efforts), "N m"),
                same=min(efforts) == max(efforts),
                share=share,
                mass=Quantity(total, "kg"),
            ),
        )


def _is_round(value: float) -> bool:
    """Says whether a number is 1, 2 or 5 times a power of ten, of 100 at least."""
    digits, _, exponent = f"{value:.6e}".partition("e")
    return float(digits) in (1.0, 2.0, 5.0) and int(exponent) >= 2
