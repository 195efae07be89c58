"""Torque limits of motors at the joints, from all statements of a URDF and an MJCF.

A torque limit has four possible sources:

- ``effort`` in the URDF;
- ``actuatorfrcrange`` of the joint or tendon in the MJCF;
- ``forcerange`` of an actuator in the MJCF, times the gear;
- ``ctrlrange`` of a torque motor in the MJCF, times gain and gear.

MuJoCo clamps a torque by all limits of the MJCF in sequence, so the smallest limit counts. The
limits of several actuators at a joint are added.

A limit of zero means a motor without torque, and a negative limit is an error (`EffortCode`). If no
file states a limit for a joint, the limit is unknown: the motor is not unlimited.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import EARTH_GRAVITY, EFFORT_UNIT, select_joint_units
from pupper_analysis.models.attributes import MIN_UNSTATED_LIMIT
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.transmission import (
    actuator_gear,
    fixed_tendon_levers,
    list_joint_actuators,
)

if TYPE_CHECKING:
    from pupper_analysis.models.mjcf_file import MjcfFile

_BOUNDED_DYNAMICS = (
    mujoco.mjtDyn.mjDYN_NONE.value,
    mujoco.mjtDyn.mjDYN_FILTER.value,
    mujoco.mjtDyn.mjDYN_FILTEREXACT.value,
)
"""Actuator dynamics (``dyntype``) with which the control range counts as a bound of the force."""


MIN_EFFORT = 1e-6
"""Lower bound of the torque limit [N m, N] of a motor. A smaller limit in a file counts as zero,
for example 1e-9 as a placeholder. Chosen: a hundredth of the torque of the smallest geared motors,
1e-4 N m.
"""


class EffortCode(StrEnum):
    """Kind of a joint's torque limit: stated by a file, zero, negative, or unknown."""

    STATED = "stated"
    ZERO = "zero"
    NEGATIVE = "negative"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class EffortStatement(Result):
    """Torque limit of a joint's motor as stated by a single attribute of a file.

    Attributes:
        file: ``URDF`` or ``MJCF``; ``""`` for a requested limit that replaces the files' limits.
        element: ``joint``, ``actuator`` or ``tendon``.
        name: Name of the element; names of several actuators at a joint are separated by commas.
        attribute: ``effort``, ``actuatorfrcrange``, ``forcerange`` or ``ctrlrange``; ``gear`` if
            the gear is 0.
        stated: Lower and upper end of the range in the file. For an effort, -effort and effort. For
            several actuators, the sum at the joint.
        factor: Torque at the joint per unit of ``stated``. For an actuator, the gear; for a
            ``ctrlrange``, times the gain; at a tendon, times the coefficient of the joint. 1 for a
            joint, for the sum of several actuators, and for an empty range.
        lower: Lower end at the joint (N m or N).
        upper: Upper end at the joint (N m or N).
    """

    file: str
    element: str
    name: str
    attribute: str
    stated: tuple[float, float] = field(metadata={"unit": "varies"})
    factor: float = field(metadata={"unit": "varies"})
    lower: float = field(metadata={"unit": EFFORT_UNIT})
    upper: float = field(metadata={"unit": EFFORT_UNIT})

    @staticmethod
    def of(
        file: str,
        element: str,
        name: str,
        attribute: str,
        stated: Sequence[float],
        factor: float = 1.0,
    ) -> EffortStatement:
        """Create the torque limit that one attribute of a file states, converted to the joint.

        Args:
            file: ``URDF`` or ``MJCF``; ``""`` for a requested limit.
            element: ``joint``, ``actuator`` or ``tendon``.
            name: Name of the element.
            attribute: Attribute with the range.
            stated: Lower and upper end in the file.
            factor: Torque at the joint per unit of ``stated``.
        """
        low, high = (float(end) for end in stated)
        ends = sorted((factor * low, factor * high))
        return EffortStatement(file, element, name, attribute, (low, high), factor, *ends)

    @staticmethod
    def empty(
        file: str, element: str, name: str, attribute: str, stated: Sequence[float]
    ) -> EffortStatement:
        """Create the torque limit that a file states by an empty range: no torque at the joint.

        Args:
            file: ``URDF`` or ``MJCF``.
            element: ``joint`` or ``actuator``.
            name: Name of the element.
            attribute: Attribute with the range.
            stated: Lower and upper end in the file, equal or inverted.
        """
        low, high = (float(end) + 0.0 for end in stated)  # + 0.0: no -0.0
        return EffortStatement(file, element, name, attribute, (low, high), 1.0, 0.0, 0.0)

    def scaled(self, factor: float) -> EffortStatement:
        """Convert this force limit by a gear or lever arm to a joint torque limit; return a copy.

        Args:
            factor: Torque at the joint per unit of the present torque or force; may be negative.
        """
        lower, upper = sorted((factor * self.lower + 0.0, factor * self.upper + 0.0))  # no -0.0
        return replace(self, factor=factor * self.factor, lower=lower, upper=upper)

    @property
    def max_torque(self) -> float:
        """Largest torque or force at the joint that the range permits in any direction [N m, N]."""
        return max(abs(self.lower), abs(self.upper))

    @property
    def symmetric_torque(self) -> float:
        """Largest torque or force that the range permits in both directions [N m, N], or 0."""
        return max(0.0, min(-self.lower, self.upper))

    @property
    def effort(self) -> float:
        """Effort of a URDF that permits no torque beyond this range [N m, N].

        The effort is the smaller end of the range. If the range permits torque in one direction
        only, the effort is the larger end.
        """
        return self.symmetric_torque or self.max_torque


