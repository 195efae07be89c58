"""Rules about joint axes."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from pupper_analysis.base.diagnostics import (
    Quantity,
    Term,
    Vector,
    diagnose,
)
from pupper_analysis.models.stated.model import HINGE, RobotModel
from pupper_analysis.tools.audit.pairs import mirror_plane
from pupper_analysis.tools.audit.registry import Found, rule

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
            told = diagnose(
                "axis-contradicts-name",
                named=_MOTIONS[axis],
                axis=Vector(tuple(joint.axis), "1"),
                turns=_MOTIONS[really],
            )
            yield Found("joint", joint.name, told, "axis")


@rule
def axis_zero(robot: RobotModel) -> Iterator[Found]:
    """Finds axes shorter than 1e-9."""
    for joint in robot.joints.values():
        if joint.moves and float(np.linalg.norm(joint.raw_axis)) < 1e-9:
            yield Found("joint", joint.name, diagnose("axis-zero"), "axis")


@rule
def axis_not_unit(robot: RobotModel) -> Iterator[Found]:
    """Finds axes whose length differs from 1 by more than 1e-3."""
    for joint in robot.joints.values():
        length = float(np.linalg.norm(joint.raw_axis))
        if joint.moves and length > 1e-9 and abs(length - 1.0) > 1e-3:
            axis = Vector(tuple(joint.raw_axis), "1")
            told = diagnose("axis-not-unit", axis=axis, length=Quantity(length, "1"))
            yield Found("joint", joint.name, told, "axis")
