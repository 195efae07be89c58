"""What is asked of a stand: the ground, the feet and which of them carry, the base, the com."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.arguments import FARTHEST, check_fields, finite, length
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.frozen import FrozenDict
from pupper_analysis.robot.ground import Ground

Array = NDArray[np.float64]
Point = tuple[float, float]


@dataclass(frozen=True)
class StandTask:
    """How the robot shall stand.

    By default on level ground at z = 0, on all feet: every foot's sphere touches the ground where
    the foot is, seen from above, at zero angles with the base at the origin; the com is above the
    centre of the feet, the mean of the contact points of those that carry. (Legs of two joints,
    which cannot place feet sideways, cannot move the com to every place: it is ``"inside"`` then.)

    Attributes:
        height: Of the base frame above the mean of the contact points (m); the robot's
            ``stand_height`` by default.
        roll: About x, forward (rad). The base's orientation is Rz(yaw) Ry(pitch) Rx(roll).
        pitch: About y, left (rad); positive looks down.
        yaw: About z, up (rad), against the feet.
        offset: (x, y) of the base from the centre of the feet, in world axes (m). With an offset
            the com is where it then is, and must have ``com_margin`` if that is not 0; without one,
            ``com`` decides where the base is.
        feet: {foot: (x, y) in the world (m)}, instead of its nominal place.
        foot_offsets: {foot: (x, y) from its nominal place (m)}.
        swing: {foot that does not carry: height of its sphere above the ground (m)}.
        ground: Plane and steps.
        com: ``"centre"``, a point (x, y) in the world (m), or ``"inside"``: anywhere in the support
            polygon with at least ``com_margin``, over the centre if that is in reach. By default
            the centre, or inside if the robot's legs cannot move the com in two directions.
        com_margin: Least distance of the com's projection from the polygon's edge (m).
        joint_margin: Least distance of every joint from its limits (rad).
        ground_clearance: Least height above the ground of every part but the feet (m).
        self_clearance: Least distance between links that are not neighbours (m); by default they
            are not looked at.
        ik_seed: (nu,) joint positions to start from (rad), which decides between ways to bend a
            knee; the robot's ``home`` by default.
    """

    height: float | None = None
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    offset: Point | None = None
    feet: Mapping[str, Point] = field(default_factory=FrozenDict)
    foot_offsets: Mapping[str, Point] = field(default_factory=FrozenDict)
    swing: Mapping[str, float] = field(default_factory=FrozenDict)
    ground: Ground = field(default_factory=Ground)
    com: str | Point | None = None
    com_margin: float = 0.0
    joint_margin: float = 0.0
    ground_clearance: float = 0.0
    self_clearance: float | None = None
    ik_seed: Sequence[float] | None = None

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        if self._as_by_default():
            return
        check_fields(self)
        if self.self_clearance is not None:
            put("self_clearance", length("self_clearance", self.self_clearance))
        for name in ("com_margin", "ground_clearance"):
            put(name, length(name, getattr(self, name)))
        for name in ("roll", "pitch", "yaw", "joint_margin"):
            put(name, finite(name, getattr(self, name)))
        for name in ("roll", "pitch", "yaw"):
            if abs(getattr(self, name)) > math.pi:
                value = getattr(self, name)
                raise ConfigurationError(name, f"{value} rad is not between -pi and pi")
        for name in ("com_margin", "joint_margin", "ground_clearance", "self_clearance"):
            if (getattr(self, name) or 0.0) < 0:
                raise ConfigurationError(name, f"{getattr(self, name)} is negative")
        if self.joint_margin > FARTHEST:
            problem = f"{self.joint_margin:g} rad is more than any joint turns"
            raise ConfigurationError("joint_margin", problem)
        if self.height is not None:
            put("height", length("height", self.height))
            if not self.height > 0:
                raise ConfigurationError("height", f"{self.height} m is not above the ground")
        if self.offset is not None:
            put("offset", _point("offset", self.offset))
            if self.com not in (None, "centre"):
                raise ConfigurationError("offset", "give an offset of the base, or a com, not both")
        for name in ("feet", "foot_offsets"):
            places = {foot: _point(f"{name}[{foot}]", p) for foot, p in getattr(self, name).items()}
            put(name, FrozenDict(places))
        both = sorted(set(self.feet) & set(self.foot_offsets))
        if both:
            raise ConfigurationError("feet", f"{both[0]} is in feet and in foot_offsets")
        swing = {foot: length(f"swing[{foot}]", h) for foot, h in self.swing.items()}
        for foot, height in swing.items():
            if height <= 0:
                raise ConfigurationError("swing", f"{foot}: {height} m is not above the ground")
        put("swing", FrozenDict(swing))
        if isinstance(self.com, str):
            if self.com not in ("centre", "inside"):
                problem = f"{self.com!r} is not 'centre', 'inside' or a point (x, y)"
                raise ConfigurationError("com", problem)
        elif self.com is not None:
            put("com", _point("com", self.com))
        if self.ik_seed is not None:
            put("ik_seed", tuple(finite("ik_seed", value) for value in self.ik_seed))

    def _as_by_default(self) -> bool:
        """Whether nothing is asked: what the class says itself needs no check."""
        if type(self.ground) is not Ground:
            return False
        mappings = (self.feet, self.foot_offsets, self.swing)
        if any(type(each) is not FrozenDict or each for each in mappings):
            return False
        return all(map(operator.is_, map(vars(self).__getitem__, _PLAIN), _PLAIN.values()))

    def filled(self, **values: object) -> StandTask:
        """Returns the task with other values, which are not checked: nobody's but our own."""
        other = object.__new__(StandTask)
        vars(other).update(vars(self), **values)
        return other

    def rotation(self) -> Array:
        """Returns the base's rotation (3, 3) in the world."""
        rotation: Array = pin.rpy.rpyToMatrix(self.roll, self.pitch, self.yaw)
        return rotation

    def turn(self) -> tuple[float, float, float, float]:
        """Returns the base's rotation in the world as a unit quaternion (w, x, y, z)."""
        a, b, c = self.roll / 2, self.pitch / 2, self.yaw / 2
        cx, sx, cy, sy = math.cos(a), math.sin(a), math.cos(b), math.sin(b)
        cz, sz = math.cos(c), math.sin(c)
        return (
            cx * cy * cz + sx * sy * sz,
            sx * cy * cz - cx * sy * sz,
            cx * sy * cz + sx * cy * sz,
            cx * cy * sz - sx * sy * cz,
        )

    def __str__(self) -> str:
        """Names the values, with units."""
        parts = [] if self.height is None else [f"height {self.height:.4f} m"]
        parts += [
            f"{name} {math.degrees(getattr(self, name)):.1f} deg"
            for name in ("roll", "pitch", "yaw")
        ]
        if self.offset is not None:
            parts.append(f"base {_millimetres(self.offset)} from the centre")
        parts += [f"{foot} at {_millimetres(place)}" for foot, place in self.feet.items()]
        parts += [f"{foot} moved by {_millimetres(p)}" for foot, p in self.foot_offsets.items()]
        parts += [f"{foot} lifted {1e3 * height:.0f} mm" for foot, height in self.swing.items()]
        if self.ground.slope:
            parts.append(
                f"slope {math.degrees(self.ground.slope):.1f} deg, rising towards "
                f"{math.degrees(self.ground.uphill):.0f} deg"
            )
        parts += [f"{foot} on {1e3 * h:.0f} mm" for foot, h in self.ground.heights.items()]
        if self.com == "inside" or (self.offset is not None and self.com_margin):
            parts.append(f"com inside by {1e3 * self.com_margin:.0f} mm")
        elif self.com is not None and not isinstance(self.com, str):
            parts.append(f"com at {_millimetres(self.com)}")
        if self.joint_margin:
            parts.append(f"{math.degrees(self.joint_margin):.1f} deg off the joint limits")
        if self.ground_clearance:
            parts.append(f"{1e3 * self.ground_clearance:.0f} mm off the ground")
        if self.self_clearance is not None:
            parts.append(f"links {1e3 * self.self_clearance:.0f} mm apart")
        return ", ".join(parts)


_PLAIN = {one.name: one.default for one in fields(StandTask) if one.default is not MISSING}
"""Fields that have one default for all tasks, and which."""


def _millimetres(point: Point) -> str:
    return f"({1e3 * point[0]:.0f}, {1e3 * point[1]:.0f}) mm"


def _point(name: str, value: object) -> Point:
    if not isinstance(value, (tuple, list, np.ndarray)) or len(value) != 2:
        raise ConfigurationError(name, f"{value!r} is not a point (x, y)")
    return length(name, value[0]), length(name, value[1])
