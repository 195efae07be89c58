"""Different conventions of two files of a robot: frame of the base, and zero positions of joints.

These conventions do not affect the robot, but change qpos. The module detects a displaced frame of
the base, and joints with a displaced zero (and displaced limits). These differences are removed
before other values are compared.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Vector,
    diagnose,
)
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.models.urdf_tree import UrdfTree, origin_of, set_origin
from pupper_analysis.robot.matching.alignment import (
    align_frames,
    angle_between,
    find_limit_offset,
    measure_body_deviation,
    measure_deviation_bits,
    measure_joint_deviation,
    measure_tree_deviation,
    with_base,
)
from pupper_analysis.robot.matching.tolerances import Tolerances

_MIN_BITS_SAVED_BY_BASE_FRAME = 3.0
"""Decrease of the total deviation [bits, see `measure_deviation_bits`] that is sufficient to accept
a displacement of the base frame that explains the whole deviation. The size of the displacement
counts as deviation. Chosen, not tuned."""

_MAX_JOINTS_TRIED = 6
"""Maximum number of joints on the base whose placements give a candidate for the pose between the
two base frames, to bound the computing time. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class Conventions:
    """Differences between the coordinates of a URDF and an MJCF: base frame and joint zeros.

    Attributes:
        base: Pose of the URDF's base frame in the MJCF's base frame. None if both are equal, or if
            no pose was found.
        shown: Whether the displaced base frame is confirmed: by the mass of the base, by several
            joints on the base, or by equal limits of the only joint on the base. If False, the zero
            of that joint may be displaced instead.
        zeros: {joint: q in the URDF minus q in the MJCF [rad, m]}, if not 0.
    """

    base: pin.SE3 | None = None
    shown: bool = True
    zeros: Mapping[str, float] = field(default_factory=dict)

    def convert_to_mjcf(self, values: MultibodyTree) -> MultibodyTree:
        """Convert a tree from the URDF's base frame and joint zeros to the MJCF's."""
        if self.base is not None:
            values = with_base(values, self.base)
        for name, offset in self.zeros.items():
            values = with_zero(values, name, offset)
        return values


def find_conventions(
    first: MultibodyTree, second: MultibodyTree, tolerances: Tolerances, *, fixed: bool
) -> Conventions:
    """Find the differences of base frame and joint zeros between a URDF and an MJCF of a robot.

    Args:
        first: Tree of the URDF, expressed in its base frame.
        second: Tree of the MJCF, expressed in its base frame.
        tolerances: Tolerances of the comparison.
        fixed: Whether the base is fixed. The frame of a fixed base is no property of the robot, so
            that quarter turns are accepted more easily.
    """
    base = _find_base_pose(first, second, tolerances, fixed=fixed)
    placed = first if base is None else with_base(first, base)
    in_place = align_frames(second, placed, tolerances).values
    if base is not None:
        # A new base frame must not increase the deviation of the whole tree.
        unchanged = align_frames(second, first, tolerances).values
        bits_as_is = measure_tree_deviation(first, unchanged, tolerances)
        if bits_as_is < measure_tree_deviation(placed, in_place, tolerances):
            base, placed, in_place = None, first, unchanged
    first, second = placed, in_place
    zeros = {}
    for name, joint in first.joints.items():
        offset = _find_zero_offset(first, second, name, tolerances)
        if offset and joint.parent == second.joints[name].parent:
            zeros[name] = offset
    return Conventions(base, _is_base_frame_confirmed(first, second, tolerances), zeros)


def _is_base_frame_confirmed(
    first: MultibodyTree, second: MultibodyTree, tolerances: Tolerances
) -> bool:
    """Return True if a displaced base frame cannot be confused with a displaced joint zero.

    Reason: with a single joint on the base, both have the same effect, unless the masses of the
    base or the limits of the joint confirm the base frame.
    """
    names = first.children(first.base)
    bodies = first.bodies[first.base], second.bodies[second.base]
    if len(names) != 1 or all(body.mass for body in bodies):
        return True
    first_joint, second_joint = (tree.joints[name] for tree in (first, second) for name in names)
    # Limits move with the zero. A range of a full turn or more gives no information.
    limit_difference = max(
        abs(first_joint.lower - second_joint.lower), abs(first_joint.upper - second_joint.upper)
    )
    return bool(
        first_joint.upper - first_joint.lower < 2 * math.pi and limit_difference <= tolerances.limit
    )


