"""Joint trees of a matched URDF and MJCF, merged values, and frame transforms between both.

`list_single_part_changes` lists changes of a single part of a rigid body that give the body a
target inertia.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import pinocchio as pin

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.models.conversion import pinocchio_from_mujoco
from pupper_analysis.models.multibody import MultibodyTree, TreeBody, copy_value
from pupper_analysis.robot.compare.differences import PropertyKey, body_changes
from pupper_analysis.robot.matching.alignment import Alignment
from pupper_analysis.robot.matching.conventions import with_zero
from pupper_analysis.robot.matching.match import Match
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import base_pose, kinematic_trees

Part = TypeVar("Part", bound=Hashable)
"""Type of the keys of a body's parts, such as the name of a link."""

_TRIANGLE_RTOL = 1e-6
"""Relative tolerance of the triangle inequality of principal moments of inertia in `is_physical`. A
smaller violation may be rounding and is accepted. Chosen, not tuned.
"""


def list_single_part_changes(
    parts: Mapping[Part, pin.Inertia], target: pin.Inertia, empty: Part
) -> list[tuple[Part, pin.Inertia]]:
    """List the ways to give a rigid body a target inertia by a change of one part only.

    Args:
        parts: Inertias of the parts with mass that form the body, in a common frame.
        target: Target inertia of the body, in the same frame.
        empty: Part that is used if no part has mass.

    Returns:
        (part, new inertia) of each change, the heaviest part first. The list may be empty. The only
        part of a body gets the target inertia without a check whether it is physically possible.
    """
    changes = []
    for part in sorted(parts, key=lambda name: -parts[name].mass) or [empty]:
        other_inertias = [body for name, body in parts.items() if name != part]
        if not other_inertias:
            changes.append((part, target))
        elif target.mass > sum(name.mass for name in other_inertias):
            remainder = functools.reduce(operator.sub, other_inertias, target)
            changes += [(part, remainder)] if is_physical(remainder) else []
    return changes


def is_physical(body: pin.Inertia) -> bool:
    """Return True if mass and rotational inertia of a body are physically possible.

    The mass must be positive. The inertia must be positive definite, and the principal moments must
    satisfy the triangle inequality within `_TRIANGLE_RTOL`.
    """
    if not body.mass > 0:
        return False
    least, middle, greatest = np.linalg.eigvalsh(np.array(body.inertia))
    return bool(least > 0 and least + middle >= (1 - _TRIANGLE_RTOL) * greatest)


def is_same_body(first: pin.Inertia, second: pin.Inertia, tolerance: float = 1e-11) -> bool:
    """Return True if mass, CoM and rotational inertia of two bodies agree.

    ``tolerance`` is relative for mass and inertia, and in m for the CoM. Both bodies must be
    expressed in the same frame.
    """
    size = max(float(np.abs(first.inertia).max()), float(np.abs(second.inertia).max()), 1e-300)
    return bool(
        abs(first.mass - second.mass) <= tolerance * max(first.mass, second.mass)
        and float(np.abs(first.lever - second.lever).max()) <= tolerance
        and float(np.abs(first.inertia - second.inertia).max()) <= tolerance * size
    )


