"""What a robot touches besides the ground: planes, and its contacts with them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

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
        force: With which it presses (N), if that is stated; by default what balance makes it, and
            beside a ``Weld``, which takes whatever is left, what costs the least motor torque.
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
    force: float | None = None

    def __post_init__(self) -> None:
        check_type("plane", self.plane, Plane)
        if self.force is not None:
            force = check_finite("force", self.force)
            if not force >= 0:
                raise ConfigurationError("force", diagnose("below-the-least", value=force, bound=0))
            object.__setattr__(self, "force", force)
        if self.place is not None:
            object.__setattr__(self, "place", _point("place", self.place))
        object.__setattr__(self, "offset", _point("offset", self.offset))
        if self.radius is not None:
            radius = check_length("radius", self.radius)
            if not radius > 0:
                raise ConfigurationError("radius", diagnose("not-above", value=radius, bound=0))
            object.__setattr__(self, "radius", radius)

    def at(self, number: float) -> Contact:
        """Returns a contact with the parallel plane at another ``number`` (m)."""
        return replace(self, plane=self.plane.moved(number))

    def __str__(self) -> str:
        """Returns it as it is typed: ``wall:0.4m,mu=0.6``."""
        return format(self, "")

    def __format__(self, spec: str) -> str:
        """Returns the same in mm, with numbers in a format, such as ``.4g``; exactly with none."""
        number, length = _written(spec)
        plane, (kind, _) = self.plane, self.plane.kind
        parts = [f"{kind}:{length(plane.number)}"]
        if not kind:
            parts = [f"plane:{','.join([*map(length, plane.point), *map(number, plane.normal)])}"]
        if self.plane.friction is not None:
            parts.append(f"mu={number(self.plane.friction)}")
        parts += _placed(self, length)
        if self.radius is not None:
            parts.append(f"radius={length(self.radius)}")
        if self.force is not None:
            parts.append(f"force={number(self.force)}N")
        return ",".join(parts)


@dataclass(frozen=True)
class Weld:
    """A part of the robot that is fixed in the world, as if bolted: held any way, by any force.

    The base stands where the task has it, a foot where it stands, and another part with a point of
    its link where it is said to be; each as it is turned there.

    Attributes:
        place: Of another part than base and feet, (x, y, z) where the point is (m); by default
            where it is with the joints at home.
        offset: Of such a part, (x, y, z) of that point in the frame of its link (m).
    """

    plane: ClassVar[None] = None
    place: Point | None = None
    offset: Point = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.place is not None:
            object.__setattr__(self, "place", _point("place", self.place))
        object.__setattr__(self, "offset", _point("offset", self.offset))

    def __str__(self) -> str:
        """Returns it as it is typed: ``weld,offset=0.0m/0.0m/0.1m``."""
        return format(self, "")

    def __format__(self, spec: str) -> str:
        """Returns the same in mm, with numbers in a format, such as ``.4g``; exactly with none."""
        return ",".join(["weld", *_placed(self, _written(spec)[1])])


def _written(spec: str) -> tuple[Callable[[float], str], Callable[[float], str]]:
    """Returns what writes numbers, and what lengths (m): in mm in a format, or exactly."""
    if not spec:
        return repr, lambda length: f"{length!r}m"
    return lambda number: format(number, spec), lambda length: f"{1e3 * length:{spec}}mm"


def _placed(one: Contact | Weld, length: Callable[[float], str]) -> Iterator[str]:
    """Yields where it is, as it is typed, as far as it is said."""
    if one.place is not None:
        yield "place=" + "/".join(map(length, one.place))
    if any(one.offset):
        yield "offset=" + "/".join(map(length, one.offset))


def contact_of(given: Any) -> Contact | Weld:
    """Returns a contact or a weld of plain data, as JSON has it, or the one given.

    Raises:
        ConfigurationError: If it is none.
    """
    if isinstance(given, Weld):
        return given
    if not isinstance(given, Mapping):
        check_type("contact", given, Contact)
        contact: Contact = given
        return contact
    try:
        if "plane" not in given:
            return Weld(**given)
        plane = given["plane"]
        plane = Plane(**plane) if isinstance(plane, Mapping) else plane
        return Contact(**{**given, "plane": plane})
    except TypeError as error:
        problem = diagnose("no-contact", given=repr(given))
        raise ConfigurationError("contact", problem) from error


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
