"""Planes, slopes and bars that a robot touches, and contacts and welds of a stand task.

``str`` and ``format`` of a ``Contact`` or ``Weld`` return its syntax on the command line, which
error messages contain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from pupper_analysis.base.arguments import (
    check_direction,
    check_finite,
    check_length,
    check_type,
    check_vector,
    suggest_degrees,
)
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.units import READ_IN, UNIT_FACTORS

Position3 = tuple[float, float, float]
"""Point or vector (x, y, z), three floats."""

MAX_FRICTION = 1e6
"""Largest accepted friction coefficient [1]. Chosen, not tuned: larger values would have no other
physical effect."""


@dataclass(frozen=True)
class Plane:
    """Plane in the world, for example a wall, a table, or one side of a roof.

    Attributes:
        point: Point (x, y, z) on the plane (m).
        normal: Normal (x, y, z) towards the robot; the constructor divides it by its norm.
        friction: Friction coefficient. Default: the coefficient of the ground.
    """

    point: Position3 = field(metadata={"unit": "m"})
    normal: Position3
    friction: float | None = field(default=None, metadata={"unit": "1"})

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", _check_position("plane.point", self.point))
        object.__setattr__(self, "normal", _check_direction("plane.normal", self.normal))
        object.__setattr__(self, "friction", _check_friction("plane.friction", self.friction))

    @property
    def kind(self) -> str:
        """Kind of this plane: ``wall`` (normal -x), ``table`` (normal +z), ``ceiling`` (normal -z).

        Empty for another normal.
        """
        return next((name for name, out in PLANE_NORMALS.items() if out == self.normal), "")

    @property
    def _parameter_sign(self) -> float:
        """Sign (1 or -1) that converts the offset n . p along the normal n to ``parameter``."""
        return sum(self.normal) if self.kind else 1.0

    @property
    def parameter(self) -> float:
        """Coordinate [m] that positions this plane: x of a wall, z of a table or ceiling.

        For another plane: the offset n . p, with the unit normal n and a point p of the plane. The
        offset is positive if the normal points away from the world origin.
        """
        offset = math.fsum(a * b for a, b in zip(self.point, self.normal, strict=True))
        return self._parameter_sign * offset

    def signed_distance(self, place: Array) -> float:
        """Return the signed distance [m] of a point from the plane; negative behind the plane.

        Args:
            place: Point, shape (3,) [m], in the world frame.
        """
        return float((place - np.array(self.point)) @ np.array(self.normal))

    def project(self, place: Array) -> Array:
        """Project a point orthogonally onto the plane.

        Args:
            place: Point, shape (3,) [m], in the world frame.
        """
        nearest: Array = place - self.signed_distance(place) * np.array(self.normal)
        return nearest

    def contact_plane(self, _point: Position3) -> Plane:
        """Return the plane of a contact: this plane itself, at any contact point.

        Args:
            _point: Ignored; `Slope.contact_plane` and `Bar.contact_plane` depend on it.
        """
        return self

    def with_parameter(self, number: float) -> Plane:
        """Return the parallel plane whose ``parameter`` is ``number`` [m].

        Raises:
            ConfigurationError: If ``number`` is not a finite number, or moves the plane beyond
                `MAX_LENGTH`.
        """
        number = check_finite("plane.parameter", number)
        offset, displacement = (
            self._parameter_sign * number,
            self._parameter_sign * (number - self.parameter),
        )
        x, y, z = (
            offset * b if abs(b) == 1.0 else a + displacement * b  # without rounding along an axis
            for a, b in zip(self.point, self.normal, strict=True)
        )
        return replace(self, point=(x, y, z))


@dataclass(frozen=True)
class Slope:
    """Inclined plane through the contact's position on the ground or step.

    Attributes:
        angle: Angle to the horizontal (rad), from 0 (floor) to pi (ceiling). The angle is the
            ``parameter``.
        uphill: Direction of steepest ascent: angle about the world's z axis, from the x axis (rad).
        friction: Friction coefficient. Default: the coefficient of the ground.
    """

    angle: float = field(metadata={"unit": "rad"})
    uphill: float = field(default=0.0, metadata={"unit": "rad"})
    friction: float | None = field(default=None, metadata={"unit": "1"})

    def __post_init__(self) -> None:
        object.__setattr__(self, "angle", _check_slope_angle(self.angle))
        object.__setattr__(self, "uphill", check_finite("slope.uphill", self.uphill))
        object.__setattr__(self, "friction", _check_friction("slope.friction", self.friction))

    @property
    def normal(self) -> Position3:
        """Unit normal (x, y, z) out of this inclined plane, in the world frame."""
        return slope_normal(self.angle, self.uphill)

    @property
    def parameter(self) -> float:
        """Angle [rad] between this inclined plane and the horizontal, from 0 to pi."""
        return self.angle

    def with_parameter(self, number: float) -> Slope:
        """Return a copy of this plane with ``number`` [rad] as angle to the horizontal."""
        return replace(self, angle=number)

    def contact_plane(self, point: Position3) -> Plane:
        """Return the plane with this slope through a point (x, y, z) [m] of the world frame."""
        return Plane(point, self.normal, self.friction)


@dataclass(frozen=True)
class Bar:
    """Round bar in the world, such as a rung. A radius of a millimetre represents an edge.

    A contact with the bar is a contact with its tangent plane (`contact_plane`).

    Attributes:
        point: Point (x, y, z) on the axis (m); its z is the ``parameter``.
        direction: Vector (x, y, z) along the axis; the constructor divides it by its norm.
        radius: Radius (m).
        friction: Friction coefficient. Default: the coefficient of the ground.
    """

    point: Position3 = field(metadata={"unit": "m"})
    direction: Position3
    radius: float = field(metadata={"unit": "m"})
    friction: float | None = field(default=None, metadata={"unit": "1"})

    def __post_init__(self) -> None:
        radius = check_length("bar.radius", self.radius)
        if not radius > 0:
            raise ConfigurationError("bar.radius", diagnose("not-above", value=radius, bound=0))
        object.__setattr__(self, "point", _check_position("bar.point", self.point))
        object.__setattr__(self, "direction", _check_direction("bar.direction", self.direction))
        object.__setattr__(self, "radius", radius)
        object.__setattr__(self, "friction", _check_friction("bar.friction", self.friction))

    @property
    def parameter(self) -> float:
        """Height z [m] in the world frame of the point (``point``) that defines the bar's axis."""
        return self.point[2]

    def with_parameter(self, number: float) -> Bar:
        """Return this bar at another height: the z of its ``point`` is ``number`` [m]."""
        return replace(self, point=(*self.point[:2], number))

    def point_above(self, x: float, y: float) -> Position3:
        """Return a point (x, y, z) [m] above the axis of this bar, for a horizontal position [m].

        The point of the bar's axis nearest to (x, y) in the horizontal plane is displaced upward,
        perpendicular to the axis. The distance is 1 m times the cosine of the bar's inclination,
        which is 0 for a vertical bar.

        Raises:
            ConfigurationError: If a coordinate exceeds `MAX_LENGTH`, as for a steep bar.
        """
        along = np.array(self.direction)
        level = along[:2] @ along[:2]
        distance = (np.array((x, y)) - self.point[:2]) @ along[:2] / level if level else 0.0
        upward = np.array((0.0, 0.0, 1.0)) - along[2] * along
        result: list[float] = (np.array(self.point) + distance * along + upward).tolist()
        return _check_position("place", result)

    def contact_plane(self, point: Position3) -> Tangent:
        """Return the tangent plane at the point of the bar's surface nearest to a given point.

        Args:
            point: Point (x, y, z) [m] in the world frame.

        Raises:
            ConfigurationError: If the point is on the axis, up to rounding.
        """
        axis, offset = np.array(self.direction), np.array(point) - self.point
        normal = offset - (offset @ axis) * axis
        if not np.linalg.norm(normal) > _AXIS_ATOL:
            raise ConfigurationError("contact.place", diagnose("place-in-a-bar"))
        normal = normal / np.linalg.norm(normal)
        contact_point = np.array(self.point) + (offset @ axis) * axis + self.radius * normal
        x, y, z = contact_point.tolist()
        a, b, c = normal.tolist()
        return Tangent((x, y, z), (a, b, c), self.friction, bar=self)


