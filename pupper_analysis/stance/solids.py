"""Distances between shapes in coal."""

from __future__ import annotations

from typing import NamedTuple

import coal  # comes with pin


class SolidPair(NamedTuple):
    """Two shapes, by their numbers, and how near they are."""

    one: int
    other: int
    near: coal.DistanceResult

    @property
    def distance(self) -> float:
        """m; negative: how deep one is in the other."""
        return float(self.near.min_distance)


def measure_distance(
    one: coal.CollisionGeometry,
    at: coal.Transform3s,
    other: coal.CollisionGeometry,
    there: coal.Transform3s,
) -> coal.DistanceResult:
    """Returns the distance, where it is, and the direction from one shape to the other."""
    result = coal.DistanceResult()
    coal.distance(one, at, other, there, coal.DistanceRequest(), result)
    return result
