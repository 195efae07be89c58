"""Rules about left and right, which are compared in the base's axes at zero angles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from pupper_analysis.base.arrays import INERTIA_ENTRIES, inertia_entries
from pupper_analysis.base.diagnostics import (
    Quantity,
    Term,
    Vector,
    describe_effort,
    diagnose,
)
from pupper_analysis.models.attributes import PASSIVE_ATTRIBUTES
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.sides import find_mirror_pairs, find_unlike_pairs
from pupper_analysis.models.stated.model import (
    HINGE,
    Array,
    Inertial,
    Joint,
    Link,
    MjcfModel,
    RobotModel,
)
from pupper_analysis.robot.contact import ContactParameters, combine_geoms, ground_geom
from pupper_analysis.robot.shapes import may_touch
from pupper_analysis.tools.audit.registry import list_known_points, rule


@dataclass(frozen=True, eq=False)
class MirrorPlane:
    """The plane between left and right, normal to one of the base's axes.

    Attributes:
        axis: 0, 1 or 2: which; 1 (y) by the usual convention.
        offset: Where it cuts that axis (m).
    """

    axis: int
    offset: float

    @property
    def matrix(self) -> Array:
        """The reflection S = S^T (3, 3) of vectors."""
        matrix = np.eye(3)
        matrix[self.axis, self.axis] = -1.0
        return matrix

    def reflect_point(self, point: Array) -> Array:
        """Returns the mirror image of a point (3,) in the base frame (m)."""
        image: Array = self.matrix @ point
        image[self.axis] += 2 * self.offset
        return image


def find_mirror_plane(robot: RobotModel, tolerance: float = 1e-3) -> MirrorPlane | None:
    """Finds the plane in which most pairs of bodies are mirror images of each other at zero angles.

    Returns:
        The plane; None if a third of the pairs, or more, is not explained by any.
    """
    pairs = find_mirror_pairs(robot.links)
    if not pairs:
        return None
    left = np.array([robot.links[name].pose.position for name, _ in pairs])
    right = np.array([robot.links[name].pose.position for _, name in pairs])
    best, most = None, 0
    for axis in (1, 0, 2):
        for offset in (0.0, float(np.median(left[:, axis] + right[:, axis])) / 2):
            mirror = MirrorPlane(axis, offset)
            images = np.array([mirror.reflect_point(point) for point in left])
            away = np.abs(left[:, axis] - right[:, axis]) > tolerance
            close = np.linalg.norm(images - right, axis=1) < tolerance
            agreeing = int(np.sum(close & away))
            if agreeing > most:
                best, most = mirror, agreeing
    return best if 3 * most >= len(pairs) else None


POSITION_TOLERANCE, MASS_RTOL, COM_TOLERANCE, INERTIA_RTOL, LIMIT_TOLERANCE = (
    1e-3,
    0.01,
    1e-3,
    0.1,
    0.02,
)
"""Tolerances: m, relative, m, relative, rad or m."""


def _body_pairs(robot: RobotModel) -> Iterator[tuple[Link, Link]]:
    """Yields pairs, the one that stands later in the file as the second."""
    for one, other in find_mirror_pairs(robot.links):
        yield robot.links[one], robot.links[other]


def _anchor(body: Link) -> Array:
    return body.joints[0].position if body.moving else body.pose.position


def _displaced(robot: RobotModel, mirror: MirrorPlane) -> tuple[set[str], list[tuple[Link, Link]]]:
    """Returns all bodies that are not at their mirror image, and the first pair of each chain."""
    displaced: set[str] = set()
    first_ones = []
    for one, other in _body_pairs(robot):
        if not (one.moving or one.mass or "foot" in one.name.lower()):
            continue  # a mark on a link
        if (
            float(np.linalg.norm(mirror.reflect_point(_anchor(one)) - _anchor(other)))
            > POSITION_TOLERANCE
        ):
            if not displaced & {*robot.ancestors(one.name), *robot.ancestors(other.name)}:
                first_ones.append((one, other))
            displaced |= {one.name, other.name}
    return displaced, first_ones


def _in_place(robot: RobotModel) -> Iterator[tuple[MirrorPlane, Link, Link]]:
    """Yields the pairs that are where they should be, with their children."""
    mirror = find_mirror_plane(robot)
    if mirror is None:
        return
    displaced, _ = _displaced(robot, mirror)
    for one, other in _body_pairs(robot):
        names = {one.name, other.name}
        names |= {child.name for name in (one.name, other.name) for child in robot.children(name)}
        if not displaced & names and not robot.is_negligible(one):
            yield mirror, one, other


def _inertials(
    robot: RobotModel,
) -> Iterator[tuple[MirrorPlane, tuple[Link, Inertial], tuple[Link, Inertial]]]:
    """Yields the pairs that are where they should be, with the inertials that both have."""
    for mirror, one, other in _in_place(robot):
        if one.inertial is not None and other.inertial is not None:
            yield mirror, (one, one.inertial), (other, other.inertial)


def _same_mass(one: Link, other: Link) -> bool:
    return not abs(one.mass - other.mass) > MASS_RTOL * max(abs(one.mass), abs(other.mass))


@rule
def mirror_position(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares the places of joints, or of fixed bodies; once per chain."""
    mirror = find_mirror_plane(robot)
    if mirror is None:
        return
    for one, other in _displaced(robot, mirror)[1]:
        image, place = mirror.reflect_point(_anchor(one)), _anchor(other)
        gap = float(np.linalg.norm(image - place))
        message = diagnose(
            "mirror-position",
            place=Vector(tuple(place), "m"),
            gap=Quantity(gap, "m"),
            image=Vector(tuple(image), "m"),
            other=one.name,
        )
        if robot.format == "urdf" and other.joints:
            yield CheckFinding("joint", other.joints[0].name, message, "origin")
        else:
            yield CheckFinding(robot.link_tag, other.name, message)


