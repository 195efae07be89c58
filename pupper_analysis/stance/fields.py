"""The table of what can be asked of a stand: one entry a wish, with its facts and its words.

``StandTask``'s checks and words, the command line's options, the live page's sliders and exports,
and the numbers that a study varies are derived from it. It loads no engine, so that ``--help`` need
not wait for one.
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

from pupper_analysis.base.arguments import check_finite, check_length
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
"""{kind of a field: unit of its numbers}."""

_AXES = {"point": "xy", "point3": "xyz"}


@dataclass(frozen=True)
class Slider:
    """How far a slider goes; see ``live.sliders``.

    Attributes:
        folder: Under which heading it is.
        low: Where it begins: deg, or a part of the nominal stand's height for lengths.
        high: Where it ends, likewise.
        step: From notch to notch; what suits its length by default.
        start: Where it is on a page just opened (SI units); the nominal value by default.
    """

    folder: str
    low: float = 0.0
    high: float = 0.0
    step: float | None = None
    start: float | None = None


@dataclass(frozen=True)
class Words:
    """What a field is called in one language.

    Attributes:
        label: Its name on a slider, without a unit.
        hint: What it is about; ``{axis}`` is where a number of a point goes.
        said: The template of a task's text, with ``{value}``, ``{of}`` (a foot or joint) and
            all other fields.
    """

    label: str
    hint: str = ""
    said: str = ""


@dataclass(frozen=True)
class Field:
    """One wish.

    Attributes:
        name: Of the attribute that has it.
        kind: ``"length"``, ``"angle"``, ``"position"`` (of a joint: an angle, or a length of one
            that slides), ``"point"`` (x, y), ``"point3"``, ``"place"`` (a point, or one of
            ``choices``), ``"mass"``, ``"ratio"``, ``"stiffness"``, ``"damping"``, ``"contact"``
            (what is touched, and where).
        en: Its words in English.
        zh: Those in Simplified Chinese.
        part: Whose attribute it is: the ``"task"``'s, or its ``"ground"``'s.
        frame: Whether its point may be in another frame than the base's: (frame, x, y, z).
        per: Of what it is a mapping to such values: ``"foot"``, ``"joint"``, ``"link"``; empty if
            it is none.
        optional: Whether nothing may be asked, by None; else it is 0.
        nominal: What the nominal stand has: ``"zero"``, an attribute of the robot, the ``"centre"``
            of the feet that carry, ``"foot_places"``, or what is the robot's ``"own"``.
        low: The least that makes sense (SI units).
        high: The greatest.
        open: Whether ``low`` itself makes no sense.
        choices: Words that are values, too.
        constraint: What it sets of the problem that a stand solves.
        gives: Which way it gives where a stance is out of reach: ``"either"``, ``"less"`` (towards
            0) or ``"no"``.
        always_said: Whether a task's text has it where it is 0, too.
        option: Of the command line, without its dashes; there is none without ``help``.
        help: What ``--help`` says of it.
        example: A value as one types it, which ``--help`` shows.
        address: What the page's address calls it.
        slider: How far the page's goes; None if it has none.
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
    gives: str = "either"
    always_said: bool = False
    option: str = ""
    help: str = ""
    example: str = ""
    address: str = ""
    slider: Slider | None = None

    @property
    def unit(self) -> str:
        """Of its numbers, in SI units."""
        return UNIT_BY_KIND[self.kind]

    @property
    def axes(self) -> str:
        """The axes of a point; empty for a number."""
        return _AXES.get(self.kind, "")

    @property
    def attribute(self) -> str:
        """The attribute of the task in which it is: its own, or the ``ground``."""
        return self.name if self.part == "task" else self.part

    @property
    def default_value(self) -> Any:
        """Its value where nothing is asked."""
        if self.per:
            return FrozenDict()
        return None if self.optional else 0.0

    def words(self, language: str) -> Words:
        """Returns what it is called in a language, ``"en"`` or ``"zh"``."""
        return self.zh if language == "zh" else self.en

    def check_value(self, value: Any) -> Any:
        """Returns a value as a task has it: numbers in range, points as tuples, frozen mappings.

        Raises:
            ConfigurationError: If it is none; of a foot's the field is ``swing[FL]``.
        """
        if value is None and self.optional:
            return None
        if self.per:
            return FrozenDict(
                {
                    of: self._check_single_value(f"{self.name}[{of}]", one)
                    for of, one in value.items()
                }
            )
        return self._check_single_value(self.name, value)

    def _check_single_value(self, name: str, value: Any) -> Any:
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
        """Refuses a number that is out of range.

        Args:
            name: What the error calls it.
            number: In ``unit``.
            unit: Whoever reads the error is shown this one; the SI unit by default.
            factor: Of this unit's numbers, over SI ones.

        Raises:
            ConfigurationError: If it is.
        """
        low, high = factor * self.low, factor * self.high
        if low < number <= high or (number == low and not self.open):
            return
        given = Quantity(number, unit or self.unit)
        if number <= low and self.kind == "length" and self.open:
            message = diagnose("height-not-above-ground", height=given)
        elif number <= low and self.open:
            message = diagnose("not-above", value=given, bound=Quantity(low, given.unit))
        elif number < low:
            message = diagnose("below-the-least", value=given, bound=Quantity(low, given.unit))
        else:
            degrees = number if given.unit == "rad" and number <= math.degrees(high) else None
            bound = Quantity(high, given.unit)
            message = diagnose("above-the-most", value=given, bound=bound, degrees=degrees)
        raise ConfigurationError(name, message)

    def quantity(self, value: Any) -> Any:
        """Returns a value with its unit; a contact says its own."""
        if self.kind == "contact":
            return value
        if isinstance(value, tuple):
            return Vector(value, self.unit)
        return Quantity(value, getattr(value, "unit", self.unit))


def read_table(package: str, file: str) -> Mapping[str, Field]:
    """Returns {name: field} of a TOML file of a package, in its order."""
    stated = tomllib.loads(files(package).joinpath(file).read_text(encoding="utf-8"))
    return MappingProxyType({name: _field(name, facts) for name, facts in stated.items()})


def _field(name: str, facts: dict[str, Any]) -> Field:
    """Returns an entry's field; its angles are in degrees."""
    scale = math.radians(1.0) if facts["kind"] == "angle" else 1.0
    bounds: dict[str, Any] = {
        key: scale * facts.pop(key) for key in ("low", "high") if key in facts
    }
    slider = facts.pop("slider", None)
    stated = {"option": name.replace("_", "-"), "address": name, **facts, **bounds}
    stated |= {language: Words(**facts[language]) for language in ("en", "zh")}
    stated["choices"] = tuple(facts.get("choices", ()))
    return Field(name, slider=None if slider is None else Slider(**slider), **stated)


FIELDS = read_table("pupper_analysis.stance", "fields.toml")
"""{name: field} of all that can be asked of a stand."""

ROBOT_FIELDS = read_table("pupper_analysis.stance", "robot_fields.toml")
"""{name: field} of what can be asked of the robot that shall stand: its load, its servos."""
