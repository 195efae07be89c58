"""Stand task: the requirements on ground, feet, base and centre of mass (CoM) of a stand.

`StandTask` contains the requirements, as attributes in m and rad, and checks them. The table
``stance/fields.toml`` defines names, bounds and texts. `stance.problem.compute_targets` converts a
task to numbers for one robot, and `describe` to a text in English or Chinese.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import pinocchio as pin

from pupper_analysis.base.arguments import check_finite, check_length, check_type
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Phrase, diagnose
from pupper_analysis.base.diagnostics.templates import fill_template
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.plane import Contact, Weld
from pupper_analysis.stance.fields import FIELDS, Field

Point = tuple[float, float]
"""Horizontal coordinates (x, y) [m]."""


@dataclass(frozen=True)
class StandTask:
    """Requirements of a stand: positions of feet and base, CoM, contacts, margins and clearances.

    The default is the nominal stand. All feet are on level ground at z = 0. Each foot is at its
    horizontal position for the robot's nominal joint positions, with the base at the origin. The
    CoM is above the centre of the feet, which is the mean of the stance contacts, if the legs can
    move it there (see ``com``).

    Attributes:
        height: Height of the base frame above the centre of the feet (m), positive without
            ``contacts``. Default: the robot's ``base_height``.
        roll: Rotation about x, forward (rad). The orientation of the base is Rz(yaw) Ry(pitch)
            Rx(roll).
        pitch: Rotation about y, left (rad); positive tilts the front down.
        yaw: Rotation about z, up (rad), relative to the feet.
        offset: (x, y) of the base from the centre of the feet, in world axes (m). If an offset is
            given, the position of the CoM is a result. It must keep ``com_margin`` only if this
            margin is positive.
        feet: {foot: (x, y) in the world (m)}, instead of the nominal position.
        foot_offsets: {foot: (x, y) from the nominal position (m)}.
        swing: {foot without load: height of the sphere above the ground (m)}.
        ground: Plane and steps.
        contacts: {foot, link, site, body or geom: surface in contact instead of the ground
            (``Contact``), or fixation in the world (``Weld``)}. The ``base`` can be welded as well.
            If other feet remain, hands and feet on planes steeper than 60 deg do not count for the
            centre of the feet, and feet on separate planes do not count for its height.
        com: ``"centre"``, a point (x, y) in the world (m), or ``"inside"``: any place in the
            support polygon with ``com_margin``, above the centre if possible. Default: centre, or
            inside if the legs cannot move the CoM in two directions.
        com_margin: Smallest distance of the projected CoM from the edge of the polygon (m).
        joint_margin: Smallest distance of each joint from the limits (rad, m).
        ground_clearance: Smallest height of parts except the feet above the ground (m).
        self_clearance: Smallest distance between links that are not neighbours (m); unchecked by
            default.
        posture: {joint that carries no foot, or a pattern such as ``*elbow*``: position (rad, m)}.
            If several patterns match a joint, the last counts.
        ik_seed: Initial guess of the joint positions, shape (nu,) (rad, m), which selects an IK
            branch of the legs. Default: the robot's ``home``.
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
        for entry in _TASK_FIELDS:
            value = getattr(self, entry.name)
            if value is _DEFAULTS[entry.name] or (type(value) is FrozenDict and not value):
                continue  # defaults need no check
            if entry.name == "height" and self.contacts:  # on a table the height may be negative
                object.__setattr__(self, "height", check_length("height", value))
                continue
            if entry.per:
                check_type(entry.name, value, Mapping[str, Any])
            object.__setattr__(self, entry.name, entry.check_value(value))
        if type(self.ground) is not Ground:
            check_type("ground", self.ground, Ground)
        if self.ground.planes:  # from `StandTargets`: planes are added again for each robot
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
            if name in self.swing:
                _check_lifted_contact(name, contact)
            on_step = contact.has_angle and contact.place is None
            if name in self.ground.heights and not on_step:
                problem = diagnose("two-grounds-of-a-foot", name=name)
                raise ConfigurationError("contacts", problem)
            if contact.place is not None and name in {**self.feet, **self.foot_offsets}:
                raise ConfigurationError("contacts", diagnose("contact-placed-twice", name=name))

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> StandTask:
        """Create a stand task from a mapping {field: value}, for example from JSON or TOML.

        Args:
            given: {field in ``stance/fields.toml``, or ``ik_seed``: value in m or rad}. The fields
                of the ground are in a mapping ``ground``, or at the same level as the other fields.

        Raises:
            ConfigurationError: If a field is unknown, or a value is invalid.
        """
        ground = given.get("ground", {})
        ground = vars(ground) if isinstance(ground, Ground) else ground
        check_type("ground", ground, Mapping[str, Any])
        values = {name: value for name, value in given.items() if name != "ground"} | dict(ground)
        values.pop("_planes", None)  # derived from the contacts
        seed = values.pop("ik_seed", None)
        if not FIELDS.keys() >= values.keys():
            raise ConfigurationError("stand", diagnose("stance-field-unknown", known=(*FIELDS,)))
        return cls(ik_seed=seed).with_values(values)

    def replace_unchecked(self, **values: Any) -> StandTask:
        """Return a copy of this task with other attributes, without checking the values.

        Checks would be a noticeable part of the solve time of a sequence of stands.

        Args:
            **values: {attribute: valid value}.
        """
        task = object.__new__(StandTask)
        vars(task).update(vars(self), **values)
        return task

    def values(self) -> dict[str, Any]:
        """Return the requirements of this task: {field in ``stance/fields.toml``: value [m, rad]}.

        Fields of the ground are included, ``ik_seed`` is not.
        """
        owners = {"task": self, "ground": self.ground}
        return {name: getattr(owners[field.part], name) for name, field in FIELDS.items()}

    def with_values(self, values: Mapping[str, Any], *, checked: bool = True) -> StandTask:
        """Return a copy of this task with other values of its requirements.

        Args:
            values: {name of the field in ``stance/fields.toml``: value}; other fields are kept.
            checked: If False, numbers and points may be unchecked, to save time: they must be known
                to be valid and have the types of this class.

        Raises:
            ConfigurationError: If a value is invalid, or contradicts another value.
        """
        grounds = {name: value for name, value in values.items() if FIELDS[name].part == "ground"}
        own: dict[str, Any] = {name: values[name] for name in values if name not in grounds}
        if grounds:
            own["ground"] = replace(self.ground, **grounds)
        converts = any(FIELDS[name].kind in _CONVERTED_KINDS for name in values)
        if checked or converts or self.ground.planes:
            return replace(self, **own)
        numbers = {name: FIELDS[name] for name in own if name in FIELDS}
        own |= {name: FrozenDict(own[name]) for name, field in numbers.items() if field.per}
        return self.replace_unchecked(**own)

    def rotation(self) -> Array:
        """Return the required rotation matrix from base axes to world axes, shape (3, 3)."""
        rotation: Array = pin.rpy.rpyToMatrix(self.roll, self.pitch, self.yaw)
        return rotation

    def base_quaternion(self) -> tuple[float, float, float, float]:
        """Return the required rotation of the base in the world, a unit quaternion (w, x, y, z)."""
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
        """Return the requirements with units, in English."""
        return self.describe("en")

    def phrase(self) -> Phrase:
        """Return a text of the task's requirements with units, in English and Chinese."""
        return Phrase(self.describe("en"), self.describe("zh"))

    def describe(self, language: str) -> str:
        """Return a text of the task's requirements with units, in ``"en"`` or ``"zh"``."""
        parts = []
        values = {
            name: FIELDS[name].quantity(value)
            for name, value in self.values().items()
            if isinstance(value, float | tuple)
        }
        for entry, of, value in self._list_requirements():
            beside = {
                name: FIELDS[name].quantity(values_of[of]) if of in values_of else None
                for name, values_of in self.values().items()
                if FIELDS[name].per and of
            }
            fields = {**values, **beside, "of": of, "value": entry.quantity(value)}
            parts.append(fill_template(entry.words(language).said, fields, language))
        return _SEPARATORS[language].join(parts)

    def _list_requirements(self) -> Iterator[tuple[Field, str, Any]]:
        """Yield (field, foot or joint or "", value [m, rad]) that the text of the task states."""
        inside = self.com == "inside" or (self.offset is not None and self.com_margin != 0.0)
        for name, value in self.values().items():
            field = FIELDS[name]
            if not field.en.said or isinstance(value, str):
                continue
            if field.per:
                yield from ((field, of, item) for of, item in value.items())
            elif name == "com_margin":  # for a required place the margin is a check only
                if inside:
                    yield field, "", value
            elif field.always_said or value != field.default_value:
                yield field, "", value


def _check_lifted_contact(foot: str, contact: Contact | Weld) -> None:
    """Raise an error if the contact of a lifted foot exerts a force (weld, grip or given force)."""
    if isinstance(contact, Weld):
        bearing = "weld"
    elif contact.grip is not None:
        bearing = "grip"
    elif contact.force is not None:
        bearing = "force"
    else:
        return
    raise ConfigurationError("swing", diagnose("lifted-foot-bears", foot=foot, bearing=bearing))


_CONVERTED_KINDS = ("contact", "position")
"""Kinds of fields whose values `Field.check_value` converts to `Contact`, `Weld` or `Position`."""

_TASK_FIELDS = tuple(field for field in FIELDS.values() if field.part == "task")
"""Fields of ``fields.toml`` that are attributes of `StandTask`. All other fields are attributes of
the ``ground`` of a task."""

_DEFAULTS = {attribute.name: attribute.default for attribute in fields(StandTask)}
"""{attribute of `StandTask`: default value, or ``dataclasses.MISSING``}. An attribute whose value
is the default object itself (``is``) is not checked."""

_SEPARATORS = {"en": ", ", "zh": "，"}  # noqa: RUF001
"""{language: separator of requirements in a text}."""
