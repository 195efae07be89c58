"""What a robot touches besides the ground: planes and bars, and its contacts with them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_finite, check_length, check_type, check_vector
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.units import READ_IN, UNITS

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

    point: Point = field(metadata={"unit": "m"})
    normal: Point
    friction: float | None = field(default=None, metadata={"unit": "1"})

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", _point("plane.point", self.point))
        object.__setattr__(self, "normal", _direction("plane.normal", self.normal))
        object.__setattr__(self, "friction", _friction("plane.friction", self.friction))

    @property
    def kind(self) -> str:
        """Which of ``KINDS`` it is; empty if it is none."""
        return next((name for name, out in KINDS.items() if out == self.normal), "")

    @property
    def _sign(self) -> float:
        """Of its number: that of its kind's normal, so that a wall is at x, a table at a height."""
        return sum(self.normal) if self.kind else 1.0

    @property
    def number(self) -> float:
        """Where it is, as one types it: of a wall x, of a table z; else along its normal (m)."""
        offset = math.fsum(a * b for a, b in zip(self.point, self.normal, strict=True))
        return self._sign * offset

    def height(self, place: Array) -> float:
        """Returns how far a place (3,) is above it (m); negative behind it."""
        return float((place - np.array(self.point)) @ np.array(self.normal))

    def nearest(self, place: Array) -> Array:
        """Returns the point (3,) of it that is nearest to a place (3,) (m)."""
        there: Array = place - self.height(place) * np.array(self.normal)
        return there

    def through(self, _point: Point) -> Plane:
        """Returns itself, which is where it is; see ``Slope``."""
        return self

    def moved(self, number: float) -> Plane:
        """Returns the parallel plane at another ``number`` (m)."""
        offset, more = self._sign * number, self._sign * (number - self.number)
        x, y, z = (
            offset * b if abs(b) == 1.0 else a + more * b  # exactly, along an axis
            for a, b in zip(self.point, self.normal, strict=True)
        )
        return replace(self, point=(x, y, z))


@dataclass(frozen=True)
class Slope:
    """A plane under what touches it: through its place, on the ground or the step that is there.

    Attributes:
        angle: Against the horizontal (rad), from 0, a floor, to pi, a ceiling; its ``number``.
        uphill: Direction in which it rises, about z from x (rad).
        friction: Coefficient of what touches it; that of the ground by default.
    """

    angle: float = field(metadata={"unit": "rad"})
    uphill: float = field(default=0.0, metadata={"unit": "rad"})
    friction: float | None = field(default=None, metadata={"unit": "1"})

    def __post_init__(self) -> None:
        object.__setattr__(self, "angle", _between("slope.angle", self.angle, math.pi, "rad"))
        object.__setattr__(self, "uphill", check_finite("slope.uphill", self.uphill))
        object.__setattr__(self, "friction", _friction("slope.friction", self.friction))

    @property
    def normal(self) -> Point:
        """(x, y, z) out of it; a unit vector."""
        return slope_normal(self.angle, self.uphill)

    @property
    def number(self) -> float:
        """Its angle, as a plane's is where it is (rad)."""
        return self.angle

    def moved(self, number: float) -> Slope:
        """Returns the one of another angle (rad)."""
        return replace(self, angle=number)

    def through(self, point: Point) -> Plane:
        """Returns the plane through a point (x, y, z) (m)."""
        return Plane(point, self.normal, self.friction)


@dataclass(frozen=True)
class Bar:
    """A round bar in the world, such as a rung; of a millimetre's radius it is an edge.

    What touches it does so in the plane that is tangent to it there.

    Attributes:
        point: (x, y, z) in its middle (m); z is its ``number``.
        direction: (x, y, z) along it; a unit vector, whatever length is given.
        radius: m.
        friction: Coefficient of what touches it; that of the ground by default.
    """

    point: Point = field(metadata={"unit": "m"})
    direction: Point
    radius: float = field(metadata={"unit": "m"})
    friction: float | None = field(default=None, metadata={"unit": "1"})

    def __post_init__(self) -> None:
        radius = check_length("bar.radius", self.radius)
        if not radius > 0:
            raise ConfigurationError("bar.radius", diagnose("not-above", value=radius, bound=0))
        object.__setattr__(self, "point", _point("bar.point", self.point))
        object.__setattr__(self, "direction", _direction("bar.direction", self.direction))
        object.__setattr__(self, "radius", radius)
        object.__setattr__(self, "friction", _friction("bar.friction", self.friction))

    @property
    def number(self) -> float:
        """Its height (m)."""
        return self.point[2]

    def moved(self, number: float) -> Bar:
        """Returns the one at another height (m)."""
        return replace(self, point=(*self.point[:2], number))

    def top(self, x: float, y: float) -> Point:
        """Returns the point on its upper side next to a place, seen from above (m)."""
        along = np.array(self.direction)
        level = along[:2] @ along[:2]
        way = (np.array((x, y)) - self.point[:2]) @ along[:2] / level if level else 0.0
        out = np.array((0.0, 0.0, 1.0)) - along[2] * along
        above: list[float] = (np.array(self.point) + way * along + out).tolist()
        return _point("place", above)

    def through(self, point: Point) -> Tangent:
        """Returns the plane that touches it where it is nearest to a point (x, y, z) (m).

        Raises:
            ConfigurationError: If the point is in its middle.
        """
        along, away = np.array(self.direction), np.array(point) - self.point
        out = away - (away @ along) * along
        if not np.linalg.norm(out) > _MIDDLE:
            raise ConfigurationError("contact.place", diagnose("place-in-a-bar"))
        out = out / np.linalg.norm(out)
        near = np.array(self.point) + (away @ along) * along + self.radius * out
        x, y, z = near.tolist()
        a, b, c = out.tolist()
        return Tangent((x, y, z), (a, b, c), self.friction, bar=self)


