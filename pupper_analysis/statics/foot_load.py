"""What the ground does to one foot, over all its contact points."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.results import Result

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


class FootLoads(Mapping[str, FootLoad]):
    """{foot: its load}, added up when it is asked for: who looks for torques needs none.

    Args:
        feet: {foot: its contact points that carry}.
        normals: {contact point: (3,) out of the ground}.
        friction: {contact point: its coefficient}.
        forces: {contact point: (3,) of the ground, in world axes (N)}.
        points: {contact point: (3,) in the world (m)}.
        sliding: {contact point: see ``sliding_share``}.
        tiny: Tangential force that counts as none (N).
    """

    def __init__(
        self,
        feet: Mapping[str, Sequence[str]],
        normals: Mapping[str, Array],
        friction: Mapping[str, float],
        forces: Mapping[str, Array],
        points: Mapping[str, Array],
        sliding: Mapping[str, float],
        tiny: float,
    ) -> None:
        self._feet, self._normals, self._friction = feet, normals, friction
        self._forces, self._points, self._sliding, self._tiny = forces, points, sliding, tiny

    def __iter__(self) -> Iterator[str]:
        return iter(self._feet)

    def __len__(self) -> int:
        return len(self._feet)

    def __getitem__(self, foot: str) -> FootLoad:
        own, forces, points = self._feet[foot], self._forces, self._points
        if len(own) == 1:
            return FootLoad(forces[own[0]], points[own[0]], self._sliding[own[0]])
        total: Array = np.sum([forces[point] for point in own], axis=0)
        normals = self._normals
        pressing = np.array([max(0.0, float(forces[point] @ normals[point])) for point in own])
        places = np.array([points[point] for point in own])
        weights = pressing / pressing.sum() if pressing.any() else np.full(len(own), 1 / len(own))
        least = min(self._friction[point] for point in own)
        share = sliding_share(total.tolist(), normals[own[0]].tolist(), least, self._tiny)
        return FootLoad(total, weights @ places, share)
