"""The support polygon, and what is inside it; on several planes, where a com is in balance."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.statics.cone_program import Balance

Array = NDArray[np.float64]
Corner = tuple[float, float]


def com_margin(com: Array, points: Mapping[str, Array]) -> float:
    """Returns the distance (m) from a com's projection to the edge of the support polygon.

    Args:
        com: (3,) centre of mass (m).
        points: The contact points {foot: (3,)} (m); the polygon is the convex hull of their
            vertical projection.

    Returns:
        The distance; positive inside, negative outside; minus infinity if the point is not a
        number, as the zero-moment point of feet that would have to pull.
    """
    x, y, *_ = com.tolist()
    return margin_of_place((x, y), tuple([_corner(point) for point in points.values()]))


def margin_of_place(place: Corner, points: tuple[Corner, ...]) -> float:
    """Returns ``com_margin`` of a place (x, y) and the places of contacts, seen from above (m)."""
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


def _corner(point: Array) -> Corner:
    x, y, *_ = point.tolist()
    return x, y


def _depth_inside(place: Corner, points: tuple[Corner, ...]) -> float | None:
    """Returns the distance (m) of a place from the edge of points' convex hull, if it is inside.

    Both are seen from above. The usual case without shapely's objects: None says nothing.
    """
    ring = _ring(points)
    if len(ring) < 3:
        return None
    x, y = place
    least = min(
        [
            (along_x * (y - y0) - along_y * (x - x0)) / length
            for x0, y0, along_x, along_y, length in ring
        ]
    )
    return least if least > 0 else None


@functools.lru_cache(maxsize=64)  # feet stay in place, as a rule, where many stands are solved
def _ring(points: tuple[Corner, ...]) -> tuple[tuple[float, ...], ...]:
    """Returns the sides of points' convex hull: corner, way to the next, length (m).

    Source: Andrew, "Another efficient algorithm for convex hulls in two dimensions", 1979.
    """
    corners = sorted(points)
    rings: list[list[Corner]] = []
    for way in (corners, corners[::-1]):  # the lower half from left to right, the upper one back
        half: list[Corner] = []
        for x, y in way:
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
"""Directions in which the end of balance is looked for: a circle's area is found to 0.3 %, from
inside."""

_SQUEEZE = 10.0
"""Weights with which contacts may press in all: between steep walls a grip carries whatever is put
anywhere, and no legs press so."""


def support_corners(
    points: Array,
    normals: Array,
    friction: Sequence[float],
    stated: tuple[Array, Array] | None = None,
    grips: Array | None = None,
) -> tuple[Corner, ...]:
    """Returns corners (x, y) of where a com is in balance on contacts, seen from above (m).

    On contacts of one plane that is the convex hull of their projection, whatever their friction,
    which is asked about elsewhere. On several it is the projection of all coms for which there are
    forces f_i in the friction cones that carry the weight: sum f_i = m g e_z and
    sum p_i x f_i = m g com x e_z. The set is convex (Bretl and Lall, "Testing static equilibrium
    for legged robots", 2008), and its ends are found by cone programmes.

    Args:
        points: (n, 3) contact points (m).
        normals: (n, 3) out of the ground.
        friction: (n,) coefficients; empty if they are not known.
        stated: (k, n) which contacts press together with a force that is stated, and (k,) these
            forces, in weights; None if none is.
        grips: (g, 4) where something is gripped (m), and up to which force (weights).

    Returns:
        The corners; those of the contact points' projection if nothing is in balance.
    """
    alike = bool((np.abs(normals - normals[:1]) < _ALIKE).all())
    found = None
    if grips is not None or (len(friction) and not (alike and stated is None)):
        together = () if stated is None else tuple(one.tobytes() for one in stated)
        held = b"" if grips is None else grips.tobytes()
        found = _balanced(points.tobytes(), normals.tobytes(), tuple(friction), together, held)
    return found or tuple([(x, y) for x, y, _ in points.tolist()])


_ALIKE = 1e-12
"""Normals that differ by no more are one plane's."""


@functools.lru_cache(maxsize=64)  # a stand's feet stay in place while its com is looked for
def _balanced(
    points: bytes,
    normals: bytes,
    friction: tuple[float, ...],
    stated: tuple[bytes, ...],
    grips: bytes,
) -> tuple[Corner, ...]:
    """Returns the ends of balance in ``SIDES`` directions; none if there is no balance."""
    places, out = (np.frombuffer(one).reshape(-1, 3) for one in (points, normals))
    held, count = np.frombuffer(grips).reshape(-1, 4), len(places)
    places = np.vstack([places, held[:, :3]])
    moments = cross_matrices(places).transpose(1, 0, 2).reshape(3, 3 * len(places))
    rows = np.vstack([np.tile(np.eye(3), len(places)), moments[2:]])
    nothing, after = np.zeros((0, 3 * len(places))), np.zeros(3 * len(held))
    weight = np.array([0.0, 0.0, 1.0, 0.0])
    if stated:
        pressed, shares = (np.frombuffer(one) for one in stated)
        more = pressed.reshape(-1, count)[:, :, None] * out
        more = np.hstack([more.reshape(len(shares), -1), np.tile(after, (len(shares), 1))])
        rows = np.vstack([rows, more])
        weight = np.concatenate([weight, shares])
    problem = Balance(rows, weight, nothing, np.zeros(0), out, held[:, 3])
    pressing = np.concatenate([out.ravel(), after])[None]
    com = np.vstack([-moments[1], moments[0]])  # of which the weight has the moment
    corners = []
    for angle in 2 * math.pi / SIDES * np.arange(SIDES):
        towards = np.array([math.cos(angle), math.sin(angle)])
        forces = problem.farthest(towards @ com, np.array(friction), pressing, np.array([_SQUEEZE]))
        if forces is None:
            return ()
        x, y = (com @ forces).tolist()
        corners.append((x, y))
    return tuple(corners)


def support_polygon(contacts: Array) -> Array:
    """Returns the corners (n, 2) of the convex hull of contact points (k, 3), counter-clockwise."""
    import shapely  # slow to import

    hull = shapely.MultiPoint(contacts[:, :2]).convex_hull
    ring = shapely.geometry.polygon.orient(hull).exterior
    corners: Array = np.array(shapely.get_coordinates(ring))[:-1]
    return corners


def polygon_sides(contacts: Array, count: int = 0) -> Array:
    """Returns the support polygon as (k, 3): a x + b y + c is the distance inside each side (m).

    A contact that moves may come to be inside the polygon of the others, and a side is lost: then
    the last one is there again, so that there are always as many.

    Args:
        contacts: (k, 2) or (k, 3) contact points, or other corners (m).
        count: How many rows there are; k by default.
    """
    ring = _ring(tuple([_corner(point) for point in contacts]))
    sides = [
        [-along_y / length, along_x / length, (along_y * x - along_x * y) / length]
        for x, y, along_x, along_y, length in ring
    ]
    return np.array(sides + sides[-1:] * ((count or len(contacts)) - len(sides)))
