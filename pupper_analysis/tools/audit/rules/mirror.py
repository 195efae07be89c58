"""Rules about left-right symmetry, compared in the base frame at zero angles.

`find_mirror_plane` derives the plane between left and right from pairs of names and the positions
of the links. `find_copied_links` finds limbs that are equal to the partner instead, such as two
arms of the same type; no mirror image is expected there. Most rules compare a quantity of the first
link or joint of a pair with the second within a tolerance. Vectors, inertias, axes and ranges are
reflected first. If several pairs of a chain are displaced, `mirror_position` reports only the first
pair. The comparisons of CoM, inertia, shapes and contacts leave displaced pairs out.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import mujoco
import numpy as np
from lxml import etree

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import INERTIA_ENTRIES, inertia_entries
from pupper_analysis.base.diagnostics import (
    Quantity,
    Severity,
    Term,
    Vector,
    describe_effort,
    diagnose,
)
from pupper_analysis.models.attributes import PASSIVE_ATTRIBUTES
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.sides import find_mirror_pairs, find_unlike_pairs, strip_sides
from pupper_analysis.models.stated.model import (
    HINGE_JOINT,
    Inertial,
    Joint,
    Link,
    MjcfModel,
    RobotModel,
    UrdfModel,
)
from pupper_analysis.robot.contact import ContactParameters, combine_geoms, ground_geom
from pupper_analysis.robot.shapes import may_touch
from pupper_analysis.tools.audit.registry import list_known_points, rule


@dataclass(frozen=True, eq=False)
class MirrorPlane:
    """Plane between left and right, normal to an axis of the base.

    Attributes:
        axis: Index of the normal axis; 1 (y) in the usual convention.
        offset: Coordinate of the plane along the axis [m].
    """

    axis: int
    offset: float

    @property
    def matrix(self) -> Array:
        """Reflection matrix S = S^T of this plane, shape (3, 3) [1], for vectors in base axes."""
        matrix = np.eye(3)
        matrix[self.axis, self.axis] = -1.0
        return matrix

    def reflect_point(self, point: Array) -> Array:
        """Return the mirror image of a point at this plane, shape (3,) [m], in the base frame."""
        image: Array = self.matrix @ point
        image[self.axis] += 2 * self.offset
        return image


def find_mirror_plane(robot: RobotModel, tolerance: float = 1e-3) -> MirrorPlane | None:
    """Find the plane between left and right, in which link pairs are mirror images.

    The plane is normal to an axis of the base. All joint positions are zero.

    Args:
        robot: Model of the robot.
        tolerance: Largest distance between a link and the mirror image of the partner [m].

    Returns:
        The plane; None if the positions of the left-right pairs of links do not define a plane. For
        a planar robot, the plane in which the robot moves.
    """
    pairs = find_mirror_pairs(robot.links)
    if not pairs:
        return None
    left = np.array([robot.links[name].pose.position for name, _ in pairs])
    right = np.array([robot.links[name].pose.position for _, name in pairs])
    best, max_agreeing = None, 0
    for axis in (1, 0, 2):
        for offset in (0.0, float(np.median(left[:, axis] + right[:, axis])) / 2):
            mirror = MirrorPlane(axis, offset)
            images = np.array([mirror.reflect_point(point) for point in left])
            away = np.abs(left[:, axis] - right[:, axis]) > tolerance
            close = np.linalg.norm(images - right, axis=1) < tolerance
            agreeing = int(np.sum(close & away))
            if agreeing > max_agreeing:
                best, max_agreeing = mirror, agreeing
    if 3 * max_agreeing >= len(pairs):
        return best
    displaced = _find_plane_of_displaced_limb(robot, pairs, tolerance)
    if displaced is not None:
        return displaced
    return _find_plane_of_motion(robot) if np.abs(left - right).max() < tolerance else None


def _find_plane_of_displaced_limb(
    robot: RobotModel, pairs: list[tuple[str, str]], tolerance: float
) -> MirrorPlane | None:
    """Return the mirror plane of a robot with one displaced limb; None if none is found.

    The vectors from the parent links to the links are mirror images in all pairs except one.
    """

    def list_vectors(names: list[str]) -> Array:
        links = [robot.links[name] for name in names]
        origins = [
            np.zeros(3) if link.parent is None else robot.links[link.parent].pose.position
            for link in links
        ]
        return np.array([link.pose.position for link in links]) - np.array(origins)

    names = [[pair[side] for pair in pairs] for side in (0, 1)]
    places = [
        np.array([robot.links[name].pose.position for name in side_names]) for side_names in names
    ]
    vectors = [list_vectors(side_names) for side_names in names]
    is_long = np.linalg.norm(vectors[0], axis=1) > tolerance
    for axis in (1, 0, 2):
        middles = (places[0][:, axis] + places[1][:, axis]) / 2
        mirror = MirrorPlane(axis, float(np.median(middles)))
        images = vectors[0] @ mirror.matrix
        close = np.linalg.norm(images - vectors[1], axis=1) < tolerance
        away = np.abs(places[0][:, axis] - places[1][:, axis]) > tolerance
        is_plane = np.ptp(middles) < tolerance and away.all()
        if is_plane and (close & is_long).sum() >= MIN_RELATIVE_PAIRS and (~close).sum() == 1:
            return mirror
    return None


MIN_RELATIVE_PAIRS = 3
"""Smallest number of left-right pairs with mirrored vectors from the parent links from which the
plane of a robot with a displaced limb is derived. Chosen, not tuned."""


def _find_plane_of_motion(robot: RobotModel) -> MirrorPlane | None:
    """Return the plane in which a planar robot moves, normal to an axis of the base.

    None if the robot has no hinges, or the hinges are not all parallel to the same axis of the
    base.
    """
    axes = np.array([joint.axis for joint in robot.joints.values() if joint.kind == HINGE_JOINT])
    for axis in range(3):
        if len(axes) and (np.abs(axes[:, axis]) > MIN_PLANAR_COSINE).all():
            places = [link.pose.position[axis] for link in robot.links.values()]
            return MirrorPlane(axis, float(np.median(places)))
    return None


MIN_PLANAR_COSINE = 0.9999
"""Lower bound of the absolute cosine between each hinge axis and the same axis of the base. Above
the bound the robot counts as planar. Chosen, not tuned.
"""


POSITION_TOLERANCE, MASS_RTOL, COM_TOLERANCE, INERTIA_RTOL, LIMIT_TOLERANCE = (
    1e-3,
    0.01,
    1e-3,
    0.1,
    0.02,
)
"""Largest differences between left and right that are not reported. In this order: positions [m],
masses (relative), CoM [m] (plus 1 % of the distance from the origin of the base), inertia (relative
to the largest entry), joint limits [rad or m]. `find_copied_links` and the repairs also use some of
these numbers. Chosen, not tuned.
"""


MIN_COPIED_TERMS = 4
"""Smallest number of terms of a limb that only a copy explains, from which the limb may count as a
copy. Chosen, not tuned: a single part that was copied has at most three (offset, CoM, inertia)."""

HYPOTHESIS_RATIO = 0.1
"""Largest deviation of a term from a prediction that counts as explained, relative to the distance
between the predictions of both hypotheses. Chosen, not tuned."""


def find_copied_links(robot: RobotModel, mirror: MirrorPlane) -> frozenset[str]:
    """Return the names of the links of limbs that are moved copies of the partner's limb.

    Let R1, R2 be the rotations of two partners' frames, and S the reflection. A copy predicts R2
    R1^T d for a vector d of the first limb, a mirror image predicts S d. A limb is a copy if at
    least `MIN_COPIED_TERMS` terms (offsets between joints, CoMs, inertias) agree with the copy
    only, and fewer with the mirror image only. Some limbs are excluded, for example if another limb
    with the same name apart from the sides is rather a mirror image.
    """
    limbs: dict[str, list[tuple[Link, Link]]] = {}
    roots: dict[tuple[str, str], str] = {}
    pairs = {
        (first.name, second.name): (first, second) for first, second in _list_body_pairs(robot)
    }
    for first, second in pairs.values():
        root, place = first.name, (first.parent, second.parent)
        while place in pairs:
            root = pairs[place][0].name
            place = (pairs[place][0].parent, pairs[place][1].parent)
        roots[first.name, second.name] = root
        limbs.setdefault(root, []).append((first, second))
    copied, mirrored_kinds = {}, set()
    for root, limb in limbs.items():
        offset_votes, other_votes = np.zeros(2, int), np.zeros(2, int)
        for first, second in limb:
            if (parents := pairs.get((str(first.parent), str(second.parent)))) is not None:
                arms = [
                    _get_anchor(link) - _get_anchor(parent)
                    for link, parent in zip((first, second), parents, strict=True)
                ]
                turn = parents[1].pose.rotation @ parents[0].pose.rotation.T
                vote = _compare_hypotheses(arms[0], arms[1], turn, mirror, POSITION_TOLERANCE)
                offset_votes += vote if first.moving else 0
                other_votes += vote if not first.moving else 0
            other_votes += _compare_inertials(first, second, mirror)
        votes = offset_votes + other_votes
        if votes[1] > votes[0]:
            mirrored_kinds.add(strip_sides(root))
        is_placed = offset_votes[0] > offset_votes[1] or not offset_votes.any()
        if is_placed and votes[0] >= MIN_COPIED_TERMS and votes[0] > votes[1]:
            copied[root] = limb
    return frozenset(
        link.name
        for root, limb in copied.items()
        if strip_sides(root) not in mirrored_kinds
        for pair in limb
        for link in pair
    )


def _compare_inertials(first: Link, second: Link, mirror: MirrorPlane) -> Array:
    """Count the terms of two inertials that only a copy, or only a mirror image, explains.

    Returns:
        The numbers for copy and mirror image, shape (2,). Zero without inertial.
    """
    if first.inertial is None or second.inertial is None:
        return np.zeros(2, int)
    turn = second.pose.rotation @ first.pose.rotation.T
    arms, tensors = (
        [
            link.pose.point(inertial.com) - _get_anchor(link)
            for link, inertial in ((first, first.inertial), (second, second.inertial))
        ],
        [
            link.pose.rotation @ inertial.inertia @ link.pose.rotation.T
            for link, inertial in ((first, first.inertial), (second, second.inertial))
        ],
    )
    least = INERTIA_RTOL * float(np.abs(tensors).max())
    places = _compare_hypotheses(arms[0], arms[1], turn, mirror, COM_TOLERANCE)
    return places + _compare_hypotheses(tensors[0], tensors[1], turn, mirror, least)


def _compare_hypotheses(
    first: Array, second: Array, turn: Array, mirror: MirrorPlane, least: float
) -> Array:
    """Return whether a vector or tensor of the second limb is a copy, or a mirror image, only.

    Args:
        first: Vector, shape (3,), or tensor, shape (3, 3), of the first limb, in base axes.
        second: The same quantity of the second limb.
        turn: Rotation from the first to the second limb, shape (3, 3), in base axes.
        mirror: Plane between left and right.
        least: Distance between both predictions, in the unit of ``first``, up to which they are
            equal.

    Returns:
        (1, 0) for a copy, (0, 1) for a mirror image, (0, 0) if undecided.
    """
    predictions = [
        matrix @ first if first.ndim == 1 else matrix @ first @ matrix.T
        for matrix in (turn, mirror.matrix)
    ]
    distance = float(np.linalg.norm(predictions[0] - predictions[1]))
    if not distance > least:
        return np.zeros(2, int)
    deviations = np.array([np.linalg.norm(second - predicted) for predicted in predictions])
    return (deviations < HYPOTHESIS_RATIO * distance).astype(int)


def _list_body_pairs(robot: RobotModel) -> Iterator[tuple[Link, Link]]:
    """Yield the left-right pairs of links."""
    for first_name, second_name in find_mirror_pairs(robot.links):
        yield robot.links[first_name], robot.links[second_name]


def _get_anchor(body: Link) -> Array:
    """Return the position of a link's first joint, or of a fixed link's frame, shape (3,) [m].

    The position is expressed in the base frame, at zero joint angles.
    """
    return body.joints[0].position if body.moving else body.pose.position


def _find_displaced_bodies(
    robot: RobotModel, mirror: MirrorPlane
) -> tuple[set[str], list[tuple[Link, Link]]]:
    """Find links whose position is not the mirror image of the partner; return names and pairs.

    The returned pairs are displaced, but have no displaced ancestor.
    """
    copied = find_copied_links(robot, mirror)
    displaced: set[str] = set()
    first_pairs = []
    for first, second in _list_body_pairs(robot):
        if not (first.moving or first.mass or "foot" in first.name.lower()):
            continue  # a marker, not a part
        if first.name in copied:
            continue
        if _measure_asymmetry(
            mirror, _get_anchor(first), _get_anchor(second)
        ) > POSITION_TOLERANCE and not _is_choice_of_frame(robot, mirror, first, second):
            if not displaced & {*robot.ancestors(first.name), *robot.ancestors(second.name)}:
                first_pairs.append((first, second))
            displaced |= {first.name, second.name}
    return displaced, first_pairs


def _measure_asymmetry(mirror: MirrorPlane, first: Array, second: Array) -> float:
    """Return the distance between the mirror image of a point and another point [m]."""
    return float(np.linalg.norm(mirror.reflect_point(first) - second))


def _is_choice_of_frame(robot: RobotModel, mirror: MirrorPlane, first: Link, second: Link) -> bool:
    """Return True if only the frames of two hinges are displaced along the axis, not the links.

    The position of a hinge's frame along the axis has no effect on the motion.
    """
    if not all(
        len(link.joints) == 1 and link.joints[0].kind == HINGE_JOINT for link in (first, second)
    ):
        return False
    if first.inertial is None or second.inertial is None:
        return False
    gap = mirror.reflect_point(_get_anchor(first)) - _get_anchor(second)
    if np.linalg.norm(np.cross(gap, second.joints[0].axis)) > POSITION_TOLERANCE:
        return False
    first_com, second_com = (
        link.pose.point(inertial.com)
        for link, inertial in ((first, first.inertial), (second, second.inertial))
    )
    # A CoM that moves with the frame is a displacement, also below the tolerance of the CoM.
    most = min(get_com_tolerance(second_com), float(np.linalg.norm(gap)) / 2)
    if _measure_asymmetry(mirror, first_com, second_com) > most:
        return False
    names = [{child.name for child in robot.children(link.name)} for link in (first, second)]
    return all(
        _measure_asymmetry(mirror, _get_anchor(first_child), _get_anchor(second_child))
        <= POSITION_TOLERANCE
        for first_child, second_child in _list_body_pairs(robot)
        if first_child.moving and first_child.name in names[0] and second_child.name in names[1]
    )


def get_com_tolerance(com: Array) -> float:
    """Return the largest accepted distance [m] between a CoM and the partner's mirror image.

    1 mm plus 1 % of the distance between the CoM and the origin of the base.
    """
    return COM_TOLERANCE + 0.01 * float(np.linalg.norm(com))


def _list_pairs_in_place(robot: RobotModel) -> Iterator[tuple[MirrorPlane, Link, Link]]:
    """Yield (mirror plane, link, partner) of left-right pairs of links that are not displaced.

    Pairs with displaced child links, or with a first link of negligible mass, are left out.
    """
    mirror = find_mirror_plane(robot)
    if mirror is None:
        return
    displaced, _ = _find_displaced_bodies(robot, mirror)
    for first, second in _list_body_pairs(robot):
        names = {first.name, second.name}
        names |= {
            child.name for name in (first.name, second.name) for child in robot.children(name)
        }
        if not displaced & names and not robot.is_negligible(first):
            yield mirror, first, second


_Part = TypeVar("_Part", Link, Joint)


def _omit_copied_limbs(
    robot: RobotModel, pairs: Iterable[tuple[MirrorPlane, _Part, _Part]]
) -> Iterator[tuple[MirrorPlane, _Part, _Part]]:
    """Yield the pairs of links or joints, except those of limbs that are copies of each other."""
    copied: frozenset[str] | None = None
    for mirror, first, second in pairs:
        copied = find_copied_links(robot, mirror) if copied is None else copied
        if (first.child if isinstance(first, Joint) else first.name) not in copied:
            yield mirror, first, second


def _list_inertial_pairs(
    robot: RobotModel,
) -> Iterator[tuple[MirrorPlane, tuple[Link, Inertial], tuple[Link, Inertial]]]:
    """Yield (mirror plane, (link, inertial), (partner, inertial)) of pairs that are not displaced.

    Copied limbs and links are left out.
    """
    for mirror, first, second in _omit_copied_limbs(robot, _list_pairs_in_place(robot)):
        if first.inertial is None or second.inertial is None:
            continue
        if _is_distributed_otherwise(robot, mirror, first, second):
            continue
        if not _is_turned_copy(robot, first, second):
            yield mirror, (first, first.inertial), (second, second.inertial)


def _is_distributed_otherwise(
    robot: RobotModel, mirror: MirrorPlane, first: Link, second: Link
) -> bool:
    """Return True if two links differ only in how mass is assigned to links that are fixed to them.

    The masses of the links differ, but mass and CoM of both groups of fixed links agree. A
    converter may add the inertial of a fixed link to its parent on one side only.
    """
    if _masses_agree(first, second):
        return False
    masses, coms = list[float](), list[Array]()
    for link in (first, second):
        group = [
            part
            for part in robot.fixed_group(robot.find_moving_body(link.name))
            if part.inertial is not None and part.mass > 0
        ]
        masses.append(sum(part.mass for part in group))
        moments = [
            part.mass * part.pose.point(part.inertial.com)
            for part in group
            if part.inertial is not None
        ]
        coms.append(np.sum(moments, axis=0) / max(masses[-1], np.finfo(float).tiny))
    if not min(masses) > 0 or abs(masses[0] - masses[1]) > MASS_RTOL * max(masses):
        return False
    gap = float(np.linalg.norm(mirror.reflect_point(coms[0]) - coms[1]))
    return gap <= get_com_tolerance(coms[1])


def _is_turned_copy(robot: RobotModel, first: Link, second: Link) -> bool:
    """Return True if two links of a URDF are the same part, mounted in another orientation.

    For example, the drives of ANYmal's knees are turned by 180 degrees, not mirrored.
    """
    if not isinstance(robot, UrdfModel) or first.inertial is None or second.inertial is None:
        return False
    if np.allclose(first.pose.rotation, second.pose.rotation, atol=1e-3):
        return False
    drawn = [
        [
            re.sub(rb"\s+", b"", etree.tostring(part, method="c14n"))
            for part in robot.file.tree.links[link.name].element.iterfind("visual")
            if part.find("geometry/mesh") is not None
        ]
        for link in (first, second)
    ]
    own, other = (
        np.concatenate([[link.mass], link.com, link.inertia.ravel()])
        for link in (first.inertial, second.inertial)
    )
    return bool(drawn[0]) and drawn[0] == drawn[1] and bool(np.array_equal(own, other))


def _masses_agree(first: Link, second: Link) -> bool:
    """Return True if the masses of two links differ by at most `MASS_RTOL` of the larger mass."""
    return not abs(first.mass - second.mass) > MASS_RTOL * max(abs(first.mass), abs(second.mass))


@rule
def mirror_position(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find joints or fixed links that are more than 1 mm from the mirror image of the partner.

    Of several displaced pairs of a chain, the pair nearest to the base is reported.
    """
    mirror = find_mirror_plane(robot)
    if mirror is None:
        return
    for first, second in _find_displaced_bodies(robot, mirror)[1]:
        image, place = mirror.reflect_point(_get_anchor(first)), _get_anchor(second)
        gap = float(np.linalg.norm(image - place))
        message = diagnose(
            "mirror-position",
            place=Vector(tuple(place), "m"),
            gap=Quantity(gap, "m"),
            image=Vector(tuple(image), "m"),
            other=first.name,
        )
        if robot.format == "urdf" and second.joints:
            yield CheckFinding("joint", second.joints[0].name, message, "origin")
        else:
            yield CheckFinding(robot.link_tag, second.name, message)


