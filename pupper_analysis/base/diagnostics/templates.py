"""What diagnostics carry, numbers with units and words; and the templates that are filled with it.

In a template may stand

- ``{mass}``, ``{mass:.3g}``: a value, as by ``format_number``; a ``Quantity`` comes with its
  unit, an angle with deg; ``{gap:mm:.1f}`` shows it in another one (mm, deg, g, ms, %),
  ``{at:read:.3g}`` in deg of rad, mm of m, ``{at:stated}`` in the SI unit that files have;
  ``{gap::.1f}`` has the number alone;
- ``{name!r}``: a text in quotes;
- ``{names}``: several, with commas between them, at most eight; ``{names:3}`` at most three. What
  is left out is counted: "a, b, c and 2 more". ``{parts:;}`` has semicolons, ``{ways:or}`` " or ",
  ``{both:and}`` " and "; ``{masses:3|.2f}`` gives the format of each;
- ``{subject}``: "joint FL_knee", ``{subject!r}``: "joint 'FL_knee'"; ``{name}``: its name alone;
- ``{count|foot|feet}``: a word that depends on a number: the first for 1;
- ``[limit? beyond {limit}]``: words that stand only where a value is (not None, empty or false);
  ``[!limit? ...]`` where it is not. They are not nested.

Words in values (``Term``, another ``Diagnostic``) are said in the same language.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from string import Formatter
from typing import Any

from pupper_analysis.base.diagnostics.catalogue import term
from pupper_analysis.base.units import READ_IN

_SHOWN_IN = {
    **{(of, shown): factor for si, (factor, shown) in READ_IN.items() for of in (si, "rad or m")},
    ("m/s", "mm/s"): 1e3,
    ("rad", "degrees"): math.degrees(1.0),
    ("rad", "°"): math.degrees(1.0),
    ("kg", "g"): 1e3,
    ("s", "ms"): 1e3,
    ("m^3", "L"): 1e3,
    ("m^3", "litres"): 1e3,
    ("1", "%"): 1e2,
}
"""{(SI unit, unit that is shown): factor}."""


def format_number(value: float, spec: str) -> str:
    """Formats a number as people write it: by a ``g`` without an exponent, from 1e-6 to 1e9.

    A ``%`` after the ``g`` shows hundredths: 0.039 by ``".2g%"`` is ``"3.9 %"``.
    """
    if spec.endswith("g%"):
        return f"{format_number(100 * value, spec[:-1])} %"
    written = format(value, spec)
    if "e" in written and not spec.endswith("e") and 1e-6 <= abs(value) < 1e9:
        return format(Decimal(written), "+f" if written.startswith("+") else "f")
    return written


@dataclass(frozen=True)
class Quantity:
    """A number with its unit.

    Attributes:
        value: In SI units.
        unit: ``"kg"``, ``"N m"``, ``"rad"`` ...; ``"1"`` for a ratio.
    """

    value: float
    unit: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", float(self.value))

    def __format__(self, spec: str) -> str:
        """Returns digits and unit: by ``"mm:.1f"`` in mm, by ``".3g"`` in the unit it has.

        By ``":.3g"`` the digits alone, where the unit is said once for several.
        """
        shown, colon, digits = spec.rpartition(":")
        alone = bool(colon and not shown)
        if not colon and (self.unit, digits) in _SHOWN_IN:
            shown, digits = digits, ""
        elif shown == "read":
            shown = READ_IN.get(self.unit, (1.0, self.unit))[1]
        elif not shown:  # so that "g" are grams of a mass, and Python's format of all else
            shown = "deg" if self.unit == "rad" else self.unit
        elif shown == "stated":
            shown = self.unit
        factor = 1.0 if shown == self.unit else _SHOWN_IN[self.unit, shown]
        number = format_number(factor * self.value, digits or ".4g")
        return number if alone else _with_unit(number, shown)

    def __str__(self) -> str:
        return format(self, "")


@dataclass(frozen=True)
class Vector:
    """Several numbers with one unit.

    Attributes:
        values: In SI units.
        unit: Of each; ``"1"`` where they have none.
    """

    values: tuple[float, ...]
    unit: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(float(value) for value in self.values))

    @staticmethod
    def rounded(values: Iterable[float], unit: str = "1") -> Vector:
        """Returns a vector of numbers rounded to 1e-9: what is beyond says nothing to a reader."""
        return Vector(tuple(round(float(value), 9) for value in values), unit)

    def __format__(self, spec: str) -> str:
        """Returns the numbers in brackets, by default with 6 digits, and the unit.

        By ``":.3g"`` the numbers alone, by ``"mm:.1f"`` in mm.
        """
        shown, colon, digits = spec.rpartition(":")
        factor = _SHOWN_IN[self.unit, shown] if shown else 1.0
        numbers = ", ".join(
            format_number(factor * value + 0.0, digits or ".6g") for value in self.values
        )
        return (
            f"({numbers})"
            if colon and not shown
            else _with_unit(f"({numbers})", shown or self.unit)
        )

    def __str__(self) -> str:
        return format(self, "")


def _with_unit(number: str, unit: str) -> str:
    """Returns digits and their unit; a degree's sign is set close."""
    return number if unit == "1" else f"{number}{unit}" if unit == "°" else f"{number} {unit}"