def _find_zero_offset(
    first: MultibodyTree, second: MultibodyTree, name: str, tolerances: Tolerances
) -> float:
    """Return the offset of a joint's zero: q in ``first`` minus q in ``second`` [rad, m].

    The result is 0 if the offset is within the tolerance, or if the joint's axis, frame or limits
    contradict it.
    """
    first_joint, second_joint = first.joints[name], second.joints[name]
    axis_angle = angle_between(first_joint.axis, second_joint.axis)
    if first_joint.slides != second_joint.slides or axis_angle > tolerances.axis:
        return 0.0
    if first_joint.slides:
        step = first_joint.rotation.T @ (second_joint.position - first_joint.position)
        offset, tolerance = float(first_joint.axis @ step), tolerances.position
        residual = float(np.linalg.norm(step - offset * first_joint.axis))
    else:
        rotation_vector = pin.log3(first_joint.rotation.T @ second_joint.rotation)
        offset, tolerance = float(first_joint.axis @ rotation_vector), tolerances.rotation
        residual = float(np.linalg.norm(rotation_vector - offset * first_joint.axis))
    if abs(offset) <= tolerance or residual > max(tolerance, 1e-3 * abs(offset)):
        return 0.0
    limits = [first_joint.lower, first_joint.upper, second_joint.lower, second_joint.upper]
    if not any(math.isfinite(limit) for limit in limits):
        return offset
    shift = find_limit_offset(first_joint, second_joint)
    # The rotation determines the angle up to full turns.
    full_turns = (
        0.0 if first_joint.slides else 2 * math.pi * round((shift - offset) / (2 * math.pi))
    )
    return (
        offset + full_turns
        if shift and abs(shift - offset - full_turns) <= tolerances.limit
        else 0.0
    )


def with_zero(values: MultibodyTree, name: str, offset: float) -> MultibodyTree:
    """Return a tree in which a joint has another zero: q' = q - ``offset``.

    Args:
        values: Tree of the robot.
        name: Joint.
        offset: Old position of the new zero [rad, m].
    """
    joint = values.joints[name]
    position, rotation = joint.position, joint.rotation
    if joint.slides:
        position = position + rotation @ joint.axis * offset
    else:
        rotation = rotation @ pin.exp3(offset * joint.axis)
    moved = replace(
        joint,
        position=position,
        rotation=rotation,
        lower=joint.lower - offset,
        upper=joint.upper - offset,
    )
    return replace(values, joints={**values.joints, name: moved})


def _find_base_pose(
    first: MultibodyTree, second: MultibodyTree, tolerances: Tolerances, *, fixed: bool
) -> pin.SE3 | None:
    """Find a pose of the first tree's base frame in the second that explains the deviation.

    None, for example, if no pose explains the deviation, or if names of limbs may be exchanged
    instead: a half turn about x exchanges left and right, too.
    """
    names = first.children(first.base)
    if not names or any(second.joints[name].parent != second.base for name in names):
        return None
    body, joints = _base_deviation(first, second, tolerances)
    if min(joints) == 0:
        return None  # a joint has the same placement, so the base frames are equal
    shown = _find_pose_of_joints(first, second, tolerances)
    if shown is not None:
        has_mass = bool(first.bodies[first.base].mass and second.bodies[second.base].mass)
        if has_mass and body == 0 and _do_joints_coincide(first, second, tolerances):
            moved_body, _ = _base_deviation(with_base(first, shown), second, tolerances)
            return None if moved_body > 0 else shown
        return shown
    total = body + sum(joints)
    best, best_cost = None, total
    for pose in _candidate_base_poses(first, second):
        angle = float(np.linalg.norm(pin.log3(pose.rotation)))
        distance = float(np.linalg.norm(pose.translation))
        pose_bits = measure_deviation_bits(distance, tolerances.position) + measure_deviation_bits(
            angle, tolerances.rotation
        )
        if pose_bits == 0:
            continue
        body, joints = _base_deviation(with_base(first, pose), second, tolerances)
        cost = body + sum(joints)
        # Sum of the size of the pose and of the deviation that remains with the pose. The sum must
        # be below 60 % of the deviation without the pose. A larger sum is accepted if the pose
        # explains all of this deviation, and saves `_MIN_BITS_SAVED_BY_BASE_FRAME`.
        total_cost = cost + pose_bits
        is_rotation_only = (
            fixed and distance <= tolerances.position and _is_axis_permutation(pose.rotation)
        )
        is_better = total_cost < 0.6 * total or (
            cost == 0 and total_cost < total - _MIN_BITS_SAVED_BY_BASE_FRAME
        )
        if is_better and total_cost < best_cost:
            best, best_cost = pose, total_cost
        elif is_rotation_only and cost == 0 and best is None:
            best = pose
    return best