@dataclass(frozen=True)
class EffortLimit(Result):
    """Torque limit of a joint, resolved from all statements of the URDF and the MJCF.

    Attributes:
        joint: Name of the joint.
        lower: Lower end of the range of torque or force (N m or N); -inf without a limit.
        upper: Upper end of the range of torque or force (N m or N); inf without a limit.
        origin: Statement with the smallest limit; None without a limit.
        stated: Statements from which the limit was resolved.
        unit: Unit of ``lower`` and ``upper``: N m for a hinge, N for a slide.
        code: Meaning of the limit: ``unknown`` if no file states a limit, ``zero`` and ``negative``
            if the motor has no torque, else ``stated``.
    """

    _reported: ClassVar[tuple[str, ...]] = ("code",)

    joint: str
    lower: float = field(metadata={"unit": EFFORT_UNIT})
    upper: float = field(metadata={"unit": EFFORT_UNIT})
    origin: EffortStatement | None
    stated: tuple[EffortStatement, ...]
    unit: str

    @property
    def code(self) -> EffortCode:
        """Meaning of this torque limit: stated, zero, negative, or unknown.

        A limit that permits less than `MIN_EFFORT` in each direction is zero, or negative if the
        lower end of the range in the file is above the upper end.
        """
        if self.origin is None:
            return EffortCode.UNKNOWN
        if max(-self.lower, self.upper) >= MIN_EFFORT:
            return EffortCode.STATED
        low, high = self.origin.stated
        return EffortCode.NEGATIVE if low > high else EffortCode.ZERO

    @property
    def without_torque(self) -> bool:
        """Whether the limit is zero or negative, so that the motor exerts no torque."""
        return self.code in (EffortCode.ZERO, EffortCode.NEGATIVE)

    def without_file(self, file: str) -> EffortLimit:
        """Return a copy without the statements of a generated file, so that reports do not cite it.

        If the range of the limit would change, this limit is returned unchanged.

        Args:
            file: Type of the generated file, ``URDF`` or ``MJCF``.
        """
        other_statements = tuple(statement for statement in self.stated if statement.file != file)
        origin = min(
            other_statements, key=lambda statement: statement.symmetric_torque, default=None
        )
        lower = max((statement.lower for statement in other_statements), default=-math.inf)
        upper = min((statement.upper for statement in other_statements), default=math.inf)
        if not (math.isclose(lower, self.lower) and math.isclose(upper, self.upper)):
            return self
        return replace(self, origin=origin, stated=other_statements)

    @property
    def positive_statement(self) -> EffortStatement | None:
        """Smallest of the stated limits that permit torque in both directions; None without one."""
        positive = [statement for statement in self.stated if statement.symmetric_torque > 0]
        return min(positive, key=lambda statement: statement.symmetric_torque, default=None)

    @property
    def symmetric_torque(self) -> float:
        """Largest torque that the limit permits in both directions [N m, N]; infinite if unknown.

        A value below `MIN_EFFORT` counts as 0.
        """
        torque = min(-self.lower, self.upper)
        return torque if torque >= MIN_EFFORT else 0.0


