"""Support polygon and support region: horizontal CoM positions that allow equilibrium.

If all contact normals are equal, the region is the convex hull of the contact points, seen from
above. With different normals, grips or prescribed contact forces, the region depends on friction.
The region is then the projection of all CoM positions for which contact forces in the friction
cones exist (`support_corners`).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.statics.cone_program import MAX_TOTAL_NORMAL_FORCE, Balance

Corner = tuple[float, float]
"""Corner of a support polygon: horizontal coordinates (x, y) [m] in the world frame."""


def com_margin(com: Array, points: Mapping[str, Array]) -> float:
    """Compute the horizontal distance from the CoM to the edge of the support polygon.

    Args:
        com: Shape (3,) [m]; centre of mass in the world frame.
        points: {contact point: position, shape (3,) [m]}. The polygon is the convex hull of the
            vertical projections.

    Returns:
        Distance [m]: positive inside, negative outside. Minus infinity if x or y of ``com`` is not
        finite. Otherwise NaN without contact points.
    """
    x, y, *_ = com.tolist()
    return margin_of_position((x, y), tuple([_get_corner(point) for point in points.values()]))


def margin_of_position(place: Corner, points: tuple[Corner, ...]) -> float:
    """Return the distance [m] from a horizontal position to the edge of the support polygon.

    Positive inside, negative outside; minus infinity if the position is not finite; NaN without
    contact points.

    Args:
        place: Horizontal position (x, y) [m], for example of the CoM.
        points: Horizontal positions (x, y) of the contact points [m].
    """
    if not math.isfinite(place[0]) or not math.isfinite(place[1]):
        return -math.inf
    inside = _depth_inside(place, points)
    if inside is not None:
        return inside
    import shapely  # slow to import

    polygon, projection = shapely.MultiPoint(points).convex_hull, shapely.Point(place)
    if polygon.geom_type == "Polygon" and polygon.contains(projection):
        return float(polygon.exterior.distance(projection))
    return -float(polygon.distance(projection))


def _get_corner(point: Array) -> Corner:
    """Return the coordinates (x, y) [m] of a position, shape (2,) or (3,) [m]."""
    x, y, *_ = point.tolist()
    return x, y


def _depth_inside(place: Corner, points: tuple[Corner, ...]) -> float | None:
    """Compute the distance [m] from an inner point to the edge of the convex hull of ``points``.

    None if the point is not strictly inside. Faster than shapely.
    """
    sides = _hull_sides(points)
    if len(sides) < 3:
        return None
    x, y = place
    depth = min(
        [
            (along_x * (y - y0) - along_y * (x - x0)) / length
            for x0, y0, along_x, along_y, length in sides
        ]
    )
    return depth if depth > 0 else None


@functools.lru_cache(maxsize=64)  # successive stands usually keep their feet in place
def _hull_sides(points: tuple[Corner, ...]) -> tuple[tuple[float, ...], ...]:
    """Compute the sides of the convex hull of points, counter-clockwise.

    Monotone chain algorithm (Andrew 1979, "Another efficient algorithm for convex hulls in two
    dimensions").

    Returns:
        For each side: corner (x, y), vector to the next corner (x, y), length [m].
    """
    corners = sorted(points)
    rings: list[list[Corner]] = []
    for direction in (corners, corners[::-1]):  # lower half from left to right, then upper half
        half: list[Corner] = []
        for x, y in direction:
            while len(half) > 1:
                (x0, y0), (x1, y1) = half[-2:]
                if (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) > 0:
                    break
                half.pop()
            half.append((x, y))
        rings.append(half[:-1])
    ring = rings[0] + rings[1]
    return tuple(
        (x0, y0, x1 - x0, y1 - y0, math.hypot(x1 - x0, y1 - y0))
        for (x0, y0), (x1, y1) in zip(ring, ring[1:] + ring[:1], strict=True)
    )


SIDES = 48
"""Number of directions in which the boundary of the support region is computed if no tolerance is
given. Also the number of rows of `SupportMargin` if feet have separate planes. Chosen: a regular
polygon with 48 corners has 0.3 % less area than its circumscribed circle.
"""

_MIN_FAILURES = 3
"""If the cone program fails in this number of directions before the first success, the support
region counts as empty. Measured on 300 random sets of 2 to 5 contacts: in 6 of 207 regions, the
cone program failed by rounding in a single direction."""


def support_corners(
    points: Array,
    normals: Array,
    friction: Sequence[float],
    stated: tuple[Array, Array] | None = None,
    grips: Array | None = None,
) -> tuple[Corner, ...]:
    """Compute points whose convex hull is the support region: the CoM positions with equilibrium.

    The region is seen from above. If all normals are equal (a single plane, or parallel planes),
    and neither prescribed forces nor grips exist, the points are the contact points, whatever the
    friction. Sliding down the plane is not checked here. Otherwise a CoM position belongs to the
    region if forces f_i in the friction cones satisfy

        sum f_i = m g e_z,    sum p_i x f_i = m g com x e_z,

    and the sum of normal forces is at most `MAX_TOTAL_NORMAL_FORCE` weights. The region is convex
    (Bretl and Lall 2008, "Testing static equilibrium for legged robots"). Its extreme points in
    `SIDES` directions are solutions of cone programs.

    Args:
        points: Shape (n, 3) [m]; contact points in the world frame.
        normals: Shape (n, 3); unit vectors out of the ground.
        friction: Shape (n,); friction coefficients, or empty if unknown.
        stated: Prescribed contact forces: groups of contact points, shape (k, n), and total normal
            force of each group, shape (k,), in units of the weight. None without prescribed forces.
        grips: Shape (g, 4): position [m] and force limit in units of the weight; None without
            grips.

    Returns:
        Points (x, y) [m] whose convex hull is the support region. If the region cannot be computed,
        the projected contact points.
    """
    is_one_plane = bool((np.abs(normals - normals[:1]) < _NORMAL_TOLERANCE).all())
    corners = None
    if grips is not None or (len(friction) and not (is_one_plane and stated is None)):
        stated_key = () if stated is None else tuple(array.tobytes() for array in stated)
        grip_key = b"" if grips is None else grips.tobytes()
        corners = _compute_region(
            points.tobytes(), normals.tobytes(), tuple(friction), stated_key, grip_key
        )
    return corners or tuple([(x, y) for x, y, _ in points.tolist()])


_NORMAL_TOLERANCE = 1e-12
"""Difference between components of two unit normals below which the normals count as equal
(rounding)."""


@functools.lru_cache(maxsize=64)  # a stand's feet stay in place while its CoM position is searched
def _compute_region(
    points: bytes,
    normals: bytes,
    friction: tuple[float, ...],
    stated: tuple[bytes, ...],
    grips: bytes,
) -> tuple[Corner, ...]:
    """Return the result of ``find_extreme_positions`` from a cache; arrays are passed as bytes."""
    positions, unit_normals = (np.frombuffer(data).reshape(-1, 3) for data in (points, normals))
    grip_rows, stated_arrays = np.frombuffer(grips).reshape(-1, 4), None
    if stated:
        groups, totals = (np.frombuffer(data) for data in stated)
        stated_arrays = groups.reshape(-1, len(positions)), totals
    return find_extreme_positions(
        positions, unit_normals, np.array(friction), stated_arrays, grip_rows
    )


def find_extreme_positions(
    points: Array,
    normals: Array,
    friction: Array,
    stated: tuple[Array, Array] | None,
    grips: Array,
    inequalities: tuple[Array, Array] | None = None,
    tolerance: float | None = None,
) -> tuple[Corner, ...]:
    """Compute the farthest CoM position that allows equilibrium, in several horizontal directions.

    A direction in which the cone program fails is left out. With ``tolerance``, directions are
    added where the region may extend beyond a side of the result (Bretl and Lall 2008).

    Args:
        points: Shape (n, 3) [m]; contact points in the world frame.
        normals: Shape (n, 3); unit vectors out of the ground.
        friction: Shape (n,); friction coefficients.
        stated: Prescribed contact forces: groups of contact points, shape (k, n), and total normal
            force of each group, shape (k,), in units of the weight. None without.
        grips: Shape (g, 4), g >= 0: position [m] and force limit in units of the weight.
        inequalities: Further bounds on the forces f, in units of the weight: rows and upper bounds
            of ``rows @ f <= upper``, for example torque limits.
        tolerance: Largest distance [m] between the region and the convex hull of the result; may be
            exceeded if a cone program fails. None: `SIDES` directions.

    Returns:
        Points (x, y) [m] in the world frame; empty if no CoM position with equilibrium is found.
    """
    count = len(points)
    positions = np.vstack([points, grips[:, :3]])
    moments = cross_matrices(positions).transpose(1, 0, 2).reshape(3, 3 * len(positions))
    # Forces in units of the weight: their sum is (0, 0, 1), their moment about z is zero.
    rows = np.vstack([np.tile(np.eye(3), len(positions)), moments[2:]])
    load = np.array([0.0, 0.0, 1.0, 0.0])
    no_joints, no_grips = np.zeros((0, 3 * len(positions))), np.zeros(3 * len(grips))
    if stated is not None:
        groups, totals = stated
        stated_rows = (groups.reshape(-1, count)[:, :, None] * normals).reshape(len(totals), -1)
        stated_rows = np.hstack([stated_rows, np.tile(no_grips, (len(totals), 1))])
        rows = np.vstack([rows, stated_rows])
        load = np.concatenate([load, totals])
    problem = Balance(rows, load, no_joints, np.zeros(0), normals, grips[:, 3])
    bounded = np.concatenate([normals.ravel(), no_grips])[None]
    limit = np.array([MAX_TOTAL_NORMAL_FORCE])
    if inequalities is not None:
        bounded = np.vstack([bounded, inequalities[0]])
        limit = np.concatenate([limit, inequalities[1]])
    forces_to_com = np.vstack(
        [-moments[1], moments[0]]
    )  # com x e_z equals the moment of the forces

    def find_extreme(angle: float) -> Corner | None:
        """Compute the farthest CoM position (x, y) [m] along an angle [rad]; None if this fails."""
        direction = np.array([math.cos(angle), math.sin(angle)])
        forces = problem.maximize(direction @ forces_to_com, friction, bounded, limit)
        if forces is None:
            return None
        x, y = (forces_to_com @ forces).tolist()
        return x, y

    sides = SIDES if tolerance is None else _FIRST_SIDES
    found, failures = list[tuple[float, Corner]](), 0
    for angle in (2 * math.pi / sides * np.arange(sides)).tolist():
        corner = find_extreme(angle)
        if corner is not None:
            found.append((angle, corner))
            continue
        failures += 1
        if not found and failures == _MIN_FAILURES:
            return ()
    corners = [corner for _, corner in found]
    if tolerance is not None and found:
        following = [*found[1:], (found[0][0] + 2 * math.pi, found[0][1])]
        corners += _refine_sides(list(zip(found, following, strict=True)), find_extreme, tolerance)
    return tuple(corners)


_FIRST_SIDES = 12
"""Number of directions in which the boundary of the support region is computed before directions
are added up to a tolerance. Chosen, not tuned."""


def _refine_sides(
    sides: list[tuple[tuple[float, Corner], tuple[float, Corner]]],
    find_extreme: Callable[[float], Corner | None],
    tolerance: float,
) -> list[Corner]:
    """Compute further extreme points (x, y) [m], to reduce the gap between hull and region.

    The region is convex. Therefore its part beyond a side is inside the triangle of the side and
    the tangents at both ends. A side for which the cone program fails is left unchanged.

    Args:
        sides: Sides of the polygon inside the region, counter-clockwise. Each of the two ends of a
            side is a pair: angle of the normal of the tangent [rad], and end point.
        find_extreme: Function that returns the extreme point in a direction, given as an angle
            [rad].
        tolerance: Largest height of the triangle [m].
    """
    corners: list[Corner] = []
    while sides:
        start, end = sides.pop()
        (first, (x0, y0)), (last, (x1, y1)) = start, end
        length, turn = math.hypot(x1 - x0, y1 - y0), last - first
        # Angles between the side and the tangents at both ends. If an angle is 0, the tangent
        # contains the side, so that the region ends at the side.
        normal = math.atan2(x0 - x1, y1 - y0)
        before = (normal - first + math.pi) % (2 * math.pi) - math.pi
        after = turn - before
        if length <= tolerance or min(before, after) <= 0 or turn >= math.pi:
            continue
        if length * math.sin(before) * math.sin(after) / math.sin(turn) <= tolerance:
            continue
        corner = find_extreme(first + before)
        if corner is None:
            continue
        depth = math.cos(normal) * (corner[0] - x0) + math.sin(normal) * (corner[1] - y0)
        if depth > _MIN_DEPTH:
            corners.append(corner)
            middle = (first + before, corner)
            sides += [(start, middle), (middle, end)]
    return corners


_MIN_DEPTH = 1e-7
"""Distance [m] of a new extreme point from a side of the computed region, above which two new sides
replace the side. Up to this distance the side counts as exact. Chosen, not tuned."""


def support_polygon(contacts: Array) -> Array:
    """Compute the corners of the support polygon: convex hull of contact points from above.

    Args:
        contacts: Shape (k, 2) or (k, 3) [m]; at least three points that are not on a common line.

    Returns:
        Shape (n, 2) [m], counter-clockwise.
    """
    import shapely  # slow to import

    hull = shapely.MultiPoint(contacts[:, :2]).convex_hull
    ring = shapely.geometry.polygon.orient(hull).exterior
    corners: Array = np.array(shapely.get_coordinates(ring))[:-1]
    return corners


def polygon_sides(contacts: Array, count: int = 0, *, from_first: bool = False) -> Array:
    """Compute the line equations of the sides of the support polygon, counter-clockwise.

    Args:
        contacts: Shape (k, 2) or (k, 3) [m]; at least three contact points or other corners that
            are not on a common line.
        count: Number of returned rows, not smaller than the number of sides; k by default.
        from_first: If True, the first side begins at the first contact that is a corner. Otherwise
            it begins at the corner with the smallest x, so that the order of rows may change with
            the contacts.

    Returns:
        Shape (count, 3): (a, b, c), so that a x + b y + c is the distance [m] from the side to the
        point (x, y), positive inside. If the polygon has fewer sides than ``count``, the last row
        is repeated.
    """
    corners = [_get_corner(point) for point in contacts]
    sides = _hull_sides(tuple(corners))
    if from_first:
        sides = _start_at_first_corner(sides, corners)
    rows = [
        [-along_y / length, along_x / length, (along_y * x - along_x * y) / length]
        for x, y, along_x, along_y, length in sides
    ]
    return np.array(rows + rows[-1:] * ((count or len(contacts)) - len(rows)))


def _start_at_first_corner(
    sides: tuple[tuple[float, ...], ...], corners: Sequence[Corner]
) -> tuple[tuple[float, ...], ...]:
    """Rotate the polygon sides, so that the first begins at the earliest point of ``corners``."""
    starts = [corners.index((x, y)) for x, y, *_ in sides]
    first = starts.index(min(starts))
    return sides[first:] + sides[:first]


def differentiate_side_distances(
    contacts: Array, contact_rates: Array, point: Array, point_rates: Array
) -> Array:
    """Compute the derivatives of the distances from the sides of the support polygon to a point.

    With corners p and q of a side and the point c, the distance is (q - p) x (c - p) / |q - p|.

    Args:
        contacts: Positions of k contacts, shape (k, 2) or (k, 3) [m]; z is ignored.
        contact_rates: Derivatives of the x and y of the contacts by n variables, shape (k, 2, n).
        point: Horizontal position, shape (2,) [m].
        point_rates: Derivatives of the point, shape (2, n).

    Returns:
        Shape (k, n); rows in the order of ``polygon_sides(contacts, from_first=True)``. If the
        polygon has fewer than k sides, the row of the last side is repeated.
    """
    corners = [_get_corner(contact) for contact in contacts]
    sides = _start_at_first_corner(_hull_sides(tuple(corners)), corners)
    starts = np.array([corners.index((x, y)) for x, y, *_ in sides])
    ends = np.roll(starts, -1)
    places = np.array(corners)
    along, levers = places[ends] - places[starts], point - places[starts]
    along_rates = contact_rates[ends] - contact_rates[starts]
    lever_rates = point_rates - contact_rates[starts]
    length = np.hypot(along[:, 0], along[:, 1])[:, None]
    area = (along[:, 0] * levers[:, 1] - along[:, 1] * levers[:, 0])[:, None]
    area_rates = (
        along_rates[:, 0] * levers[:, 1:]
        - along_rates[:, 1] * levers[:, :1]
        + along[:, :1] * lever_rates[:, 1]
        - along[:, 1:] * lever_rates[:, 0]
    )
    length_rates = np.einsum("ki,kin->kn", along, along_rates) / length
    rates = area_rates / length - area / length**2 * length_rates
    repeated = np.repeat(rates[-1:], len(contacts) - len(rates), axis=0)
    result: Array = np.concatenate([rates, repeated])
    return result