@dataclass(frozen=True, eq=False)
class MatchedRobots:
    """Joint trees of a matched URDF and MJCF in common frames, with transforms to the files.

    Attributes:
        matched: Match of the two files.
        urdf: Joint tree of the URDF, in the URDF's link frames with the MJCF's zero angles.
        mjcf: Joint tree of the MJCF, in the same frames.
        own: Joint tree of the MJCF in the MJCF's frames. The origin of each body frame is at the
            joint.
        urdf_frames: {base or joint: pose of the URDF link's frame in the frame of the trees}.
        mjcf_frames: {base or joint: pose of the MJCF body's frame at the joint in the frame of the
            trees}.
        bodies: {body of the MJCF: pose in the frame of the body that a joint moves}.
    """

    matched: Match
    urdf: MultibodyTree
    mjcf: MultibodyTree
    own: MultibodyTree
    urdf_frames: Mapping[str, pin.SE3]
    mjcf_frames: Mapping[str, pin.SE3]
    bodies: Mapping[str, pin.SE3]

    def merge_values(self, side: str, taken: Collection[PropertyKey]) -> MultibodyTree:
        """Build the multibody tree that a file must describe after taking values of the other file.

        Args:
            side: ``"urdf"`` or ``"mjcf"``: file to be changed.
            taken: Differences for which the value of the other file is taken.
        """
        own_tree, other_tree = (self.urdf, self.mjcf) if side == "urdf" else (self.mjcf, self.urdf)
        result = own_tree
        for kind, element in taken:
            result = copy_value(result, other_tree, kind, element)
        if side == "urdf":  # the comparison used the MJCF's zero angles: restore those of the URDF
            for name, offset in self.matched.conventions.zeros.items():
                result = with_zero(result, name, -offset)
        return result

    def list_equal_inertias(
        self, taken: Collection[PropertyKey], tolerances: Tolerances
    ) -> list[PropertyKey]:
        """List ("inertia", body) of bodies with equal inertias whose mass and CoM are in ``taken``.

        ``taken`` are the values that are copied from the other file. Inertias within the tolerance
        count as equal. If the inertia is copied as well, a link with fixed links may need fewer
        changes.
        """
        bodies = [name for kind, name in taken if kind == "mass" and ("com", name) in taken]
        return [
            ("inertia", name)
            for name in bodies
            if "inertia"
            not in {
                change.kind
                for change in body_changes(
                    name, self.urdf.bodies[name], self.mjcf.bodies[name], tolerances
                )
            }
        ]


def pair_robots(matched: Match, alignment: Alignment) -> MatchedRobots:
    """Compute the joint trees of a URDF and an MJCF in common frames, with transforms to the files.

    Args:
        matched: Match of the two files.
        alignment: Result of the alignment; contains the tree of the MJCF in the URDF's link frames.
    """
    robot = matched.robot
    urdf, mjcf_tree = kinematic_trees(robot)
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
        own=mjcf_tree,
        urdf_frames=urdf_frames,
        mjcf_frames=_find_gauge_transforms(mjcf_tree, alignment.values),
        bodies={
            name: model.frames[model.getFrameId(name, pin.FrameType.BODY)].placement.copy()
            for name in names
        },
    )


def _find_gauge_transforms(tree: MultibodyTree, moved: MultibodyTree) -> dict[str, pin.SE3]:
    """Find the poses by which the body frames of two descriptions of the same robot differ.

    Returns:
        {base or joint: pose of the frame in ``tree`` relative to the frame in ``moved``}.
    """
    gauges = {tree.base: pin.SE3.Identity()}
    waiting = tree.children(tree.base)
    while waiting:
        name = waiting.pop()
        before, after = tree.joints[name], moved.joints[name]
        gauge = after.placement.inverse() * gauges[before.parent] * before.placement
        gauges[name] = pin.SE3.Identity() if gauge.isIdentity(1e-12) else gauge
        waiting += tree.children(name)
    return gauges


@dataclass(eq=False, kw_only=True)
class Side:
    """URDF or MJCF that receives numbers: base class of the planners.

    Attributes:
        sides: Matched robots of both files.
        target: Multibody tree that the changed file must describe.
        same_bodies: ``target``, with equal inertias also from the other file
            (`MatchedRobots.list_equal_inertias`); None if ``target`` is exact.
        unwritten: {difference: reason why no value can be written}.
        notes: {difference: note on the written value}.
    """

    sides: MatchedRobots
    target: MultibodyTree
    same_bodies: MultibodyTree | None = None
    unwritten: dict[PropertyKey, Diagnostic] = field(default_factory=dict)
    notes: dict[PropertyKey, Diagnostic] = field(default_factory=dict)

    def list_body_targets(self, mover: str) -> list[TreeBody]:
        """Return the target of a body, and the target with an equal inertia of the other file.

        The planners use the target that needs fewer changes, and otherwise the first.
        """
        trees = [tree for tree in (self.target, self.same_bodies) if tree is not None]
        return [tree.bodies[mover] for tree in trees]