def resolve_effort_limit(
    model: mujoco.MjModel,
    joint: int,
    effort: float | None = None,
    *,
    name: str = "",
    drives: Sequence[int] | None = None,
    empty_range: EffortStatement | None = None,
) -> EffortLimit:
    """Return the torque limit of a joint: the intersection of the ranges in URDF and MJCF.

    Args:
        model: MuJoCo model of the MJCF.
        joint: Id of a hinge or slide.
        effort: Effort of the URDF's joint [N m; N for a slide]; None or at least
            ``MIN_UNSTATED_LIMIT`` if unknown.
        name: Name of the joint in the URDF. Default: as in the MJCF.
        drives: Ids of the actuators of the joint. Default: determined from the model.
        empty_range: Force range of the joint in the MJCF that permits no force (``null_efforts``),
            which the compiled model does not contain.
    """
    own = str(model.joint(joint).name)
    drives = list_joint_actuators(model, joint) if drives is None else drives
    stated = _list_statements(model, joint, drives)
    if empty_range is not None:
        stated.insert(0, empty_range)  # as the origin, if a gear of 0 scales other ranges to 0
    if effort is not None and effort < MIN_UNSTATED_LIMIT:
        # First, so that of two equal limits the one of the URDF is the origin.
        range_ = (-effort, effort)
        make = EffortStatement.of if effort > 0 else EffortStatement.empty
        stated.insert(0, make("URDF", "joint", name or own, "effort", range_))
    return EffortLimit(
        joint=name or own,
        lower=max((statement.lower for statement in stated), default=-math.inf),
        upper=min((statement.upper for statement in stated), default=math.inf),
        origin=min(stated, key=lambda statement: statement.symmetric_torque, default=None),
        stated=tuple(stated),
        unit=select_joint_units(slides=model.jnt_type[joint] == JointKind.SLIDE).effort,
    )


def _list_statements(
    model: mujoco.MjModel, joint: int, drives: Sequence[int]
) -> list[EffortStatement]:
    """Return the torque limits at a joint [N m, N] that an MJCF states: on joint and actuators.

    Ranges of several actuators are added if each actuator has one. ``drives`` are the ids of the
    actuators. Without actuators, an actuator at a fixed tendon counts.
    """
    statements = read_joint_effort(model, joint)
    if not drives:
        return statements + _read_tendon_efforts(model, joint)
    if len(drives) == 1:
        return statements + read_actuator_efforts(model, drives[0])
    by_drive = [read_actuator_efforts(model, actuator) for actuator in drives]
    if drives and all(by_drive):
        lower = sum(max(statement.lower for statement in own) for own in by_drive)
        upper = sum(min(statement.upper for statement in own) for own in by_drive)
        names = ", ".join(own[0].name for own in by_drive)
        least = min(by_drive[0], key=lambda statement: statement.symmetric_torque)
        statements.append(
            EffortStatement.of("MJCF", "actuator", names, least.attribute, (lower, upper))
        )
    return statements


def _read_tendon_efforts(model: mujoco.MjModel, joint: int) -> list[EffortStatement]:
    """Return the torque limits [N m, N] at a joint from a single actuator at a fixed tendon."""
    levers = fixed_tendon_levers(model)
    actuators = [actuator for actuator, by_joint in levers.items() if joint in by_joint]
    if len(actuators) != 1:
        return []
    lever = levers[actuators[0]][joint]
    return [limit.scaled(lever) for limit in read_tendon_forces(model, actuators[0])]


def read_tendon_forces(model: mujoco.MjModel, actuator: int) -> list[EffortStatement]:
    """Return the force limits of an actuator at a tendon, before the gear [N or N m].

    A force range of the tendon is included only for a single actuator, because it limits the sum.
    """
    found = _read_actuator_forces(model, actuator)
    tendon = int(model.actuator_trnid[actuator, 0])
    at_tendons = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON.value
    is_alone = np.count_nonzero(at_tendons & (model.actuator_trnid[:, 0] == tendon)) == 1
    name, range_ = str(model.tendon(tendon).name), model.tendon_actfrcrange[tendon]
    if model.tendon_actfrclimited[tendon] and is_alone and not _is_unstated(range_):
        found.append(EffortStatement.of("MJCF", "tendon", name, "actuatorfrcrange", range_))
    return found


