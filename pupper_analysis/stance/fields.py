"""Table of the fields (requirements) of a stand task: a `Field` per entry of ``fields.toml``.

Several parts of the package depend on this table: the checks and texts of `StandTask`, command-line
options, sliders and exports of the live page, and variables of a study. The module imports no
engine, so that ``--help`` is fast.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import numpy as np

from pupper_analysis.base.arguments import check_finite, check_length, suggest_degrees
from pupper_analysis.base.diagnostics import Quantity, Vector, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.units import Position

UNIT_BY_KIND = {
    **dict.fromkeys(("length", "point", "point3", "place"), "m"),
    "angle": "rad",
    "position": "rad or m",
    "mass": "kg",
    "ratio": "1",
    "stiffness": "N m/rad",
    "damping": "N m s/rad",
    "contact": "m",
}
"""{kind of a field: SI unit of its numbers}. The angle of a contact with a slope is in rad."""

_AXES_BY_KIND = {"point": "xy", "point3": "xyz"}
"""{kind of a field: axes of the point}; other kinds, such as ``place``, are not included."""


@dataclass(frozen=True)
class Slider:
    """Slider of the live page (browser page that updates results): range, step and initial value.

    Attributes:
        folder: Heading of the group that contains the slider.
        low: Lower end of the range, in deg for angles, stand heights for lengths, and robot masses
            for a mass; lengths and masses are rounded on the page. The ranges of gains and joint
            positions are derived from the model instead.
        high: Upper end of the range, in the unit of ``low``.
        step: Step of the slider of an angle [deg]. None: 0.1. Other steps are derived from ranges.
        start: Initial value of a length on a new page [m], or value that replaces missing gains of
            the model (SI units). None: the nominal value, or 1 for a gain.
    """

    folder: str
    low: float = 0.0
    high: float = 0.0
    step: float | None = None
    start: float | None = None


@dataclass(frozen=True)
class Words:
    """Texts of a field in a single language.

    Attributes:
        label: Name on a slider, without unit.
        hint: Explanation; ``{axis}`` is replaced by the axis of a point's component.
        said: Template for the text of a task. It may contain ``{value}``, ``{of}`` (a foot, joint
            or link) and the values of other fields. Empty if the text does not contain the field.
    """

    label: str
    hint: str = ""
    said: str = ""


@dataclass(frozen=True)
class Field:
    """Field of a stand task: type, bounds, default, texts and command-line option of a requirement.

    Attributes:
        name: Name of the attribute.
        kind: ``"length"``, ``"angle"``, ``"position"`` (of a joint: an angle, or the length of a
            slide), ``"point"`` (x, y), ``"point3"``, ``"place"`` (a point, or a word in
            ``choices``), ``"mass"``, ``"ratio"``, ``"stiffness"``, ``"damping"`` or ``"contact"``
            (contact surface and position).
        en: English texts.
        zh: Texts in Simplified Chinese.
        part: Owner of the attribute: the ``"task"``, or the ``"ground"`` of the task.
        frame: Whether the point may be given in another frame than the base's, as (frame, x, y, z).
        per: Kind of the keys, if the field is a mapping: ``"foot"``, ``"joint"`` or ``"link"``.
            Empty if the field is a single value.
        optional: Whether the default is None. Otherwise the default is 0 or an empty mapping.
        nominal: Value of the nominal stand: ``"zero"``, an attribute of the robot, the ``"centre"``
            of the stance feet, ``"foot_places"``, or the robot's ``"own"``.
        low: Lower bound of the value (SI units).
        high: Upper bound of the value (SI units).
        open: Whether ``low`` itself is invalid.
        choices: Words that are valid values as well.
        constraint: Name of the constraint that the field defines.
        relaxation: Direction in which the value may be relaxed for the message about an unreachable
            stance: ``"either"``, ``"less"`` (towards 0) or ``"no"``.
        always_said: Whether a task text contains the field if the value is the default.
        option: Command-line option without dashes; there is no option if ``help`` is empty.
        help: Text in ``--help``.
        example: Value in command-line syntax, for ``--help``.
        address: Key in the address of the live page.
        slider: Slider of the live page; None if there is none.
    """

    name: str
    kind: str
    en: Words
    zh: Words
    part: str = "task"
    frame: bool = False
    per: str = ""
    optional: bool = False
    nominal: str = "zero"
    low: float = -math.inf
    high: float = math.inf
    open: bool = False
    choices: tuple[str, ...] = ()
    constraint: str = ""
    relaxation: str = "either"
    always_said: bool = False
    option: str = ""
    help: str = ""
    example: str = ""
    address: str = ""
    slider: Slider | None = None

    @property
    def unit(self) -> str:
        """SI unit of the numbers of this field."""
        return UNIT_BY_KIND[self.kind]

    @property
    def axes(self) -> str:
        """Axes of this field's point, ``"xy"`` or ``"xyz"``; empty for other kinds and "place"."""
        return _AXES_BY_KIND.get(self.kind, "")

    @property
    def attribute(self) -> str:
        """Attribute of `StandTask` that stores the value of this field, such as ``"ground"``."""
        return self.name if self.part == "task" else self.part

    @property
    def default_value(self) -> Any:
        """Value of this field in a default task (an empty mapping, None or 0)."""
        if self.per:
            return FrozenDict()
        return None if self.optional else 0.0

    def words(self, language: str) -> Words:
        """Return the texts of this field; in Chinese for ``"zh"``, else in English."""
        return self.zh if language == "zh" else self.en

    def check_value(self, value: Any) -> Any:
        """Check a value of this field, and convert it to the type of the attribute.

        Points become tuples, mappings frozen mappings, contacts ``Contact`` or ``Weld``, and joint
        positions `Position`. Values of the kind "point3" are not supported.

        Raises:
            ConfigurationError: If the value is invalid. The field of the error is, for example,
                ``swing[FL]``.
        """
        if value is None and self.optional:
            return None
        if self.per:
            return FrozenDict(
                {
                    of: self._check_single_value(f"{self.name}[{of}]", item)
                    for of, item in value.items()
                }
            )
        return self._check_single_value(self.name, value)

    def _check_single_value(self, name: str, value: Any) -> Any:
        """Check and convert a single value of this field (for a mapping: the value of one key)."""
        if self.choices and isinstance(value, str):
            if value not in self.choices:
                message = diagnose("neither-word-nor-point", given=value, known=self.choices)
                raise ConfigurationError(name, message)
            return value
        if self.kind == "contact":
            from pupper_analysis.robot.plane import contact_of  # no engine, but NumPy

            try:
                return contact_of(value)
            except ConfigurationError as error:
                where = f"{name}.{error.field}".removesuffix(".contact")
                raise ConfigurationError(where, error.problem) from None
        if self.axes or self.choices:
            if not isinstance(value, tuple | list | np.ndarray) or len(value) != 2:
                raise ConfigurationError(name, diagnose("no-place", given=repr(value)))
            return check_length(name, value[0]), check_length(name, value[1])
        number = check_length(name, value) if self.kind == "length" else check_finite(name, value)
        self.check_range(name, number)
        if self.kind == "position":
            return Position(number, getattr(value, "unit", self.unit))
        return number

    def check_range(self, name: str, number: float, unit: str = "", factor: float = 1.0) -> None:
        """Raise an error if a number is outside of the range of this field.

        Args:
            name: Name of the field in the error.
            number: Number in ``unit``.
            unit: Unit that the error prints. Default: the SI unit.
            factor: Factor from the SI unit to ``unit``.

        Raises:
            ConfigurationError: If the number is out of range.
        """
        low, high = factor * self.low, factor * self.high
        if low < number <= high or (number == low and not self.open):
            return
        given = Quantity(number, unit or self.unit)
        if number <= low and self.kind == "length" and self.open:
            message = diagnose("height-not-above-ground", height=given)
        elif number <= low and self.open:
            message = diagnose("not-above", value=given, bound=Quantity(low, given.unit))
        elif given.unit == "rad":
            message = diagnose(
                "angle-out-of-range",
                angle=given,
                low=Quantity(low, "rad"),
                high=Quantity(high, "rad"),
                written=suggest_degrees(number, low, high),
            )
        elif number < low:
            message = diagnose("below-the-least", value=given, bound=Quantity(low, given.unit))
        else:
            message = diagnose("above-the-most", value=given, bound=Quantity(high, given.unit))
        raise ConfigurationError(name, message)

    def quantity(self, value: Any) -> Any:
        """Return a value of this field as a `Quantity` or `Vector` with unit, for a message.

        Values of the kind "contact" are returned unchanged.
        """
        if self.kind == "contact":
            return value
        if isinstance(value, tuple):
            return Vector(value, self.unit)
        return Quantity(value, getattr(value, "unit", self.unit))


