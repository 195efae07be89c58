"""How far bodies reach: points of their shapes, of their frames and of what hangs on them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pupper_analysis.models.stated.model import Array, Link, RobotModel


def extent_points(bodies: Sequence[Link], frame: Link) -> Array | None:
    """Returns points (n, 3) that span all shapes of some bodies, in the frame of one of them (m).

    Returns:
        None if they have no shapes, or the extent of one is not known.
    """
    points, whole = known_points(bodies, frame)
    return points if whole else None


def known_points(bodies: Sequence[Link], frame: Link) -> tuple[Array | None, bool]:
    """Returns points of those shapes whose extent is known, and whether that is all of them.

    Returns:
        Points (n, 3) as ``extent_points`` has them, None if no shape is known; and whether none is
        left out, such as a mesh that is not read.
    """
    to_frame, parts, whole = frame.pose.inverse(), [], True
    for body in bodies:
        for shape in body.shapes:
            points = shape.points
            if points is None:
                whole = False
            else:
                parts.append((to_frame * body.pose).point(points))
    return (np.concatenate(parts) if parts else None), whole


def link_points(robot: RobotModel, body: Link) -> Array:
    """Returns a body's origin, frames and children's origins (n, 3), in its frame (m)."""
    to_frame = body.pose.inverse()
    points = [np.zeros(3), *(frame.position for frame in body.frames)]
    points += [to_frame.point(child.pose.position) for child in robot.children(body.name)]
    return np.array(points)


def outside_hull(points: Array, point: Array) -> float:
    """Returns how far a point is outside the convex hull of others, at least; <= 0 if inside (m).

    Of points that lie in a plane the bounding box is taken.
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        faces = ConvexHull(points).equations
    except (QhullError, ValueError):
        return float(np.max(np.maximum(points.min(0) - point, point - points.max(0))))
    return float(np.max(faces[:, :3] @ point + faces[:, 3]))