@dataclass(frozen=True)
class Tangent(Plane):
    """The plane in which something touches a bar."""

    bar: Bar | None = None


_MIDDLE = 1e-9
"""A point that is no further from a bar's axis is on it (m)."""


@dataclass(frozen=True)
class Contact:
    """A foot, or another part of the robot, that touches a plane or a bar of its own.

    A foot touches with what it is. Another part, a hand, touches with a ball in a point of its
    link, which weighs nothing and touches that plane alone. A foot of several points, a sole,
    touches no bar.

    Attributes:
        plane: What it touches.
        force: With which it presses (N), if that is stated; by default what balance makes it, and
            beside a ``Weld``, which takes whatever is left, what costs the least motor torque.
        place: (x, y, z) where, or next to it: the nearest point of the plane (m). By default where
            the foot stands by default, or where a hand is with the joints at home.
        offset: Of a hand, (x, y, z) of its ball's centre in the frame of its link (m).
        radius: Of that ball (m); by default of the largest there that is within the hand's own
            shapes, or 1 cm if it is in none.
        grip: Up to which force (N) it is held there, any way, as by a hand that is closed around a
            rung: its ball's centre stays where it is, and the hand may turn about it. By default
            nothing holds it, and it can only press.
    """

    plane: Plane | Slope | Bar
    place: Point | None = field(default=None, metadata={"unit": "m"})
    offset: Point = field(default=(0.0, 0.0, 0.0), metadata={"unit": "m"})
    radius: float | None = field(default=None, metadata={"unit": "m"})
    force: float | None = field(default=None, metadata={"unit": "N"})
    grip: float | None = field(default=None, metadata={"unit": "N"})

    def __post_init__(self) -> None:
        check_type("plane", self.plane, Plane | Slope | Bar)
        if self.grip is not None:
            grip = check_finite("grip", self.grip)
            if not grip > 0:
                raise ConfigurationError("grip", diagnose("not-above", value=grip, bound=0))
            if self.force is not None:
                raise ConfigurationError("grip", diagnose("grip-and-force"))
            object.__setattr__(self, "grip", grip)
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

    @property
    def turns(self) -> bool:
        """Whether its number is an angle, of a slope."""
        return isinstance(self.plane, Slope)

    @property
    def numbers(self) -> tuple[float, ...]:
        """Those that can give where it is out of reach: its plane's, or a bar's point (m, rad)."""
        return self.plane.point if isinstance(self.plane, Bar) else (self.plane.number,)

    def moved(self, numbers: Sequence[float]) -> Contact:
        """Returns one with others (m, rad)."""
        if isinstance(self.plane, Bar):
            return replace(self, plane=replace(self.plane, point=_point("point", numbers)))
        return self.at(*numbers)

    def at(self, number: float) -> Contact:
        """Returns a contact with the parallel plane at another ``number`` (m, rad)."""
        return replace(self, plane=self.plane.moved(number))

    def __str__(self) -> str:
        """Returns it as it is typed: ``wall:0.4m,mu=0.6``."""
        return format(self)

    def __format__(self, spec: str) -> str:
        """Returns the same in mm and deg, in a format such as ``.4g``; exactly with none."""
        say, plane = _writer(spec), self.plane
        if isinstance(plane, Slope):
            parts = ["slope:" + say([plane.angle], "rad")]
            parts += ["uphill=" + say([plane.uphill], "rad")] if plane.uphill else []
        elif isinstance(plane, Bar):
            place, way = say(plane.point, "m", ","), say(plane.direction, "", ",")
            parts = [f"bar:{place},{way},{say([plane.radius], 'm')}"]
        elif plane.kind:
            parts = [f"{plane.kind}:{say([plane.number], 'm')}"]
        else:
            parts = [f"plane:{say(plane.point, 'm', ',')},{say(plane.normal, '', ',')}"]
        parts += [] if plane.friction is None else ["mu=" + say([plane.friction], "")]
        parts += _placed(self, say)
        parts += [] if self.radius is None else ["radius=" + say([self.radius], "m")]
        parts += [] if self.force is None else ["force=" + say([self.force], "N")]
        parts += [] if self.grip is None else ["grip=" + say([self.grip], "N")]
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
    turns: ClassVar[bool] = False
    place: Point | None = field(default=None, metadata={"unit": "m"})
    offset: Point = field(default=(0.0, 0.0, 0.0), metadata={"unit": "m"})

    def __post_init__(self) -> None:
        if self.place is not None:
            object.__setattr__(self, "place", _point("place", self.place))
        object.__setattr__(self, "offset", _point("offset", self.offset))

    @property
    def numbers(self) -> tuple[float, ...]:
        """Those that can give where it is out of reach: its place, if that is said (m)."""
        return self.place or ()

    def moved(self, numbers: Sequence[float]) -> Weld:
        """Returns one at another place (m)."""
        return replace(self, place=_point("place", numbers))

    def __str__(self) -> str:
        """Returns it as it is typed: ``weld,offset=0.0m/0.0m/0.1m``."""
        return format(self)

    def __format__(self, spec: str) -> str:
        """Returns the same in mm, with numbers in a format, such as ``.4g``; exactly with none."""
        return ",".join(["weld", *_placed(self, _writer(spec))])