@dataclass(frozen=True)
class Tangent(Plane):
    """Tangent plane of a bar, the plane of a contact with this bar.

    Attributes:
        bar: Bar that the plane touches.
    """

    bar: Bar | None = None


_AXIS_ATOL = 1e-9
"""Distance [m] from the axis of a bar up to which a point counts as on the axis. A point on the
axis is refused, because it has no unique nearest point on the bar. Chosen, not tuned."""


@dataclass(frozen=True)
class Contact:
    """Contact of a foot, or of another part of the robot (a hand), with a plane or a bar.

    A foot touches with its collision geometry. A hand touches with a massless sphere that is fixed
    to its link, and that collides at most with the plane of the contact. A sole (foot with several
    contact points) can neither touch a bar nor grip.

    Attributes:
        plane: Plane, slope or bar.
        force: Prescribed normal force (N). By default, the force follows from balance. If the robot
            also has a ``Weld``, balance permits any force, and the force follows from minimum motor
            torque.
        place: Target point (x, y, z) in the world (m), which is projected to the plane. By default,
            the position of the foot in the task, or the position of the hand with the joints at
            home.
        offset: Centre (x, y, z) of the contact sphere in the named frame of the hand (m).
        radius: Radius of the contact sphere of a hand (m). By default, the radius of the largest
            sphere with this centre inside a collision shape of the hand. If the centre is outside
            of all shapes, the default is 1 cm.
        grip: Maximum force (N) of a grip in any direction, for example of a hand around a rung. The
            grip fixes the centre of the sphere, and permits rotation about the centre. By default,
            the contact is unilateral, without grip.
    """

    plane: Plane | Slope | Bar
    place: Position3 | None = field(default=None, metadata={"unit": "m"})
    offset: Position3 = field(default=(0.0, 0.0, 0.0), metadata={"unit": "m"})
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
            object.__setattr__(self, "place", _check_position("place", self.place))
        object.__setattr__(self, "offset", _check_position("offset", self.offset))
        if self.radius is not None:
            radius = check_length("radius", self.radius)
            if not radius > 0:
                raise ConfigurationError("radius", diagnose("not-above", value=radius, bound=0))
            object.__setattr__(self, "radius", radius)

    @property
    def has_angle(self) -> bool:
        """True if ``parameters`` is an angle [rad], for a `Slope`; False for lengths [m]."""
        return isinstance(self.plane, Slope)

    @property
    def parameters(self) -> tuple[float, ...]:
        """Numbers that define the position or the angle of the plane or bar.

        - Bar: x, y, z of a point on the axis (``Bar.point``) [m].
        - Slope: angle to the horizontal [rad].
        - Other plane: ``parameter`` of the plane [m].
        """
        return self.plane.point if isinstance(self.plane, Bar) else (self.plane.parameter,)

    def with_parameters(self, numbers: Sequence[float]) -> Contact:
        """Return a copy of this contact with other ``parameters`` of its plane or bar.

        Args:
            numbers: Three coordinates of the point of a bar [m]; or one number: the angle of a
                slope [rad], or the ``parameter`` of another plane [m].

        Raises:
            ConfigurationError: If the count of the numbers is wrong, or a number is not valid, for
                example a slope angle above pi.
        """
        if isinstance(self.plane, Bar):
            return replace(self, plane=replace(self.plane, point=_check_position("point", numbers)))
        return self.with_plane_parameter(float(check_vector("parameters", numbers, 1)[0]))

    def with_plane_parameter(self, number: float) -> Contact:
        """Return a copy of this contact in which the ``parameter`` of the plane is ``number``.

        The parameter is an angle [rad] for a slope, otherwise a length [m].
        """
        return replace(self, plane=self.plane.with_parameter(number))

    def __str__(self) -> str:
        """Return this contact in the syntax of the command line, for example ``wall:0.4m,mu=0.6``.

        The text has all digits. Reading the text gives an equivalent contact; its unit vectors may
        differ by rounding.
        """
        return format(self)

    def __format__(self, spec: str) -> str:
        """Return this contact in the syntax of the command line, with formatted numbers.

        With a number format ``spec`` such as ``.4g``, lengths are in mm, and angles in deg. If
        ``spec`` is empty, all digits are written, in SI units or degrees.
        """
        write, plane = _make_formatter(spec), self.plane
        if isinstance(plane, Slope):
            parts = ["slope:" + write([plane.angle], "rad")]
            parts += ["uphill=" + write([plane.uphill], "rad")] if plane.uphill else []
        elif isinstance(plane, Bar):
            point, direction = write(plane.point, "m", ","), write(plane.direction, "", ",")
            parts = [f"bar:{point},{direction},{write([plane.radius], 'm')}"]
        elif plane.kind:
            parts = [f"{plane.kind}:{write([plane.parameter], 'm')}"]
        else:
            parts = [f"plane:{write(plane.point, 'm', ',')},{write(plane.normal, '', ',')}"]
        parts += [] if plane.friction is None else ["mu=" + write([plane.friction], "")]
        parts += _format_placement(self, write)
        parts += [] if self.radius is None else ["radius=" + write([self.radius], "m")]
        parts += [] if self.force is None else ["force=" + write([self.force], "N")]
        parts += [] if self.grip is None else ["grip=" + write([self.grip], "N")]
        return ",".join(parts)


