"""What two files may mean by the same coordinate: where the base's frame is, where angles are zero.

Both are conventions: a robot is the same however they are chosen. But its qpos is not. So a frame
of the base that is placed elsewhere, and a joint whose zero is elsewhere (with its limits moved
along), is found here, taken out of the comparison, and told as the one difference that it is.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from lxml import etree
from numpy.typing import NDArray

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
    count_digits,
    digits_in_all,
    digits_of,
    digits_of_body,
    offset_of_limits,
    with_base,
)
from pupper_analysis.robot.matching.tolerances import Tolerances

Array = NDArray[np.float64]

_GAIN = 3.0  # bits that another frame of the base must save

_TRIED = 6  # joints on the base whose frames are tried as a hint to where its own is


@dataclass(frozen=True, eq=False)
class Conventions:
    """How the MJCF's coordinates differ from the URDF's, for one and the same robot.

    Attributes:
        base: Pose of the URDF's base frame in the MJCF's; None if they are the same.
        shown: Whether the base's body, several joints on it, or the same limits of the one joint
            show that its frame is elsewhere; else it might as well be that joint's zero.
        zeros: {joint: q in the URDF less q in the MJCF (rad or m)} where that is not 0.
    """

    base: pin.SE3 | None = None
    shown: bool = True
    zeros: Mapping[str, float] = field(default_factory=dict)

    def done(self, values: MultibodyTree) -> MultibodyTree:
        """Returns a robot, given in the URDF's conventions, in the MJCF's."""
        if self.base is not None:
            values = with_base(values, self.base)
        for name, offset in self.zeros.items():
            values = with_zero(values, name, offset)
        return values


def find_conventions(
    first: MultibodyTree, second: MultibodyTree, tolerances: Tolerances, *, fixed: bool
) -> Conventions:
    """Finds how the conventions of two trees differ.

    Args:
        first: The URDF's joints and bodies, in its base's frame.
        second: The MJCF's, in that of its base.
        tolerances: What counts as a difference.
        fixed: Whether the base is fixed: then where it stands is no property of the robot, and a
            quarter turn of its frame is taken for one even if the base has no mass to show it.
    """
    base = _base(first, second, tolerances, fixed=fixed)
    placed = first if base is None else with_base(first, base)
    in_place = align_frames(second, placed, tolerances).values
    if base is not None:
        # What is on the base must not have to pay for it further out.
        as_it_is = align_frames(second, first, tolerances).values
        message = digits_in_all(first, as_it_is, tolerances)
        if message < digits_in_all(placed, in_place, tolerances):
            base, placed, in_place = None, first, as_it_is
    first, second = placed, in_place
    zeros = {}
    for name, joint in first.joints.items():
        offset = _zero(first, second, name, tolerances)
        if offset and joint.parent == second.joints[name].parent:
            zeros[name] = offset
    return Conventions(base, _shown(first, second, tolerances), zeros)


def _shown(first: MultibodyTree, second: MultibodyTree, tolerances: Tolerances) -> bool:
    """Tells whether it is the base's frame that is elsewhere, and not the zero of a joint on it."""
    names = first.children(first.base)
    bodies = first.bodies[first.base], second.bodies[second.base]
    if len(names) > 1 or all(body.mass for body in bodies):
        return True
    one, two = (tree.joints[name] for tree in (first, second) for name in names)
    # The limits would have moved with the zero; of a whole turn and more they say nothing.
    apart = max(abs(one.lower - two.lower), abs(one.upper - two.upper))
    return bool(one.upper - one.lower < 2 * math.pi and apart <= tolerances.limit)


def _zero(first: MultibodyTree, second: MultibodyTree, name: str, tolerances: Tolerances) -> float:
    """Returns how far a joint's zero is off if its limits are off by as much; else 0."""
    one, two = first.joints[name], second.joints[name]
    if one.slides != two.slides or float(one.axis @ two.axis) < 1 - tolerances.axis:
        return 0.0
    if one.slides:
        step = one.rotation.T @ (two.position - one.position)
        offset, tolerance = float(one.axis @ step), tolerances.position
        off = float(np.linalg.norm(step - offset * one.axis))
    else:
        turn = pin.log3(one.rotation.T @ two.rotation)
        offset, tolerance = float(one.axis @ turn), tolerances.rotation
        off = float(np.linalg.norm(turn - offset * one.axis))
    if abs(offset) <= tolerance or off > max(tolerance, 1e-3 * abs(offset)):
        return 0.0
    said = [one.lower, one.upper, two.lower, two.upper]
    if not any(math.isfinite(limit) for limit in said):
        return offset
    shift = offset_of_limits(one, two)
    # An angle is known but for full turns.
    turns = 0.0 if one.slides else 2 * math.pi * round((shift - offset) / (2 * math.pi))
    return offset + turns if shift and abs(shift - offset - turns) <= tolerances.limit else 0.0