def _find_pose_of_joints(
    first: MultibodyTree, second: MultibodyTree, tolerances: Tolerances
) -> pin.SE3 | None:
    """Fit the pose between the base frames of two trees with which all joints on the base agree.

    Masses and inertias are not compared, because they may differ with any base frame. The pose is
    fitted by least squares to the joint positions and to points on the axes (Kabsch, Acta Cryst.
    A32 (1976) 922). None if no such pose is found, or the base frames are equal.
    """
    names = first.children(first.base)
    anchors, axes = _list_anchors_and_axes(first, names)
    other_anchors, other_axes = _list_anchors_and_axes(second, names)
    spread = float(np.ptp(anchors, axis=0).max())
    if len(names) < _MIN_JOINTS_OF_POSE or spread <= _MIN_SPREAD:
        return None
    points = np.vstack([anchors, anchors + spread * axes])
    other_points = np.vstack([other_anchors, other_anchors + spread * other_axes])
    middle, other_middle = points.mean(axis=0), other_points.mean(axis=0)
    left, sizes, right = np.linalg.svd((other_points - other_middle).T @ (points - middle))
    joints = [(first.joints[name], second.joints[name]) for name in names]
    if math.sqrt(sizes[1] / len(points)) > _MIN_SPREAD:
        handedness = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(left @ right)))])
        rotation = left @ handedness @ right
        turns = [np.eye(3)]
    elif np.linalg.norm(points - other_points, axis=1).max() <= _MIN_SPREAD:
        return None  # a rotation about the line may also be a displaced zero of all joints
    else:  # all points are on a line, and any rotation about it fits
        rotation = joints[0][1].rotation @ joints[0][0].rotation.T
        turns = [partner.rotation.T @ rotation @ joint.rotation for joint, partner in joints]
    pose = pin.SE3(rotation, other_middle - rotation @ middle)
    gaps = np.linalg.norm(anchors @ rotation.T + pose.translation - other_anchors, axis=1)
    angles = np.linalg.norm(axes @ rotation.T - other_axes, axis=1)
    if gaps.max() > tolerances.position or angles.max() > tolerances.axis:
        return None
    if max(float(np.linalg.norm(pin.log3(turn))) for turn in turns) > tolerances.rotation:
        return None
    angle = float(np.linalg.norm(pin.log3(rotation)))
    distance = float(np.linalg.norm(pose.translation))
    is_moved = distance > tolerances.position or angle > tolerances.rotation
    return pose if is_moved else None


def _do_joints_coincide(
    first: MultibodyTree, second: MultibodyTree, tolerances: Tolerances
) -> bool:
    """Return True if the joints on the base have equal positions and axes, whatever their names."""
    names = first.children(first.base)
    anchors, axes = _list_anchors_and_axes(first, names)
    other_anchors, other_axes = _list_anchors_and_axes(second, names)
    gaps = np.linalg.norm(anchors[:, None] - other_anchors, axis=2)
    angles = np.linalg.norm(axes[:, None] - other_axes, axis=2)
    agrees = (gaps <= tolerances.position) & (angles <= tolerances.axis)
    return bool(agrees.any(axis=0).all() and agrees.any(axis=1).all())


_MIN_JOINTS_OF_POSE, _MIN_SPREAD = 2, 1e-3
"""Requirements of `_find_pose_of_joints`: minimum number of joints on the base (two joints with
axes determine ten numbers, a pose has six), and lower bound of the spread of points [m]. The spread
also is the largest distance [m] of equal points on a line, with which base frames count as equal.
Chosen, not tuned."""


def _list_anchors_and_axes(tree: MultibodyTree, names: list[str]) -> tuple[Array, Array]:
    """Return the positions [m] and unit axes of joints on the base, in its frame, (n, 3) each."""
    joints = [tree.joints[name] for name in names]
    axes = np.array([joint.rotation @ joint.axis for joint in joints])
    return np.array([joint.position for joint in joints]), axes


