"""Rules about the axes and the limits of joints."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import (
    Quantity,
    Term,
    Vector,
    diagnose,
)
from pupper_analysis.models.efforts import Motor, null_efforts, placeholder_efforts
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.stated.mjcf import find_element_place
from pupper_analysis.models.stated.model import (
    HINGE,
    Array,
    Joint,
    Link,
    MjcfModel,
    RobotModel,
    UrdfModel,
)
from pupper_analysis.tools.audit.registry import rule
from pupper_analysis.tools.audit.rules.mirror import find_mirror_plane, list_joint_pairs

_MOTIONS = (Term("rolls (about x)"), Term("pitches (about y)"), Term("yaws (about z)"))

_NAMES = (
    "haa|abad|abduction|adduction|hip_?roll|hx",
    "hfe|kfe|thigh|knee|calf|shank|hip_?pitch|hy",
    "hip_?yaw",
)
_PATTERNS = [re.compile(rf"(?<![a-z])(?:{names})(?![a-z])", re.IGNORECASE) for names in _NAMES]
_HIP = re.compile(r"(?<![a-z])hip(?![a-z])", re.IGNORECASE)


def infer_axis_from_name(name: str, all_names: set[str]) -> int | None:
    """Returns about which axis (0 to 2) a joint turns by its name; None if that says nothing clear.

    ``hip`` alone is the abduction where there are a ``thigh`` and a ``calf`` of the same leg.
    """
    for axis, pattern in enumerate(_PATTERNS):
        if pattern.search(name):
            return axis
    if _HIP.search(name) and {_HIP.sub("thigh", name), _HIP.sub("calf", name)} <= all_names:
        return 0
    return None


@rule
def axis_contradicts_name(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares axes at zero angles with names; an axis may be up to 60 degrees inclined."""
    mirror = find_mirror_plane(robot)
    if mirror is not None and mirror.axis != 1:
        return  # the base's y is not sideways: roll and pitch are about other axes
    names = set(robot.joints)
    for joint in robot.joints.values():
        axis = infer_axis_from_name(joint.name, names)
        if axis is None or joint.kind != HINGE or not joint.axis.any():
            continue
        if abs(joint.axis[axis]) < 0.5:
            really = int(np.argmax(np.abs(joint.axis)))
            message = diagnose(
                "axis-contradicts-name",
                named=_MOTIONS[axis],
                axis=Vector(tuple(joint.axis), "1"),
                turns=_MOTIONS[really],
            )
            yield CheckFinding("joint", joint.name, message, "axis")


@rule
def axis_zero(robot: RobotModel) -> Iterator[CheckFinding]:
    """Finds axes shorter than 1e-9."""
    for joint in robot.joints.values():
        if joint.moves and float(np.linalg.norm(joint.raw_axis)) < 1e-9:
            yield CheckFinding("joint", joint.name, diagnose("axis-zero"), "axis")


# Rules about the limits of joints.


@rule
def range_empty(robot: RobotModel) -> Iterator[CheckFinding]:
    """Finds lower >= upper, also where both are left out of a URDF, where they count as 0.

    Of an MJCF's ranges that nothing says to be off, also those of actuators: MuJoCo takes an
    inverted one for none, without a word.
    """
    for joint in robot.joints.values():
        if joint.moves and joint.lower >= joint.upper:
            lower, upper = Quantity(joint.lower, joint.unit), Quantity(joint.upper, joint.unit)
            message = diagnose("range-empty", lower=lower, upper=upper)
            yield CheckFinding("joint", joint.name, message, "limit")
    if isinstance(robot, MjcfModel) and robot.refusal is None:
        yield from _inverted(robot)


def _inverted(robot: MjcfModel) -> Iterator[CheckFinding]:
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
    """Finds joints of type continuous that state limits all the same."""
    for joint in robot.joints.values():
        lower, upper = (joint.stated.get(f"{end} limit", math.nan) for end in ("lower", "upper"))
        if joint.moves and math.isinf(joint.lower) and lower < upper:
            low, high = Quantity(lower, "rad"), Quantity(upper, "rad")
            message = diagnose("limits-without-effect", lower=low, upper=high)
            yield CheckFinding("joint", joint.name, message, "limit")


@rule
def limits_in_wrong_unit(robot: RobotModel) -> Iterator[CheckFinding]:
    """Finds limits of 12 to 400 rad, and a file in degrees with none above 2 pi.

    Limits of 10 rad are a habit of those who want none.
    """
    hinges = [
        j for j in robot.joints.values() if j.kind == HINGE and math.isfinite(j.lower + j.upper)
    ]
    for joint in hinges:
        limits = (joint.lower, joint.upper)
        if 12 <= max(map(abs, limits)) <= 400:
            lower, upper = (Quantity(value, "rad") for value in limits)
            message = diagnose("limits-look-like-degrees", lower=lower, upper=upper)
            yield CheckFinding("joint", joint.name, message, "limit")
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