@rule
def mirror_mass(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find left-right pairs of links whose masses differ by more than 1 %.

    The severity is ERROR if positive masses have at least the ratio `IMPOSSIBLE_MASS_RATIO`. A pair
    is left out if mass and CoM of the two rigid groups (each link with the links fixed to it)
    agree: then only the assignment of the mass to the links of a group differs.
    """
    mirror = find_mirror_plane(robot)
    for first, second in _list_body_pairs(robot):
        if mirror is not None and _is_distributed_otherwise(robot, mirror, first, second):
            continue
        if not _masses_agree(first, second):
            message = diagnose(
                "mirror-mass",
                mass=Quantity(second.mass, "kg"),
                other=first.name,
                its=Quantity(first.mass, "kg"),
            )
            low, high = sorted((first.mass, second.mass))
            severity = Severity.ERROR if 0 < IMPOSSIBLE_MASS_RATIO * low <= high else None
            part = robot.inertial_path("mass")
            yield CheckFinding(robot.link_tag, second.name, message, part, severity=severity)


IMPOSSIBLE_MASS_RATIO = 10.0
"""Ratio of the masses of a left and a right link from which the difference is an error. Chosen, not
tuned."""


@rule
def mirror_com(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find left-right pairs of links whose CoM positions are no mirror images at zero angles.

    Pairs at displaced positions and copied limbs, for example, are left out.
    """
    for mirror, (first, first_inertial), (second, second_inertial) in _list_inertial_pairs(robot):
        image = mirror.reflect_point(first.pose.point(first_inertial.com))
        com = second.pose.point(second_inertial.com)
        gap = float(np.linalg.norm(image - com))
        if gap > get_com_tolerance(com):
            message = diagnose(
                "mirror-com",
                com=Vector(tuple(com), "m"),
                gap=Quantity(gap, "m"),
                image=Vector(tuple(image), "m"),
                other=first.name,
            )
            yield CheckFinding(robot.link_tag, second.name, message, robot.inertial_path("origin"))


@rule
def mirror_inertia(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find pairs of left and right links with inertias that are no mirror images.

    I and I' are the inertias about the CoMs in base axes at zero angles, and S is the reflection.
    An entry of S I S - I' may have up to 10 % of the largest entry, or more if the written digits
    are rounded. A wrong sign of a product of inertia (`_has_wrong_sign`) is a finding, too.
    """
    names = tuple(INERTIA_ENTRIES)
    for mirror, (first, first_inertial), (second, second_inertial) in _list_inertial_pairs(robot):
        if not _masses_agree(first, second):
            continue
        rotated = first.pose.rotation @ first_inertial.inertia @ first.pose.rotation.T
        image = mirror.matrix @ rotated @ mirror.matrix
        tensor = second.pose.rotation @ second_inertial.inertia @ second.pose.rotation.T
        scale = max(float(np.abs(image).max()), float(np.abs(tensor).max()))
        rounding = 2 * max(first_inertial.rounding, second_inertial.rounding)
        first_entries, second_entries = inertia_entries(image), inertia_entries(tensor)
        gap = np.abs(first_entries - second_entries)
        worst = int(np.argmax(gap))
        flipped = _has_wrong_sign(first_entries, second_entries)
        if gap[worst] > max(INERTIA_RTOL * scale, min(rounding, 0.5 * scale)) or flipped:
            message = diagnose(
                "mirror-inertia",
                entry=names[worst],
                value=Quantity(second_entries[worst], "kg m^2"),
                other=first.name,
                its=Quantity(first_entries[worst], "kg m^2"),
            )
            yield CheckFinding(robot.link_tag, second.name, message, robot.inertial_path("inertia"))


SIGN_RTOL, MIN_PRODUCT_FRACTION = 0.02, 0.01
"""Bounds of the check for a wrong sign of a product of inertia. `SIGN_RTOL`: two entries count as
equal up to sign if the magnitudes differ by at most this fraction of the entry.
`MIN_PRODUCT_FRACTION`: lower bound of all products of inertia, relative to the largest entry; with
a smaller product no sign is compared. Chosen, not tuned.
"""

_PRODUCTS = np.array([name[1] != name[2] for name in INERTIA_ENTRIES])
"""Mask of the products among the entries of an inertia, in the order of `INERTIA_ENTRIES`."""


def _has_wrong_sign(image: Array, entries: Array) -> bool:
    """Return True if two inertias differ only in the sign of one or three products of inertia.

    With two opposite signs the result is False: such a part is not mirrored, but turned by 180
    degrees. The result is also False if a product is near zero. ``image`` is the mirrored inertia.
    Both have shape (6,) [kg m^2], in the order of `INERTIA_ENTRIES`: ixx, iyy, izz, ixy, ixz, iyz.
    """
    tolerance = SIGN_RTOL * np.abs(image)
    is_equal = np.abs(image - entries) <= tolerance
    is_opposite = np.abs(image + entries) <= tolerance
    smallest = MIN_PRODUCT_FRACTION * float(np.abs(image).max())
    known = (np.abs(image[_PRODUCTS]) > smallest).all()
    wrong = int((is_opposite & ~is_equal & _PRODUCTS).sum())
    return bool(known and (is_equal | (is_opposite & _PRODUCTS)).all() and wrong % 2 == 1)


MIN_NAMED_PAIRS = 3
"""Smallest number of left-right pairs of links whose joints have mirrored names, per pair whose
joints do not, so that the other names are reported. Chosen, not tuned."""


@rule
def joint_name_odd(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find joints whose names do not follow the pattern of the limbs, such as ``knee`` for ``KFE``.

    The links of both joints have mirrored names. Of both joints, the joint is reported whose name
    without the words for the limb occurs less often.
    """
    pairs = [
        (first, second)
        for first, second in _list_body_pairs(robot)
        if len(first.joints) == len(second.joints) == 1 and first.moving and second.moving
    ]
    mirrored = {frozenset(names) for names in find_mirror_pairs(robot.joints)}
    odd = [
        (first, second)
        for first, second in pairs
        if frozenset((first.joints[0].name, second.joints[0].name)) not in mirrored
    ]
    num_regular = len(pairs) - len(odd)
    if not odd or num_regular < MIN_NAMED_PAIRS * len(odd):
        return
    counts = Counter(strip_sides(name) for name in robot.joints)
    for links in odd:
        link, partner_link = sorted(
            links, key=lambda link: counts[strip_sides(link.joints[0].name)]
        )
        name, other_name = link.joints[0].name, partner_link.joints[0].name
        if not name or counts[strip_sides(name)] == counts[strip_sides(other_name)]:
            continue
        message = diagnose(
            "joint-name-odd", link=partner_link.name, other=other_name, count=num_regular
        )
        yield CheckFinding("joint", name, message)


def list_joint_pairs(robot: RobotModel) -> Iterator[tuple[MirrorPlane, Joint, Joint]]:
    """Yield (mirror plane, joint, partner) of each left-right pair of moving joints of equal kind.

    Nothing is yielded if the robot has no mirror plane.
    """
    mirror, joints = find_mirror_plane(robot), robot.joints
    if mirror is None:
        return
    for pair in find_mirror_pairs(joints):
        first, second = (joints[name] for name in pair)
        if first.moves and first.kind == second.kind:
            yield mirror, first, second


def _compute_axis_sense(mirror: MirrorPlane, first: Joint, second: Joint) -> float:
    """Compute the cosine between a joint axis and the mirrored axis of the partner.

    With the reflection matrix S, the image of a sliding axis a is S a. The image of a rotation axis
    a (a pseudovector) is -S a.
    """
    image = mirror.matrix @ first.axis * (-1.0 if first.kind == HINGE_JOINT else 1.0)
    return float(image @ second.axis)


@rule
def mirror_axis(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find left-right pairs of joints whose axes, up to sign, are no mirror images within 1 deg.

    A pair is a finding, too, if the sense of the axes differs from all other pairs. Copied limbs
    are skipped.
    """
    yield from _find_reversed_axis(robot)
    for mirror, first, second in _omit_copied_limbs(robot, list_joint_pairs(robot)):
        if first.axis.any() and second.axis.any():
            cosine = abs(_compute_axis_sense(mirror, first, second))
            if cosine < np.cos(np.deg2rad(1.0)):
                message = diagnose(
                    "mirror-axis",
                    axis=Vector(tuple(second.axis), "1"),
                    angle=Quantity(np.arccos(cosine), "rad"),
                    other=first.name,
                    image=Vector(tuple(mirror.matrix @ first.axis), "1"),
                )
                yield CheckFinding("joint", second.name, message, "axis")


MIN_EQUAL_SENSES = 2
"""Smallest number of left-right pairs of hinges with the same axis sense with which a single pair
with another sense is reported. Chosen, not tuned."""


def _find_reversed_axis(robot: RobotModel) -> Iterator[CheckFinding]:
    """Yield a finding if the axes of exactly one left-right pair have an unusual relative sense.

    In most published robots, the axes of all pairs are parallel, or the axes of all pairs are
    mirror images. The finding names the joint of the pair whose axis is probably reversed.
    """
    pairs, parallel = [], []
    for mirror, first, second in _omit_copied_limbs(robot, list_joint_pairs(robot)):
        cosine = float(first.axis @ second.axis)
        sense = _compute_axis_sense(mirror, first, second)
        if abs(cosine) > 0.9 and abs(sense) > 0.9 and first.kind == HINGE_JOINT:
            pairs.append((first, second))
            parallel.append((cosine > 0, sense > 0))
    if len(pairs) <= MIN_EQUAL_SENSES:
        return
    conventions = np.array(parallel).T
    if conventions.all(axis=1).any():
        return
    exceptions = [
        (pairs[int(odd[0])], is_mirrored)
        for is_mirrored, agrees in enumerate(conventions)
        if len(odd := np.flatnonzero(~agrees)) == 1
    ]
    if len(exceptions) > 1:
        unlike = [exception for exception in exceptions if not _ranges_agree(mirror, *exception[0])]
        exceptions = unlike if len(unlike) == 1 else exceptions
    if not exceptions:
        return
    (first, second), is_mirrored = exceptions[0]
    kind = strip_sides(first.name)
    hinges = [joint for joint in robot.joints.values() if joint.kind == HINGE_JOINT]
    other_hinges = [joint for joint in hinges if joint not in (first, second)]
    equal = [joint for joint in other_hinges if strip_sides(joint.name) == kind]
    plane = mirror if is_mirrored else None
    for group in (equal, other_hinges):
        votes = sum(_compare_senses(joint, second, plane) for joint in group)
        if votes:
            break
    joint, partner = (second, first) if votes < 0 else (first, second)
    against = [hinge for hinge in equal or other_hinges if _compare_senses(hinge, joint, plane) < 0]
    message = diagnose(
        "mirror-axis-reversed",
        other=partner.name,
        pairs=len(pairs) - 1,
        certain=bool(votes),
        like=(against or equal or other_hinges)[0].name,
    )
    yield CheckFinding("joint", joint.name, message, "axis")


def _compare_senses(first: Joint, second: Joint, mirror: MirrorPlane | None) -> float:
    """Return 1 if the axes of two joints have the same sense, -1 if opposite, 0 if not parallel.

    ``mirror`` is None for a robot whose left and right axes are parallel. With a plane, the axis of
    a joint on the other side is mirrored.
    """
    cosine = float(first.axis @ second.axis)
    if mirror is not None:
        sides = [joint.position[mirror.axis] - mirror.offset for joint in (first, second)]
        if sides[0] * sides[1] < 0:
            cosine = _compute_axis_sense(mirror, first, second)
    return float(np.sign(cosine)) if abs(cosine) > 0.9 else 0.0


def _ranges_agree(mirror: MirrorPlane, first: Joint, second: Joint) -> bool:
    """Return True if the ranges of two joints are mirror images within `LIMIT_TOLERANCE`."""
    is_same = _compute_axis_sense(mirror, first, second) > 0
    image = (first.lower, first.upper) if is_same else (0.0 - first.upper, 0.0 - first.lower)
    stated = (second.lower, second.upper)
    gaps = (abs(a - b) if a != b else 0.0 for a, b in zip(image, stated, strict=True))
    return max(gaps) <= LIMIT_TOLERANCE


@rule
def mirror_limits(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find left-right joints whose ranges differ by over 0.02 rad (m), or efforts by over 1 %.

    Velocity limits are compared, too. Of a pair a single difference is reported. Pairs whose axes
    are no mirror images, and copied limbs, are skipped.
    """
    for mirror, first, second in _omit_copied_limbs(robot, list_joint_pairs(robot)):
        sense = _compute_axis_sense(mirror, first, second)
        if abs(sense) < 0.9:
            continue
        if not _ranges_agree(mirror, first, second):
            image = (first.lower, first.upper)
            if sense < 0:
                image = 0.0 - first.upper, 0.0 - first.lower
            stated = (second.lower, second.upper)
            lower, upper, its_lower, its_upper = (
                Quantity(limit, second.unit) for limit in (*stated, *image)
            )
            message = diagnose(
                "mirror-limits",
                lower=lower,
                upper=upper,
                other=first.name,
                same_sense=sense > 0,
                its_lower=its_lower,
                its_upper=its_upper,
            )
        elif first.effort != second.effort and not np.isclose(
            first.effort, second.effort, rtol=0.01
        ):
            unit = second.units.effort
            effort, first_effort = (
                describe_effort(second.effort, unit),
                describe_effort(first.effort, unit),
            )
            message = diagnose("mirror-effort", effort=effort, other=first.name, its=first_effort)
        elif not _speeds_agree(first, second):
            message = diagnose(
                "mirror-velocity",
                velocity=Quantity(second.stated["velocity"], second.units.velocity),
                other=first.name,
                its=Quantity(first.stated["velocity"], first.units.velocity),
            )
        else:
            continue
        yield CheckFinding("joint", second.name, message, "limit")


def _speeds_agree(first: Joint, second: Joint) -> bool:
    """Return True if two joints state equal velocity limits within 1 %, or one states none."""
    speed, other = (joint.stated.get("velocity") for joint in (first, second))
    return speed is None or other is None or bool(np.isclose(speed, other, rtol=0.01))


@rule
def mirror_type(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find a fixed joint of a URDF whose left or right partner is a hinge or a slide.

    The child links of both joints must be a left-right pair, too.
    """
    for fixed, moving in _list_unlike_joints(robot):
        message = diagnose("mirror-type", other=moving.name, kind=Term(moving.kind))
        yield CheckFinding("joint", fixed.name, message)


def _list_unlike_joints(robot: RobotModel) -> Iterator[tuple[Joint, Joint]]:
    """Yield (fixed joint, moving joint) of each left-right pair of a fixed and a moving joint."""
    pairs = set(map(frozenset, find_mirror_pairs(robot.links)))
    for names in find_mirror_pairs(robot.joints):
        first, second = (robot.joints[name] for name in names)
        if first.moves != second.moves and frozenset((first.child, second.child)) in pairs:
            yield (first, second) if second.moves else (second, first)


@rule
def mirror_drive(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find left-right pairs of joints with different damping, dry friction, armature or springs."""
    pairs = [(first.name, second.name) for _, first, second in list_joint_pairs(robot)]
    for attribute in PASSIVE_ATTRIBUTES:
        stated = {
            name: value
            for name, joint in robot.joints.items()
            if (value := joint.stated.get(attribute.kind)) is not None
        }
        for first, second in find_unlike_pairs(pairs, stated):
            unit = attribute.unit(robot.joints[second].kind != HINGE_JOINT)
            message = diagnose(
                "mirror-drive",
                what=Term(attribute.kind),
                own=Quantity(stated[second], unit),
                other=first,
                its=Quantity(stated[first], unit),
            )
            yield CheckFinding("joint", second, message, robot.locate_parameter(attribute)[1])


SIMPLE_SHAPE_TOLERANCE = 2e-3
"""Largest distance between corresponding sides of the bounding boxes of left and right primitive
shapes [m] that is not reported. Measured on published robots: at most 1 mm."""

SHAPE_TOLERANCE = 0.01
"""Fixed part of the largest distance between corresponding sides of the bounding boxes of left and
right meshes [m] that is not reported. A tenth of the size is added. Left and right meshes may be
cut differently. Chosen, not tuned.
"""


@rule
def mirror_shapes(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find pairs of left and right links with collision shapes that are no mirror images.

    The bounding boxes along the base axes, at zero angles, are compared, including shapes of links
    fixed to the link. A link without shapes whose partner has shapes is a finding, too. Pairs at
    displaced positions and copied limbs, for example, are left out.
    """
    unlike = {
        robot.find_moving_body(joint.parent)
        for joints in _list_unlike_joints(robot)
        for joint in joints
    }
    for mirror, first, second in _omit_copied_limbs(robot, _list_pairs_in_place(robot)):
        if unlike & {first.name, second.name}:
            continue
        pair = [_list_colliding_links(robot, link) for link in (first, second)]
        if not any(pair):
            continue
        if not all(pair):
            bare, shaped = (first, second) if not pair[0] else (second, first)
            message = diagnose("mirror-without-shapes", other=shaped.name)
            yield CheckFinding(robot.link_tag, bare.name, message)
            continue
        extents = [
            _find_extent_points(link, parts)
            for link, parts in zip((first, second), pair, strict=True)
        ]
        if extents[0] is None or extents[1] is None:
            continue
        image = np.array([mirror.reflect_point(point) for point in extents[0]])
        ends = [
            np.array([points.min(axis=0), points.max(axis=0)]) for points in (image, extents[1])
        ]
        gap = float(np.abs(ends[0] - ends[1]).max())
        size = float(np.ptp(ends[0], axis=0).max())
        simple = all(
            shape.kind != "mesh" for parts in pair for part in parts for shape in part.shapes
        )
        if gap > (SIMPLE_SHAPE_TOLERANCE if simple else SHAPE_TOLERANCE + 0.1 * size):
            wrong, partner = _choose_wrong_shapes(robot, first, second)
            message = diagnose("mirror-shapes", gap=Quantity(gap, "m"), other=partner.name)
            yield CheckFinding(robot.link_tag, wrong.name, message)


def _choose_wrong_shapes(robot: RobotModel, first: Link, second: Link) -> tuple[Link, Link]:
    """Choose the link of a pair whose collision shapes are probably wrong: (wrong, other)."""
    pairs = [(second, first), (first, second)]
    kind, boxes = strip_sides(first.name), dict[str, Array]()
    for name, link in robot.links.items():
        if strip_sides(name) == kind:
            points, is_complete = list_known_points(_list_colliding_links(robot, link), link)
            if not is_complete or points is None:
                points = np.zeros((1, 3))
            low, high = points.min(axis=0), points.max(axis=0)
            boxes[name] = np.concatenate([high - low, np.abs(high + low) / 2])
    deviating = select_deviating_pairs(pairs, boxes)
    if len(deviating) != 1:
        deviating = [
            (wrong, partner)
            for wrong, partner in pairs
            if not any(shape.collides for shape in wrong.shapes)
        ]
    return deviating[0] if len(deviating) == 1 else pairs[0]


MIN_SIBLINGS = 2
"""Smallest number of further limbs whose equal value decides which of two mirrored links or joints
has the wrong value. Chosen, not tuned."""


def select_deviating_pairs(
    pairs: list[tuple[Link, Link]], values: Mapping[str, Array]
) -> list[tuple[Link, Link]]:
    """Select the pair whose first link deviates from the corresponding links of other limbs.

    Args:
        pairs: (link that may be wrong, link on the other side).
        values: {link: numbers that are equal on both sides} of the pairs and of other limbs: the
            magnitudes of CoM coordinates in the frame of the link [m], for example, or of tensor
            entries relative to the largest entry [1].

    Returns:
        The selected pair as a list. All pairs if the other limbs are too few (`MIN_SIBLINGS`) or
        differ (`SIBLING_ATOL`). Empty if none or several of the first links deviate.
    """
    names = {link.name for link, _ in pairs}
    other_values = [value for name, value in values.items() if name not in names]
    if len(other_values) < MIN_SIBLINGS or not np.allclose(
        other_values, other_values[0], atol=SIBLING_ATOL
    ):
        return pairs
    wrong = [
        pair
        for pair in pairs
        if not np.allclose(values[pair[0].name], other_values[0], atol=SIBLING_ATOL)
    ]
    return wrong if len(wrong) == 1 else []


SIBLING_ATOL = 2e-3
"""Largest difference between numbers of corresponding links of several limbs that count as equal in
`select_deviating_pairs`: lengths [m], or tensor entries relative to the largest entry [1]. Chosen,
not tuned."""


@rule
def mirror_contacts(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find left-right pairs of links with different contact parameters on the ground.

    MuJoCo combines the parameters of each geom with the parameters of the ground: condim, friction,
    solref, solimp and margin. Geoms of links fixed to the link are included. If the file has no
    ground, a plane with MuJoCo's defaults is assumed.
    """
    model = robot.mj_model
    if model is None:
        return
    ground = ground_geom(model)
    for _, first, second in _list_pairs_in_place(robot):
        if not all(_list_colliding_links(robot, link) for link in (first, second)):
            continue  # reported by mirror_shapes
        first_contacts, second_contacts = (
            _list_contact_parameters(robot, model, link, ground) for link in (first, second)
        )
        if bool(first_contacts) != bool(second_contacts):
            bare, touching = (first, second) if second_contacts else (second, first)
            message = diagnose(
                "mirror-contacts", other=touching.name, word=None, own=None, its=None
            )
            yield CheckFinding(robot.link_tag, bare.name, message)
        elif len(first_contacts) != len(second_contacts) and len(
            _list_geoms(robot, model, first)
        ) == len(_list_geoms(robot, model, second)):
            sides = sorted(
                ((first_contacts, first), (second_contacts, second)), key=lambda side: len(side[0])
            )
            (fewer, link), (more, partner) = sides
            message = diagnose(
                "mirror-contacts-fewer", number=len(fewer), other=partner.name, its=len(more)
            )
            yield CheckFinding(robot.link_tag, link.name, message)
        for word in (
            _CONTACT_PARAMETERS
            if second_contacts and len(first_contacts) == len(second_contacts)
            else ()
        ):
            values = [
                np.array([np.ravel(getattr(contact, word)) for contact in side])
                for side in (second_contacts, first_contacts)
            ]
            second_values, first_values = (rows[np.lexsort(rows.T[::-1])] for rows in values)
            for place in np.flatnonzero(~np.isclose(second_values, first_values).all(axis=1))[:1]:
                message = diagnose(
                    "mirror-contacts",
                    other=first.name,
                    word=word,
                    own=Vector(tuple(second_values[place]), ""),
                    its=Vector(tuple(first_values[place]), ""),
                )
                yield CheckFinding(robot.link_tag, second.name, message)


_CONTACT_PARAMETERS = ("condim", "friction", "solref", "solimp", "margin")
"""Attributes of `ContactParameters` that `mirror_contacts` compares between left and right."""


def _list_contact_parameters(
    robot: MjcfModel, model: mujoco.MjModel, link: Link, ground: int | None
) -> list[ContactParameters]:
    """Return the contact parameters of the geoms of a link that can touch the ground.

    Geoms of links that are fixed to the link are included.
    """
    return [
        combine_geoms(model, geom, ground)
        for geom in _list_geoms(robot, model, link)
        if may_touch(model, geom, ground)
    ]


def _list_geoms(robot: MjcfModel, model: mujoco.MjModel, link: Link) -> list[int]:
    """Return the indices of the geoms of a link and of the links fixed to this link."""
    bodies = [robot.body_names.index(part.name) for part in robot.fixed_group(link.name)]
    indices: list[int] = np.flatnonzero(np.isin(model.geom_bodyid, bodies)).tolist()
    return indices


def _list_colliding_links(robot: RobotModel, link: Link) -> list[Link]:
    """Return a link and the links fixed to it, each with collision shapes only.

    Links without collision shapes are left out.
    """
    parts = [
        replace(part, shapes=tuple(shape for shape in part.shapes if shape.collides))
        for part in robot.fixed_group(link.name)
    ]
    return [part for part in parts if part.shapes]


def _find_extent_points(link: Link, parts: list[Link]) -> Array | None:
    """Return points with about the convex hull of all shapes of ``parts``, shape (n, 3) [m].

    The points are in the base frame, at zero angles; ``link`` is the link to which the parts are
    fixed. None if there are no shapes, or if the size of a shape is unknown.
    """
    points, is_complete = list_known_points(parts, link)
    return link.pose.point(points) if is_complete and points is not None else None
