"""Transformation of the link frames of one multibody tree to the frames of another tree.

Link frames are a convention. Mechanically, a hinge is a line, a slide is a direction, and a body
has a mass, a CoM and an inertia. The axes of a link frame do not affect the robot. The position of
the origin on the axis of a hinge has no effect either. Before two trees are compared, the link
frames of the second tree are transformed to the frames of the first tree, joint by joint from the
base outwards. Candidate frames of a joint are compared by their total deviation: the sum of
log2(1 + deviation / tolerance).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.models.multibody import MultibodyTree, TreeBody, TreeJoint
from pupper_analysis.robot.matching.tolerances import Tolerances

_MIN_BITS_SAVED_BY_BODY_FRAME = 0.5
"""Lower bound of the decrease of the deviation between two trees [bits, see
`measure_deviation_bits`] with which a candidate frame of a body replaces the best previous frame.
It excludes rounding errors. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Multibody tree of a robot, expressed in the link frames of another tree.

    Attributes:
        values: The tree in the aligned frames.
        moved: {joint: displacement (3,) [m] of the origin of its link frame, in the original axes
            of the body}. Joints with unchanged origin are omitted.
    """

    values: MultibodyTree
    moved: Mapping[str, Array]


def align_frames(
    second: MultibodyTree,
    first: MultibodyTree,
    tolerances: Tolerances,
    fixed: Collection[str] = (),
    only: Iterable[str] | None = None,
) -> Alignment:
    """Express the tree ``second`` in link frames near the link frames of ``first``.

    A link frame may have any position along a hinge axis, and any orientation, without changing the
    robot. The alignment uses a hundredth of the tolerances: with the full tolerances, it could
    distribute a difference over several values that are each within the tolerance.

    Args:
        second: Tree whose link frames are transformed.
        first: Tree with the target frames, and with the same names of joints.
        tolerances: Tolerances of the comparison.
        fixed: Slides whose origin must not be moved.
        only: Joints whose frames are transformed; all joints by default.
    """
    tolerances = tighten_tolerances(tolerances)
    names = list(first.joints if only is None else only)
    nearest = _align_by_cost(second, first, tolerances, fixed, names, as_the_first=False)
    if only is not None or not measure_tree_deviation(first, nearest.values, tolerances):
        return nearest
    # A file may rotate several successive frames, and rotate back after the last. Then no single
    # transformation decreases the deviation, but all together do (thumb of a Shadow Hand).
    rotated = _align_by_cost(second, first, tolerances, fixed, names, as_the_first=True)
    costs = [
        measure_tree_deviation(first, alignment.values, tolerances)
        for alignment in (nearest, rotated)
    ]
    return rotated if costs[1] < costs[0] - _MIN_BITS_SAVED_BY_BODY_FRAME else nearest


def _align_by_cost(
    second: MultibodyTree,
    first: MultibodyTree,
    tolerances: Tolerances,
    fixed: Collection[str],
    names: Iterable[str],
    *,
    as_the_first: bool,
) -> Alignment:
    """Transform the frames of the joints ``names`` to frames near ``first``, joint by joint.

    The origins of slides in ``fixed`` are not moved. With ``as_the_first``, frames get their
    orientation in ``first`` at zero angles, even if this increases the deviation.
    """
    result, moved = second, {}
    for name in names:
        joint, other_joint = first.joints[name], result.joints[name]
        if joint.parent != other_joint.parent or joint.slides != other_joint.slides:
            continue
        best, least_cost = result, measure_joint_deviation(first, result, name, tolerances)
        if least_cost == 0:
            continue
        rotations = list(_candidate_rotations(first, result, name))
        if as_the_first:
            rotations, least_cost = rotations[1:2], math.inf
        shift = np.zeros(3)
        for rotation in rotations:
            rotated = in_axes(result, name, rotation)
            for step in _candidate_steps(first, rotated, name, still=name in fixed):
                candidate = with_origin(rotated, name, step)
                cost = measure_joint_deviation(first, candidate, name, tolerances)
                if cost < least_cost - _MIN_BITS_SAVED_BY_BODY_FRAME:
                    best, least_cost, shift = candidate, cost, rotation.T @ step
        result = best
        if shift.any():
            moved[name] = shift
    return Alignment(result, moved)


def tighten_tolerances(tolerances: Tolerances) -> Tolerances:
    """Return a hundredth of the given tolerances, for the alignment of frames."""
    return Tolerances(
        **{kind.name: 0.01 * getattr(tolerances, kind.name) for kind in fields(tolerances)}
    )


def measure_deviation_bits(size: float, tolerance: float) -> float:
    """Convert a deviation to bits: log2(1 + size / tolerance), or 0 within the tolerance.

    Bits are used to add deviations with different units.

    Args:
        size: Deviation, not negative.
        tolerance: Tolerance, in the unit of the deviation.
    """
    return math.log2(1.0 + size / tolerance) if size > tolerance else 0.0


def measure_joint_deviation(
    first: MultibodyTree, second: MultibodyTree, name: str, tolerances: Tolerances
) -> float:
    """Return the deviation of a joint and its body between two trees, as a number without unit.

    The result is a sum of `measure_deviation_bits`, log2(1 + deviation / tolerance), of the joint,
    the body that it moves, the frames on this body, and the placements of the child joints.

    Args:
        first: First tree.
        second: Second tree, with the same names of joints.
        name: Joint.
        tolerances: Tolerances of the comparison.
    """
    total = _joint_bits(first, second, name, tolerances)
    for child in first.children(name):
        if second.joints[child].parent == name:
            total += _measure_placement_deviation(
                first.joints[child], second.joints[child], tolerances
            )
    return total


def measure_tree_deviation(
    first: MultibodyTree, second: MultibodyTree, tolerances: Tolerances
) -> float:
    """Return the summed deviation of all joints, moved bodies and frames of two trees, in bits.

    Frames on the base, or on different bodies in both trees, are not included. For bits see
    `measure_deviation_bits`.

    Args:
        first: First tree.
        second: Second tree, with the same names of joints.
        tolerances: Tolerances of the comparison.
    """
    return sum(_joint_bits(first, second, name, tolerances) for name in first.joints)


def _joint_bits(
    first: MultibodyTree, second: MultibodyTree, name: str, tolerances: Tolerances
) -> float:
    """Return the deviation of a joint, its body and its frames between two trees, in bits."""
    total = _measure_placement_deviation(first.joints[name], second.joints[name], tolerances)
    total += measure_deviation_bits(
        angle_between(first.joints[name].axis, second.joints[name].axis), tolerances.axis
    )
    total += measure_body_deviation(first.bodies[name], second.bodies[name], tolerances)
    for frame in first.list_frames(name):
        owner, position = second.frames[frame]
        if owner == name:
            distance = float(np.linalg.norm(position - first.frames[frame][1]))
            total += measure_deviation_bits(distance, tolerances.position)
    return total


def measure_body_deviation(first: TreeBody, second: TreeBody, tolerances: Tolerances) -> float:
    """Return the deviation of CoM and inertia between two bodies, as a number without unit.

    The deviations of CoM and inertia are converted to bits (`measure_deviation_bits`), and added.
    The result is 0 if a body has no mass.

    Args:
        first: Body of the first tree.
        second: Body of the second tree, expressed in the same frame.
        tolerances: Tolerances of the comparison.
    """
    if not (first.mass and second.mass):
        return 0.0
    scale = max(float(np.abs(first.inertia).max()), float(np.abs(second.inertia).max()), 1e-300)
    relative_deviation = float(np.abs(second.inertia - first.inertia).max()) / scale
    total = measure_deviation_bits(float(np.linalg.norm(second.com - first.com)), tolerances.com)
    return total + measure_deviation_bits(relative_deviation, tolerances.inertia)


def _measure_placement_deviation(
    first: TreeJoint, second: TreeJoint, tolerances: Tolerances
) -> float:
    """Return the deviation of position and rotation between two joint frames, in bits."""
    distance = float(np.linalg.norm(second.position - first.position))
    angle = float(np.linalg.norm(pin.log3(first.rotation.T @ second.rotation)))
    return measure_deviation_bits(distance, tolerances.position) + measure_deviation_bits(
        angle, tolerances.rotation
    )


def angle_between(first: Array, second: Array) -> float:
    """Return the angle [rad] between two vectors (3,)."""
    return math.atan2(float(np.linalg.norm(np.cross(first, second))), float(first @ second))


def _candidate_rotations(first: MultibodyTree, second: MultibodyTree, name: str) -> Iterator[Array]:
    """Yield rotations (3, 3) of a body frame of the second tree that may match the first tree.

    The first is the identity, the second rotates the frame to its orientation in the first tree.
    """
    first_joint, second_joint = first.joints[name], second.joints[name]
    yield np.eye(3)
    full = first_joint.rotation.T @ second_joint.rotation
    yield full
    if first_joint.slides or float(first_joint.axis @ (full @ second_joint.axis)) < 0.99:
        return
    offset = find_limit_offset(first_joint, second_joint)
    if offset:
        yield pin.exp3(-offset * first_joint.axis) @ full


def _list_matching_points(
    first: MultibodyTree, second: MultibodyTree, name: str
) -> Iterator[tuple[Array, Array]]:
    """Yield points (3,) [m] of a body in both trees, in its body frames: CoM, joints, frames."""
    yield first.bodies[name].com, second.bodies[name].com
    for child in first.children(name):
        if second.joints[child].parent == name:
            yield first.joints[child].position, second.joints[child].position
    for frame in first.list_frames(name):
        owner, position = second.frames[frame]
        if owner == name:
            yield first.frames[frame][1], position


def find_limit_offset(first: TreeJoint, second: TreeJoint) -> float:
    """Return the offset by which both limits of a joint differ: first minus second [rad, m].

    The result is 0 if the offsets of lower and upper limit differ, or if a limit is infinite.
    """
    lower, upper = first.lower - second.lower, first.upper - second.upper
    if not (math.isfinite(lower) and math.isfinite(upper)):
        return 0.0
    return lower if math.isclose(lower, upper, rel_tol=1e-3, abs_tol=1e-4) else 0.0


def _candidate_steps(
    first: MultibodyTree, second: MultibodyTree, name: str, *, still: bool
) -> Iterator[Array]:
    """Yield candidate displacements (3,) [m] of a joint's origin in the tree ``second``.

    Displacements are expressed in the axes of the body that the joint moves. The first is zero.
    ``still`` keeps the origin of a slide in place.
    """
    yield np.zeros(3)
    first_joint, second_joint = first.joints[name], second.joints[name]
    to_other_origin = second_joint.rotation.T @ (first_joint.position - second_joint.position)
    median_offset = np.median(
        [
            other_position - position
            for position, other_position in _list_matching_points(first, second, name)
        ],
        axis=0,
    )
    if not second_joint.slides:
        for step in (to_other_origin, median_offset):
            yield float(second_joint.axis @ step) * second_joint.axis
    elif not still:
        yield to_other_origin
        yield median_offset
        yield to_other_origin - float(second_joint.axis @ to_other_origin) * second_joint.axis


def in_axes(values: MultibodyTree, name: str, rotation: Array) -> MultibodyTree:
    """Rotate the frame of a body in a tree; the robot itself does not move.

    The new coordinates of a point x are x' = rotation x.

    Args:
        values: Tree of the robot.
        name: Joint that moves the body.
        rotation: Rotation matrix, shape (3, 3).
    """
    joint, joints = values.joints[name], dict(values.joints)
    joints[name] = replace(joint, rotation=joint.rotation @ rotation.T, axis=rotation @ joint.axis)
    changed = replace(values, joints=joints)
    return in_body_frame(changed, name, rotation, np.zeros(3))


def with_origin(values: MultibodyTree, name: str, step: Array) -> MultibodyTree:
    """Displace the origin of a body's frame in a tree; the robot itself does not move.

    Args:
        values: Tree of the robot.
        name: Joint that moves the body.
        step: Displacement of the origin, shape (3,) [m], in the axes of the body.
    """
    if not step.any():
        return values
    joint, joints = values.joints[name], dict(values.joints)
    joints[name] = replace(joint, position=joint.position + joint.rotation @ step)
    moved = replace(values, joints=joints)
    return in_body_frame(moved, name, np.eye(3), -step)


def in_body_frame(values: MultibodyTree, name: str, rotation: Array, shift: Array) -> MultibodyTree:
    """Express CoM, inertia, frames and child joints of a body in a new frame of the body.

    The new coordinates of a point x are x' = rotation x + shift.

    Args:
        values: Tree of the robot.
        name: Joint that moves the body, or the base.
        rotation: Rotation matrix, shape (3, 3).
        shift: Translation, shape (3,) [m].
    """
    joints, body = dict(values.joints), values.bodies[name]
    for child in values.children(name):
        child_joint = joints[child]
        joints[child] = replace(
            child_joint,
            position=rotation @ child_joint.position + shift,
            rotation=rotation @ child_joint.rotation,
        )
    inertia = rotation @ body.inertia @ rotation.T
    bodies = {
        **values.bodies,
        name: replace(body, com=rotation @ body.com + shift, inertia=inertia),
    }
    frames = {
        frame: (owner, rotation @ position + shift if owner == name else position)
        for frame, (owner, position) in values.frames.items()
    }
    return replace(values, joints=joints, bodies=bodies, frames=frames)


def with_base(values: MultibodyTree, pose: pin.SE3) -> MultibodyTree:
    """Return a tree of the same robot with another frame of the base.

    Args:
        values: Tree of the robot.
        pose: Pose of the old base frame in the new base frame.
    """
    return in_body_frame(values, values.base, np.array(pose.rotation), np.array(pose.translation))
