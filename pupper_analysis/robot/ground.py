"""The ground: a slope, and steps on it, each of which may have a slope of its own."""

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
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.robot.plane import Plane

Array = NDArray[np.float64]
Point = tuple[float, float]


_LEVEL = 0.0


class Step(NamedTuple):
    """The box under a foot.

    Attributes:
        centre: (3,) in the world (m).
        half: (3,) half of its sides (m).
        rotation: (3, 3) of its axes; the third is out of its top.
    """

    centre: Array
    half: Array
    rotation: Array

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
        tilts: {foot: angle of a step of its own against the horizontal (rad)}, from 0 to pi; those
            of others are parallel to the plane. The foot touches it in its place, at the height of
            its step.
        tilt_uphill: {foot: direction in which that rises, as ``uphill`` (rad)}; 0 where not given.
    """

    slope: float = _LEVEL
    uphill: float = _LEVEL
    heights: Mapping[str, float] = field(default_factory=FrozenDict)
    tilts: Mapping[str, float] = field(default_factory=FrozenDict)
    tilt_uphill: Mapping[str, float] = field(default_factory=FrozenDict)
    _planes: Mapping[str, Plane] = field(default_factory=FrozenDict, init=False, repr=False)

    def __post_init__(self) -> None:
        plain = self.slope is _LEVEL and self.uphill is _LEVEL
        of_feet = self.heights, self.tilts, self.tilt_uphill
        if plain and all(type(one) is FrozenDict and not one for one in of_feet):
            return  # what the class says itself needs no check
        check_fields(self)
        object.__setattr__(self, "slope", _angle("slope", self.slope))
        object.__setattr__(self, "uphill", check_finite("uphill", self.uphill))
        for name, check in (
            ("heights", check_length), ("tilts", _tilt), ("tilt_uphill", check_finite)
        ):  # fmt: skip
            given = getattr(self, name).items()
            values = {foot: check(f"{name}[{foot}]", value) for foot, value in given}
            object.__setattr__(self, name, FrozenDict(values))

    @property
    def level(self) -> bool:
        """Whether it is the plane z = 0 everywhere."""
        own = *self.heights.values(), *self.tilts.values(), *self._planes
        return self.slope == 0 and not any(own)

    @property
    def planes(self) -> Mapping[str, Plane]:
        """{foot: the plane that it touches instead}, by a task's ``contacts``."""
        return self._planes

    def with_planes(self, planes: Mapping[str, Plane]) -> Ground:
        """Returns the ground with planes that feet touch instead, {foot: its plane}."""
        other = replace(self)
        object.__setattr__(other, "_planes", FrozenDict(planes))
        return other

    @property
    def apart(self) -> tuple[str, ...]:
        """The feet that touch a plane of their own, parallel to no other's."""
        return (*self.tilts, *self._planes)

    def _slope(self, foot: str | None) -> tuple[float, float]:
        """Returns angle and direction uphill (rad) of a foot's step, or of the plane."""
        if foot is not None and foot in self.tilts:
            return self.tilts[foot], self.tilt_uphill.get(foot, 0.0)
        return self.slope, self.uphill

    def normal(self, foot: str | None = None) -> Array:
        """Returns the direction (3,) out of the ground, or out of what a foot touches."""
        if foot is not None and foot in self._planes:
            out: Array = np.array(self._planes[foot].normal)
            return out
        slope, uphill = self._slope(foot)
        tilt = math.sin(slope)
        return np.array([-tilt * math.cos(uphill), -tilt * math.sin(uphill), math.cos(slope)])

    def rotation(self, foot: str | None = None) -> Array:
        """Returns the rotation (3, 3) that takes the level to the plane, by the shortest way."""
        turn: Array = pin.Quaternion.FromTwoVectors(
            np.array([0.0, 0.0, 1.0]), self.normal(foot)
        ).matrix()
        return turn

    def touched(self, foot: str, centre: Array, radius: float) -> Array:
        """Returns the point (3,) of the ground, or of a foot's step, below a foot (m).

        Args:
            foot: Which foot.
            centre: (3,) of its sphere, which may be lifted (m).
            radius: Of the sphere (m).
        """
        if foot in self._planes:
            return self._planes[foot].nearest(centre)
        x, y, _ = centre - radius * self.normal(foot) if foot in self.tilts else centre
        return np.array([x, y, self.height((x, y), foot)])

    @check_arguments
    def steps(self, places: Mapping[str, Array], radii: Mapping[str, float]) -> dict[str, Step]:
        """Returns the box under each foot that is on a step, or on a plane of its own.

        That of a step down is as thick as the step is deep, and its top is the bottom of the pit.

        It is under the foot's contact points, and reaches ``STEP_HALF_WIDTH`` beyond them.

        Args:
            places: {contact point: (3,) its centre (m)}; the points of a flat foot are called
                ``foot/1``, ``foot/2``...
            radii: {contact point: of its sphere (m)}.
        """
        found, apart = {}, self.apart
        for foot in dict.fromkeys((*self.heights, *apart)):
            own = [name for name in places if name == foot or name.startswith(f"{foot}/")]
            if own and (self.heights.get(foot) or foot in apart):
                top, reach = self.middle(foot, {name: places[name] for name in own}, radii)
                wide = reach + STEP_HALF_WIDTH
                thick = abs(self.heights.get(foot, 0.0)) / 2 * math.cos(self.slope)
                half = np.array([wide, wide, wide / 2 if foot in apart else thick])
                found[foot] = Step(top - half[2] * self.normal(foot), half, self.rotation(foot))
        return found

    def middle(
        self, foot: str, places: Mapping[str, Array], radii: Mapping[str, float]
    ) -> tuple[Array, float]:
        """Returns the point (3,) of the ground below a foot's middle, and how far it reaches (m).

        Args:
            foot: Which foot.
            places: {contact point of it: (3,) its centre (m)}.
            radii: {contact point: of its sphere (m)}.
        """
        centres = np.array([*places.values()])
        centre = centres.mean(axis=0)
        radius = float(np.mean([radii[name] for name in places]))
        reach = float(np.linalg.norm(centres - centre, axis=1).max())
        return self.touched(foot, centre, radius), reach

    def height(self, place: Sequence[float] | Array, foot: str | None = None) -> float:
        """Returns the height (m) of the plane at a place (x, y), or there of a foot's step.

        Of a step with a slope of its own it is that of its middle, wherever the place is.
        """
        rise = math.tan(self.slope)
        along = place[0] * math.cos(self.uphill) + place[1] * math.sin(self.uphill)
        return float(rise * along) + (0.0 if foot is None else self.heights.get(foot, 0.0))

    def centre(self, foot: str, place: Point | Array, radius: float) -> Array:
        """Returns the centre (3,) of a foot's sphere that touches the ground.

        Args:
            foot: Which foot: it may be on a step.
            place: (x, y) of the centre; where it touches a step with a slope of its own (m).
            radius: Of the sphere (m).
        """
        x, y = float(place[0]), float(place[1])
        if foot in self.tilts:
            return np.array([x, y, self.height((x, y), foot)]) + radius * self.normal(foot)
        return np.array([x, y, self.height((x, y), foot) + radius / math.cos(self.slope)])


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


def _tilt(name: str, value: float) -> float:
    """Returns an angle against the horizontal (rad), from 0 to pi.

    Raises:
        ConfigurationError: If it is none.
    """
    angle = check_finite(name, value)
    if not 0 <= angle <= math.pi:
        most = Quantity(math.pi, "rad")
        problem = diagnose("not-between", given=f"{angle} rad", low=0, high=most)
        raise ConfigurationError(name, problem)
    return angle


STEP_HALF_WIDTH = 0.03
"""How far the box that is put under a foot on a step reaches beyond its contact points (m)."""