class Term(str):
    """A word of the catalogue's terms, such as ``joint``, said in the reader's language."""

    __slots__ = ()


class Phrase(str):
    """Words that are made elsewhere, as a stand's task says what it asks for: in both languages.

    It is its English; ``chinese`` is the same in Simplified Chinese.
    """

    __slots__ = ("chinese",)

    chinese: str

    def __new__(cls, english: str, chinese: str) -> Phrase:
        """Returns the phrase."""
        phrase = super().__new__(cls, english)
        phrase.chinese = chinese
        return phrase

    def __reduce__(self) -> tuple[type[Phrase], tuple[str, str]]:
        """Tells what it is made of, when it is copied or pickled."""
        return Phrase, (str(self), self.chinese)

    def text(self, language: str = "en") -> str:
        """Returns its words in ``"en"`` or ``"zh"``."""
        return self.chinese if language == "zh" else str(self)


UNLIMITED = Term("unlimited")


def describe_bound(value: float, unit: str) -> Quantity | Term:
    """Returns a limit with its unit, or that there is none."""
    return Quantity(value, unit) if math.isfinite(value) else UNLIMITED


def to_unicode(text: str) -> str:
    """Returns a text as Unicode has it: other bytes of a file's name become hexadecimal."""
    return text.encode("utf-8", "backslashreplace").decode()


_OPTIONAL = re.compile(r"\[(!?)(\w+)\?((?:[^\[\]])*)\]")
_LIST = re.compile(r"(,or|or|and|,|;|)(\d*)(?:\|(.*))?$")

_MOST_NAMES = 8
"""Names in a list: a page of names hides what is said of them."""

_BETWEEN = {
    "en": {",": ", ", ";": "; ", "or": " or ", ",or": ", or ", "and": " and "},
    "zh": {",": "、", ";": "；", "or": "或", ",or": "，或 ", "and": "和"},  # noqa: RUF001
}
_MORE = {"en": "{listed} and {left} more", "zh": "{listed}，另有 {left} 个"}  # noqa: RUF001


def fill_template(template: str, values: Mapping[str, Any], language: str) -> str:
    """Returns a template with its values.

    Args:
        template: The template.
        values: {name: value}.
        language: ``"en"`` or ``"zh"``.

    Raises:
        KeyError: If a value is missing.
    """
    whole = _OPTIONAL.sub(
        lambda part: part[3] if bool(values.get(part[2])) != bool(part[1]) else "", template
    )
    return _Filler(language).vformat(whole, (), values)


class _Filler(Formatter):
    """Python's formatter, with lists, words that depend on numbers, and a language."""

    def __init__(self, language: str) -> None:
        self.language = language

    def get_field(self, field_name: str, _args: Any, kwargs: Any) -> tuple[Any, str]:
        name, *forms = field_name.split("|")
        value = kwargs[name]
        if forms:
            one, many = forms
            count = value if isinstance(value, int | float) else len(value)
            return (one if count == 1 else many), name
        return value, name

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        if conversion == "r" and isinstance(value, tuple):
            return tuple(repr(one) for one in value)
        if conversion == "r" and hasattr(value, "kind"):
            return f"{term(value.kind, self.language)} {value.name!r}"
        return super().convert_field(value, conversion)

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, tuple):
            return self._listed(value, format_spec)
        if isinstance(value, Term):
            return term(str(value), self.language)
        if hasattr(value, "text"):  # another diagnostic, or a phrase
            return str(value.text(self.language))
        if hasattr(value, "kind"):  # a subject
            return f"{term(value.kind, self.language)} {value.name}"
        write = format_number if isinstance(value, float) else format
        return write(value, format_spec)

    def _listed(self, values: tuple[Any, ...], spec: str) -> str:
        found = _LIST.match(spec)
        if found is None:
            raise ValueError(f"{spec!r} is no format of a list")
        mark, most, each = found[1] or ",", int(found[2] or _MOST_NAMES), found[3] or ""
        shown = values if len(values) <= most + 1 else values[:most]  # "and 1 more" saves nothing
        listed = _BETWEEN[self.language][mark].join(self.format_field(one, each) for one in shown)
        left = len(values) - len(shown)
        return _MORE[self.language].format(listed=listed, left=left) if left else listed