def find_null_efforts(file: MjcfFile) -> dict[str, EffortStatement]:
    """Find the joints of an MJCF whose actuators exert no force, or whose force range is empty.

    An actuator exerts no force if its gear is 0, or if its force or control range is empty: both
    ends are equal, or inverted. MuJoCo ignores an empty range without a message, so the compiled
    model has no limit for the joint.

    Returns:
        {joint: statement with the empty range of the joint, or of its first actuator}.
    """
    unknown = file.unknown.get("effort", ())  # if converted from another format
    found: dict[str, EffortStatement] = {}
    by_joint: dict[str, list[EffortStatement | None]] = {}
    axes = {joint.name: _GEAR_LENGTHS.get(joint.type, 1) for joint in file.spec.joints}
    for actuator in file.spec.actuators:
        if actuator.trntype in _JOINT_TRANSMISSIONS:
            empty = _find_empty_range(file, actuator, axes.get(actuator.target, 1))
            by_joint.setdefault(actuator.target, []).append(empty)
    for joint, statements in by_joint.items():
        first = statements[0]
        if first is not None and all(statements):  # several actuators add up
            found[joint] = first
    for joint in file.spec.joints:
        name, range_ = joint.name, joint.actfrcrange
        switch = joint.actfrclimited
        if name in unknown:
            continue
        if name and _is_empty(file, "joint", name, "actuatorfrcrange", range_, switch):
            found[name] = EffortStatement.empty("MJCF", "joint", name, "actuatorfrcrange", range_)
    return found


_JOINT_TRANSMISSIONS = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
"""Transmissions of actuators that act on a single joint, in an ``MjSpec``."""


_GEAR_LENGTHS = {mujoco.mjtJoint.mjJNT_BALL: 3, mujoco.mjtJoint.mjJNT_FREE: 6}
"""{type of a joint: number of the values of ``gear`` that act on the joint}, if not 1."""


def _find_empty_range(
    file: MjcfFile, actuator: mujoco.MjsActuator, axes: int
) -> EffortStatement | None:
    """Return the range of an actuator that permits no force, or its gear of 0; None without one.

    The first ``axes`` values of the gear act on the joint.
    """
    name = actuator.name or actuator.target
    if not np.any(actuator.gear[:axes]):
        return EffortStatement.empty("MJCF", "actuator", name, "gear", (0.0, 0.0))
    ranges = [("forcerange", actuator.forcerange, actuator.forcelimited)]
    if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE and actuator.gainprm[0] != 0:
        ranges.append(("ctrlrange", actuator.ctrlrange, actuator.ctrllimited))
    for attribute, range_, switch in ranges:
        ends = np.ravel(range_)[:2].tolist()
        if _is_empty(file, "actuator", name, attribute, ends, switch):
            return EffortStatement.empty("MJCF", "actuator", name, attribute, ends)
    return None


def _is_empty(
    file: MjcfFile, kind: str, name: str, attribute: str, range_: Sequence[float], limited: int
) -> bool:
    """Return True if an MJCF states a force or control range without numbers between its ends.

    False if ``limited``, MuJoCo's flag for the range, is not "auto".
    """
    low, high = (float(end) for end in range_)
    if limited != mujoco.mjtLimited.mjLIMITED_AUTO or low < high:
        return False
    return low > high or file.find_attribute(kind, name, (attribute,)) is not None


def read_joint_effort(model: mujoco.MjModel, joint: int) -> list[EffortStatement]:
    """Return the torque limit that ``actuatorfrcrange`` of a joint states, as a list.

    The list is empty if there is no limit, or the limit is `_is_unstated`, as of MuJoCo's import of
    a URDF without effort.
    """
    name, range_ = str(model.joint(joint).name), model.jnt_actfrcrange[joint]
    if _is_unstated(range_) or not model.jnt_actfrclimited[joint]:
        return []
    return [EffortStatement.of("MJCF", "joint", name, "actuatorfrcrange", range_)]


