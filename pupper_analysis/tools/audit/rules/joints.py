"""Rules about the axes and limits of joints.

Input is the model that a file states, with joint axes and positions in the base frame at zero
angles. The limits are position ranges, efforts and velocities. `find_legs` derives hips and knees
from names, axes and lengths, for the rule that checks which stances the limits allow.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    Quantity,
    Severity,
    Term,
    Vector,
    diagnose,
)
from pupper_analysis.models.efforts import JointEffort, find_null_efforts, placeholder_efforts
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.sides import strip_sides
from pupper_analysis.models.stated.mjcf import find_element_place
from pupper_analysis.models.stated.model import (
    HINGE_JOINT,
    Joint,
    Link,
    MjcfModel,
    RobotModel,
    UrdfModel,
)
from pupper_analysis.tools.audit.registry import rule
from pupper_analysis.tools.audit.rules.mass import list_placeholder_masses
from pupper_analysis.tools.audit.rules.mirror import find_mirror_plane, list_joint_pairs

_AXIS_MOTIONS = (Term("rolls (about x)"), Term("pitches (about y)"), Term("yaws (about z)"))
"""Texts in messages for a rotation about the x, y and z axis of the base, respectively."""

_AXIS_NAMES = (
    "haa|abad|abduction|adduction|hip_?roll|hx",
    "hfe|kfe|thigh|knee|calf|shank|hip_?pitch|hy",
    "hip_?yaw",
)
"""Patterns of words in joint names that imply a rotation about x, y or z of the base, respectively.
"""

_AXIS_PATTERNS = [
    re.compile(rf"(?<![a-z])(?:{names})(?![a-z])", re.IGNORECASE) for names in _AXIS_NAMES
]
"""Regular expressions that find the words of `_AXIS_NAMES` in a joint name."""

_HIP_PATTERN = re.compile(r"(?<![a-z])hip(?![a-z])", re.IGNORECASE)
"""Regular expression that finds the word "hip" in a joint name."""


def infer_axis_from_name(name: str, all_names: set[str]) -> int | None:
    """Infer the rotation axis of a joint, x, y or z of the base frame, from the joint name.

    For example, ``hip_roll`` implies x, ``knee`` implies y, and ``hip_yaw`` implies z.

    Args:
        name: Name of the joint.
        all_names: Names of all joints.

    Returns:
        0, 1 or 2 for x, y or z; None if the name implies no axis.
    """
    for axis, pattern in enumerate(_AXIS_PATTERNS):
        if pattern.search(name):
            return axis
    if (
        _HIP_PATTERN.search(name)
        and {_HIP_PATTERN.sub("thigh", name), _HIP_PATTERN.sub("calf", name)} <= all_names
    ):
        return 0
    return None


@rule
def axis_contradicts_name(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find hinges with an axis that contradicts the name of the joint: ``knee`` implies the y axis.

    A finding is a joint axis, at zero joint angles, at more than 60 degrees from the axis x, y or z
    of the base frame that `infer_axis_from_name` derives. Robots whose y axis probably does not
    point sideways are skipped.
    """
    mirror = find_mirror_plane(robot)
    if mirror is not None and mirror.axis != 1:
        return  # the base's y is not sideways: roll and pitch are about other axes
    names = set(robot.joints)
    named = [
        (joint, axis)
        for joint in robot.joints.values()
        if (axis := infer_axis_from_name(joint.name, names)) is not None
        and joint.kind == HINGE_JOINT
        and joint.axis.any()
    ]
    agreeing = sum(bool(abs(joint.axis[axis]) >= 0.5) for joint, axis in named)
    if mirror is None and 2 * agreeing < len(named):
        return
    for joint, axis in named:
        if abs(joint.axis[axis]) < 0.5:
            really = int(np.argmax(np.abs(joint.axis)))
            message = diagnose(
                "axis-contradicts-name",
                named=_AXIS_MOTIONS[axis],
                axis=Vector(tuple(joint.axis), "1"),
                turns=_AXIS_MOTIONS[really],
            )
            yield CheckFinding("joint", joint.name, message, "axis")