@dataclass(frozen=True)
class Weld:
    """Rigid fixation of a robot part to the world in a stand task, which can bear any wrench.

    - Base: fixed at its pose in the task.
    - Foot: fixed at its position in the stand.
    - Other part: its point ``offset`` is fixed at the position ``place``.

    The orientation of a part is its orientation in the stand.

    Attributes:
        place: World position (x, y, z) of the fixed point of another part (m). By default, the
            position with the joints at home.
        offset: Fixed point (x, y, z) of another part, in the named frame of the part (m).
    """

    plane: ClassVar[None] = None
    has_angle: ClassVar[bool] = False
    place: Position3 | None = field(default=None, metadata={"unit": "m"})
    offset: Position3 = field(default=(0.0, 0.0, 0.0), metadata={"unit": "m"})

    def __post_init__(self) -> None:
        if self.place is not None:
            object.__setattr__(self, "place", _check_position("place", self.place))
        object.__setattr__(self, "offset", _check_position("offset", self.offset))

    @property
    def parameters(self) -> tuple[float, ...]:
        """Position (x, y, z) [m] at which the part is welded; empty if none is specified."""
        return self.place or ()

    def with_parameters(self, numbers: Sequence[float]) -> Weld:
        """Return a copy of this weld at another position (x, y, z) [m].

        Raises:
            ConfigurationError: If ``numbers`` are not three finite numbers, or exceed `MAX_LENGTH`
                (1 km).
        """
        return replace(self, place=_check_position("place", numbers))

    def __str__(self) -> str:
        """Return this weld in the syntax of the command line.

        For example ``weld,offset=0.0m/0.0m/0.1m``.
        """
        return format(self)

    def __format__(self, spec: str) -> str:
        """Return this weld in the syntax of the command line, with formatted numbers.

        With a number format such as ``.4g``, lengths are in mm. If ``spec`` is empty, all digits
        are written, in m.
        """
        return ",".join(["weld", *_format_placement(self, _make_formatter(spec))])