@rule
def range_placeholder(robot: RobotModel) -> Iterator[CheckFinding]:
    """Finds one range of half a turn or more either way at all hinges, four or more."""
    hinges = [j for j in robot.joints.values() if j.kind == HINGE and math.isfinite(j.upper)]
    if len(hinges) < _HINGES:
        return
    upper = hinges[0].upper
    if upper >= _HALF_TURN and all(j.upper == upper and j.lower == -upper for j in hinges):
        message = diagnose("one-range-of-all", upper=Quantity(upper, "rad"), count=len(hinges))
        yield CheckFinding("joint", hinges[0].name, message, "limit")


_HINGES, _HALF_TURN = 4, 3.1
"""Fewer may be alike; 3.1 rad is the least that people write for half a turn."""


@rule
def effort_or_velocity_zero(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find limits of effort and velocity that are zero, on joints that move and mimic none.

    In an MJCF these are force ranges from 0 to 0, which MuJoCo ignores.
    """
    if isinstance(robot, MjcfModel):
        for name, empty in null_efforts(robot.file).items() if robot.refusal is None else ():
            if empty.stated == (0.0, 0.0):
                yield _zero_finding(robot, name, [Term(empty.attribute)])
        return
    for name, stated in _stated_limits(robot):
        zero = [Term(what) for what in ("effort", "velocity") if stated.get(what) == 0]
        if zero:
            yield _zero_finding(robot, name, zero)


def _zero_finding(robot: RobotModel, name: str, what: list[Term]) -> CheckFinding:
    """Return the finding of limits of zero, with the effort of the mirrored joint."""
    other = None if what == [Term("velocity")] else _mirrored_effort(robot, name)
    message = diagnose(
        "effort-or-velocity-zero",
        what=what,
        other=None if other is None else other[0],
        effort=None if other is None else Quantity(other[1], "N m"),
    )
    return CheckFinding("joint", name, message, "limit")


def _stated_limits(robot: RobotModel) -> Iterator[tuple[str, Mapping[str, float]]]:
    """Yield (joint, stated numbers) of the joints of a URDF that move and mimic none."""
    if isinstance(robot, UrdfModel):
        for name, joint in robot.file.tree.joints.items():
            if not joint.is_fixed and joint.mimic is None:
                yield name, robot.joints[name].stated


def _mirrored_effort(robot: RobotModel, name: str) -> tuple[str, float] | None:
    """Return the mirrored joint of a joint and its effort (N m); None without a positive one."""
    for _, first, second in list_joint_pairs(robot):
        for joint, other in ((first, second), (second, first)):
            if joint.name == name and 0 < other.effort < math.inf:
                return other.name, other.effort
    return None


@rule
def effort_negative(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find limits of effort and velocity below zero."""
    for name, stated in ((joint.name, joint.stated) for joint in robot.joints.values()):
        for what, unit in (("effort", "N m"), ("velocity", "rad/s")):
            value = stated.get(what, 0.0)
            if value < 0:
                limit = Quantity(value, unit)
                message = diagnose(
                    "limit-negative", what=Term(what), value=limit, size=Quantity(-value, unit)
                )
                yield CheckFinding("joint", name, message, "limit")


@rule
def effort_placeholder(robot: RobotModel) -> Iterator[CheckFinding]:
    """Finds efforts that no motor of that mass, armature or robot gives."""
    motors = []
    for joint in robot.joints.values():
        if joint.kind == HINGE:
            ends = map(robot.carrier, (joint.parent, joint.child))
            mass = sum(link.mass for end in ends for link in robot.fixed_group(end))
            armature = joint.stated.get("armature", 0.0)
            motors.append(Motor(joint.name, joint.effort, mass, armature))
    for joints, message in placeholder_efforts(motors, robot.total_mass):
        yield CheckFinding("joint", joints[0], message, "limit")


MIN_PARALLEL_COSINE, MAX_AXIS_SLOPE = 0.99, 0.3
"""Cosine of axes that count as parallel; and the most that an axis of pitch points up."""

MIN_REACHED_FRACTION = 0.75
"""Share of a knee's range in which the foot comes below the hip: of less, limits are looked at."""

NUM_KNEE_ANGLES = 61
"""Angles of a knee over its range."""


@dataclass(frozen=True, eq=False)
class Leg:
    """A hip and a knee whose axes are parallel, at zero angles in the base frame.

    Attributes:
        hip: The joint.
        knee: The next one.
        thigh: (3,) from the hip to the knee, across the axis (m).
        shank: (3,) from the knee to the next joint, or the foot, across the axis (m).
        axis: (3,) the hip's.
        knee_sign: 1 if the knee turns the same way round for the same sign, else -1.
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
        """Returns the share of a knee's range in which the foot can be straight below the hip."""
        down = np.array([0.0, 0.0, -1.0]) - self.axis * -self.axis[2]
        side = np.cross(self.axis, down)
        angles, inside, counted = np.linspace(*knee, NUM_KNEE_ANGLES), 0, 0
        for angle in self.knee_sign * angles:
            turned = _turn(self.shank, self.axis, angle) + self.thigh
            length = float(np.linalg.norm(self.thigh) + np.linalg.norm(self.shank))
            if np.linalg.norm(turned) < 0.2 * length:
                continue  # folded: the foot is at the hip, wherever that turns
            needed = -math.atan2(float(turned @ side), float(turned @ down))
            first = needed + 2 * math.pi * math.ceil((hip[0] - needed) / (2 * math.pi) - 1e-9)
            counted += 1
            inside += first <= hip[1] + 1e-9
        return inside / counted if counted else 1.0


def _turn(vector: Array, axis: Array, angle: float) -> Array:
    """Returns a vector (3,) across an axis turned about it."""
    turned: Array = math.cos(angle) * vector + math.sin(angle) * np.cross(axis, vector)
    return turned


def _across(vector: Array, axis: Array) -> Array:
    across: Array = vector - (vector @ axis) * axis
    return across


def find_legs(robot: RobotModel) -> Iterator[Leg]:
    """Yields the limbs that hang down: a hip and a knee that bend in one plane."""
    for link in robot.links.values():
        if not link.moving or link.joints[-1].kind != HINGE:
            continue
        knee = link.joints[-1]
        above = robot.links.get(robot.carrier(knee.parent))
        end = _end(robot, link)
        if above is None or not above.moving or above.joints[-1].kind != HINGE or end is None:
            continue
        hip = above.joints[-1]
        cosine = float(hip.axis @ knee.axis)
        if abs(cosine) < MIN_PARALLEL_COSINE or abs(hip.axis[2]) > MAX_AXIS_SLOPE:
            continue
        thigh, shank = (
            _across(vector, hip.axis)
            for vector in (knee.position - hip.position, end - knee.position)
        )
        lengths = [float(np.linalg.norm(vector)) for vector in (thigh, shank)]
        if min(lengths) > 0.4 * max(lengths) and _ends_low(robot, link):
            yield Leg(hip, knee, thigh, shank, hip.axis, math.copysign(1.0, cosine))


def _end(robot: RobotModel, shank: Link) -> Array | None:
    """Returns where a shank ends: at its next joint, or its foot (3,) in the base frame (m)."""
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


def _ends_low(robot: RobotModel, link: Link) -> bool:
    """Whether a link, or one that it carries, is said to be a foot, a calf or an ankle."""
    parts = (link, *robot.descendants(link.name))
    names = [part.name for part in parts]
    names += [frame.name for part in parts for frame in part.frames]
    names += [joint.name for part in parts for joint in part.joints]
    return any(map(_LEGGED.search, names))


_LEGGED = re.compile("foot|calf|shank|ankle|knee|kfe|lower_?leg|leg_|toe", re.IGNORECASE)
"""In names of what a robot stands on; arms hang down, too, and bend otherwise."""


@rule
def limits_away_from_stand(robot: RobotModel) -> Iterator[CheckFinding]:
    """Finds knees that bend away from what their hips allow: the foot does not come below the hip.

    In most of the knee's range it can, in robots that stand. Told where it could if the knee's, or
    the hip's, limits (or its axis) had the other sign.
    """
    for leg in find_legs(robot):
        hip, knee = ((joint.lower, joint.upper) for joint in (leg.hip, leg.knee))
        if not all(map(math.isfinite, (*hip, *knee))) or hip[0] >= hip[1] or knee[0] >= knee[1]:
            continue
        share = leg.compute_reached_fraction(hip, knee)
        if share >= MIN_REACHED_FRACTION:
            continue
        others = {
            leg.knee.name: leg.compute_reached_fraction(hip, (-knee[1], -knee[0])),
            leg.hip.name: leg.compute_reached_fraction((-hip[1], -hip[0]), knee),
        }
        name = max(others, key=lambda one: others[one])
        if others[name] > 0.95:
            message = diagnose(
                "limits-away-from-stand",
                share=Quantity(share, "1"),
                knee=leg.knee.name,
                turned=name,
                other=Quantity(others[name], "1"),
            )
            yield CheckFinding("joint", leg.knee.name, message, "limit")
