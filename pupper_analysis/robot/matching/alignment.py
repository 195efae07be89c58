"""Brings the link frames of one tree of joints to those of another: they are a matter of choice.

A joint is a line (of a slide, a direction), and a body is a mass, a com and an inertia. Where the
file puts the axes of a link, and where on its own line a joint's origin is, has no effect on the
robot. So before two trees are compared, the frames of the second are put to those of the first,
joint by joint from the base outwards, in the way in which the fewest digits say how they differ.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.models.multibody import MultibodyTree, TreeBody, TreeJoint
from pupper_analysis.robot.matching.tolerances import Tolerances

Array = NDArray[np.float64]

_GAIN = 0.5  # bits that another frame must save, lest rounding decides


@dataclass(frozen=True, eq=False)
class Alignment:
    """A tree in another's link frames.

    Attributes:
        values: The same robot, in those frames.
        moved: {joint: (3,) how far its origin was moved (m), in the axes of the body's own frame};
            without those that stayed.
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
    """Puts the link frames of a tree to those of another.

    Args:
        second: The tree whose frames are moved.
        first: Whose frames are kept; it has joints of the same names.
        tolerances: What counts as a difference.
        fixed: Slides whose origin is not to be moved.
        only: The joints whose frames are moved; by default all.
    """
    # Finer than what is tolerated, lest a difference is shared out until no part of it counts.
    tolerances = tighten_tolerances(tolerances)
    names = list(first.joints if only is None else only)
    nearest = _aligned(second, first, tolerances, fixed, names, as_the_first=False)
    if only is not None or not digits_in_all(first, nearest.values, tolerances):
        return nearest
    # Where a file turns the frames of several links in a row, and back after the last, none of them
    # is nearer to the other's by itself, but all together are (the thumb of a Shadow Hand).
    whole = _aligned(second, first, tolerances, fixed, names, as_the_first=True)
    costs = [digits_in_all(first, one.values, tolerances) for one in (nearest, whole)]
    return whole if costs[1] < costs[0] - _GAIN else nearest


def _aligned(
    second: MultibodyTree,
    first: MultibodyTree,
    tolerances: Tolerances,
    fixed: Collection[str],
    names: Iterable[str],
    *,
    as_the_first: bool,
) -> Alignment:
    """Puts link frames to those of another tree, each in the way that tells least about its joint.

    Args:
        second: The tree whose frames are moved.
        first: Whose frames are kept.
        tolerances: What counts as a difference.
        fixed: Slides whose origin is not to be moved.
        names: The joints whose frames are moved.
        as_the_first: Turn each frame as the first's is at zero angles, whatever that tells.
    """
    result, moved = second, {}
    for name in names:
        mine, other = first.joints[name], result.joints[name]
        if mine.parent != other.parent or mine.slides != other.slides:
            continue
        best, least = result, digits_of(first, result, name, tolerances)
        if least == 0:
            continue
        turns = list(_turns(first, result, name))
        if as_the_first:
            turns, least = turns[1:2], math.inf
        shift = np.zeros(3)
        for turn in turns:
            turned = in_axes(result, name, turn)
            for step in _steps(first, turned, name, still=name in fixed):
                candidate = with_origin(turned, name, step)
                cost = digits_of(first, candidate, name, tolerances)
                if cost < least - _GAIN:
                    best, least, shift = candidate, cost, turn.T @ step
        result = best
        if shift.any():
            moved[name] = shift
    return Alignment(result, moved)


def tighten_tolerances(tolerances: Tolerances) -> Tolerances:
    """Returns tolerances of a hundredth."""
    return Tolerances(
        **{kind.name: 0.01 * getattr(tolerances, kind.name) for kind in fields(tolerances)}
    )


def count_digits(size: float, tolerance: float) -> float:
    """Says how many binary digits a deviation has, above what is tolerated."""
    return math.log2(1.0 + size / tolerance) if size > tolerance else 0.0


def digits_of(one: MultibodyTree, two: MultibodyTree, name: str, tolerances: Tolerances) -> float:
    """Says how many digits tell the differences of a joint, its body, and what that carries."""
    total = _of_joint(one, two, name, tolerances)
    for child in one.children(name):
        if two.joints[child].parent == name:
            total += _of_place(one.joints[child], two.joints[child], tolerances)
    return total


def digits_in_all(one: MultibodyTree, two: MultibodyTree, tolerances: Tolerances) -> float:
    """Says how many digits tell the differences of all joints and their bodies."""
    return sum(_of_joint(one, two, name, tolerances) for name in one.joints)


def _of_joint(one: MultibodyTree, two: MultibodyTree, name: str, tolerances: Tolerances) -> float:
    """Says how many digits tell the differences of a joint, its body and its frames."""
    total = _of_place(one.joints[name], two.joints[name], tolerances)
    total += count_digits(_angle(one.joints[name].axis, two.joints[name].axis), tolerances.axis)
    total += digits_of_body(one.bodies[name], two.bodies[name], tolerances)
    for frame in one.carried_by(name):
        owner, other = two.frames[frame]
        if owner == name:
            apart = float(np.linalg.norm(other - one.frames[frame][1]))
            total += count_digits(apart, tolerances.position)
    return total


def digits_of_body(one: TreeBody, two: TreeBody, tolerances: Tolerances) -> float:
    """Says how many digits tell the differences of two coms and inertias; none without mass."""
    if not (one.mass and two.mass):
        return 0.0
    size = max(float(np.abs(one.inertia).max()), float(np.abs(two.inertia).max()), 1e-300)
    apart = float(np.abs(two.inertia - one.inertia).max()) / size
    total = count_digits(float(np.linalg.norm(two.com - one.com)), tolerances.com)
    return total + count_digits(apart, tolerances.inertia)


def _of_place(one: TreeJoint, two: TreeJoint, tolerances: Tolerances) -> float:
    apart = float(np.linalg.norm(two.position - one.position))
    angle = float(np.linalg.norm(pin.log3(one.rotation.T @ two.rotation)))
    return count_digits(apart, tolerances.position) + count_digits(angle, tolerances.rotation)


def _angle(one: Array, two: Array) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(one, two))), float(one @ two))


