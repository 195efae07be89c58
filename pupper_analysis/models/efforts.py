"""What a motor can give at its joint, by all that two files state of it.

A limit of torque has four homes: the URDF's ``effort``, and in an MJCF the joint's
``actuatorfrcrange``, an actuator's ``forcerange`` times its gear, and the ``ctrlrange`` of a plain
motor times its gain and gear. MuJoCo cuts a torque by all of them, one after the other, so the
least counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco

from pupper_analysis.models.transmission import actuator_gear, drives_of
from pupper_analysis.results import Result

_EFFORT_TOLERANCE = 1e-6
"""Relative: numbers that a file rounds to seven digits are one."""

_HOLDING = (
    mujoco.mjtDyn.mjDYN_NONE.value,
    mujoco.mjtDyn.mjDYN_FILTER.value,
    mujoco.mjtDyn.mjDYN_FILTEREXACT.value,
)
"""Dynamics through which a force is never more than that of the greatest command."""


@dataclass(frozen=True)
class EffortStatement(Result):
    """One place where a file says what a joint's motor can give.

    Attributes:
        file: ``URDF`` or ``MJCF``.
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
    stated: tuple[float, float]
    factor: float
    lower: float
    upper: float

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
        stated: All statements of both files. One of 0 in a URDF is none.
        gear: By what the URDF's effort was multiplied, where it is the motor's before the gear.
    """

    joint: str
    lower: float
    upper: float
    origin: EffortStatement | None
    stated: tuple[EffortStatement, ...]
    gear: float = 1.0

    @property
    def least(self) -> float:
        """What it can give either way (N m)."""
        return max(0.0, min(-self.lower, self.upper))


def effort_of(
    model: mujoco.MjModel, joint: int, effort: float | None = None, *, name: str = ""
) -> EffortLimit:
    """Returns what a joint's motor can give by both files.

    Args:
        model: MuJoCo's model of the MJCF.
        joint: The id of a hinge or slide in it.
        effort: The URDF's for the joint (N m); None or 0 where it does not say, as exporters do.
        name: The joint's in the URDF; by default as in the MJCF.
    """
    own, drives, gear = str(model.joint(joint).name), drives_of(model, joint), 1.0
    stated = _stated(model, joint, drives)
    if effort is not None and 0 < effort < math.inf:
        gear = _gear_left_out(model, drives, stated, effort) or 1.0
        # First: of two that say the same, the one that says it of the joint.
        range_ = (-effort, effort)
        stated.insert(0, EffortStatement.of("URDF", "joint", name or own, "effort", range_, gear))
    return EffortLimit(
        joint=name or own,
        lower=max((one.lower for one in stated), default=-math.inf),
        upper=min((one.upper for one in stated), default=math.inf),
        origin=min(stated, key=lambda one: one.least, default=None),
        stated=tuple(stated),
        gear=gear,
    )


def _stated(model: mujoco.MjModel, joint: int, drives: Sequence[int]) -> list[EffortStatement]:
    """Returns what an MJCF states of a joint's effort, each worked out at the joint.

    Several actuators at a joint add up: what bounds their sum is one statement.
    """
    found = stated_by_joint(model, joint)
    if len(drives) == 1:
        return found + stated_by_actuator(model, drives[0])
    each = [stated_by_actuator(model, actuator) for actuator in drives]
    if drives and all(each):
        lower = sum(max(one.lower for one in own) for own in each)
        upper = sum(min(one.upper for one in own) for own in each)
        names = ", ".join(own[0].name for own in each)
        least = min(each[0], key=lambda one: one.least)
        found.append(EffortStatement.of("MJCF", "actuator", names, least.attribute, (lower, upper)))
    return found


def stated_by_joint(model: mujoco.MjModel, joint: int) -> list[EffortStatement]:
    """Returns what a joint's own attribute states."""
    if not model.jnt_actfrclimited[joint]:
        return []
    name, range_ = str(model.joint(joint).name), model.jnt_actfrcrange[joint]
    return [EffortStatement.of("MJCF", "joint", name, "actuatorfrcrange", range_)]


def effort_limit(model: mujoco.MjModel, joint: int) -> float:
    """Returns the greatest force or torque that a joint's actuators can give; inf if unlimited."""
    limit = effort_of(model, joint)
    return max(abs(limit.lower), abs(limit.upper))


def gear_left_out(model: mujoco.MjModel, joint: int, effort: float) -> float | None:
    """Returns the gear by which a URDF's effort falls short of its joint's; None if it does not.

    A URDF's effort is the joint's; some have the motor's, before its gear. So it is where one of
    the MJCF's limits is that of the URDF times the gear exactly: Cassie's hip has an effort of
    4.5 N m, a ``ctrlrange`` of 4.5 and a gear of 25.

    Args:
        model: MuJoCo's model of the MJCF.
        joint: The id of a hinge or slide in it.
        effort: The URDF's (N m).
    """
    drives = drives_of(model, joint)
    return _gear_left_out(model, drives, _stated(model, joint, drives), effort)


def _gear_left_out(
    model: mujoco.MjModel, drives: Sequence[int], stated: Sequence[EffortStatement], effort: float
) -> float | None:
    if len(drives) != 1 or not effort > 0:
        return None
    gear = abs(float(actuator_gear(model, drives[0])[0]))
    if abs(gear - 1.0) <= _EFFORT_TOLERANCE:
        return None
    same = any(
        math.isclose(gear * effort, one.greatest, rel_tol=_EFFORT_TOLERANCE) for one in stated
    )
    return gear if same else None


def stated_by_actuator(model: mujoco.MjModel, actuator: int) -> list[EffortStatement]:
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
