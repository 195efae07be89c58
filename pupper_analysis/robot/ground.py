"""The ground: a slope, and steps on it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arguments import (
    check_arguments,
    check_fields,
    check_finite,
    check_length,
)
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict

Array = NDArray[np.float64]
Point = tuple[float, float]


_LEVEL = 0.0


@dataclass(frozen=True)
class Ground:
    """A plane through the world's origin, with steps on it.

    Attributes:
        slope: Angle against the horizontal (rad), from 0 to less than pi/2.
        uphill: Direction in which the plane rises, about z from x (rad).
        heights: {foot: height of the step under it, above the plane and parallel to it (m)}.
    """

    slope: float = _LEVEL
    uphill: float = _LEVEL
    heights: Mapping[str, float] = field(default_factory=FrozenDict)

    def __post_init__(self) -> None:
        plain = self.slope is _LEVEL and self.uphill is _LEVEL
        if plain and type(self.heights) is FrozenDict and not self.heights:
            return  # what the class says itself needs no check
        check_fields(self)
        object.__setattr__(self, "slope", check_finite("slope", self.slope))
        object.__setattr__(self, "uphill", check_finite("uphill", self.uphill))
        if not 0 <= self.slope < math.pi / 2:
            slope = Quantity(self.slope, "rad")
            degrees = self.slope if 0 < self.slope < 90 else None
            message = diagnose("slope-not-valid", slope=slope, degrees=degrees)
            raise ConfigurationError("slope", message)
        heights = {foot: check_length(f"heights[{foot}]", h) for foot, h in self.heights.items()}
        object.__setattr__(self, "heights", FrozenDict(heights))

    @property
    def level(self) -> bool:
        """Whether it is the plane z = 0 everywhere."""
        return self.slope == 0 and not any(self.heights.values())

    def normal(self) -> Array:
        """Returns the direction (3,) out of the ground."""
        tilt = math.sin(self.slope)
        return np.array(
            [-tilt * math.cos(self.uphill), -tilt * math.sin(self.uphill), math.cos(self.slope)]
        )

    def rotation(self) -> Array:
        """Returns the rotation (3, 3) that takes the level to the plane, by the shortest way."""
        turn: Array = pin.Quaternion.FromTwoVectors(
            np.array([0.0, 0.0, 1.0]), self.normal()
        ).matrix()
        return turn

    def step(
        self, foot: str, place: Sequence[float] | Array, half_width: float
    ) -> tuple[Array, Array]:
        """Returns centre (3,) and half size (3,) of the box that is a foot's step (m).

        Args:
            foot: Which foot.
            place: (x, y, ...) of the foot's centre (m); its height does not matter.
            half_width: Half of the box's edge (m).
        """
        half = np.array(
            [half_width, half_width, abs(self.heights[foot]) / 2 * math.cos(self.slope)]
        )
        top = np.array([place[0], place[1], self.height(place, foot)])
        return top - half[2] * self.normal(), half

    @check_arguments
    def steps(self, places: Mapping[str, Array]) -> dict[str, tuple[Array, Array]]:
        """Returns each step's box, {foot: centre (3,) and half size (3,)} (m).

        That of a step down is as thick as the step is deep, and its top is the bottom of the pit.

        It is under the foot's contact points, and reaches ``STEP_HALF_WIDTH`` beyond them.

        Args:
            places: {contact point: (3,) its centre (m)}; the points of a flat foot are called
                ``foot/1``, ``foot/2``...
        """
        found = {}
        for foot, height in self.heights.items():
            own = [p for name, p in places.items() if name == foot or name.startswith(f"{foot}/")]
            if height and own:
                middle = np.mean(own, axis=0)
                reach = float(np.linalg.norm(np.array(own) - middle, axis=1).max())
                found[foot] = self.step(foot, middle, reach + STEP_HALF_WIDTH)
        return found

    def height(self, place: Sequence[float] | Array, foot: str | None = None) -> float:
        """Returns the height (m) of the plane at a place (x, y), or of a foot's step there."""
        rise = math.tan(self.slope)
        along = place[0] * math.cos(self.uphill) + place[1] * math.sin(self.uphill)
        return float(rise * along) + (0.0 if foot is None else self.heights.get(foot, 0.0))

    def centre(self, foot: str, place: Point | Array, radius: float) -> Array:
        """Returns the centre (3,) of a foot's sphere that touches the ground.

        Args:
            foot: Which foot: it may be on a step.
            place: (x, y) of the centre (m).
            radius: Of the sphere (m).
        """
        x, y = float(place[0]), float(place[1])
        return np.array([x, y, self.height((x, y), foot) + radius / math.cos(self.slope)])


STEP_HALF_WIDTH = 0.03
"""How far the box that is put under a foot on a step reaches beyond its contact points (m)."""
