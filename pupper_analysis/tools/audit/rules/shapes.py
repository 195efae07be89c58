"""Rules about where shapes are, and how large: whether numbers are in kg and m at all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from pupper_analysis.base.diagnostics import (
    Quantity,
    Severity,
    Subject,
    Term,
    diagnose,
)
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.shapes import Shape
from pupper_analysis.models.stated.model import Array, Link, RobotModel
from pupper_analysis.tools.audit.registry import (
    list_extent_points,
    list_known_points,
    list_link_points,
    rule,
)

POSITION_TOLERANCE = 1e-3
"""How exactly shapes are expected at joints and frames (m)."""


def _next_points(robot: RobotModel, body: Link) -> dict[Subject, Array]:
    """Returns where the link ends: its moving children and its feet, in its frame (m)."""
    to_frame = body.pose.inverse()
    points: dict[Subject, Array] = {}
    for part in robot.fixed_group(body.name):
        local = to_frame * part.pose
        for child in robot.children(part.name):
            if child.moving:
                points[Subject("joint", child.joints[0].name)] = to_frame.point(child.pose.position)
        if part is not body and _is_foot(part.name):
            points[Subject(robot.link_tag, part.name)] = local.position
        for frame in part.frames:
            if _is_foot(frame.name):
                points[Subject("site", frame.name)] = local.point(frame.position)
    return points


def _is_foot(name: str) -> bool:
    return "foot" in name.lower()


def _from_joint(shape: Shape, anchor: Array) -> tuple[Array, float] | None:
    """Returns direction (3,) and length (m) of a rod that begins at the joint, else None."""
    if shape.kind not in ("capsule", "cylinder"):
        return None
    radius, half = shape.size
    axis = shape.pose.rotation[:, 2]
    for sign in (1.0, -1.0):
        start = shape.pose.position - sign * half * axis
        if np.linalg.norm(start - anchor) < max(POSITION_TOLERANCE, 0.02 * half) and half > radius:
            return sign * axis, 2 * half
    return None


@rule
def shape_ends_off_joint(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares capsules and cylinders that begin at their body's joint with the way to the next.

    Longer by 2 % or more is reported, shorter by 20 % or more: some shorten a shape on purpose, to
    keep it clear of its neighbour.
    """
    for body in robot.links.values():
        if not body.moving:
            continue
        ends = _next_points(robot, body)
        anchor = body.pose.inverse().point(body.joints[-1].position)
        reported = set()
        for shape in body.shapes:
            rod = _from_joint(shape, anchor)
            if rod is None:
                continue
            direction, length = rod
            ahead = {
                name: float((point - anchor) @ direction)
                for name, point in ends.items()
                if _on_line(point - anchor, direction, shape.size[0])
            }
            if not ahead:
                continue
            end, way = min(ahead.items(), key=lambda item: abs(item[1] - length))
            gap, caps = length - way, shape.size[0]
            tolerance = max(POSITION_TOLERANCE, 0.02 * way)
            reached = -0.2 * way < gap < tolerance or abs(gap + caps) < tolerance
            if not reached and (end, round(length, 6)) not in reported:
                reported.add((end, round(length, 6)))
                message = diagnose(
                    "shape-ends-off-joint",
                    shape=Term(shape.kind),
                    length=Quantity(length, "m"),
                    kind=Term(end.kind),
                    end=end.name,
                    way=Quantity(way, "m"),
                    gap=Quantity(abs(gap), "m"),
                    beyond=gap > 0,
                )
                yield CheckFinding(robot.link_tag, body.name, message, _tag(robot, shape))


