"""Rules about the position and the size of shapes, including wrong units of mass and length.

The extent of points is the longest side of the bounding box [m], along the axes of the frame in
which the points are expressed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import PurePath

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    Quantity,
    Severity,
    Subject,
    Term,
    diagnose,
)
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.places import Place
from pupper_analysis.models.shapes import COMPARISON_DIRECTIONS, Mesh, Shape
from pupper_analysis.models.sides import strip_sides
from pupper_analysis.models.stated.model import HINGE_JOINT, Link, RobotModel, UrdfModel
from pupper_analysis.models.urdf_tree import origin_of
from pupper_analysis.tools.audit.registry import (
    compute_hull_distance,
    compute_hull_volume,
    list_extent_points,
    list_known_points,
    list_link_points,
    rule,
)

POSITION_TOLERANCE = 1e-3
"""Tolerance of positions of shapes, joints and feet [m]; some tests use a larger tolerance relative
to the size. Chosen, not tuned.
"""


def _list_end_points(robot: RobotModel, body: Link) -> dict[Subject, Array]:
    """Find the ends of a link: {joint or foot: position in the link frame, shape (3,) [m]}.

    The ends are the moving joints of the next links, and the links and frames with "foot" in the
    name.
    """
    to_frame = body.pose.inverse()
    points: dict[Subject, Array] = {}
    for part in robot.fixed_group(body.name):
        local = to_frame * part.pose
        for child in robot.children(part.name):
            if child.moving:
                points[Subject("joint", child.joints[0].name)] = to_frame.point(
                    child.joints[0].position
                )
        if part is not body and _is_foot(part.name):
            points[Subject(robot.link_tag, part.name)] = local.position
        for frame in part.frames:
            if _is_foot(frame.name):
                points[Subject("site", frame.name)] = local.point(frame.position)
    return points


def _is_foot(name: str) -> bool:
    """Return True if a name contains "foot"."""
    return "foot" in name.lower()


def _measure_rod(shape: Shape, anchor: Array) -> tuple[Array, float] | None:
    """Return unit direction, shape (3,), and length [m] of a rod that begins at the joint.

    ``anchor`` is the position of the joint [m], in the frame in which the shape is expressed. The
    length of a capsule excludes the caps. None if the shape is no capsule or cylinder, is short, or
    does not begin at the joint.
    """
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
    """Find capsules and cylinders from a joint towards the next that do not end there.

    The end may also be a foot. The length without caps may be about 2 % too long, or 20 % too
    short, since shapes are often shortened to avoid contact with the neighbour. The length may also
    be too short by one radius, so that the cap ends at the joint.
    """
    for body in robot.links.values():
        if not body.moving:
            continue
        ends = _list_end_points(robot, body)
        anchor = body.pose.inverse().point(body.joints[-1].position)
        reported = set()
        for shape in body.shapes:
            rod = _measure_rod(shape, anchor)
            if rod is None:
                continue
            direction, length = rod
            ahead = {
                name: float((point - anchor) @ direction)
                for name, point in ends.items()
                if _is_on_line(point - anchor, direction, shape.size[0])
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
                yield CheckFinding(robot.link_tag, body.name, message, _get_shape_tag(robot, shape))


@rule
def shape_off_link(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find collision rods and slabs along a link that are away from the line between the joints.

    The centre may be away from the line by the half width plus 10 % of the distance between the
    joints, and displaced along the line by 40 %.
    """
    for body in robot.links.values():
        ends = [
            body.pose.inverse().point(child.joints[0].position)
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
            axis, half, width = _measure_long_axis(shape)
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
                yield CheckFinding(robot.link_tag, body.name, message, _get_shape_tag(robot, shape))


MIN_LINK_LENGTH = 0.03
"""Smallest distance between two joints of a link [m] from which the position of the link's shapes
is checked. Chosen, not tuned.
"""

MIN_ALIGNMENT_COSINE = 0.966
"""Smallest absolute cosine between the long axis of a shape and the line between two joints of a
link, with which the position of the shape is checked: 15 degrees. Chosen, not tuned."""


def _measure_long_axis(shape: Shape) -> tuple[Array, float, float]:
    """Return the direction of the long axis, shape (3,), the half length and the half width [m].

    The half length of a capsule includes a cap.
    """
    if shape.kind == "box":
        order = np.argsort(shape.size)
        direction: Array = shape.pose.rotation[:, order[2]]
        return direction, shape.size[order[2]], shape.size[order[1]]
    radius, half = shape.size
    return shape.pose.rotation[:, 2], half + (radius if shape.kind == "capsule" else 0.0), radius


def _get_shape_tag(robot: RobotModel, shape: Shape) -> str:
    """Return the tag of a shape: ``geom`` in an MJCF, else ``collision`` or ``visual``."""
    if robot.format == "mjcf":
        return "geom"
    return "collision" if shape.collides else "visual"


def _is_on_line(offset: Array, direction: Array, radius: float) -> bool:
    """Return True if a point is near the axis of a rod, beyond the joint where the rod begins.

    ``offset`` is the point relative to the joint, shape (3,) [m]; ``direction`` is the unit vector
    along the rod, shape (3,).
    """
    along = float(offset @ direction)
    across = float(np.linalg.norm(offset - along * direction))
    return along > 2 * radius and across < max(POSITION_TOLERANCE, 0.5 * radius)


@rule
def foot_sphere_off_frame(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find foot frames that are neither at the centre nor on the surface of the foot's sphere.

    The foot's sphere is the nearest collision sphere that moves with the frame; spheres with "foot"
    in the name of sphere or link have precedence. Frames farther than five radii from the centre
    are skipped. The severity is NOTE if the frame is inside the sphere.
    """
    for body in robot.links.values():
        group = robot.fixed_group(body.name)
        feet = {f.name: (body, f.position, "site") for f in body.frames if _is_foot(f.name)}
        if not feet and _is_foot(body.name) and not body.moving and body.parent is not None:
            feet = {body.name: (body, np.zeros(3), robot.link_tag)}
            group = robot.fixed_group(robot.find_moving_body(body.name))
        if feet and not any(_list_collision_spheres(part) for part in group):
            group = robot.fixed_group(robot.find_moving_body(body.name))
        for name, (owner, position, kind) in feet.items():
            place = owner.pose.point(position)
            spheres = [
                (
                    not _is_foot(shape.name + part.name),
                    float(np.linalg.norm(part.pose.point(shape.pose.position) - place)),
                    shape.size[0],
                )
                for part in group
                for shape in _list_collision_spheres(part)
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


def _list_collision_spheres(link: Link) -> list[Shape]:
    """Return the collision spheres of a link."""
    return [shape for shape in link.shapes if shape.collides and shape.kind == "sphere"]


# Rules about sizes.

MAX_DENSITY = 20_000.0
"""Mass per volume of the convex hull of a link [kg/m^3] above which the density is reported. Also a
bound in `_find_excess_axis` and in repairs. Tungsten has 19300. The densest of 1500 published links
has 15600: a wrist whose mesh omits attached parts.
"""

UNREAD_MESH_FACTOR = 5.0
"""Factor on `MAX_DENSITY` for a link with a shape of unknown size, since the known shapes may be
smaller than the link. Chosen, not tuned.
"""

MIN_DENSITY = 2.0
"""Mass per volume of the convex hull of a link [kg/m^3] below which the density is reported. Also a
bound in repairs. Air has 1.2, light foam about 10, the lightest published link 8.8.
"""

MIN_MASS_FRACTION = 0.01
"""Smallest mass of a link with fixed links, relative to the robot's mass, at which the density of a
link other than a free base is checked. The shapes of a lighter link may be markers instead of the
real geometry. `_is_light_part` and `compute_median_density` also use the fraction. Chosen, not
tuned.
"""

MIN_SHAPE_FRACTION = 0.5
"""Smallest extent of a link's shapes, relative to the extent of the link's joints and frames, with
which the density is checked. Smaller shapes may show only a part of the link. Chosen, not tuned.
"""

MIN_EXTENT = 0.01
"""Smallest extent [m] of a link's shapes with which the link's density is checked, and of all joint
positions with which the size of shapes is checked. Chosen, not tuned.
"""

MAX_ROBOT_EXTENT, MIN_ROBOT_EXTENT = 20.0, 0.002
"""Extent of all joint positions of a robot [m] above and below which the size is reported as
implausible, for example because of a wrong unit of length. Chosen, not tuned."""

MIN_USUAL_EXTENT, MAX_USUAL_EXTENT = 0.05, 5.0
"""Extent of all joint positions of a robot [m], after multiplication by 1000 or division by 1000,
between which the message of `scale_unusual` names this factor. Chosen, not tuned.
"""

MAX_SHAPE_RATIO = 20.0
"""Extent of a link's shapes, relative to the extent of all joints, above which the shapes are
reported as too large. Measured: the largest ratio of 1500 published links is 2.3.
"""

MIN_MESH_RATIO, MAX_MESH_RATIO = 5e-5, 2.5e-3
"""Extent of a mesh, relative to the extent of all joints, between which the mesh is reported as
probably scaled by 0.001 twice. A thousand times these ratios are 0.05 and 2.5, and thus the usual
ratios of published links (see `MAX_SHAPE_RATIO`). Chosen, not tuned.
"""

MAX_MILLIMETRE_SCALE = 0.01
"""Scale of a mesh [1] up to which a tiny mesh is reported. Without a scale, a tiny mesh may be a
marker: B2 has spheres of 0.5 mm. Chosen, not tuned.
"""


@rule
def density_implausible(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find implausible densities: mass / volume of the convex hull of the shapes.

    A root link or moving link is checked together with the links fixed to it. The hull contains
    visual and collision shapes, and the origins of link, frames and children. The density is
    compared with fixed bounds (`MIN_DENSITY`, `MAX_DENSITY`) and with the median density of the
    other links. Light bodies and small shapes, for example, are skipped.
    """
    for body in _list_moving_links(robot):
        group = robot.fixed_group(body.name)
        mass = sum(part.mass for part in group)
        light = mass < MIN_MASS_FRACTION * robot.total_mass
        is_trunk = body.name == robot.base and robot.has_free_base
        if mass <= 0 or (light and not is_trunk):
            continue
        points, whole = list_known_points(group, body)
        if points is None or not (whole or body.moving):
            continue  # unread meshes may be most of a base
        most = MAX_DENSITY if whole else UNREAD_MESH_FACTOR * MAX_DENSITY
        links = list_link_points(robot, body)
        own, way = _compute_extent(points), _compute_extent(links)
        if own < max(MIN_EXTENT, MIN_SHAPE_FRACTION * way):
            continue
        volume = compute_hull_volume(np.concatenate([points, links]))
        density = mass / volume if volume > 0 else np.inf
        # Only a dense link is compared with the others: their convex hulls take most of the time.
        typical = (
            compute_median_density(robot, body.name)
            if whole and DENSITY_OF_STEEL < density <= most
            else None
        )
        if typical is not None and density > MIN_DENSITY_RATIO * typical:
            message = diagnose(
                "denser-than-others",
                mass=Quantity(mass, "kg"),
                volume=Quantity(volume, "m^3"),
                density=Quantity(density, "kg/m^3"),
                times=density / typical,
                typical=Quantity(typical, "kg/m^3"),
            )
            yield CheckFinding(robot.link_tag, body.name, message, robot.inertial_path("mass"))
        if volume > 0 and not (MIN_DENSITY if whole else 0.0) <= density <= most:
            message = diagnose(
                "denser-than-metal" if density > most else "lighter-than-foam",
                mass=Quantity(mass, "kg"),
                volume=Quantity(volume, "m^3"),
                density=Quantity(density, "kg/m^3"),
            )
            impossible = density > IMPOSSIBLE_SIZE_RATIO * MAX_DENSITY
            severity = Severity.ERROR if impossible else None
            part = robot.inertial_path("mass")
            yield CheckFinding(robot.link_tag, body.name, message, part, severity=severity)


DENSITY_OF_STEEL, MIN_DENSITY_RATIO = 7900.0, 5.0
"""Density of steel [kg/m^3], and ratio to the median density of the other links: a link above both
is reported. Chosen, not tuned: motors and gears fill a part of a hull."""

MIN_OTHER_LINKS = 3
"""Smallest number of other comparable links or hinges with which a single exception is reported, or
a median density is computed. Chosen, not tuned.
"""


def compute_median_density(robot: RobotModel, name: str) -> float | None:
    """Compute the median density of a robot's links except one: mass / hull volume [kg/m^3].

    Links without volume or with a shape of unknown size, and light links, are left out. None if
    fewer than `MIN_OTHER_LINKS` remain.

    Args:
        robot: Model of the robot.
        name: Link that is left out.
    """
    densities = []
    for body in _list_moving_links(robot):
        group = robot.fixed_group(body.name)
        mass = sum(part.mass for part in group)
        points, whole = list_known_points(group, body)
        light = mass < MIN_MASS_FRACTION * (robot.total_mass - robot.links[name].mass)
        if body.name == name or light or not whole or points is None:
            continue
        volume = compute_hull_volume(np.concatenate([points, list_link_points(robot, body)]))
        if volume > 0 and mass > 0:
            densities.append(mass / volume)
    return float(np.median(densities)) if len(densities) >= MIN_OTHER_LINKS else None


@rule
def moving_link_without_collision(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find the only moving link of a URDF with visual shapes, but without collision shapes.

    Collision shapes of fixed links may count, and light rotors and light links between others need
    no collision shapes.
    """
    collides: dict[str, bool] = {}
    for body in robot.links.values():
        own = [shape for shape in body.shapes if shape.kind != "none"]
        group = [
            s for part in robot.fixed_group(body.name) for s in part.shapes if s.kind != "none"
        ]
        shapes = own if any(not shape.collides for shape in own) else group
        is_drawn = any(not shape.collides for shape in shapes)
        if body.moving and is_drawn and not _is_light_part(robot, body):
            collides[body.name] = any(shape.collides for shape in shapes) or (
                _is_covered_by_fixed_link(robot, body)
            )
    bare = [name for name in collides if not collides[name]]
    if len(bare) == 1 and len(collides) > MIN_OTHER_LINKS:
        message = diagnose("moving-link-without-collision", others=len(collides) - 1)
        yield CheckFinding("link", bare[0], message)


def _is_light_part(robot: UrdfModel, body: Link) -> bool:
    """Return True for a light rotor, a light link between moving links, or a light carrier.

    A rotor is on a hinge without limits. A carrier has a heavier fixed link with collision shapes.
    Light means below `MIN_MASS_FRACTION` of the robot's mass, with all fixed links except for a
    carrier.
    """
    group = robot.fixed_group(body.name)
    is_between = any(child.moving for part in group for child in robot.children(part.name))
    is_rotor = all(joint.kind == HINGE_JOINT and np.isinf(joint.lower) for joint in body.joints)
    mass, limit = sum(part.mass for part in group), MIN_MASS_FRACTION * robot.total_mass
    is_carrier = any(
        2 * part.mass > mass and any(shape.collides for shape in part.shapes) for part in group[1:]
    )
    is_light_between = is_between and 0 < mass < limit
    return (is_rotor and mass < limit) or is_light_between or (body.mass < limit and is_carrier)


def _is_covered_by_fixed_link(robot: UrdfModel, body: Link) -> bool:
    """Return True if a fixed link has collision shapes where a link has visual shapes.

    The bounding box of the collision shapes contains the centre of the bounding box of the visual
    shapes, along the axes of the link.
    """
    visual = list_extent_points([_select_shapes(body, collides=False)], body)
    if visual is None:
        return False
    centre = (visual.min(axis=0) + visual.max(axis=0))[None] / 2
    solids = [
        list_extent_points([_select_shapes(part, collides=True)], body)
        for part in robot.fixed_group(body.name)
        if part is not body
    ]
    return any(solid is not None and _measure_box_gap(centre, solid) < 0 for solid in solids)


@rule
def collision_off_visual(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find links whose collision shapes are apart from the visual shapes.

    The gap [m] between the bounding boxes of the collision and visual shapes along the axes of the
    link is compared with `POSITION_TOLERANCE` and a fraction of the extent. If the size of a shape
    is unknown, origins of equal meshes are compared instead. A gap that several limbs have in
    common may be intended, and is then not reported.
    """
    gaps = {name: _measure_collision_gap(robot, body) for name, body in robot.links.items()}
    gaps = {name: gap for name, gap in gaps.items() if gap > 0}
    intended = _list_intended_gaps(robot, gaps)
    for name in (name for name in gaps if name not in intended):
        message = diagnose("collision-off-visual", gap=Quantity(gaps[name], "m"))
        yield CheckFinding("link", name, message, "collision")


def _list_intended_gaps(robot: UrdfModel, gaps: Mapping[str, float]) -> set[str]:
    """Return links of several limbs with about the same gap, which is probably intended.

    Most of the links must fulfil `_is_drawn_by_next_link`. ``gaps`` is {link: gap between collision
    and visual shapes [m]}.
    """
    kinds: dict[str, list[str]] = {}
    for name in gaps:
        kinds.setdefault(strip_sides(name), []).append(name)
    intended: set[str] = set()
    for names in kinds.values():
        drawn = [name for name in names if _is_drawn_by_next_link(robot, robot.links[name])]
        if 1 < len(names) < 2 * len(drawn):
            usual = float(np.median([gaps[name] for name in drawn]))
            intended |= {name for name in names if abs(gaps[name] - usual) <= POSITION_TOLERANCE}
    return intended


def _measure_collision_gap(robot: UrdfModel, body: Link) -> float:
    """Return the gap between collision and visual shapes of a link [m]; 0 if not reported."""
    sides = [_select_shapes(body, collides=collides) for collides in (False, True)]
    if not all(side.shapes for side in sides):
        return 0.0
    visual, solid = (list_extent_points([side], body) for side in sides)
    if visual is None or solid is None:
        gap = _measure_equal_mesh_gap(robot, body.name)
        size = 0.0 if gap is None else _compute_reach_of_children(robot, body)
    else:
        gap, size = _measure_box_gap(visual, solid), _compute_extent(visual)
    is_apart = gap is not None and gap > max(MIN_GAP_FRACTION * size, POSITION_TOLERANCE)
    return gap if is_apart and gap is not None else 0.0


def _select_shapes(body: Link, *, collides: bool) -> Link:
    """Return a link with only the collision shapes, or only the visual shapes."""
    return replace(body, shapes=tuple(s for s in body.shapes if s.collides == collides))


def _measure_box_gap(first: Array, second: Array) -> float:
    """Return the largest gap along an axis between the bounding boxes of points, (n, 3) [m].

    The result is negative if the boxes overlap.
    """
    gaps = np.maximum(
        second.min(axis=0) - first.max(axis=0), first.min(axis=0) - second.max(axis=0)
    )
    return float(gaps.max())


def _is_drawn_by_next_link(robot: UrdfModel, body: Link) -> bool:
    """Return True if a link's collision shapes are at the joint and shapes of a moving child.

    The bounding box of the collision shapes, along the axes of the link at zero angles, contains
    the joint, and overlaps the visual shapes of the child.
    """
    solid = list_extent_points([_select_shapes(body, collides=True)], body)
    if solid is None:
        return False
    for child in robot.children(body.name):
        visual = list_extent_points([_select_shapes(child, collides=False)], body)
        joint = body.pose.inverse().point(child.pose.position)
        if (
            child.moving
            and visual is not None
            and all(_measure_box_gap(points, solid) < 0 for points in (visual, joint[None]))
        ):
            return True
    return False


@rule
def joint_off_links(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find a hinge with an axis outside one of its two links, or with links that are apart.

    A link is the convex hull of its shapes, with all fixed links, at zero joint angles. Both links
    must have visual meshes, since boxes and rods may show a part of a link only, and all sizes must
    be known. Several such hinges of a robot are not reported: then the meshes are simplified.
    """
    hulls: dict[str, Mesh | None] = {}
    found, num_hinges = [], 0
    for joint in robot.joints.values():
        if joint.kind != HINGE_JOINT or not joint.axis.any():
            continue
        names = (robot.find_moving_body(joint.parent), joint.child)
        for name in names:
            if name not in hulls:
                hulls[name] = _make_drawn_hull(robot, name)
        parent, child = (hulls[name] for name in names)
        if parent is None or child is None:
            continue
        num_hinges += 1
        plane = np.linalg.svd(joint.axis[None])[2][1:]  # two unit vectors normal to the axis
        offsets = {
            name: compute_hull_distance(hull.vertices @ plane.T, plane @ joint.position)
            for name, hull in zip(names, (parent, child), strict=True)
        }
        link, gap = max(offsets, key=lambda name: offsets[name]), _measure_hull_gap(parent, child)
        size = min(_compute_extent(hull.vertices) for hull in (parent, child))
        if max(offsets[link], gap) <= max(MAX_HINGE_OFFSET, MAX_HINGE_FRACTION * size):
            continue
        if gap > offsets[link]:
            message = diagnose(
                "links-of-hinge-apart",
                gap=Quantity(gap, "m"),
                parent=names[0],
                child=names[1],
            )
        else:
            message = diagnose("axis-off-link", offset=Quantity(offsets[link], "m"), link=link)
        found.append(CheckFinding("joint", joint.name, message, "origin"))
    if len(found) == 1 and num_hinges > MIN_OTHER_LINKS:
        yield found[0]


MAX_HINGE_OFFSET, MAX_HINGE_FRACTION = 0.005, 0.2
"""Largest distance between a hinge's axis and a link, and between the two links of the hinge, that
is not reported. It is the larger of a length [m] and a fraction of the extent of the smaller link.
Chosen, not tuned."""


def _make_drawn_hull(robot: RobotModel, name: str) -> Mesh | None:
    """Return the convex hull of a link and all fixed links, in the base frame [m].

    None if the hull is unknown or flat, or no shape is a visual mesh.
    """
    link = robot.links.get(name)
    if link is None:
        return None
    group = robot.fixed_group(name)
    shapes = [shape for part in group for shape in part.shapes]
    points = list_extent_points(group, link)
    if points is None or not any(s.kind == "mesh" and not s.collides for s in shapes):
        return None
    hull = Mesh(link.pose.point(points), np.zeros((0, 3), dtype=int)).hull()
    return hull if len(hull.faces) else None


def _measure_hull_gap(first: Mesh, second: Mesh) -> float:
    """Return a lower bound of the distance between two convex hulls [m]; negative if they overlap.

    The bound is the largest gap along `COMPARISON_DIRECTIONS`.
    """
    gaps = (second.vertices @ COMPARISON_DIRECTIONS.T).min(axis=0) - (
        first.vertices @ COMPARISON_DIRECTIONS.T
    ).max(axis=0)
    return float(gaps.max())


MIN_GAP_FRACTION = 0.1
"""Lower bound of a reported gap between a link's visual and collision shapes, relative to the
extent that `_measure_collision_gap` compares. Chosen, not tuned.
"""


def _compute_reach_of_children(robot: RobotModel, body: Link) -> float:
    """Compute the extent of the origins of a link, its frames and its child links [m]."""
    return _compute_extent(list_link_points(robot, body))


def _measure_equal_mesh_gap(robot: UrdfModel, name: str) -> float | None:
    """Return the distance [m] of the origins of a link's collision mesh and the equal visual mesh.

    None if no unique pair of equal meshes exists.
    """
    found: dict[str, list[tuple[str, Array]]] = {"visual": [], "collision": []}
    for tag, shape, geometry in robot.file.tree.links[name].shapes:
        if geometry is not None and geometry.tag == "mesh":
            stem = PurePath(geometry.get("filename", "")).stem
            found[tag].append((stem, origin_of(shape).translation))
    if len(found["collision"]) != 1 or sum(s.collides for s in robot.links[name].shapes) != 1:
        return None
    ((stem, place),) = found["collision"]
    places = [visual for visual_stem, visual in found["visual"] if visual_stem == stem]
    return float(np.linalg.norm(places[0] - place)) if len(places) == 1 else None


IMPOSSIBLE_SIZE_RATIO = 10.0
"""Ratio between a too large density and `MAX_DENSITY`, or between the extent of a robot and its
lower or upper bound, from which the severity is ERROR instead of WARNING. Chosen, not tuned.
"""


@rule
def scale_unusual(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find robots and shapes of implausible size, for example in millimetres.

    The extent of the positions of all moving joints at zero angles must be 0, or between
    `MIN_ROBOT_EXTENT` and `MAX_ROBOT_EXTENT` [m]. The shapes of a link must extend over at most
    `MAX_SHAPE_RATIO` times the extent of the joints, if the latter is at least `MIN_EXTENT`. A mesh
    of a URDF with a scale of at most `MAX_MILLIMETRE_SCALE` must not be between `MIN_MESH_RATIO`
    and `MAX_MESH_RATIO` times this extent. Robots with fewer than two moving joints are skipped.
    """
    places = np.array([joint.position for joint in robot.joints.values() if joint.moves])
    if len(places) < 2 or robot.base not in robot.links:
        return
    size = _compute_extent(places)
    if size > MAX_ROBOT_EXTENT or 0 < size < MIN_ROBOT_EXTENT:
        factor = 1e-3 if size > MAX_ROBOT_EXTENT else 1e3
        usual = MIN_USUAL_EXTENT < size * factor < MAX_USUAL_EXTENT
        message = diagnose(
            "joints-out-of-scale",
            size=Quantity(size, "m"),
            least=Quantity(MIN_ROBOT_EXTENT, "m"),
            most=Quantity(MAX_ROBOT_EXTENT, "m"),
            factor=factor if usual else None,
            meant=Quantity(size * factor, "m"),
        )
        impossible = (
            not MIN_ROBOT_EXTENT
            < IMPOSSIBLE_SIZE_RATIO * size
            < IMPOSSIBLE_SIZE_RATIO**2 * MAX_ROBOT_EXTENT
        )
        severity = Severity.ERROR if impossible else None
        yield CheckFinding(robot.link_tag, robot.base, message, severity=severity)
    if size < MIN_EXTENT:
        return
    for body in robot.links.values():
        points = list_extent_points([body], body)
        if points is not None and _compute_extent(points) > MAX_SHAPE_RATIO * size:
            message = diagnose(
                "shapes-out-of-scale",
                length=Quantity(_compute_extent(points), "m"),
                times=_compute_extent(points) / size,
                size=Quantity(size, "m"),
            )
            yield CheckFinding(robot.link_tag, body.name, message)
        scaled = _list_scaled_meshes(robot, body) if isinstance(robot, UrdfModel) else []
        tiny = [
            extent
            for extent in _list_mesh_extents(body)
            if scaled and MIN_MESH_RATIO < extent / size < MAX_MESH_RATIO
        ]
        if tiny:
            message = diagnose(
                "mesh-out-of-scale",
                length=Quantity(max(tiny), "m"),
                size=Quantity(size, "m"),
                meant=Quantity(1e3 * max(tiny), "m"),
            )
            yield CheckFinding(robot.link_tag, body.name, message, place=scaled[0])


def _list_scaled_meshes(robot: UrdfModel, body: Link) -> list[Place]:
    """List the places of a link's meshes with a scale of at most `MAX_MILLIMETRE_SCALE`."""
    places = []
    for mesh in robot.file.tree.links[body.name].element.iter("mesh"):
        with contextlib.suppress(ValueError):  # other checks report texts that are no numbers
            scale = [abs(float(number)) for number in mesh.get("scale", "1").split()]
            if scale and max(scale) <= MAX_MILLIMETRE_SCALE:
                places.append(Place(robot.file.path, mesh.sourceline))
    return places


def _list_mesh_extents(body: Link) -> Iterator[float]:
    """Yield the extent of each mesh of a link [m]; meshes of unknown size are skipped."""
    for shape in body.shapes:
        if shape.kind == "mesh":
            points = list_extent_points([replace(body, shapes=(shape,))], body)
            if points is not None:
                yield _compute_extent(points)


def _list_moving_links(robot: RobotModel) -> Iterator[Link]:
    """Yield the root links, and the links that move relative to the parent."""
    for body in robot.links.values():
        if body.parent is None or body.moving:
            yield body


def _compute_extent(points: Array) -> float:
    """Return the longest side of the axis-aligned bounding box of points, shape (n, 3) [m]."""
    return float(np.ptp(points, axis=0).max())
