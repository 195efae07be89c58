"""What a robot touches besides the ground: planes, and its contacts with them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_finite, check_length, check_type, check_vector
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError

Array = NDArray[np.float64]
Point = tuple[float, float, float]

MOST_FRICTION = 1e6
"""Far beyond all that does not slide; of much more, the cone programmes overflow."""


@dataclass(frozen=True)
class Plane:
    """A plane in the world: a wall, a table, a side of a roof.

    Attributes:
        point: (x, y, z) on it (m).
        normal: (x, y, z) out of it, towards the robot; a unit vector, whatever length is given.
        friction: Coefficient of what touches it; that of the ground by default.
    """

    point: Point
    normal: Point
    friction: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", _point("plane.point", self.point))
        way = check_vector("plane.normal", self.normal, 3).tolist()
        size = math.hypot(*way)
        if not size:
            raise ConfigurationError("plane.normal", diagnose("normal-has-no-direction"))
        object.__setattr__(self, "normal", tuple(one / size for one in way))
        if self.friction is not None:
            friction = check_finite("plane.friction", self.friction)
            if not 0 <= friction <= MOST_FRICTION:
                problem = diagnose("not-between", given=friction, low=0, high=MOST_FRICTION)
                raise ConfigurationError("plane.friction", problem)
            object.__setattr__(self, "friction", friction)

    @property
    def kind(self) -> tuple[str, float]:
        """Which of ``KINDS`` it is, and the sign of its number; of no name another one."""
        return next(
            ((name, sign) for name, (out, sign) in KINDS.items() if out == self.normal), _ANY
        )

    @property
    def number(self) -> float:
        """Where it is, as one types it: of a wall x, of a table z; else along its normal (m)."""
        offset = math.fsum(a * b for a, b in zip(self.point, self.normal, strict=True))
        return self.kind[1] * offset

    def height(self, place: Array) -> float:
        """Returns how far a place (3,) is above it (m); negative behind it."""
        return float((place - np.array(self.point)) @ np.array(self.normal))

    def nearest(self, place: Array) -> Array:
        """Returns the point (3,) of it that is nearest to a place (3,) (m)."""
        there: Array = place - self.height(place) * np.array(self.normal)
        return there

    def moved(self, number: float) -> Plane:
        """Returns the parallel plane at another ``number`` (m)."""
        offset = self.kind[1] * number
        more = self.kind[1] * (number - self.number)
        x, y, z = (
            offset * b if abs(b) == 1.0 else a + more * b  # exactly, along an axis
            for a, b in zip(self.point, self.normal, strict=True)
        )
        return replace(self, point=(x, y, z))


@dataclass(frozen=True)
class Contact:
    """A foot, or another part of the robot, that touches a plane of its own.

    A foot touches with what it is. Another part, a hand, touches with a ball in a point of its
    link, which weighs nothing and touches that plane alone.

    Attributes:
        plane: What it touches.
        place: (x, y, z) where, or next to it: the nearest point of the plane (m). By default where
            the foot stands by default, or where a hand is with the joints at home.
        offset: Of a hand, (x, y, z) of its ball's centre in the frame of its link (m).
        radius: Of that ball (m); by default of the largest there that is within the hand's own
            shapes, or 1 cm if it is in none.
    """

    plane: Plane
    place: Point | None = None
    offset: Point = (0.0, 0.0, 0.0)
    radius: float | None = None

    def __post_init__(self) -> None:
        check_type("plane", self.plane, Plane)
        if self.place is not None:
            object.__setattr__(self, "place", _point("place", self.place))
        object.__setattr__(self, "offset", _point("offset", self.offset))
        if self.radius is not None:
            radius = check_length("radius", self.radius)
            if not radius > 0:
                raise ConfigurationError("radius", diagnose("not-above", value=radius, bound=0))
            object.__setattr__(self, "radius", radius)

    @staticmethod
    def of(given: Any) -> Contact:
        """Returns a contact of plain data, as JSON has it, or the contact given.

        Raises:
            ConfigurationError: If it is none.
        """
        if not isinstance(given, Mapping):
            check_type("contact", given, Contact)
            contact: Contact = given
            return contact
        plane = given.get("plane")
        try:
            plane = Plane(**plane) if isinstance(plane, Mapping) else plane
            return Contact(**{**given, "plane": plane})
        except TypeError as error:
            problem = diagnose("no-contact", given=repr(given))
            raise ConfigurationError("contact", problem) from error

    def at(self, number: float) -> Contact:
        """Returns a contact with the parallel plane at another ``number`` (m)."""
        return replace(self, plane=self.plane.moved(number))

    def __str__(self) -> str:
        """Returns it as it is typed: ``wall:0.4m,mu=0.6``."""
        return self._typed(lambda length: f"{length!r}m", repr)

    def __format__(self, spec: str) -> str:
        """Returns the same in mm, with numbers in a format, such as ``.4g``; exactly with none."""
        if not spec:
            return str(self)
        return self._typed(lambda m: f"{1e3 * m:{spec}}mm", lambda number: format(number, spec))

    def _typed(self, length: Callable[[float], str], number: Callable[[float], str]) -> str:
        plane, (kind, _) = self.plane, self.plane.kind
        parts = [f"{kind}:{length(plane.number)}"]
        if not kind:
            parts = [f"plane:{','.join([*map(length, plane.point), *map(number, plane.normal)])}"]
        if self.plane.friction is not None:
            parts.append(f"mu={number(self.plane.friction)}")
        if self.place is not None:
            parts.append("place=" + "/".join(map(length, self.place)))
        if any(self.offset):
            parts.append("offset=" + "/".join(map(length, self.offset)))
        if self.radius is not None:
            parts.append(f"radius={length(self.radius)}")
        return ",".join(parts)


KINDS: dict[str, tuple[Point, float]] = {
    "wall": ((-1.0, 0.0, 0.0), -1.0),
    "table": ((0.0, 0.0, 1.0), 1.0),
    "ceiling": ((0.0, 0.0, -1.0), -1.0),
}
"""{kind of plane: its normal, and the sign of its number, how far it is along that}: a wall at x, a
table and a ceiling at a height."""

_ANY = "", 1.0


def plane_of(kind: str, at: float, friction: float | None = None) -> Plane:
    """Returns a wall, a table or a ceiling at a place (m); see ``KINDS``."""
    normal, _ = KINDS[kind]
    x, y, z = (abs(one) * at for one in normal)
    return Plane((x, y, z), normal, friction)


def _point(name: str, value: Any) -> Point:
    x, y, z = (check_length(name, one) for one in check_vector(name, value, 3).tolist())
    return x, y, z