@rule
def shape_off_link(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares rods and slabs that run along a limb's link with the way from joint to joint.

    Of 119 in use none is off that way by more than 3 % of it beyond its own half width, nor its
    middle by more than a fifth along it; a tenth and two fifths are allowed.
    """
    for body in robot.links.values():
        ends = [
            body.pose.inverse().point(child.pose.position)
            for part in robot.fixed_group(body.name)
            for child in robot.children(part.name)
            if child.moving
        ]
        if not body.moving or len(ends) != 1:
            continue
        anchor = body.pose.inverse().point(body.joints[-1].position)
        way, length = ends[0] - anchor, float(np.linalg.norm(ends[0] - anchor))
        for shape in body.shapes:
            if not shape.collides or shape.kind not in ("box", "cylinder", "capsule"):
                continue
            axis, half, width = _rod(shape)
            along = 0.6 < 2 * half / max(length, MIN_LINK_LENGTH) < 1.4 and half > 2 * width
            if (
                length < MIN_LINK_LENGTH
                or not along
                or abs(way @ axis) < MIN_ALIGNMENT_COSINE * length
            ):
                continue
            middle = shape.pose.position - anchor - way / 2
            ahead = float(middle @ way) / length
            aside = float(np.linalg.norm(middle - ahead * way / length))
            if aside - width > 0.1 * length or abs(ahead) > 0.4 * length:
                message = diagnose(
                    "shape-off-link",
                    shape=Term(shape.kind),
                    aside=Quantity(aside, "m"),
                    ahead=Quantity(abs(ahead), "m"),
                    way=Quantity(length, "m"),
                )
                yield CheckFinding(robot.link_tag, body.name, message, _tag(robot, shape))


MIN_LINK_LENGTH = 0.03
"""m: of joints that are nearer, no shape shows where a link is."""

MIN_ALIGNMENT_COSINE = 0.966
"""Cosine of 15 degrees: what is more inclined does not run along its link."""


def _rod(shape: Shape) -> tuple[Array, float, float]:
    """Returns the direction (3,) in which a shape is longest, half its length, half its width."""
    if shape.kind == "box":
        order = np.argsort(shape.size)
        direction: Array = shape.pose.rotation[:, order[2]]
        return direction, shape.size[order[2]], shape.size[order[1]]
    radius, half = shape.size
    return shape.pose.rotation[:, 2], half + (radius if shape.kind == "capsule" else 0.0), radius


def _tag(robot: RobotModel, shape: Shape) -> str:
    if robot.format == "mjcf":
        return "geom"
    return "collision" if shape.collides else "visual"


def _on_line(offset: Array, direction: Array, radius: float) -> bool:
    along = float(offset @ direction)
    across = float(np.linalg.norm(offset - along * direction))
    return along > 2 * radius and across < max(POSITION_TOLERANCE, 0.5 * radius)


@rule
def foot_sphere_off_frame(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares a foot's frame with the nearest sphere that touches things, of what moves with it.

    Spheres of the foot, by their name or their link's, come first. NOTE where the frame is inside
    the sphere: some make a flat sole that way.
    """
    for body in robot.links.values():
        group = robot.fixed_group(body.name)
        feet = {f.name: (body, f.position, "site") for f in body.frames if _is_foot(f.name)}
        if not feet and _is_foot(body.name) and not body.moving and body.parent is not None:
            feet = {body.name: (body, np.zeros(3), robot.link_tag)}
            group = robot.fixed_group(robot.carrier(body.name))
        for name, (owner, position, kind) in feet.items():
            place = owner.pose.point(position)
            spheres = [
                (
                    not _is_foot(shape.name + part.name),
                    float(np.linalg.norm(part.pose.point(shape.pose.position) - place)),
                    shape.size[0],
                )
                for part in group
                for shape in part.shapes
                if shape.collides and shape.kind == "sphere"
            ]
            if not spheres:
                continue
            _, gap, radius = min(spheres)
            if (
                gap > 5 * radius
                or gap < POSITION_TOLERANCE
                or abs(gap - radius) < POSITION_TOLERANCE
            ):
                continue
            message = diagnose(
                "foot-sphere-off-frame", radius=Quantity(radius, "m"), gap=Quantity(gap, "m")
            )
            yield CheckFinding(
                kind, name, message, severity=Severity.NOTE if gap < radius else None
            )


# How large they are.

MAX_DENSITY = 20_000.0
"""Mass per volume of the convex hull (kg/m^3) above which no link is: tungsten has 19300.

The hull is the largest volume that a body of these shapes can have. Of 1500 links of robots in use
the densest has 15600, a wrist whose mesh leaves out what is screwed to it.
"""

UNREAD_MESH_FACTOR = 5.0
"""Times that, where some mesh is not read: the shapes that are may be smaller than the link."""

MIN_DENSITY = 2.0
"""Likewise below which none is (kg/m^3): air has 1.2, the lightest foam 10; the links, 8.8."""

MIN_MASS_FRACTION = 0.01
"""Of the robot's mass: what weighs less may have a token of a shape."""

MIN_SHAPE_FRACTION = 0.5
"""A shape less than this share of the way to the next joint does not show how large a link is."""

MIN_EXTENT = 0.01
"""Nor does one below this extent (m)."""

MAX_ROBOT_EXTENT, MIN_ROBOT_EXTENT = 20.0, 0.002
"""Extents between which the joints of a robot are expected (m)."""

MAX_SHAPE_RATIO = 20.0
"""Times the extent of all joints that no link is drawn; of 1500 links the largest has 2.3."""


@rule
def density_implausible(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares a moving body's mass, with all that is fixed to it, with its shapes' convex hull."""
    for body in _moving(robot):
        group = robot.fixed_group(body.name)
        mass = sum(part.mass for part in group)
        if mass < MIN_MASS_FRACTION * robot.total_mass or mass <= 0:
            continue
        points, whole = list_known_points(group, body)
        if points is None or not (whole or body.moving):
            continue  # of a base, what is not read may be nearly all
        most = MAX_DENSITY if whole else UNREAD_MESH_FACTOR * MAX_DENSITY
        links = list_link_points(robot, body)
        own, way = _extent(points), _extent(links)
        if own < max(MIN_EXTENT, MIN_SHAPE_FRACTION * way):
            continue
        volume = _volume(np.concatenate([points, links]))
        density = mass / volume if volume > 0 else np.inf
        if volume > 0 and not (MIN_DENSITY if whole else 0.0) <= density <= most:
            message = diagnose(
                "denser-than-metal" if density > most else "lighter-than-foam",
                mass=Quantity(mass, "kg"),
                volume=Quantity(volume, "m^3"),
                density=Quantity(density, "kg/m^3"),
            )
            yield CheckFinding(robot.link_tag, body.name, message, robot.inertial_part("mass"))


@rule
def scale_unusual(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares the extent of all joints with that of robots, and that of each link with it."""
    places = np.array([joint.position for joint in robot.joints.values() if joint.moves])
    if len(places) < 2 or robot.base not in robot.links:
        return
    size = _extent(places)
    if size > MAX_ROBOT_EXTENT or 0 < size < MIN_ROBOT_EXTENT:
        message = diagnose(
            "joints-out-of-scale",
            size=Quantity(size, "m"),
            least=Quantity(MIN_ROBOT_EXTENT, "m"),
            most=Quantity(MAX_ROBOT_EXTENT, "m"),
        )
        yield CheckFinding(robot.link_tag, robot.base, message)
    if size < MIN_EXTENT:
        return
    for body in robot.links.values():
        points = list_extent_points([body], body)
        if points is not None and _extent(points) > MAX_SHAPE_RATIO * size:
            message = diagnose(
                "shapes-out-of-scale",
                length=Quantity(_extent(points), "m"),
                times=_extent(points) / size,
                size=Quantity(size, "m"),
            )
            yield CheckFinding(robot.link_tag, body.name, message)


def _moving(robot: RobotModel) -> Iterator[Link]:
    for body in robot.links.values():
        if body.parent is None or body.moving:
            yield body


def _extent(points: Array) -> float:
    return float(np.ptp(points, axis=0).max())


def _volume(points: Array) -> float:
    """Returns the volume of the convex hull (m^3); 0 of what lies in a plane."""
    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0