def _make_formatter(spec: str) -> Callable[..., str]:
    """Return a function that formats SI numbers with their unit.

    With a number format ``spec`` such as ``.4g``, lengths are in mm, and angles in deg. If ``spec``
    is empty, all digits are written.
    """

    def write(values: Sequence[float], unit: str, by: str = "/") -> str:
        """Format numbers, given in the SI unit ``unit``, as a text, joined by ``by``."""
        factor, shown_unit = READ_IN.get(unit, (1.0, unit)) if spec else (1.0, unit)
        if unit == "rad" and not spec:
            return by.join(map(_format_exact_angle, values))
        numbers = (format(factor * value, spec) if spec else repr(value) for value in values)
        return by.join(number + shown_unit for number in numbers)

    return write


def _format_exact_angle(angle: float) -> str:
    """Return the shortest text in degrees that is read as exactly this angle [rad], or radians."""
    candidates = (f"{math.degrees(angle):.{digits}g}" for digits in range(3, 18))
    radians_per_degree = UNIT_FACTORS["angle"]["deg"]
    return next(
        (f"{text}deg" for text in candidates if float(text) * radians_per_degree == angle),
        f"{angle!r}rad",
    )


def _format_placement(contact: Contact | Weld, write: Callable[..., str]) -> Iterator[str]:
    """Yield the command-line words for a specified place and a nonzero offset of a contact."""
    if contact.place is not None:
        yield "place=" + write(contact.place, "m")
    if any(contact.offset):
        yield "offset=" + write(contact.offset, "m")