@rule
def axis_zero(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find axes of hinges and slides that are shorter than 1e-9 in the file."""
    for joint in robot.joints.values():
        if joint.moves and float(np.linalg.norm(joint.raw_axis)) < 1e-9:
            yield CheckFinding("joint", joint.name, diagnose("axis-zero"), "axis")


MAX_AXIS_LENGTH_ERROR = 0.01
"""Largest difference between the length of a URDF axis and 1 that is not reported: rounding of
printed numbers, such as 0.707 0.707 0. Chosen, not tuned."""


@rule
def axis_not_unit(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find axes of moving URDF joints whose length differs from 1 by over `MAX_AXIS_LENGTH_ERROR`.

    Axes of zero are reported by another rule.
    """
    for joint in robot.joints.values():
        length = float(np.linalg.norm(joint.raw_axis))
        if joint.moves and length > 0 and abs(length - 1) > MAX_AXIS_LENGTH_ERROR:
            message = diagnose(
                "axis-not-unit", axis=Vector(tuple(joint.raw_axis), "1"), length=length
            )
            yield CheckFinding("joint", joint.name, message, "axis")


@rule
def mimic_invalid(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find joints of a URDF that mimic a missing joint, a fixed joint, or themselves.

    A cycle of several joints counts as a joint that mimics itself. The severity is WARNING if the
    leading joint is fixed, since engines read such a file.
    """
    leaders = {
        name: str(mimic.get("joint"))
        for name, joint in robot.file.tree.joints.items()
        if (mimic := joint.element.find("mimic")) is not None
    }
    for name, leader in leaders.items():
        chain, last = [leader], leader
        while last in leaders and leaders[last] not in chain:
            last = leaders[last]
            chain.append(last)
        followed = robot.joints.get(leader)
        is_fixed = followed is not None and not followed.moves
        if name in chain or followed is None or is_fixed:
            other_joints = [joint for joint in robot.joints if joint != name]
            alike = difflib.get_close_matches(leader, other_joints, n=1, cutoff=0.8)
            message = diagnose(
                "mimic-invalid",
                leader=leader,
                itself=name in chain,
                missing=followed is None,
                fixed=is_fixed,
                alike=alike[0] if followed is None and alike else None,
            )
            severity = Severity.WARNING if is_fixed else None
            yield CheckFinding("joint", name, message, "mimic", severity=severity)


@rule
def axis_sign_odd(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find a hinge of a serial chain with an axis opposite to the axes of all other hinges.

    Each axis is expressed in the frame of its joint. Short chains, and robots with hinges on
    several branches, are skipped: the sign is then often a choice.
    """
    hinges = [j for j in robot.joints.values() if j.kind == HINGE_JOINT and j.raw_axis.any()]
    if len(hinges) < MIN_CHAIN_HINGES:
        return
    last = max(hinges, key=lambda joint: len(list(robot.ancestors(joint.child))))
    chain = {last.child, *robot.ancestors(last.child)}
    if any(joint.child not in chain for joint in hinges):
        return
    axes = np.array([joint.raw_axis / np.linalg.norm(joint.raw_axis) for joint in hinges])
    for joint, axis in zip(hinges, axes, strict=True):
        opposite = np.linalg.norm(axes + axis, axis=1) < AXIS_ATOL
        if opposite.sum() == len(hinges) - 1:
            message = diagnose("axis-sign-odd", axis=Vector.rounded(axis), others=len(hinges) - 1)
            yield CheckFinding("joint", joint.name, message, "axis")


MIN_CHAIN_HINGES, AXIS_ATOL = 5, 1e-3
"""Bounds of `axis_sign_odd`: smallest number of hinges of a serial chain, and largest norm of the
sum of two unit axes that count as opposite. Chosen, not tuned."""


# Rules about the limits of joints.


@rule
def range_empty(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find position ranges of moving joints with lower >= upper.

    In an MJCF with ``limited="auto"``, MuJoCo silently ignores a range with lower > upper; such
    ranges of joints, actuators and tendons are reported, too.
    """
    for joint in robot.joints.values():
        if joint.moves and joint.lower >= joint.upper:
            lower, upper = Quantity(joint.lower, joint.unit), Quantity(joint.upper, joint.unit)
            message = diagnose("range-empty", lower=lower, upper=upper)
            yield CheckFinding("joint", joint.name, message, "limit")
    if isinstance(robot, MjcfModel) and robot.refusal is None:
        yield from _find_inverted_ranges(robot)


def _find_inverted_ranges(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Yield findings for ranges with lower > upper and ``limited="auto"``.

    Ranges of joints, actuators and tendons of an MJCF are checked.
    """
    spec, auto = robot.file.spec, mujoco.mjtLimited.mjLIMITED_AUTO
    kinds = (
        ("joint", spec.joints, (("range", "limited"), ("actfrcrange", "actfrclimited"))),
        (
            "actuator",
            spec.actuators,
            (("ctrlrange", "ctrllimited"), ("forcerange", "forcelimited")),
        ),
        ("tendon", spec.tendons, (("range", "limited"),)),
    )
    for tag, elements, pairs in kinds:
        for element in elements:
            for name, switch in pairs:
                low, high = np.array(getattr(element, name)).reshape(-1)[:2]
                if getattr(element, switch) == auto and low > high:
                    around = element.parent.name if tag == "joint" else robot.base
                    place = (
                        None if element.name else find_element_place(robot.file, element, around)
                    )
                    message = diagnose("range-inverted", attribute=name, low=low, high=high)
                    yield CheckFinding(tag, element.name, message, place=place)


@rule
def limits_without_effect(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find stated position limits that have no effect.

    Examples are limits of a URDF joint of the type ``continuous``, and ranges of an MJCF with equal
    lower and upper end, which MuJoCo ignores (severity WARNING).
    """
    for joint in robot.joints.values():
        lower, upper = (joint.stated.get(f"{end} limit", math.nan) for end in ("lower", "upper"))
        if joint.moves and math.isinf(joint.lower) and lower < upper:
            low, high = Quantity(lower, "rad"), Quantity(upper, "rad")
            message = diagnose("limits-without-effect", lower=low, upper=high)
            yield CheckFinding("joint", joint.name, message, "limit")
    if isinstance(robot, MjcfModel) and robot.refusal is None:
        yield from _find_ranges_with_equal_ends(robot.file)


def _find_ranges_with_equal_ends(file: MjcfFile) -> Iterator[CheckFinding]:
    """Yield ranges with equal ends and ``limited="auto"`` of named joints, tendons and servos.

    Servos are the actuators with a bias.
    """
    servos = [act for act in file.spec.actuators if act.biastype != mujoco.mjtBias.mjBIAS_NONE]
    for tag, elements, name, switch in (
        ("joint", file.spec.joints, "range", "limited"),
        ("tendon", file.spec.tendons, "range", "limited"),
        ("actuator", servos, "ctrlrange", "ctrllimited"),
    ):
        for element in elements:
            low, high = np.array(getattr(element, name)).reshape(-1)[:2]
            automatic = getattr(element, switch) == mujoco.mjtLimited.mjLIMITED_AUTO
            if not automatic or low != high or not element.name:
                continue
            place = file.find_attribute(tag, element.name, (name,))
            if place is not None:
                message = diagnose("range-inverted", attribute=name, low=low, high=high)
                yield CheckFinding(
                    tag, element.name, message, place=place, severity=Severity.WARNING
                )


@rule
def limits_in_wrong_unit(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find finite hinge limits that appear to be in the wrong unit.

    Limits of 12 to 400 rad are probably degrees, and larger limits if another limb has the same
    limits in radians. Smaller limits are accepted, since 10 rad is a common way to specify no
    limit. In a file in degrees, limits that are all below 2 pi degrees are probably radians.
    """
    hinges = [
        j
        for j in robot.joints.values()
        if j.kind == HINGE_JOINT and math.isfinite(j.lower + j.upper)
    ]
    for joint in () if robot.in_degrees else hinges:
        limits = (joint.lower, joint.upper)
        largest = max(map(abs, limits))
        if 12 <= largest <= 400 or (largest > 400 and _equals_other_limb(joint, hinges)):
            lower, upper = (Quantity(value, "rad") for value in limits)
            message = diagnose("limits-look-like-degrees", lower=lower, upper=upper)
            impossible = max(map(abs, limits)) >= 10 * 2 * math.pi and sum(limits) != 0
            severity = Severity.ERROR if impossible else None
            yield CheckFinding("joint", joint.name, message, "limit", severity=severity)
    if not robot.in_degrees or len(hinges) < 3:
        return
    widest = max(hinges, key=lambda j: max(abs(j.lower), abs(j.upper)))
    low, high = np.rad2deg((widest.lower, widest.upper))
    if max(abs(low), abs(high)) <= 2 * math.pi:
        message = diagnose(
            "limits-look-like-radians",
            hinges=len(hinges),
            lower=Quantity(widest.lower, "rad"),
            upper=Quantity(widest.upper, "rad"),
        )
        yield CheckFinding("joint", widest.name, message)


def _equals_other_limb(joint: Joint, hinges: Sequence[Joint]) -> bool:
    """Return True if another limb has the same joint limits, after conversion from degrees.

    The limits of ``joint`` are converted to radians, and may be negated; the relative tolerance is
    1 %.
    """
    lower, upper = np.deg2rad((joint.lower, joint.upper))
    kind = strip_sides(joint.name)
    return any(
        np.allclose(limits, (hinge.lower, hinge.upper), rtol=0.01)
        for hinge in hinges
        if hinge is not joint and strip_sides(hinge.name) == kind
        for limits in ((lower, upper), (-upper, -lower))
    )


@rule
def range_placeholder(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find robots with at least four limited hinges that all have the same symmetric range.

    The range is a finding if the upper limit is at least 3.1 rad, since the range is then probably
    a placeholder.
    """
    hinges = [j for j in robot.joints.values() if j.kind == HINGE_JOINT and math.isfinite(j.upper)]
    if len(hinges) < _MIN_HINGES:
        return
    upper = hinges[0].upper
    if upper >= _HALF_TURN and all(j.upper == upper and j.lower == -upper for j in hinges):
        message = diagnose("one-range-of-all", upper=Quantity(upper, "rad"), count=len(hinges))
        yield CheckFinding("joint", hinges[0].name, message, "limit")


_MIN_HINGES, _HALF_TURN = 4, 3.1
"""Bounds with which `range_placeholder` reports the common range of all limited hinges: smallest
number of these hinges, and smallest upper limit [rad], about half a turn. Chosen, so that 3.1 and
3.14 count."""


@rule
def effort_or_velocity_zero(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find effort and velocity limits of zero in a URDF, or force ranges from 0 to 0 in an MJCF.

    MuJoCo ignores force ranges, and control ranges of torque motors, from 0 to 0.
    """
    if isinstance(robot, MjcfModel):
        for name, empty in find_null_efforts(robot.file).items() if robot.refusal is None else ():
            if empty.stated == (0.0, 0.0) and empty.attribute != "gear":  # actuator-without-effect
                yield _make_zero_finding(robot, name, [Term(empty.attribute)])
        return
    for name, stated in _list_stated_limits(robot):
        zero = [Term(what) for what in ("effort", "velocity") if stated.get(what) == 0]
        if zero:
            yield _make_zero_finding(robot, name, zero)


def _make_zero_finding(robot: RobotModel, name: str, what: list[Term]) -> CheckFinding:
    """Create the finding of a joint with an effort or velocity limit of zero.

    ``what`` names the limits that are zero (in an MJCF the attribute).
    """
    other = None if what == [Term("velocity")] else _find_mirrored_effort(robot, name)
    message = diagnose(
        "effort-or-velocity-zero",
        what=what,
        other=None if other is None else other[0],
        effort=None if other is None else Quantity(other[1], robot.joints[name].units.effort),
    )
    return CheckFinding("joint", name, message, "limit")


def _list_stated_limits(robot: RobotModel) -> Iterator[tuple[str, Mapping[str, float]]]:
    """Yield moving URDF joints with the stated limits, {kind of parameter: number in the file}.

    Joints that mimic another joint are skipped.
    """
    if isinstance(robot, UrdfModel):
        for name, joint in robot.file.tree.joints.items():
            if not joint.is_fixed and joint.mimic is None:
                yield name, robot.joints[name].stated


def _find_mirrored_effort(robot: RobotModel, name: str) -> tuple[str, float] | None:
    """Return the mirrored joint and the effort of the mirrored joint [N m, N].

    None if there is no such joint with a positive, finite effort.
    """
    for _, first, second in list_joint_pairs(robot):
        for joint, partner in ((first, second), (second, first)):
            if joint.name == name and 0 < partner.effort < math.inf:
                return partner.name, partner.effort
    return None


@rule
def effort_negative(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find URDF effort limits [N m, N] and velocity limits [rad/s, m/s] below zero."""
    for joint in robot.joints.values():
        for what in ("effort", "velocity"):
            value, unit = joint.stated.get(what, 0.0), getattr(joint.units, what)
            if value < 0:
                limit = Quantity(value, unit)
                message = diagnose(
                    "limit-negative", what=Term(what), value=limit, size=Quantity(-value, unit)
                )
                yield CheckFinding("joint", joint.name, message, "limit")


MAX_JOINT_SPEED = 105.0
"""Largest finite velocity limit of a hinge that is not reported [rad/s], about 1000 rpm. Chosen,
not tuned."""


@rule
def velocity_implausible(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find finite velocity limits of hinges above `MAX_JOINT_SPEED`; all together are a finding."""
    fast = [
        joint
        for joint in robot.joints.values()
        if joint.kind == HINGE_JOINT
        and MAX_JOINT_SPEED < joint.stated.get("velocity", 0.0) < math.inf
    ]
    if fast:
        first = max(fast, key=lambda joint: joint.stated["velocity"])
        speed = first.stated["velocity"]
        message = diagnose(
            "velocity-implausible",
            velocity=Quantity(speed, "rad/s"),
            others=len(fast) - 1,
            degrees=Quantity(math.radians(speed), "rad/s"),
            turns=Quantity(speed * math.pi / 30, "rad/s"),
        )
        yield CheckFinding("joint", first.name, message, "limit")


MIN_MOTOR_ACCELERATION = 10.0
"""Smallest ratio of effort and armature [rad/s^2] that is not reported: the acceleration of the
rotor alone. Chosen, not tuned."""


@rule
def armature_implausible(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find hinges whose armature is too large for the effort; all such hinges are one finding.

    The effort [N m] divided by the armature [kg m^2] must be at least `MIN_MOTOR_ACCELERATION`.
    """
    slow = [
        joint
        for joint in robot.joints.values()
        if joint.kind == HINGE_JOINT
        and 0 < joint.effort < MIN_MOTOR_ACCELERATION * joint.stated.get("armature", 0.0)
    ]
    if slow:
        first = min(slow, key=lambda joint: joint.effort / joint.stated["armature"])
        armature = first.stated["armature"]
        message = diagnose(
            "armature-implausible",
            armature=Quantity(armature, "kg m^2"),
            effort=Quantity(first.effort, "N m"),
            acceleration=Quantity(first.effort / armature, "rad/s^2"),
            others=len(slow) - 1,
        )
        yield CheckFinding("joint", first.name, message)


@rule
def friction_beyond_effort(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find moving joints whose dry friction is at least the positive effort, as one finding."""
    stuck = [
        joint
        for joint in robot.joints.values()
        if joint.moves and 0 < joint.effort <= joint.stated.get("friction", 0.0)
    ]
    if stuck:
        first = stuck[0]
        message = diagnose(
            "friction-beyond-effort",
            friction=Quantity(first.stated["friction"], first.units.effort),
            effort=Quantity(first.effort, first.units.effort),
            others=len(stuck) - 1,
        )
        yield CheckFinding("joint", first.name, message)


@rule
def effort_placeholder(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find effort limits of hinges [N m] that are probably placeholders.

    For example, such limits are too large for the mass of the two bodies that the joint connects,
    for the armature, or for the mass of the robot (`placeholder_efforts`). Robots with placeholder
    masses are skipped.
    """
    if list_placeholder_masses(robot):
        return
    motors = []
    for joint in robot.joints.values():
        if joint.kind == HINGE_JOINT:
            ends = map(robot.find_moving_body, (joint.parent, joint.child))
            mass = sum(link.mass for end in ends for link in robot.fixed_group(end))
            armature = joint.stated.get("armature", 0.0)
            motors.append(JointEffort(joint.name, joint.effort, mass, armature))
    for joints, message in placeholder_efforts(motors, robot.total_mass):
        yield CheckFinding("joint", joints[0], message, "limit")


MIN_PARALLEL_COSINE, MAX_AXIS_SLOPE = 0.99, 0.3
"""Bounds with which `find_legs` accepts two joints as hip and knee: smallest absolute cosine
between both axes, and largest absolute z component of the hip's axis in the base frame. Chosen, not
tuned.
"""

MIN_REACHED_FRACTION = 0.75
"""Lower bound of the fraction of the knee range in which a hip angle within the limits puts the
foot below the hip. Below the bound, the signs of the limits are checked. Chosen, not tuned.
"""

NUM_KNEE_ANGLES = 61
"""Number of knee angles, evenly spaced over the range, at which the reach of a leg is evaluated.
Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class Leg:
    """Geometry of a leg with parallel hip and knee axes, at zero angles in the base frame.

    Attributes:
        hip: Joint of the hip.
        knee: Next joint.
        thigh: Vector from the hip to the knee, normal to the axis, shape (3,) [m].
        shank: Vector from the knee to the end of the shank (`_find_shank_end`), normal to the axis,
            shape (3,) [m].
        axis: Axis of the hip, shape (3,).
        knee_sign: 1 if hip and knee axes point the same way, otherwise -1.
    """

    hip: Joint
    knee: Joint
    thigh: Array
    shank: Array
    axis: Array
    knee_sign: float

    def compute_reached_fraction(
        self, hip: tuple[float, float], knee: tuple[float, float]
    ) -> float:
        """Compute the fraction of the knee range for which a hip angle puts the foot below the hip.

        The hip angle must be within the limits. Sampled knee angles with a folded leg (foot near
        the hip) are left out.

        Args:
            hip: Lower and upper limit of the hip [rad].
            knee: Lower and upper limit of the knee [rad].

        Returns:
            Fraction from 0 to 1; 1 if the leg is folded at all angles.
        """
        down = np.array([0.0, 0.0, -1.0]) - self.axis * -self.axis[2]
        side = np.cross(self.axis, down)
        angles, inside, counted = np.linspace(*knee, NUM_KNEE_ANGLES), 0, 0
        for angle in self.knee_sign * angles:
            turned = _rotate_vector(self.shank, self.axis, angle) + self.thigh
            length = float(np.linalg.norm(self.thigh) + np.linalg.norm(self.shank))
            if np.linalg.norm(turned) < 0.2 * length:
                continue  # folded: the foot stays at the hip for all hip angles
            needed = -math.atan2(float(turned @ side), float(turned @ down))
            first = needed + 2 * math.pi * math.ceil((hip[0] - needed) / (2 * math.pi) - 1e-9)
            counted += 1
            inside += first <= hip[1] + 1e-9
        return inside / counted if counted else 1.0


def _rotate_vector(vector: Array, axis: Array, angle: float) -> Array:
    """Rotate a vector, shape (3,), about a unit axis normal to the vector, by an angle [rad]."""
    turned: Array = math.cos(angle) * vector + math.sin(angle) * np.cross(axis, vector)
    return turned


def _project_across(vector: Array, axis: Array) -> Array:
    """Return the component of a vector, shape (3,), perpendicular to a unit axis."""
    across: Array = vector - (vector @ axis) * axis
    return across


def find_legs(robot: RobotModel) -> Iterator[Leg]:
    """Yield the legs of a robot (hip, knee, lengths), found by names, joint axes and lengths.

    Hip and knee axes must be parallel and nearly horizontal, thigh and shank of comparable length.
    """
    for link in robot.links.values():
        if not link.moving or link.joints[-1].kind != HINGE_JOINT:
            continue
        knee = link.joints[-1]
        above = robot.links.get(robot.find_moving_body(knee.parent))
        end = _find_shank_end(robot, link)
        if above is None or not above.moving or above.joints[-1].kind != HINGE_JOINT or end is None:
            continue
        hip = above.joints[-1]
        cosine = float(hip.axis @ knee.axis)
        if abs(cosine) < MIN_PARALLEL_COSINE or abs(hip.axis[2]) > MAX_AXIS_SLOPE:
            continue
        thigh, shank = (
            _project_across(vector, hip.axis)
            for vector in (knee.position - hip.position, end - knee.position)
        )
        lengths = [float(np.linalg.norm(vector)) for vector in (thigh, shank)]
        if min(lengths) > 0.4 * max(lengths) and _is_leg(robot, link):
            yield Leg(hip, knee, thigh, shank, hip.axis, math.copysign(1.0, cosine))


def _find_shank_end(robot: RobotModel, shank: Link) -> Array | None:
    """Return the end of a shank in the base frame, shape (3,) [m]; None if unknown.

    The end is the next joint, or else the most distant fixed link, frame or sphere.
    """
    group = robot.fixed_group(shank.name)
    moving = [c for part in group for c in robot.children(part.name) if c.moving]
    if len(moving) == 1:
        return moving[0].joints[0].position
    if moving:
        return None
    points = [part.pose.position for part in group if part is not shank]
    points += [part.pose.point(f.position) for part in group for f in part.frames]
    points += [p.pose.point(s.pose.position) for p in group for s in p.shapes if s.kind == "sphere"]
    start = shank.joints[-1].position
    return max(points, key=lambda p: float(np.linalg.norm(p - start)), default=None)


def _is_leg(robot: RobotModel, link: Link) -> bool:
    """Return True if a link or a descendant, or a frame or joint of these, is named like a leg."""
    parts = (link, *robot.descendants(link.name))
    names = [part.name for part in parts]
    names += [frame.name for part in parts for frame in part.frames]
    names += [joint.name for part in parts for joint in part.joints]
    return any(map(_LEG_PATTERN.search, names))


_LEG_PATTERN = re.compile("foot|calf|shank|ankle|knee|kfe|lower_?leg|leg_|toe", re.IGNORECASE)
"""Parts of names of links, joints and frames by which `_is_leg` distinguishes legs from arms."""


@rule
def limits_away_from_stand(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find legs whose hip or knee limits probably have the wrong sign.

    The test uses the fraction of the knee range in which a hip angle within the limits puts the
    foot below the hip. With the stated limits, the fraction is below `MIN_REACHED_FRACTION`. With
    the opposite sign of the knee limits, or of the hip limits, the fraction is above 95 %.
    """
    for leg in find_legs(robot):
        hip, knee = ((joint.lower, joint.upper) for joint in (leg.hip, leg.knee))
        if not all(map(math.isfinite, (*hip, *knee))) or hip[0] >= hip[1] or knee[0] >= knee[1]:
            continue
        fraction = leg.compute_reached_fraction(hip, knee)
        if fraction >= MIN_REACHED_FRACTION:
            continue
        fractions = {
            leg.knee.name: leg.compute_reached_fraction(hip, (-knee[1], -knee[0])),
            leg.hip.name: leg.compute_reached_fraction((-hip[1], -hip[0]), knee),
        }
        name = max(fractions, key=lambda joint_name: fractions[joint_name])
        if fractions[name] > 0.95:
            message = diagnose(
                "limits-away-from-stand",
                share=Quantity(fraction, "1"),
                knee=leg.knee.name,
                turned=name,
                other=Quantity(fractions[name], "1"),
            )
            yield CheckFinding("joint", leg.knee.name, message, "limit")
