"""Where a com that may be anywhere inside the support polygon is looked for."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from pupper_analysis.stance.problem import Goal
from pupper_analysis.stance.tasks import TASK_TOLERANCE
from pupper_analysis.statics.support_polygon import support_polygon

Array = NDArray[np.float64]

_OUTWARDS = 0.8
"""How far towards the support polygon's corners searches begin: there the com can still move."""


def first_places(goal: Goal) -> list[Array]:
    """Returns where a com that may be anywhere inside begins: the centre, corners and sides."""
    centre = goal.contacts[:, :2].mean(axis=0)
    corners = centre + _OUTWARDS * (support_polygon(goal.contacts) - centre)
    sides = (corners + np.roll(corners, 1, axis=0)) / 2
    return [pushed_inside(place, goal) for place in (centre, *corners, *sides)]


def pushed_inside(place: Array, goal: Goal) -> Array:
    """Returns the nearest place (2,) to one that has the task's margin in the support polygon."""
    polygon, point = inner(goal), shapely.Point(place)
    if polygon.is_empty or polygon.contains(point):
        return place
    line = shapely.shortest_line(polygon, point)  # from the polygon to the point
    return np.array(line.coords[0])


def inner(goal: Goal) -> shapely.Polygon:
    """Returns where in the support polygon the com has the task's margin."""
    polygon = shapely.Polygon(support_polygon(goal.contacts))
    return polygon.buffer(-(goal.task.com_margin + TASK_TOLERANCE), join_style="mitre")