def contact_of(data: Any) -> Contact | Weld:
    """Convert plain data, for example from JSON, to a contact or weld.

    A mapping without the key ``plane`` is a weld.

    Raises:
        ConfigurationError: If the data are not valid.
    """
    if isinstance(data, Weld):
        return data
    if not isinstance(data, Mapping):
        check_type("contact", data, Contact)
        contact: Contact = data
        return contact
    try:
        if "plane" not in data:
            return Weld(**data)
        plane = data["plane"]
        if isinstance(plane, Mapping):
            kind = Bar if "direction" in plane else Slope if "angle" in plane else Plane
            plane = kind(**plane)
        return Contact(**{**data, "plane": plane})
    except TypeError as error:
        problem = diagnose("no-contact", given=repr(data))
        raise ConfigurationError("contact", problem) from error


PLANE_NORMALS: dict[str, Position3] = {
    "wall": (-1.0, 0.0, 0.0),
    "table": (0.0, 0.0, 1.0),
    "ceiling": (0.0, 0.0, -1.0),
}
"""{kind of plane: unit normal towards the robot, in the world frame}."""


def describe_surface(kind: str, foot: str) -> Diagnostic:
    """Name the surface that a foot or hand touches instead of the floor: "wall of left_palm".

    Args:
        kind: ``"wall"``, ``"table"``, ``"ceiling"``, ``"bar"`` or ``"step"``; empty for another
            plane.
        foot: Name of the foot or hand.
    """
    return diagnose("surface-of-contact", kind=Term(kind or "plane"), contact=foot)


def slope_normal(angle: float, uphill: float) -> Position3:
    """Return the unit normal of a sloped plane, in the world frame.

    Args:
        angle: Angle to the horizontal [rad]: the normal is upward for 0, and downward for pi.
        uphill: Direction of steepest ascent, as an angle about z from the x axis [rad].
    """
    rise = math.sin(angle)
    return -rise * math.cos(uphill), -rise * math.sin(uphill), math.cos(angle)


def _check_slope_angle(value: float) -> float:
    """Return the angle [rad] of a slope to the horizontal; ConfigurationError if not valid."""
    name, low, high = "slope.angle", 0.0, math.pi
    angle = check_finite(name, value)
    if not low <= angle <= high:
        problem = diagnose(
            "angle-out-of-range",
            angle=Quantity(angle, "rad"),
            low=Quantity(low, "rad"),
            high=Quantity(high, "rad"),
            written=suggest_degrees(angle, low, high),
        )
        raise ConfigurationError(name, problem)
    return angle


def _check_friction(name: str, value: float | None) -> float | None:
    """Return a friction coefficient, or None; ConfigurationError if it is not valid."""
    if value is None:
        return None
    friction = check_finite(name, value)
    if not 0 <= friction <= MAX_FRICTION:
        raise ConfigurationError(
            name, diagnose("not-between", given=friction, low=0, high=MAX_FRICTION)
        )
    return friction


def _check_direction(name: str, value: Any) -> Position3:
    """Return the unit vector (x, y, z) of a vector; ConfigurationError if it is not valid."""
    x, y, z = check_direction(name, value).tolist()
    return x, y, z


def _check_position(name: str, value: Any) -> Position3:
    """Return a position (x, y, z) [m] as floats; ConfigurationError if it is not valid."""
    x, y, z = (
        check_length(name, coordinate) for coordinate in check_vector(name, value, 3).tolist()
    )
    return x, y, z
