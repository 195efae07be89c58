"""What the ground does to one foot, over all its contact points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.results import Result

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FootLoad(Result):
    """What the ground does to one foot, over all its contact points.

    Attributes:
        force: (3,) in world axes (N).
        centre_of_pressure: (3,) where the normal forces act together, in the world (m).
        friction_utilisation: Tangential force / (friction coefficient x normal force).
    """

    force: Array
    centre_of_pressure: Array
    friction_utilisation: float


def sliding_share(
    force: Sequence[float], normal: Sequence[float], friction: float, tiny: float
) -> float:
    """Returns tangential force / (friction x normal force), 0 where the former is ``tiny`` (N)."""
    (x, y, z), (a, b, c) = force, normal
    pressing = x * a + y * b + z * c
    tangential = math.hypot(x - pressing * a, y - pressing * b, z - pressing * c)
    return 0.0 if tangential < tiny else tangential / (friction * pressing)


def add_up_foot_load(
    own: Sequence[str],
    forces: Mapping[str, Array],
    points: Mapping[str, Array],
    normals: Mapping[str, Array],
    friction: Mapping[str, float],
    sliding: Mapping[str, float],
    tiny: float,
) -> FootLoad:
    """Adds up what the ground does to a foot's contact points; see ``sliding_share``.

    That of the only one is its own: force and point cannot be written to.
    """
    if len(own) == 1:
        return FootLoad(forces[own[0]], points[own[0]], sliding[own[0]])
    total: Array = np.sum([forces[point] for point in own], axis=0)
    pressing = np.array([max(0.0, float(forces[point] @ normals[point])) for point in own])
    places = np.array([points[point] for point in own])
    weights = pressing / pressing.sum() if pressing.any() else np.full(len(own), 1 / len(own))
    least = min(friction[point] for point in own)
    share = sliding_share(total.tolist(), normals[own[0]].tolist(), least, tiny)
    return FootLoad(total, weights @ places, share)