def _writer(spec: str) -> Callable[..., str]:
    """Returns what writes numbers of a unit: as they are read, in a format, or exactly."""

    def say(values: Sequence[float], unit: str, by: str = "/") -> str:
        factor, read = READ_IN.get(unit, (1.0, unit)) if spec else (1.0, unit)
        if unit == "rad" and not spec:
            return by.join(map(_angle_exactly, values))
        numbers = (format(factor * one, spec) if spec else repr(one) for one in values)
        return by.join(number + read for number in numbers)

    return say


def _angle_exactly(angle: float) -> str:
    """Returns an angle in the fewest digits that are read back as it is: degrees, if any are."""
    written = (f"{math.degrees(angle):.{digits}g}" for digits in range(3, 18))
    size = UNITS["angle"]["deg"]
    return next((f"{one}deg" for one in written if float(one) * size == angle), f"{angle!r}rad")


def _placed(one: Contact | Weld, say: Callable[..., str]) -> Iterator[str]:
    """Yields where it is, as it is typed, as far as it is said."""
    if one.place is not None:
        yield "place=" + say(one.place, "m")
    if any(one.offset):
        yield "offset=" + say(one.offset, "m")


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
        if isinstance(plane, Mapping):
            kind = Bar if "direction" in plane else Slope if "angle" in plane else Plane
            plane = kind(**plane)
        return Contact(**{**given, "plane": plane})
    except TypeError as error:
        problem = diagnose("no-contact", given=repr(given))
        raise ConfigurationError("contact", problem) from error


KINDS: dict[str, Point] = {
    "wall": (-1.0, 0.0, 0.0),
    "table": (0.0, 0.0, 1.0),
    "ceiling": (0.0, 0.0, -1.0),
}
"""{kind of plane: its normal}."""


def slope_normal(angle: float, uphill: float) -> Point:
    """Returns the direction out of a plane at an angle, that rises in a direction (rad)."""
    rise = math.sin(angle)
    return -rise * math.cos(uphill), -rise * math.sin(uphill), math.cos(angle)


def _between(name: str, value: float, high: float, unit: str = "") -> float:
    """Returns a number, of a unit or none, from 0 to ``high``.

    Raises:
        ConfigurationError: If it is none.
    """
    number = check_finite(name, value)
    if not 0 <= number <= high:
        given, most = (Quantity(one, unit) if unit else one for one in (number, high))
        raise ConfigurationError(name, diagnose("not-between", given=given, low=0, high=most))
    return number


def _friction(name: str, value: float | None) -> float | None:
    return None if value is None else _between(name, value, MOST_FRICTION)


def _direction(name: str, value: Any) -> Point:
    """Returns a unit vector.

    Raises:
        ConfigurationError: If it has no length.
    """
    x, y, z = check_vector(name, value, 3).tolist()
    size = math.hypot(x, y, z)
    if not size:
        raise ConfigurationError(name, diagnose("normal-has-no-direction"))
    return x / size, y / size, z / size


def _point(name: str, value: Any) -> Point:
    x, y, z = (check_length(name, one) for one in check_vector(name, value, 3).tolist())
    return x, y, z
