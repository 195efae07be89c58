"""The two robots side by side: their trees, the taken values, where the files' frames are.

And how parts of a rigid body make it another.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.models.conversion import pinocchio_from_mujoco
from pupper_analysis.models.multibody import MultibodyTree, copy_value
from pupper_analysis.robot.matching.alignment import Alignment
from pupper_analysis.robot.matching.conventions import with_zero
from pupper_analysis.robot.matching.match import Match
from pupper_analysis.robot.matching.trees import base_pose, kinematic_trees

Array = NDArray[np.float64]

Part = TypeVar("Part", bound=Hashable)

_TRIANGLE = 1e-6
"""By how much of itself a principal moment may exceed the sum of the others, for rounding."""


def list_single_part_changes(
    parts: Mapping[Part, pin.Inertia], wanted: pin.Inertia, empty: Part
) -> list[tuple[Part, pin.Inertia]]:
    """Returns how one part of a body alone can make it another.

    Args:
        parts: Those with mass, in one frame.
        wanted: Their sum, as it shall be.
        empty: The part that gets it where none has any.

    Returns:
        (part, as it shall be) for each way, the heaviest part first; none if there is none.
    """
    alone = []
    for part in sorted(parts, key=lambda one: -parts[one].mass) or [empty]:
        others = [body for other, body in parts.items() if other != part]
        if not others:
            alone.append((part, wanted))
        elif wanted.mass > sum(other.mass for other in others):
            left = functools.reduce(operator.sub, others, wanted)
            alone += [(part, left)] if is_physical(left) else []
    return alone


def is_physical(body: pin.Inertia) -> bool:
    """Says whether a rigid body can be so."""
    if not body.mass > 0:
        return False
    least, middle, greatest = np.linalg.eigvalsh(np.array(body.inertia))
    return bool(least > 0 and least + middle >= (1 - _TRIANGLE) * greatest)


def is_same_body(one: pin.Inertia, two: pin.Inertia, tolerance: float = 1e-11) -> bool:
    """Says whether two bodies are the same but for rounding."""
    size = max(float(np.abs(one.inertia).max()), float(np.abs(two.inertia).max()), 1e-300)
    return bool(
        abs(one.mass - two.mass) <= tolerance * max(one.mass, two.mass)
        and float(np.abs(one.lever - two.lever).max()) <= tolerance
        and float(np.abs(one.inertia - two.inertia).max()) <= tolerance * size
    )


Key = tuple[str, str]
"""Kind and element of a difference."""


@dataclass(frozen=True, eq=False)
class MatchedRobots:
    """Both robots, in the URDF's link frames and in the MJCF's conventions.

    Attributes:
        matched: The match.
        urdf: The URDF's parameters.
        mjcf: The MJCF's.
        own: The MJCF's, in its own frames: those of its bodies, at their joints.
        urdf_frames: {base or joint: the frame of these parameters from that of the URDF's link}.
        mjcf_frames: {base or joint: likewise of the MJCF's body, at its joint}.
        bodies: {body of the MJCF: its pose in the frame of the body that a joint moves}.
    """

    matched: Match
    urdf: MultibodyTree
    mjcf: MultibodyTree
    own: MultibodyTree
    urdf_frames: Mapping[str, pin.SE3]
    mjcf_frames: Mapping[str, pin.SE3]
    bodies: Mapping[str, pin.SE3]

    def merge_values(self, side: str, taken: Collection[Key]) -> MultibodyTree:
        """Returns what one side shall be, with what is taken from the other.

        Args:
            side: ``"urdf"`` or ``"mjcf"``, whose file is changed.
            taken: The differences in which it gets the other's value.
        """
        one, two = (self.urdf, self.mjcf) if side == "urdf" else (self.mjcf, self.urdf)
        result = one
        for kind, element in taken:
            result = copy_value(result, two, kind, element)
        if side == "urdf":  # it was given the MJCF's zeros: what it keeps is its own
            for name, offset in self.matched.conventions.zeros.items():
                result = with_zero(result, name, -offset)
        return result


def pair_robots(matched: Match, alignment: Alignment) -> MatchedRobots:
    """Puts the two robots side by side.

    Args:
        matched: The two files, matched.
        alignment: The MJCF's tree in the URDF's link frames.
    """
    robot = matched.robot
    urdf, own = kinematic_trees(robot)
    base = matched.conventions.base or pin.SE3.Identity()
    if not robot.floating:
        base = base_pose(robot) * base
    urdf_frames = {robot.base: base} | {name: pin.SE3.Identity() for name in urdf.joints}
    model = pinocchio_from_mujoco(robot.mj_model)
    names = [str(robot.mj_model.body(index).name) for index in range(1, robot.mj_model.nbody)]
    return MatchedRobots(
        matched=matched,
        urdf=urdf,
        mjcf=alignment.values,
        own=own,
        urdf_frames=urdf_frames,
        mjcf_frames=_gauges(own, alignment.values),
        bodies={
            name: model.frames[model.getFrameId(name, pin.FrameType.BODY)].placement.copy()
            for name in names
        },
    )


def _gauges(own: MultibodyTree, moved: MultibodyTree) -> dict[str, pin.SE3]:
    """Returns {base or joint: its frame after from that before}, for one robot in two frames."""
    gauges = {own.base: pin.SE3.Identity()}
    waiting = own.children(own.base)
    while waiting:
        name = waiting.pop()
        before, after = own.joints[name], moved.joints[name]
        gauge = after.placement.inverse() * gauges[before.parent] * before.placement
        gauges[name] = pin.SE3.Identity() if gauge.isIdentity(1e-12) else gauge
        waiting += own.children(name)
    return gauges


@dataclass(eq=False, kw_only=True)
class Side:
    """A file that gets numbers of the other one.

    Attributes:
        sides: Both robots.
        wanted: What this file's shall be.
        left: {difference: why it cannot be written}.
        notes: What else is to be said, per difference.
    """

    sides: MatchedRobots
    target: MultibodyTree
    unwritten: dict[Key, Diagnostic] = field(default_factory=dict)
    notes: dict[Key, Diagnostic] = field(default_factory=dict)
