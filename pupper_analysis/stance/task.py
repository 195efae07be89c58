"""What is asked of a stand: the ground, the feet and which of them carry, the base, the com."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_finite, check_length, check_type
from pupper_analysis.base.diagnostics import Phrase, diagnose
from pupper_analysis.base.diagnostics.templates import fill_template
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.plane import Contact, Weld
from pupper_analysis.stance.fields import FIELDS, Field

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
        contacts: {foot: what it touches instead of the ground (``Contact``)}; or another link,
            site, body or geom, a hand: what that touches. Each of them, and the ``base``, may be
            fixed in the world instead (``Weld``). No hand moves the centre of the feet, nor
            does a foot on what is steeper than 60 deg; no foot on such a plane moves the height.
        com: ``"centre"``, a point (x, y) in the world (m), or ``"inside"``: anywhere in the support
            polygon with at least ``com_margin``, over the centre if that is in reach. By default
            the centre, or inside if the robot's legs cannot move the com in two directions.
        com_margin: Least distance of the com's projection from the polygon's edge (m).
        joint_margin: Least distance of every joint from its limits (rad).
        ground_clearance: Least height above the ground of every part but the feet (m).
        self_clearance: Least distance between links that are not neighbours (m); by default they
            are not looked at.
        posture: {joint that carries no foot, or a pattern such as ``*elbow*``: its position (rad,
            m)}; of patterns that match the same joint the last counts. Where nothing is said a
            search begins at ``home``, and leaves these joints there to some milliradians.
        ik_seed: (nu,) joint positions to start from (rad), which decides between ways to bend a
            knee; the robot's ``home`` by default.
    """

    height: float | None = field(default=None, metadata={"unit": "m"})
    roll: float = field(default=0.0, metadata={"unit": "rad"})
    pitch: float = field(default=0.0, metadata={"unit": "rad"})
    yaw: float = field(default=0.0, metadata={"unit": "rad"})
    offset: Point | None = field(default=None, metadata={"unit": "m"})
    feet: Mapping[str, Point] = field(default_factory=FrozenDict, metadata={"unit": "m"})
    foot_offsets: Mapping[str, Point] = field(default_factory=FrozenDict, metadata={"unit": "m"})
    swing: Mapping[str, float] = field(default_factory=FrozenDict, metadata={"unit": "m"})
    ground: Ground = field(default_factory=Ground)
    contacts: Mapping[str, Contact | Weld] = field(default_factory=FrozenDict)
    com: str | Point | None = field(default=None, metadata={"unit": "m"})
    com_margin: float = field(default=0.0, metadata={"unit": "m"})
    joint_margin: float = field(default=0.0, metadata={"unit": "rad"})
    ground_clearance: float = field(default=0.0, metadata={"unit": "m"})
    self_clearance: float | None = field(default=None, metadata={"unit": "m"})
    posture: Mapping[str, float] = field(default_factory=FrozenDict, metadata={"unit": "rad or m"})
    ik_seed: Sequence[float] | None = field(default=None, metadata={"unit": "rad"})

    def __post_init__(self) -> None:
        for entry in _OWN:
            value = getattr(self, entry.name)
            if value is _DEFAULTS[entry.name] or (type(value) is FrozenDict and not value):
                continue  # what the class says itself needs no check
            if entry.name == "height" and self.contacts:  # on a table it may be below what carries
                object.__setattr__(self, "height", check_length("height", value))
                continue
            if entry.per:
                check_type(entry.name, value, Mapping[str, Any])
            object.__setattr__(self, entry.name, entry.check_value(value))
        if type(self.ground) is not Ground:
            check_type("ground", self.ground, Ground)
        if self.ground.planes:  # of a task worked out for a robot
            object.__setattr__(self, "ground", replace(self.ground))
        if self.ik_seed is not None:
            check_type("ik_seed", self.ik_seed, Sequence[float])
            seed = tuple(check_finite("ik_seed", value) for value in self.ik_seed)
            object.__setattr__(self, "ik_seed", seed)
        if self.offset is not None and self.com not in (None, "centre"):
            raise ConfigurationError("offset", diagnose("offset-and-com"))
        for foot in self.feet:
            if foot in self.foot_offsets:
                message = diagnose("foot-placed-twice", foot=foot)
                raise ConfigurationError("feet", message)
        for name in self.contacts:
            contact = self.contacts[name]
            on_step = contact.turns and contact.place is None
            if name in self.ground.heights and not on_step:
                problem = diagnose("two-grounds-of-a-foot", name=name)
                raise ConfigurationError("contacts", problem)
            if contact.place is not None and name in {**self.feet, **self.foot_offsets}:
                raise ConfigurationError("contacts", diagnose("contact-placed-twice", name=name))

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> StandTask:
        """Returns the task of plain data, as JSON and TOML have it.

        Args:
            given: {field: value}; the ground's in a mapping of their own, or beside the others.

        Raises:
            ConfigurationError: If there is no such field, or it makes no sense.
        """
        ground = given.get("ground", {})
        ground = vars(ground) if isinstance(ground, Ground) else ground
        check_type("ground", ground, Mapping[str, Any])
        values = {name: value for name, value in given.items() if name != "ground"} | dict(ground)
        values.pop("_planes", None)  # its contacts'
        seed = values.pop("ik_seed", None)
        if not FIELDS.keys() >= values.keys():
            raise ConfigurationError("stand", diagnose("stance-field-unknown", known=(*FIELDS,)))
        return cls(ik_seed=seed).with_values(values)

    def replace_unchecked(self, **values: Any) -> StandTask:
        """Returns the task with what it leaves open: a word for where the com is, the ground.

        Nothing is checked again: that took an eighth of a stand's time in a sequence.
        """
        task = object.__new__(StandTask)
        vars(task).update(vars(self), **values)
        return task

    def values(self) -> dict[str, Any]:
        """Returns {field of the table of ``stance.fields``: its value}, those of the ground too."""
        owners = {"task": self, "ground": self.ground}
        return {name: getattr(owners[field.part], name) for name, field in FIELDS.items()}

    def with_values(self, values: Mapping[str, Any]) -> StandTask:
        """Returns the task with other values, {field of the table: value}.

        Raises:
            ConfigurationError: If one is out of range.
        """
        grounds = {name: value for name, value in values.items() if FIELDS[name].part == "ground"}
        own: dict[str, Any] = {name: values[name] for name in values if name not in grounds}
        if grounds:
            own["ground"] = replace(self.ground, **grounds)
        return replace(self, **own)

    def rotation(self) -> Array:
        """Returns the base's rotation (3, 3) in the world."""
        rotation: Array = pin.rpy.rpyToMatrix(self.roll, self.pitch, self.yaw)
        return rotation

    def base_quaternion(self) -> tuple[float, float, float, float]:
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
        return self.describe("en")

    def phrase(self) -> Phrase:
        """Returns the values with units, in both languages."""
        return Phrase(self.describe("en"), self.describe("zh"))

    def describe(self, language: str) -> str:
        """Returns the values with units, in ``"en"`` or ``"zh"``."""
        parts = []
        values = {
            name: FIELDS[name].quantity(value)
            for name, value in self.values().items()
            if isinstance(value, float | tuple)
        }
        for entry, of, value in self._asked():
            beside = {
                name: FIELDS[name].quantity(every[of]) if of in every else None
                for name, every in self.values().items()
                if FIELDS[name].per and of
            }
            fields = {**values, **beside, "of": of, "value": entry.quantity(value)}
            parts.append(fill_template(entry.words(language).said, fields, language))
        return _COMMA[language].join(parts)

    def _asked(self) -> Iterator[tuple[Field, str, Any]]:
        """Yields what is asked: field, of which foot or joint (or empty), and value."""
        inside = self.com == "inside" or (self.offset is not None and self.com_margin != 0.0)
        for name, value in self.values().items():
            field = FIELDS[name]
            if not field.en.said or isinstance(value, str):
                continue
            if field.per:
                yield from ((field, of, one) for of, one in value.items())
            elif name == "com_margin":  # of a com that is where it is asked to be, it is a check
                if inside:
                    yield field, "", value
            elif field.always_said or value != field.default_value:
                yield field, "", value


_OWN = tuple(field for field in FIELDS.values() if field.part == "task")

_DEFAULTS = {one.name: one.default for one in fields(StandTask)}

_COMMA = {"en": ", ", "zh": "，"}  # noqa: RUF001
