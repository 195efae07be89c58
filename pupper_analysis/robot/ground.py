"""Ground of a stand: a sloped plane, steps on it, and planes or bars under individual feet.

Input: slope, uphill direction and step heights of a task, and the planes of individual feet.
Output: height, normal and ground point for each foot, and the boxes and cylinders that
represent the steps in MuJoCo's model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pupper_analysis.base.arguments import (
    check_arguments,
    check_fields,
    check_finite,
    check_length,
    suggest_degrees,
)
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import quaternion_from_rotation
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.robot.plane import Plane, describe_surface, slope_normal

Point = tuple[float, float]
"""Horizontal position (x, y) in the world frame [m]."""


_DEFAULT_ANGLE = 0.0
"""Default of slope and uphill direction [rad]. To save time, the constructor skips its checks if
both are this object (``is``, not ``==``), and there are no steps."""


class Step(NamedTuple):
    """Box or bar under a foot, for MuJoCo's model.

    Attributes:
        centre: Centre (3,) [m] in the world. The top face of the box for a pit is the bottom of the
            pit.
        half: Half sizes (3,) [m].
        rotation: Rotation matrix (3, 3) to world axes. The third column is the normal of the top
            face, or the axis of a bar.
        round: Whether the step is a bar: a cylinder in the box with the half sizes ``half``.
        height: Height [m] of the top above the plane of the ground, negative for a pit. 0 for a
            bar, and for a separate plane under a foot without a step.
    """

    centre: Array
    half: Array
    rotation: Array
    round: bool = False
    height: float = 0.0

    @property
    def quaternion(self) -> Array:
        """Orientation of this box or bar in the world as a quaternion (w, x, y, z)."""
        return quaternion_from_rotation(self.rotation)

    @property
    def top(self) -> Array:
        """Centre of the top face of a box, or of an end face of a bar, (3,) [m], in the world."""
        top: Array = self.centre + self.half[2] * self.rotation[:, 2]
        return top


@dataclass(frozen=True)
class Ground:
    """Ground of a stand: a plane through the world's origin, with steps under individual feet.

    Attributes:
        slope: Angle to the horizontal (rad), in [0, pi/2).
        uphill: Direction of steepest ascent: angle about the world's z axis, from the x axis (rad).
        heights: {foot: height of the step under the foot, above the plane (m)}.
    """

    slope: float = field(default=_DEFAULT_ANGLE, metadata={"unit": "rad"})
    uphill: float = field(default=_DEFAULT_ANGLE, metadata={"unit": "rad"})
    heights: Mapping[str, float] = field(default_factory=FrozenDict, metadata={"unit": "m"})
    _planes: Mapping[str, Plane] = field(
        default_factory=FrozenDict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        plain = self.slope is _DEFAULT_ANGLE and self.uphill is _DEFAULT_ANGLE
        if plain and type(self.heights) is FrozenDict and not self.heights:
            return  # the defaults need no check
        check_fields(self)
        object.__setattr__(self, "slope", _check_slope("slope", self.slope))
        object.__setattr__(self, "uphill", check_finite("uphill", self.uphill))
        values = {foot: check_length(f"heights[{foot}]", h) for foot, h in self.heights.items()}
        object.__setattr__(self, "heights", FrozenDict(values))

    @property
    def is_level(self) -> bool:
        """Whether the ground is the plane z = 0, without steps and separate planes."""
        return self.slope == 0 and not any((*self.heights.values(), *self._planes))

    @property
    def planes(self) -> Mapping[str, Plane]:
        """Separate planes under individual feet, ``{foot: plane}``, set by ``with_planes``."""
        return self._planes

    def with_planes(self, planes: Mapping[str, Plane]) -> Ground:
        """Return a copy of the ground in which some feet touch their own planes, such as walls.

        Args:
            planes: {foot: plane that the foot touches instead of the ground}. All earlier planes
                are dropped.
        """
        ground = replace(self)
        object.__setattr__(ground, "_planes", FrozenDict(planes))
        return ground

    def describe_surface(self, foot: str) -> Diagnostic | None:
        """Name the surface that a foot or hand touches instead of the floor, for messages.

        Args:
            foot: Foot or hand.

        Returns:
            Kind of the surface (wall, table, ceiling, plane, bar or step) and the foot, such as
            "wall of left_palm". None for a foot without a step (or with a step of height 0) and
            without a separate plane.
        """
        if foot in self._planes:
            plane = self._planes[foot]
            kind = "bar" if getattr(plane, "bar", None) is not None else plane.kind
            return describe_surface(kind, foot)
        return describe_surface("step", foot) if self.heights.get(foot) else None

    def normal(self, foot: str | None = None) -> Array:
        """Return the unit normal of the ground under a foot, shape (3,), in the world frame.

        Args:
            foot: Foot, which may have a separate plane (``planes``). Default: the sloped ground.
        """
        if foot is not None and foot in self._planes:
            return np.array(self._planes[foot].normal)
        return np.array(slope_normal(self.slope, self.uphill))

    def rotation(self, foot: str | None = None) -> Array:
        """Return the shortest rotation (3, 3) from the world's z to the normal under a foot.

        Args:
            foot: Foot, which may have a separate plane (``planes``). Default: the sloped ground.
        """
        return _align_z_with(self.normal(foot))

    def ground_point(self, foot: str, centre: Array) -> Array:
        """Return the ground point (3,) [m] under a foot, in the world frame.

        The point is vertically below the foot, or the nearest point of a separate plane
        (``planes``).

        Args:
            foot: Foot.
            centre: Centre of the foot's sphere, shape (3,) [m], in the world frame.
        """
        if foot in self._planes:
            return self._planes[foot].project(centre)
        x, y, _ = centre
        return np.array([x, y, self.height((x, y), foot)])

    @check_arguments
    def steps(self, places: Mapping[str, Array]) -> dict[str, Step]:
        """Compute the boxes and cylinders that represent steps, planes and bars in MuJoCo's model.

        - Step with height h > 0: the box stands on the ground.
        - Step with height h < 0 (pit): the top of the box is the bottom of the pit, at height h.
        - Separate plane: the top of the box is in the plane.
        - Bar: a cylinder with the radius and direction of the bar.

        A box extends at least 3 cm (``STEP_HALF_WIDTH``) beyond the contact points of the foot.

        Args:
            places: {contact point: sphere centre (3,) [m] in the world frame}. The contact points
                of a flat foot are named ``foot/1``, ``foot/2`` ...

        Returns:
            {foot: box or cylinder}, for feet with a contact point in ``places``. A step of height 0
            has no box.

        Raises:
            ConfigurationError: If ``places`` is no mapping with names as keys.
        """
        steps = {}
        for foot in dict.fromkeys((*self.heights, *self._planes)):
            centres = [
                centre for point, centre in places.items() if f"{point}/".startswith(f"{foot}/")
            ]
            if centres and (self.heights.get(foot) or foot in self._planes):
                top, reach = self.foot_ground_point(foot, np.array(centres))
                half_width = reach + STEP_HALF_WIDTH
                bar = getattr(self._planes.get(foot), "bar", None)
                if bar is not None:
                    rotation = _align_z_with(np.array(bar.direction))
                    half = np.array([bar.radius, bar.radius, _BAR_LENGTH_FACTOR * half_width])
                    middle = top - bar.radius * self.normal(foot)
                    steps[foot] = Step(middle, half, rotation, round=True)
                    continue
                height = self.heights.get(foot, 0.0)
                half_thickness = abs(height) / 2 * math.cos(self.slope)
                half = np.array(
                    [
                        half_width,
                        half_width,
                        half_width / 2 if foot in self._planes else half_thickness,
                    ]
                )
                middle = top - half[2] * self.normal(foot)
                steps[foot] = Step(middle, half, self.rotation(foot), height=height)
        return steps

    def foot_ground_point(self, foot: str, centres: Array) -> tuple[Array, float]:
        """Return the ground point under a sole, and the largest distance of its contact spheres.

        Args:
            foot: Foot.
            centres: Sphere centres, shape (n, 3) [m], in the world frame.

        Returns:
            Ground point (`ground_point`) of the mean sphere centre, shape (3,) [m], in the world
            frame; largest distance [m] of a sphere centre from the mean.
        """
        centre = centres.mean(axis=0)
        reach = float(np.linalg.norm(centres - centre, axis=1).max())
        return self.ground_point(foot, centre), reach

    def height(self, place: Sequence[float] | Array, foot: str | None = None) -> float:
        """Return the height z [m] of the sloped ground in the world, at a horizontal position.

        Args:
            place: Position (x, y) or (x, y, z) [m], in the world frame.
            foot: Foot whose step height (``heights``) is added. Default: no step.
        """
        rise = math.tan(self.slope)
        along = place[0] * math.cos(self.uphill) + place[1] * math.sin(self.uphill)
        return float(rise * along) + (0.0 if foot is None else self.heights.get(foot, 0.0))

    def centre(self, foot: str, place: Point | Array, radius: float) -> Array:
        """Return the centre (3,) [m] of a foot's sphere that touches the sloped ground or a step.

        The centre is in the world frame. Separate planes of feet (``planes``) are not considered.

        Args:
            foot: Foot, which may be on a step.
            place: Horizontal coordinates (x, y) [m] of the centre.
            radius: Radius of the sphere [m].
        """
        x, y = float(place[0]), float(place[1])
        return np.array([x, y, self.height((x, y), foot) + radius / math.cos(self.slope)])


def _align_z_with(direction: Array) -> Array:
    """Return the shortest rotation (3, 3) that aligns the z axis with a unit vector (3,)."""
    rotation: Array = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction).matrix()
    return rotation


def _check_slope(name: str, value: float) -> float:
    """Return a slope angle [rad] in [0, pi/2) as a float; ConfigurationError if it is not valid."""
    angle = check_finite(name, value)
    if not 0 <= angle < math.pi / 2:
        written = suggest_degrees(angle, 0.0, math.pi / 2)
        message = diagnose("slope-not-valid", slope=Quantity(angle, "rad"), written=written)
        raise ConfigurationError(name, message)
    return angle


_BAR_LENGTH_FACTOR = 3.0
"""Half length of the cylinder that represents a bar in MuJoCo's model, relative to the half width
of a box for the same foot [1]. Chosen, not tuned: a foot must not reach the end of the bar."""

STEP_HALF_WIDTH = 0.03
"""Minimum distance [m] by which the top of a step's box extends beyond the contact points of its
foot. A foot that slips less than this distance stays on the box. Chosen, not tuned."""