def find_effort(model: mujoco.MjModel, joint: int) -> float:
    """Return the effort limit of a joint of an MJCF, as a URDF states it [N m, N].

    Returns:
        Smaller magnitude of the limits in both directions, which bounds motor utilisations. If the
        actuators exert torque in one direction only, the larger magnitude. Infinite without limit.
    """
    limit = resolve_effort_limit(model, joint)
    if not math.isfinite(limit.lower) or not math.isfinite(limit.upper):
        return math.inf
    return limit.symmetric_torque or max(abs(limit.lower), abs(limit.upper))


def read_actuator_efforts(model: mujoco.MjModel, actuator: int) -> list[EffortStatement]:
    """Return the torque limits at the joint [N m, N] that attributes of an actuator state."""
    gear = float(actuator_gear(model, actuator)[0])
    return [limit.scaled(gear) for limit in _read_actuator_forces(model, actuator)]


def _read_actuator_forces(model: mujoco.MjModel, actuator: int) -> list[EffortStatement]:
    """Return the limits of an actuator's force that the file states, before the gear [N or N m].

    Ranges from -``MIN_UNSTATED_LIMIT`` to ``MIN_UNSTATED_LIMIT`` or more are omitted.
    """
    found, name = [], str(model.actuator(actuator).name)
    range_ = model.actuator_forcerange[actuator]
    if model.actuator_forcelimited[actuator] and not _is_unstated(range_):
        found.append(EffortStatement.of("MJCF", "actuator", name, "forcerange", range_))
    plain = (
        model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE.value
        and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED.value
        and model.actuator_dyntype[actuator] in _BOUNDED_DYNAMICS
    )
    control = int(model.actuator_ctrladr[actuator])
    if plain and model.actuator_ctrllimited[control]:
        factor, range_ = model.actuator_gainprm[actuator, 0], model.actuator_ctrlrange[control]
        statement = EffortStatement.of("MJCF", "actuator", name, "ctrlrange", range_, float(factor))
        if not _is_unstated((statement.lower, statement.upper)):
            found.append(statement)
    return found


def _is_unstated(range_: Sequence[float]) -> bool:
    """Return True if both ends of a range of torque or force are so large that it is no limit."""
    low, high = range_
    return bool(low <= -MIN_UNSTATED_LIMIT and high >= MIN_UNSTATED_LIMIT)


MAX_TORQUE_PER_LINK_MASS = 250.0
"""Torque limit of a joint, divided by the mass of its two links [N m/kg], above which a round
effort counts as a placeholder, except for very light links. Chosen: the best geared motors have 150
N m per kg of motor, and none of 1500 joints with the motor in one of the two links is above 117.
"""

MAX_TORQUE_PER_ROBOT_MASS = 90.0
"""Sum of torque limits per mass of the robot [N m/kg] above which these limits count as
placeholders. Chosen: 150 N m per kg of motor, with motors of at most six tenths of the mass, give
90. Robots in use have 2 to 55.
"""

MAX_ROTOR_ACCELERATION = 1e5
"""Acceleration of a rotor without load, effort / armature [rad/s^2], above which the effort counts
as a placeholder. Chosen above the values of robots in use, 350 to 25,000.
"""


MIN_OUTLIER_RATIO = 5.0
"""Ratio [1] of a round effort to the next smaller effort of the robot, from which the effort counts
as a placeholder. Further conditions are `MIN_OUTLIER_LEVER` and `MAX_OUTLIER_SHARE`. Chosen; robots
in use reach the ratio with wrists or fingers as the other joints: 7.3 (Panda), 5.4 (UR5)."""

MIN_OUTLIER_LEVER = 0.6
"""Lower bound of effort / weight of the robot [m], a lever arm, with which an effort far above the
other efforts counts as a placeholder. Chosen: walking robots in use have 0.1 to 0.5 m."""

MAX_OUTLIER_SHARE = 1 / 3
"""Upper bound of the fraction [1] of joints with efforts far above the other efforts, with which
these efforts count as placeholders. Chosen: arms have large motors in half of the joints, for
example 3 of 6 (UR5), 4 of 7 (Panda)."""


@dataclass(frozen=True)
class JointEffort:
    """Effort of a hinge, with the mass and armature to which the effort is compared.

    Attributes:
        joint: Name of a hinge.
        effort: Stated torque limit [N m].
        mass: Mass [kg] of the two links that the joint connects, with links fixed to them. One of
            the two contains the motor.
        armature: Rotor inertia at the joint [kg m^2]; 0 if not stated.
    """

    joint: str
    effort: float
    mass: float
    armature: float = 0.0