def read_field_table(package: str, file: str) -> Mapping[str, Field]:
    """Read {name: field} from a TOML file with field definitions in a package, in file order."""
    stated = tomllib.loads(files(package).joinpath(file).read_text(encoding="utf-8"))
    return MappingProxyType({name: _make_field(name, facts) for name, facts in stated.items()})


def _make_field(name: str, facts: dict[str, Any]) -> Field:
    """Create a field from an entry of the TOML table, in which bounds of angles are in deg."""
    scale = math.radians(1.0) if facts["kind"] == "angle" else 1.0
    bounds: dict[str, Any] = {
        key: scale * facts.pop(key) for key in ("low", "high") if key in facts
    }
    slider = facts.pop("slider", None)
    stated = {"option": name.replace("_", "-"), "address": name, **facts, **bounds}
    stated |= {language: Words(**facts[language]) for language in ("en", "zh")}
    stated["choices"] = tuple(facts.get("choices", ()))
    return Field(name, slider=None if slider is None else Slider(**slider), **stated)


FIELDS = read_field_table("pupper_analysis.stance", "fields.toml")
"""{name: field} of all requirements of a stand task, without the initial guess ``ik_seed``."""

ROBOT_FIELDS = read_field_table("pupper_analysis.stance", "robot_fields.toml")
"""{name: field} of the properties of a robot that a command can change: payload, servo gains,
friction."""