def with_zero(values: MultibodyTree, name: str, offset: float) -> MultibodyTree:
    """Describes a robot with a coordinate that is smaller by an offset, in the same pose."""
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


def _base(
    first: MultibodyTree, second: MultibodyTree, tolerances: Tolerances, *, fixed: bool
) -> pin.SE3 | None:
    """Returns the pose of the first's base frame in the second's, if they are not the same."""
    names = first.children(first.base)
    if not names or any(second.joints[name].parent != second.base for name in names):
        return None
    body, joints = _digits_at_base(first, second, tolerances)
    if min(joints) == 0:
        return None  # a joint is where it is in the other: so is the base's frame
    least = body + sum(joints)
    best, still = None, least
    for pose in _poses(first, second):
        angle = float(np.linalg.norm(pin.log3(pose.rotation)))
        apart = float(np.linalg.norm(pose.translation))
        own = count_digits(apart, tolerances.position) + count_digits(angle, tolerances.rotation)
        if own == 0:
            continue
        body, joints = _digits_at_base(with_base(first, pose), second, tolerances)
        cost = body + sum(joints)
        # What it explains must be more than what it takes to state it, and most of what there is.
        said = cost + own
        turned = fixed and apart <= tolerances.position and _is_quarter(pose.rotation)
        enough = said < 0.6 * least or (cost == 0 and said < least - _GAIN)
        if enough and said < still:
            best, still = pose, said
        elif turned and cost == 0 and best is None:
            best = pose
    return best


def _digits_at_base(
    first: MultibodyTree, second: MultibodyTree, tolerances: Tolerances
) -> tuple[float, list[float]]:
    """Says how many digits tell the differences of the base's body, and of each joint on it."""
    body = digits_of_body(first.bodies[first.base], second.bodies[second.base], tolerances)
    names = first.children(first.base)
    second = align_frames(second, first, tolerances, only=names).values
    return body, [digits_of(first, second, name, tolerances) for name in names]


def _is_quarter(rotation: Array) -> bool:
    return bool(np.allclose(np.abs(rotation).max(axis=0), 1.0, atol=1e-6))


def _poses(first: MultibodyTree, second: MultibodyTree) -> Iterator[pin.SE3]:
    """Yields where the first's base frame may be in the second's."""
    names = first.children(first.base)
    for name in names[:_TRIED]:
        one, two = first.joints[name], second.joints[name]
        yield two.placement * one.placement.inverse()
    here = np.array([first.joints[name].position for name in names])
    there = np.array([second.joints[name].position for name in names])
    bases = [values.bodies[values.base] for values in (first, second)]
    if all(base.mass and np.isfinite(base.com).all() for base in bases):
        here = np.vstack([here, bases[0].com])
        there = np.vstack([there, bases[1].com])
    for turn in quarter_turns():
        yield pin.SE3(turn, np.zeros(3))
        yield pin.SE3(turn, there.mean(axis=0) - turn @ here.mean(axis=0))


def quarter_turns() -> Iterator[Array]:
    """Yields the 24 rotations that map the axes onto each other."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            for row, (column, sign) in enumerate(zip(order, signs, strict=True)):
                matrix[row, column] = sign
            if np.linalg.det(matrix) > 0:
                yield matrix


def take_conventions(
    root: etree._Element, link: str, found: Conventions, first: MultibodyTree
) -> None:
    """Gives a URDF the MJCF's conventions, in place: another base frame, other zeros.

    Args:
        root: Its XML.
        link: Its root link.
        found: The conventions.
        first: Its joints, as they were.
    """
    tree = UrdfTree(root)
    if found.base is not None:
        inertial = tree.links[link].inertial
        below = [joint.element for joint in tree.below.get(link, ())]
        for element in below if inertial is None else [*below, inertial]:
            set_origin(element, found.base * origin_of(element))
    for name, mover in tree.joints.items():
        joint, offset = mover.element, found.zeros.get(name)
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
    """Says where a frame is in another."""
    turn = pin.log3(pose.rotation)
    angle = float(np.linalg.norm(turn))
    away = float(np.linalg.norm(pose.translation)) > 1e-9
    parts = []
    if away:
        parts.append(diagnose("pose-at", at=Vector.rounded(pose.translation, "m")))
    if angle > 1e-9:
        axis = Vector.rounded(turn / angle)
        parts.append(diagnose("pose-turned", angle=Quantity(angle, "rad"), axis=axis))
    return diagnose("pose", parts=parts)