def placeholder_efforts(
    motors: Sequence[JointEffort], total: float
) -> Iterator[tuple[tuple[str, ...], Diagnostic]]:
    """Yield the torque limits of hinges that are probably placeholders.

    A round effort (`is_placeholder_number`) is compared with the mass of the joint's two links
    (`MAX_TORQUE_PER_LINK_MASS`) and with the smaller efforts (`MIN_OUTLIER_RATIO`). Each effort is
    compared with the armature (`MAX_ROTOR_ACCELERATION`). The sum of the other efforts is compared
    with the mass of the robot (`MAX_TORQUE_PER_ROBOT_MASS`).

    Args:
        motors: Hinges with their torque limits.
        total: Mass of the robot [kg].

    Yields:
        (names of joints, diagnostic about their efforts).
    """
    stated = [motor for motor in motors if 0 < motor.effort < math.inf]
    found: dict[tuple[str, float], list[JointEffort]] = {}
    for motor in stated:
        weighed = motor.mass > 1e-3 * total and motor.effort > MAX_TORQUE_PER_LINK_MASS * motor.mass
        if weighed and is_placeholder_number(motor.effort):
            found.setdefault(("effort-beyond-links", motor.effort), []).append(motor)
        elif motor.armature > 0 and motor.effort > MAX_ROTOR_ACCELERATION * motor.armature:
            found.setdefault(("effort-beyond-armature", motor.effort), []).append(motor)
    for (code, effort), several in found.items():
        names, limit = tuple(motor.joint for motor in several), Quantity(effort, "N m")
        if code == "effort-beyond-links":
            mass = Quantity(min(motor.mass for motor in several), "kg")
            message = diagnose("effort-beyond-links", more=names[1:], effort=limit, mass=mass)
        else:
            armature = min(motor.armature for motor in several)
            message = diagnose(
                "effort-beyond-armature",
                more=names[1:],
                effort=limit,
                armature=Quantity(armature, "kg m^2"),
                quick=effort / armature,
            )
        yield names, message
    named = {motor.joint for several in found.values() for motor in several}
    rest = [motor for motor in stated if motor.joint not in named]
    for several, message in _find_outliers(rest, total):
        yield tuple(motor.joint for motor in several), message
        rest = [motor for motor in rest if motor not in several]
    share = sum(motor.effort for motor in rest) / total if total > 0 else 0.0
    if share > MAX_TORQUE_PER_ROBOT_MASS:
        rest.sort(key=lambda motor: -motor.effort / max(motor.mass, 1e-3 * total))
        efforts = [motor.effort for motor in rest]
        names = tuple(motor.joint for motor in rest)
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


def _find_outliers(
    motors: Sequence[JointEffort], total: float
) -> Iterator[tuple[list[JointEffort], Diagnostic]]:
    """Yield the motors with a round effort far above all smaller efforts, and a diagnostic.

    See `MIN_OUTLIER_RATIO`, `MIN_OUTLIER_LEVER` and `MAX_OUTLIER_SHARE`. ``total`` is the mass of
    the robot [kg].
    """
    weight = EARTH_GRAVITY * total
    efforts = sorted({motor.effort for motor in motors})
    for smaller, effort in pairwise(efforts):
        equal = [motor for motor in motors if motor.effort == effort]
        is_far = effort >= MIN_OUTLIER_RATIO * smaller and effort >= MIN_OUTLIER_LEVER * weight
        is_rare = len(equal) <= MAX_OUTLIER_SHARE * len(motors)
        if is_far and is_rare and weight > 0 and is_placeholder_number(effort):
            yield (
                equal,
                diagnose(
                    "effort-beyond-others",
                    more=[motor.joint for motor in equal[1:]],
                    effort=Quantity(effort, "N m"),
                    smaller=Quantity(smaller, "N m"),
                    weight=Quantity(weight, "N"),
                    lever=Quantity(effort / weight, "m"),
                ),
            )


def is_placeholder_number(value: float) -> bool:
    """Return True for 1, 2 or 5 times a power of ten from 100 on: a probable placeholder."""
    digits, _, exponent = f"{value:.6e}".partition("e")
    return float(digits) in (1.0, 2.0, 5.0) and int(exponent) >= 2
