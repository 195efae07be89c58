"""Rules about the axes and the limits of joints."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    Vector,
    diagnose,
)
from pupper_analysis.models.attributes import BY_KIND
from pupper_analysis.models.efforts import Motor, placeholder_efforts
from pupper_analysis.models.loading import Found
from pupper_analysis.models.stated.mjcf import line_of
from pupper_analysis.models.stated.model import (
    HINGE,
    Joint,
    MjcfModel,
    RobotModel,
    UrdfModel,
)
from pupper_analysis.tools.audit.registry import rule
from pupper_analysis.tools.audit.rules.mirror import mirror_plane

_MOTIONS = (Term("rolls (about x)"), Term("pitches (about y)"), Term("yaws (about z)"))

_NAMES = (
    (0, ("haa", "abad", "abduction", "adduction", "hip_roll", "hx")),
    (1, ("hfe", "kfe", "thigh", "knee", "calf", "shank", "hip_pitch", "hy")),
    (2, ("hip_yaw",)),
)
_PATTERNS = [
    (axis, re.compile(rf"(?<![a-z]){name.replace('_', '_?')}(?![a-z])", re.IGNORECASE))
    for axis, names in _NAMES
    for name in names
]
_HIP = re.compile(r"(?<![a-z])hip(?![a-z])", re.IGNORECASE)


def expected_axis(name: str, all_names: set[str]) -> int | None:
    """Returns about which axis (0 to 2) a joint turns by its name; None if that says nothing clear.

    ``hip`` alone is the abduction where there are a ``thigh`` and a ``calf`` of the same leg.
    """
    for axis, pattern in _PATTERNS:
        if pattern.search(name):
            return axis
    if _HIP.search(name) and {_HIP.sub("thigh", name), _HIP.sub("calf", name)} <= all_names:
        return 0
    return None


@rule
def axis_contradicts_name(robot: RobotModel) -> Iterator[Found]:
    """Compares axes at zero angles with names; an axis may be up to 60 degrees inclined."""
    mirror = mirror_plane(robot)
    if mirror is not None and mirror.axis != 1:
        return  # the base's y is not sideways: roll and pitch are about other axes
    names = set(robot.joints)
    for joint in robot.joints.values():
        axis = expected_axis(joint.name, names)
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
            yield Found("joint", joint.name, message, "axis")


@rule
def axis_zero(robot: RobotModel) -> Iterator[Found]:
    """Finds axes shorter than 1e-9."""
    for joint in robot.joints.values():
        if joint.moves and float(np.linalg.norm(joint.raw_axis)) < 1e-9:
            yield Found("joint", joint.name, diagnose("axis-zero"), "axis")


# Rules about the limits of joints.


@rule
def range_empty(robot: RobotModel) -> Iterator[Found]:
    """Finds lower >= upper, also where both are left out of a URDF, where they count as 0.

    Of an MJCF's ranges that nothing says to be off, also those of actuators: MuJoCo takes an
    inverted one for none, without a word.
    """
    for joint in robot.joints.values():
        if joint.moves and joint.lower >= joint.upper:
            lower, upper = Quantity(joint.lower, joint.unit), Quantity(joint.upper, joint.unit)
            message = diagnose("range-empty", lower=lower, upper=upper)
            yield Found("joint", joint.name, message, "limit")
    if isinstance(robot, MjcfModel) and robot.refusal is None:
        yield from _inverted(robot)


def _inverted(robot: MjcfModel) -> Iterator[Found]:
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
                    place = None if element.name else line_of(robot.file, element, around)
                    message = diagnose("range-inverted", attribute=name, low=low, high=high)
                    yield Found(tag, element.name, message, place=place)


@rule
def limit_missing(robot: RobotModel) -> Iterator[Found]:
    """Finds hinges and slides without a range, but for wheels.

    In a URDF, these are those of type continuous: others without <limit> are refused on reading.
    """
    for joint in robot.joints.values():
        if joint.moves and math.isinf(joint.lower) and "wheel" not in joint.name.lower():
            ignored = _limits_without_effect(joint)
            if ignored is not None:
                yield Found("joint", joint.name, ignored, "limit")
                continue
            message = diagnose("joint-without-end", kind=Term(joint.kind))
            yield Found("joint", joint.name, message)


def _limits_without_effect(joint: Joint) -> Diagnostic | None:
    """Says so if a joint without limits states some all the same: one of type continuous."""
    lower, upper = (joint.stated.get(f"{end} limit", math.nan) for end in ("lower", "upper"))
    if not lower < upper:
        return None
    return diagnose(
        "limits-without-effect", lower=Quantity(lower, "rad"), upper=Quantity(upper, "rad")
    )


@rule
def limits_in_wrong_unit(robot: RobotModel) -> Iterator[Found]:
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
            yield Found("joint", joint.name, message, "limit")
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
        yield Found("joint", widest.name, message)


@rule
def range_placeholder(robot: RobotModel) -> Iterator[Found]:
    """Finds one range of half a turn or more either way at all hinges, four or more."""
    hinges = [j for j in robot.joints.values() if j.kind == HINGE and math.isfinite(j.upper)]
    if len(hinges) < _HINGES:
        return
    upper = hinges[0].upper
    if upper >= _HALF_TURN and all(j.upper == upper and j.lower == -upper for j in hinges):
        message = diagnose("one-range-of-all", upper=Quantity(upper, "rad"), count=len(hinges))
        yield Found("joint", hinges[0].name, message, "limit")


_HINGES, _HALF_TURN = 4, 3.1
"""Fewer may be alike; 3.1 rad is the least that people write for half a turn."""


@rule
def effort_or_velocity_zero(robot: UrdfModel) -> Iterator[Found]:
    """Finds <limit effort="0"> and <limit velocity="0"> on joints that move and mimic none."""
    for name, joint in robot.file.tree.joints.items():
        if joint.is_fixed or joint.mimic is not None:
            continue
        stated = robot.joints[name].stated
        zero = {what: stated[what] for what in ("effort", "velocity") if stated.get(what, 1.0) <= 0}
        if zero:
            slides = joint.kind == "prismatic"
            effort, velocity = (
                Quantity(zero[what], BY_KIND[what].unit(slides)) if what in zero else None
                for what in ("effort", "velocity")
            )
            message = diagnose(
                "effort-or-velocity-zero", effort=effort, velocity=velocity, both=len(zero) == 2
            )
            yield Found("joint", name, message, "limit")


@rule
def effort_placeholder(robot: RobotModel) -> Iterator[Found]:
    """Finds efforts that no motor of that mass, armature or robot gives."""
    motors = []
    for joint in robot.joints.values():
        if joint.kind == HINGE:
            ends = map(robot.carrier, (joint.parent, joint.child))
            mass = sum(link.mass for end in ends for link in robot.fixed_group(end))
            armature = joint.stated.get("armature", 0.0)
            motors.append(Motor(joint.name, joint.effort, mass, armature))
    for joints, message in placeholder_efforts(motors, robot.total_mass):
        yield Found("joint", joints[0], message, "limit")