def _base_deviation(
    first: MultibodyTree, second: MultibodyTree, tolerances: Tolerances
) -> tuple[float, list[float]]:
    """Return the deviation of the base, and of each joint on the base, between two trees [bits]."""
    body = measure_body_deviation(first.bodies[first.base], second.bodies[second.base], tolerances)
    names = first.children(first.base)
    second = align_frames(second, first, tolerances, only=names).values
    return body, [measure_joint_deviation(first, second, name, tolerances) for name in names]


def _is_axis_permutation(rotation: Array) -> bool:
    """Return True if a rotation (3, 3) maps x, y and z onto coordinate axes, of either sign."""
    return bool(np.allclose(np.abs(rotation).max(axis=0), 1.0, atol=1e-6))


def _candidate_base_poses(first: MultibodyTree, second: MultibodyTree) -> Iterator[pin.SE3]:
    """Yield candidate poses of the first base frame in the second, from joints or quarter turns."""
    names = first.children(first.base)
    for name in names[:_MAX_JOINTS_TRIED]:
        first_joint, second_joint = first.joints[name], second.joints[name]
        yield second_joint.placement * first_joint.placement.inverse()
    positions = np.array([first.joints[name].position for name in names])
    other_positions = np.array([second.joints[name].position for name in names])
    bases = [values.bodies[values.base] for values in (first, second)]
    if all(base.mass and np.isfinite(base.com).all() for base in bases):
        positions = np.vstack([positions, bases[0].com])
        other_positions = np.vstack([other_positions, bases[1].com])
    for rotation in quarter_turns():
        yield pin.SE3(rotation, np.zeros(3))
        yield pin.SE3(rotation, other_positions.mean(axis=0) - rotation @ positions.mean(axis=0))


def quarter_turns() -> Iterator[Array]:
    """Yield the 24 rotation matrices (3, 3) that map coordinate axes onto coordinate axes."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            for row, (column, sign) in enumerate(zip(order, signs, strict=True)):
                matrix[row, column] = sign
            if np.linalg.det(matrix) > 0:
                yield matrix


def apply_conventions(
    root: etree._Element, link: str, conventions: Conventions, first: MultibodyTree
) -> None:
    """Convert a URDF to the base frame and the joint zeros of the MJCF, in place.

    Args:
        root: Root element of the URDF; modified.
        link: Name of the root link.
        conventions: Differences between the coordinates of URDF and MJCF (`find_conventions`).
        first: Tree of the URDF before the conversion; its joint axes and types are used.
    """
    tree = UrdfTree(root)
    if conventions.base is not None:
        parts = [
            part
            for tag in ("inertial", "visual", "collision")
            for part in tree.links[link].element.findall(tag)
        ]
        for element in (*parts, *(joint.element for joint in tree.child_joints.get(link, ()))):
            set_origin(element, conventions.base * origin_of(element))
    for name, mover in tree.joints.items():
        joint, offset = mover.element, conventions.zeros.get(name)
        if offset:
            axis, slides = first.joints[name].axis, first.joints[name].slides
            step = (
                pin.SE3(np.eye(3), offset * axis)
                if slides
                else pin.SE3(pin.exp3(offset * axis), np.zeros(3))
            )
            set_origin(joint, mover.origin * step)
            limit = joint.find("limit")
            for word in ("lower", "upper") if limit is not None else ():
                if limit.get(word) is not None or joint.get("type") != "continuous":
                    limit.set(word, repr(float(limit.get(word, "0")) - offset))


def describe_pose(pose: pin.SE3) -> Diagnostic:
    """Describe a pose, for a message: translation [m], and angle and axis of the rotation."""
    rotation_vector = pin.log3(pose.rotation)
    angle = float(np.linalg.norm(rotation_vector))
    is_translated = float(np.linalg.norm(pose.translation)) > 1e-9
    parts = []
    if is_translated:
        parts.append(diagnose("pose-at", at=Vector.rounded(pose.translation, "m")))
    if angle > 1e-9:
        axis = Vector.rounded(rotation_vector / angle)
        parts.append(diagnose("pose-turned", angle=Quantity(angle, "rad"), axis=axis))
    return diagnose("pose", parts=parts)