def _turns(first: MultibodyTree, second: MultibodyTree, name: str) -> Iterator[Array]:
    """Yields the turns of a body's frame that come into question.

    None; that to the other's frame; and, where the limits say that the zero angles differ, that to
    a frame which differs from the other's by the joint's angle alone.
    """
    one, two = first.joints[name], second.joints[name]
    yield np.eye(3)
    full = one.rotation.T @ two.rotation
    yield full
    if one.slides or float(one.axis @ (full @ two.axis)) < 0.99:
        return
    offset = offset_of_limits(one, two)
    if offset:
        yield pin.exp3(-offset * one.axis) @ full


def _places(
    first: MultibodyTree, second: MultibodyTree, name: str
) -> Iterator[tuple[Array, Array]]:
    """Yields places on a body, in both: coms, children's places, frames."""
    yield first.bodies[name].com, second.bodies[name].com
    for child in first.children(name):
        if second.joints[child].parent == name:
            yield first.joints[child].position, second.joints[child].position
    for frame in first.carried_by(name):
        owner, position = second.frames[frame]
        if owner == name:
            yield first.frames[frame][1], position


def offset_of_limits(one: TreeJoint, two: TreeJoint) -> float:
    """Returns by how much the first's limits are above the second's; 0 if not both by the same."""
    lower, upper = one.lower - two.lower, one.upper - two.upper
    if not (math.isfinite(lower) and math.isfinite(upper)):
        return 0.0
    return lower if math.isclose(lower, upper, rel_tol=1e-3, abs_tol=1e-4) else 0.0


def _steps(
    first: MultibodyTree, second: MultibodyTree, name: str, *, still: bool
) -> Iterator[Array]:
    """Yields how far the origin of a joint may be moved, in the axes of its body.

    That of a hinge along its own axis, of a slide anywhere: to where the other's is, or so that
    most of what is on the body is where it is on the other.
    """
    yield np.zeros(3)
    one, two = first.joints[name], second.joints[name]
    apart = two.rotation.T @ (one.position - two.position)
    inside = np.median([there - here for here, there in _places(first, second, name)], axis=0)
    if not two.slides:
        for step in (apart, inside):
            yield float(two.axis @ step) * two.axis
    elif not still:
        yield apart
        yield inside
        yield apart - float(two.axis @ apart) * two.axis


def in_axes(values: MultibodyTree, name: str, turn: Array) -> MultibodyTree:
    """Describes the body that a joint moves in other axes: x' = turn x."""
    joint, joints = values.joints[name], dict(values.joints)
    joints[name] = replace(joint, rotation=joint.rotation @ turn.T, axis=turn @ joint.axis)
    changed = replace(values, joints=joints)
    return in_body_frame(changed, name, turn, np.zeros(3))


def with_origin(values: MultibodyTree, name: str, step: Array) -> MultibodyTree:
    """Describes the body that a joint moves from another origin, by a step in its own axes."""
    if not step.any():
        return values
    joint, joints = values.joints[name], dict(values.joints)
    joints[name] = replace(joint, position=joint.position + joint.rotation @ step)
    moved = replace(values, joints=joints)
    return in_body_frame(moved, name, np.eye(3), -step)


def in_body_frame(values: MultibodyTree, name: str, turn: Array, shift: Array) -> MultibodyTree:
    """Describes a body and what it carries in a new frame of it: x' = turn x + shift."""
    joints, body = dict(values.joints), values.bodies[name]
    for child in values.children(name):
        carried = joints[child]
        joints[child] = replace(
            carried, position=turn @ carried.position + shift, rotation=turn @ carried.rotation
        )
    inertia = turn @ body.inertia @ turn.T
    bodies = {**values.bodies, name: replace(body, com=turn @ body.com + shift, inertia=inertia)}
    frames = {
        frame: (owner, turn @ position + shift if owner == name else position)
        for frame, (owner, position) in values.frames.items()
    }
    return replace(values, joints=joints, bodies=bodies, frames=frames)


def with_base(values: MultibodyTree, pose: pin.SE3) -> MultibodyTree:
    """Describes a robot from another frame of its base: x' = pose x."""
    return in_body_frame(values, values.base, np.array(pose.rotation), np.array(pose.translation))
