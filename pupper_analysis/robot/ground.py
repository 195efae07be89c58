"""The ground: a slope, steps on it, and planes that feet touch instead."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arguments import (
    check_arguments,
    check_fields,
    check_finite,
    check_length,
)
from pupper_analysis.base.arrays import quaternion_from_rotation
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.robot.plane import Plane, slope_normal

Array = NDArray[np.float64]
Point = tuple[float, float]


_LEVEL = 0.0


class Step(NamedTuple):
    """The box under a foot, or the bar, as it is put into MuJoCo's model.

    Attributes:
        centre: (3,) in the world (m); that of a pit ends at its bottom.
        half: (3,) half of its sides (m).
        rotation: (3, 3) of its axes; the third is out of its top, or along a bar.
        round: Whether it is a bar: a cylinder within these sides.
        height: Above the plane of the ground (m); negative for a pit, 0 of a plane of its own.
    """

    centre: Array
    half: Array
    rotation: Array
    round: bool = False
    height: float = 0.0

    @property
    def turn(self) -> Array:
        """Its rotation as a quaternion (w, x, y, z)."""
        return quaternion_from_rotation(self.rotation)

    @property
    def top(self) -> Array:
        """The middle (3,) of its top (m)."""
        there: Array = self.centre + self.half[2] * self.rotation[:, 2]
        return there


@dataclass(frozen=True)
class Ground:
    """A plane through the world's origin, with steps on it.

    Attributes:
        slope: Angle against the horizontal (rad), from 0 to less than pi/2.
        uphill: Direction in which the plane rises, about z from x (rad).
        heights: {foot: height of the step under it, above the plane (m)}.
    """

    slope: float = field(default=_LEVEL, metadata={"unit": "rad"})
    uphill: float = field(default=_LEVEL, metadata={"unit": "rad"})
    heights: Mapping[str, float] = field(default_factory=FrozenDict, metadata={"unit": "m"})
    _planes: Mapping[str, Plane] = field(
        default_factory=FrozenDict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        plain = self.slope is _LEVEL and self.uphill is _LEVEL
        if plain and type(self.heights) is FrozenDict and not self.heights:
            return  # what the class says itself needs no check
        check_fields(self)
        object.__setattr__(self, "slope", _angle("slope", self.slope))
        object.__setattr__(self, "uphill", check_finite("uphill", self.uphill))
        values = {foot: check_length(f"heights[{foot}]", h) for foot, h in self.heights.items()}
        object.__setattr__(self, "heights", FrozenDict(values))

    @property
    def level(self) -> bool:
        """Whether it is the plane z = 0 everywhere."""
        return self.slope == 0 and not any((*self.heights.values(), *self._planes))

    @property
    def planes(self) -> Mapping[str, Plane]:
        """{foot: the plane that it touches instead}, of a task that is worked out for a robot."""
        return self._planes

    def with_planes(self, planes: Mapping[str, Plane]) -> Ground:
        """Returns the ground with planes that feet touch instead, {foot: its plane}."""
        other = replace(self)
        object.__setattr__(other, "_planes", FrozenDict(planes))
        return other

    def normal(self, foot: str | None = None) -> Array:
        """Returns the direction (3,) out of the ground, or out of what a foot touches."""
        if foot is not None and foot in self._planes:
            return np.array(self._planes[foot].normal)
        return np.array(slope_normal(self.slope, self.uphill))

    def rotation(self, foot: str | None = None) -> Array:
        """Returns the rotation (3, 3) that takes the level to the plane, by the shortest way."""
        return _turned_up(self.normal(foot))

    def touched(self, foot: str, centre: Array) -> Array:
        """Returns the point (3,) of the ground, step or plane below a foot's centre (3,) (m)."""
        if foot in self._planes:
            return self._planes[foot].nearest(centre)
        x, y, _ = centre
        return np.array([x, y, self.height((x, y), foot)])

    @check_arguments
    def steps(self, places: Mapping[str, Array]) -> dict[str, Step]:
        """Returns the box under each foot that is on a step, or on a plane of its own.

        That of a step down is as thick as the step is deep, and its top is the bottom of the pit.

        It is under the foot's contact points, and reaches ``STEP_HALF_WIDTH`` beyond them.

        Args:
            places: {contact point: (3,) its centre (m)}; the points of a flat foot are called
                ``foot/1``, ``foot/2``...
        """
        found = {}
        for foot in dict.fromkeys((*self.heights, *self._planes)):
            own = [at for point, at in places.items() if f"{point}/".startswith(f"{foot}/")]
            if own and (self.heights.get(foot) or foot in self._planes):
                top, reach = self.middle(foot, np.array(own))
                wide = reach + STEP_HALF_WIDTH
                bar = getattr(self._planes.get(foot), "bar", None)
                if bar is not None:
                    turn = _turned_up(np.array(bar.direction))
                    half = np.array([bar.radius, bar.radius, _LONG * wide])
                    middle = top - bar.radius * self.normal(foot)
                    found[foot] = Step(middle, half, turn, round=True)
                    continue
                height = self.heights.get(foot, 0.0)
                thick = abs(height) / 2 * math.cos(self.slope)
                half = np.array([wide, wide, wide / 2 if foot in self._planes else thick])
                middle = top - half[2] * self.normal(foot)
                found[foot] = Step(middle, half, self.rotation(foot), height=height)
        return found

    def middle(self, foot: str, centres: Array) -> tuple[Array, float]:
        """Returns the point (3,) of the ground below a foot's middle, and how far it reaches (m).

        Args:
            foot: Which foot.
            centres: (n, 3) of its contact points (m).
        """
        centre = centres.mean(axis=0)
        reach = float(np.linalg.norm(centres - centre, axis=1).max())
        return self.touched(foot, centre), reach

    def height(self, place: Sequence[float] | Array, foot: str | None = None) -> float:
        """Returns the height (m) of the plane at a place (x, y), or there of a foot's step."""
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


def _turned_up(out: Array) -> Array:
    """Returns the rotation (3, 3) that takes up to a direction (3,), by the shortest way."""
    turn: Array = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), out).matrix()
    return turn


def _angle(name: str, value: float) -> float:
    """Returns an angle against the horizontal (rad), from 0 to less than pi/2.

    Raises:
        ConfigurationError: If it is none.
    """
    angle = check_finite(name, value)
    if not 0 <= angle < math.pi / 2:
        degrees = angle if 0 < angle < 90 else None
        message = diagnose("slope-not-valid", slope=Quantity(angle, "rad"), degrees=degrees)
        raise ConfigurationError(name, message)
    return angle


_LONG = 3.0
"""A bar reaches so many times as far to both sides of what touches it."""

STEP_HALF_WIDTH = 0.03
"""How far the box that is put under a foot on a step reaches beyond its contact points (m)."""