@rule
def mirror_mass(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares masses, with 1 % of tolerance."""
    for one, other in _body_pairs(robot):
        if not _same_mass(one, other):
            message = diagnose(
                "mirror-mass",
                mass=Quantity(other.mass, "kg"),
                other=one.name,
                its=Quantity(one.mass, "kg"),
            )
            yield CheckFinding(robot.link_tag, other.name, message, robot.inertial_part("mass"))


@rule
def mirror_com(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares coms, with 1 mm and 1 % of the distance to the base of tolerance."""
    for mirror, (one, here), (other, there) in _inertials(robot):
        image = mirror.reflect_point(one.pose.point(here.com))
        com = other.pose.point(there.com)
        gap = float(np.linalg.norm(image - com))
        if gap > COM_TOLERANCE + 0.01 * float(np.linalg.norm(com)):
            message = diagnose(
                "mirror-com",
                com=Vector(tuple(com), "m"),
                gap=Quantity(gap, "m"),
                image=Vector(tuple(image), "m"),
                other=one.name,
            )
            yield CheckFinding(robot.link_tag, other.name, message, robot.inertial_part("origin"))


@rule
def mirror_inertia(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares S I S with I', with S the reflection, where the masses agree; tolerance: 10 %."""
    names = tuple(INERTIA_ENTRIES)
    for mirror, (one, here), (other, there) in _inertials(robot):
        if not _same_mass(one, other):
            continue
        turned = one.pose.rotation @ here.inertia @ one.pose.rotation.T
        image = mirror.matrix @ turned @ mirror.matrix
        tensor = other.pose.rotation @ there.inertia @ other.pose.rotation.T
        scale = max(float(np.abs(image).max()), float(np.abs(tensor).max()))
        rounding = 2 * max(here.rounding, there.rounding)
        its, own = inertia_entries(image), inertia_entries(tensor)
        gap = np.abs(its - own)
        worst = int(np.argmax(gap))
        if gap[worst] > max(INERTIA_RTOL * scale, min(rounding, 0.5 * scale)):
            message = diagnose(
                "mirror-inertia",
                entry=names[worst],
                value=Quantity(own[worst], "kg m^2"),
                other=one.name,
                its=Quantity(its[worst], "kg m^2"),
            )
            yield CheckFinding(robot.link_tag, other.name, message, robot.inertial_part("inertia"))


def list_joint_pairs(robot: RobotModel) -> Iterator[tuple[MirrorPlane, Joint, Joint]]:
    """Yields the pairs of joints that move alike, if there is a plane between them."""
    mirror, joints = find_mirror_plane(robot), robot.joints
    if mirror is None:
        return
    for pair in find_mirror_pairs(joints):
        one, other = (joints[name] for name in pair)
        if one.moves and one.kind == other.kind:
            yield mirror, one, other


def _sense(mirror: MirrorPlane, one: Joint, other: Joint) -> float:
    """Returns the cosine between a joint's axis and its partner's mirrored one.

    An axis of rotation is a pseudovector: its mirror image is -S a, that of a sliding axis S a.
    """
    image = mirror.matrix @ one.axis * (-1.0 if one.kind == HINGE else 1.0)
    return float(image @ other.axis)


@rule
def mirror_axis(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares the lines along which axes lie; either may point either way. Tolerance: 1 degree."""
    for mirror, one, other in list_joint_pairs(robot):
        if one.axis.any() and other.axis.any():
            cosine = abs(_sense(mirror, one, other))
            if cosine < np.cos(np.deg2rad(1.0)):
                message = diagnose(
                    "mirror-axis",
                    axis=Vector(tuple(other.axis), "1"),
                    angle=Quantity(np.arccos(cosine), "rad"),
                    other=one.name,
                    image=Vector(tuple(mirror.matrix @ one.axis), "1"),
                )
                yield CheckFinding("joint", other.name, message, "axis")


@rule
def mirror_limits(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares ranges, turned round if the axes' senses differ, and efforts (1 %)."""
    for mirror, one, other in list_joint_pairs(robot):
        sense = _sense(mirror, one, other)
        if abs(sense) < 0.9:
            continue
        image = (one.lower, one.upper) if sense > 0 else (0.0 - one.upper, 0.0 - one.lower)
        here = (other.lower, other.upper)
        gap = max(abs(a - b) if a != b else 0.0 for a, b in zip(image, here, strict=True))
        if gap > LIMIT_TOLERANCE:
            lower, upper, its_lower, its_upper = (
                Quantity(limit, other.unit) for limit in (*here, *image)
            )
            message = diagnose(
                "mirror-limits",
                lower=lower,
                upper=upper,
                other=one.name,
                same_sense=sense > 0,
                its_lower=its_lower,
                its_upper=its_upper,
            )
        elif one.effort != other.effort and not np.isclose(one.effort, other.effort, rtol=0.01):
            unit = "N m" if other.kind == HINGE else "N"
            effort, its = describe_effort(other.effort, unit), describe_effort(one.effort, unit)
            message = diagnose("mirror-effort", effort=effort, other=one.name, its=its)
        else:
            continue
        yield CheckFinding("joint", other.name, message, "limit")


@rule
def mirror_drive(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares damping, dry friction, armature and springs; see ``unlike_pairs``."""
    pairs = [(one.name, other.name) for _, one, other in list_joint_pairs(robot)]
    for attribute in PASSIVE_ATTRIBUTES:
        stated = {
            name: value
            for name, joint in robot.joints.items()
            if (value := joint.stated.get(attribute.kind)) is not None
        }
        for one, other in find_unlike_pairs(pairs, stated):
            unit = attribute.unit(robot.joints[other].kind != HINGE)
            message = diagnose(
                "mirror-drive",
                what=Term(attribute.kind),
                own=Quantity(stated[other], unit),
                other=one,
                its=Quantity(stated[one], unit),
            )
            yield CheckFinding("joint", other, message, robot.words(attribute)[1])


SIMPLE_SHAPE_TOLERANCE = 2e-3
"""m: of simple shapes, whose numbers are typed; the largest gap in use is 1 mm."""

SHAPE_TOLERANCE = 0.01
"""m: of what touches, plus a tenth of its size: left and right meshes are cut otherwise."""


@rule
def mirror_shapes(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares what touches: whether there is anything, and how far it reaches."""
    for mirror, one, other in _in_place(robot):
        pair = [_touching(robot, link) for link in (one, other)]
        if not any(pair):
            continue
        if not all(pair):
            bare, whole = (one, other) if not pair[0] else (other, one)
            message = diagnose("mirror-without-shapes", other=whole.name)
            yield CheckFinding(robot.link_tag, bare.name, message)
            continue
        extents = [_extent(link, parts) for link, parts in zip((one, other), pair, strict=True)]
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
            message = diagnose("mirror-shapes", gap=Quantity(gap, "m"), other=one.name)
            yield CheckFinding(robot.link_tag, other.name, message)


@rule
def mirror_contacts(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Compares the contacts that MuJoCo makes of shapes and ground; of none, that of a scene."""
    model = robot.mj_model
    if model is None:
        return
    ground = ground_geom(model)
    for _, one, other in _in_place(robot):
        if not all(_touching(robot, link) for link in (one, other)):
            continue  # which is another slip
        its, own = (_contacts(robot, model, link, ground) for link in (one, other))
        if bool(its) != bool(own):
            bare, whole = (one, other) if own else (other, one)
            message = diagnose("mirror-contacts", other=whole.name, word=None, own=None, its=None)
            yield CheckFinding(robot.link_tag, bare.name, message)
        for word in _OF_CONTACTS if own and len(its) == len(own) else ():
            values = [
                np.array([np.ravel(getattr(contact, word)) for contact in side])
                for side in (own, its)
            ]
            a, b = (rows[np.lexsort(rows.T[::-1])] for rows in values)
            for place in np.flatnonzero(~np.isclose(a, b).all(axis=1))[:1]:
                message = diagnose(
                    "mirror-contacts",
                    other=one.name,
                    word=word,
                    own=Vector(tuple(a[place]), ""),
                    its=Vector(tuple(b[place]), ""),
                )
                yield CheckFinding(robot.link_tag, other.name, message)


_OF_CONTACTS = ("condim", "friction", "solref", "solimp", "margin")


def _contacts(
    robot: MjcfModel, model: mujoco.MjModel, link: Link, ground: int | None
) -> list[ContactParameters]:
    """Returns the contacts with the ground of all shapes that move with a link."""
    bodies = [robot.body_names.index(part.name) for part in robot.fixed_group(link.name)]
    return [
        combine_geoms(model, geom, ground)
        for geom in np.flatnonzero(np.isin(model.geom_bodyid, bodies)).tolist()
        if may_touch(model, geom, ground)
    ]


def _touching(robot: RobotModel, link: Link) -> list[Link]:
    """Returns a link, and what is fixed to it, with the shapes alone that touch."""
    parts = [
        replace(part, shapes=tuple(shape for shape in part.shapes if shape.collides))
        for part in robot.fixed_group(link.name)
    ]
    return [part for part in parts if part.shapes]


def _extent(link: Link, parts: list[Link]) -> Array | None:
    """Returns points (n, 3) of what touches, in the base's axes (m); None if some is not known."""
    points, whole = list_known_points(parts, link)
    return link.pose.point(points) if whole and points is not None else None
