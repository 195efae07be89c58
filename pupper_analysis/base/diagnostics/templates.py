"""Values of diagnostics (numbers with units, terms, phrases), and templates for the texts.

Syntax of a template:

- ``{mass}``, ``{mass:.3g}``: a value; a float is formatted by ``format_number``. A ``Quantity`` is
  formatted with its unit, and an angle in deg. ``{gap:mm:.1f}`` selects another unit
  (`_UNIT_FACTORS`). ``{at:read:.3g}`` selects deg for rad, and mm for m. ``{at:stated:.3g}``
  selects the SI unit. ``{gap::.1f}`` omits the unit; an angle is still in deg;
- ``{name!r}``: a text in quotes;
- ``{names}``: a tuple, separated by commas. At most eight items are shown, and ``{names:3}`` shows
  at most three. An item that alone would be omitted is also shown. Two or more omitted items are
  counted: "a, b, c and 2 more", or "a; b; 2 more failures" in a list of diagnostics. The separator
  is ";" in ``{parts:;}``, " or " in ``{ways:or}``, ", or " in ``{ways:,or}``, and " and " in
  ``{both:and}``. ``{masses:3|.2f}`` sets the format of each item;
- ``{subject}``: "joint FL_knee", ``{subject!r}``: "joint 'FL_knee'"; ``{name}``: the name alone;
- ``{count|foot|feet}``: the first word if the number (or the number of items) is 1, otherwise the
  second word;
- ``[limit? beyond {limit}]``: text that is included only if the value ``limit`` is true. A value is
  false if it is missing, None, empty, zero or False; a ``Quantity`` of zero is true. A text
  ``[!limit? ...]`` is included only if the value is false. These optional texts cannot be nested.

Two compared numbers of the same type and unit (`_COMPARED_NAMES`), such as ``{one:.6g}`` and
``{two:.6g}``, get more digits if they differ but would be printed alike (`format_pair`).

Values of type ``Term``, ``Phrase`` or ``Diagnostic`` are written in the language of the text.
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

_UNIT_FACTORS = {
    **{(of, shown): factor for si, (factor, shown) in READ_IN.items() for of in (si, "rad or m")},
    ("m/s", "mm/s"): 1e3,
    ("rad", "degrees"): math.degrees(1.0),
    ("rad", "°"): math.degrees(1.0),
    ("rad", "mrad"): 1e3,
    ("m/s", "mm/min"): 6e4,
    ("rad/s", "mrad/min"): 6e4,
    ("kg", "g"): 1e3,
    ("s", "ms"): 1e3,
    ("m^3", "L"): 1e3,
    ("m^3", "litres"): 1e3,
    ("1", "%"): 1e2,
}
"""{(SI unit, displayed unit): factor}. The displayed number is the factor times the number in the
SI unit."""


def format_number(value: float, spec: str) -> str:
    """Format a number by a Python format specification such as ``".3g"``, mostly without exponent.

    Absolute values from 1e-6 to below 1e9 get no exponent, except in the formats ``e``, ``E`` and
    ``G``. A negative number that is rounded to zero gets no minus sign. With ``%``, the number is
    shown in percent: 0.039 by ``".1%"`` or ``".2g%"`` is ``"3.9 %"``.
    """
    if spec.endswith("%"):
        number = spec[:-1] if spec.endswith("g%") else f"{spec[:-1]}f"
        return f"{_format_without_exponent(100 * value, number, 1e11)} %"
    return _format_without_exponent(value, spec, 1e9)


def _format_without_exponent(value: float, spec: str, bound: float) -> str:
    """Format a number, without exponent if its absolute value is from 1e-6 to below ``bound``."""
    written = format(value, spec)
    if written.startswith("-") and float(written) == 0.0:
        written = format(0.0, spec)
    if "e" in written and not spec.endswith("e") and 1e-6 <= abs(value) < bound:
        return format(Decimal(written), "+f" if written.startswith("+") else "f")
    return written


_MAX_DIGITS = 17
"""Number of significant digits with which any two different doubles have different texts."""

_DEFAULT_DIGITS = 6
"""Number of digits of a number format without precision, such as ``g`` (Python)."""

_PRECISION = re.compile(r"(?:\.(\d+)|^|(?<=:))([efg]%?)$")
"""Pattern of the end of a number format such as ``.3g``: an optional precision, and the type. A
unit such as ``kg`` does not match."""


def format_pair(
    first: float | Quantity | Vector, second: float | Quantity | Vector, spec: str
) -> tuple[str, str]:
    """Format two numbers that a message compares, with enough digits to show a difference.

    Args:
        first: Number.
        second: Number of the same type and unit.
        spec: Format specification of both numbers, with the smallest number of digits, such as
            ``.3g``.

    Returns:
        Texts of ``first`` and of ``second``, with units. Digits are added, up to 17, if different
        numbers would have the same text.
    """
    texts = _format_value(first, spec), _format_value(second, spec)
    if texts[0] != texts[1] or first == second:
        return texts
    prefix, digits, kind = _split_precision(first, spec)
    for count in range(digits + 1, _MAX_DIGITS + 1):
        longer = f"{prefix}.{count}{kind}"
        finer = _format_value(first, longer), _format_value(second, longer)
        if finer[0] != finer[1]:
            return finer
    return texts


def _format_value(value: float | Quantity | Vector, spec: str) -> str:
    """Format a number by a format specification, such as ``.3g``; append its unit, if any."""
    return format_number(value, spec) if isinstance(value, float | int) else format(value, spec)


def _split_precision(value: float | Quantity | Vector, spec: str) -> tuple[str, int, str]:
    """Split a number format into prefix, number of digits and type.

    For example, ``mm:.1f`` is split into ``mm:``, 1 and ``f``. If ``spec`` ends with no number
    format, the default format is used.
    """
    match = _PRECISION.search(spec)
    if match is not None:
        return spec[: match.start()], int(match[1] or _DEFAULT_DIGITS), match[2]
    if isinstance(value, Quantity | Vector):
        prefix = f"{spec}:" if spec and not spec.endswith(":") else spec
        return prefix, 6 if isinstance(value, Vector) else 4, "g"
    return "", _MAX_DIGITS, "g"


@dataclass(frozen=True)
class Quantity:
    """Number with a unit, as value of a diagnostic.

    Attributes:
        value: Number in SI units.
        unit: ``"kg"``, ``"N m"``, ``"rad"`` ...; ``"1"`` for a ratio.
    """

    value: float
    unit: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", float(self.value))

    def __format__(self, spec: str) -> str:
        """Return number and unit in a format such as ``"mm:.1f"`` or ``".3g"``.

        - ``"mm:.1f"`` converts to mm.
        - ``".3g"`` uses deg for angles, and the SI unit otherwise.
        - ``":.3g"`` omits the unit of ``".3g"``; an angle is still in deg.
        - ``"read:.3g"`` uses deg for rad, and mm for m; ``"stated:.3g"`` uses the SI unit.

        Without a number format, the format is ``.4g``.

        Raises:
            KeyError: If the unit cannot be converted to the requested unit.
        """
        shown, colon, digits = spec.rpartition(":")
        omit_unit = bool(colon and not shown)
        if not colon and (self.unit, digits) in _UNIT_FACTORS:
            shown, digits = digits, ""
        elif shown == "read":
            shown = READ_IN.get(self.unit, (1.0, self.unit))[1]
        elif not shown:  # no unit: for example "g" with a unit other than kg is a number format
            shown = "deg" if self.unit == "rad" else self.unit
        elif shown == "stated":
            shown = self.unit
        factor = 1.0 if shown == self.unit else _UNIT_FACTORS[self.unit, shown]
        number = format_number(factor * self.value, digits or ".4g")
        return number if omit_unit else _with_unit(number, shown)

    def __str__(self) -> str:
        return format(self, "")


@dataclass(frozen=True)
class Vector:
    """Several numbers with a common unit, as value of a diagnostic.

    Attributes:
        values: Numbers in SI units.
        unit: Common unit; ``"1"`` without unit.
    """

    values: tuple[float, ...]
    unit: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(float(value) for value in self.values))

    @staticmethod
    def rounded(values: Iterable[float], unit: str = "1") -> Vector:
        """Create a vector of numbers rounded to 9 decimals, to display no rounding errors.

        Args:
            values: Numbers in the SI unit ``unit``.
            unit: SI unit; ``"1"`` for dimensionless numbers.
        """
        return Vector(tuple(round(float(value), 9) for value in values), unit)

    def __format__(self, spec: str) -> str:
        """Return the numbers in parentheses, by default with 6 digits, and the unit.

        ``":.3g"`` omits the unit; ``"mm:.1f"`` converts to mm.
        """
        shown, colon, digits = spec.rpartition(":")
        factor = _UNIT_FACTORS[self.unit, shown] if shown else 1.0
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
    """Return a number and the unit, without a space before a degree sign; no unit for "1"."""
    return number if unit == "1" else f"{number}{unit}" if unit == "°" else f"{number} {unit}"


class Term(str):
    """Key of a term in the catalogue, such as ``joint``, as value of a diagnostic.

    A text contains the word for this term, in the language of the text.
    """

    __slots__ = ()


class Phrase(str):
    """Text in both languages that other code has composed, for example the description of a task.

    The string value is the English text.

    Attributes:
        chinese: Text in Simplified Chinese.
    """

    __slots__ = ("chinese",)

    chinese: str

    def __new__(cls, english: str, chinese: str) -> Phrase:
        """Create a phrase from both texts."""
        phrase = super().__new__(cls, english)
        phrase.chinese = chinese
        return phrase

    def __reduce__(self) -> tuple[type[Phrase], tuple[str, str]]:
        """Return the constructor and the arguments, for copying and pickling."""
        return Phrase, (str(self), self.chinese)

    def text(self, language: str = "en") -> str:
        """Return this text in a language.

        Args:
            language: ``"en"`` or ``"zh"``.
        """
        return self.chinese if language == "zh" else str(self)


UNLIMITED = Term("unlimited")
"""Term that messages contain instead of an infinite limit."""


NOT_STATED = Term("not stated")
"""Term that messages contain instead of a torque limit that no file states."""


def describe_effort(value: float, unit: str) -> Quantity | Term:
    """Return a torque or force limit for a message: a quantity, or "not stated" if not finite."""
    return Quantity(value, unit) if math.isfinite(value) else NOT_STATED


def describe_bound(value: float, unit: str) -> Quantity | Term:
    """Return a limit for a message: a quantity, or the term "unlimited" if not finite."""
    return Quantity(value, unit) if math.isfinite(value) else UNLIMITED


def to_unicode(text: str) -> str:
    """Return a text that can be encoded as UTF-8; escape sequences replace undecodable bytes."""
    return text.encode("utf-8", "backslashreplace").decode()


OPTIONAL_TEXT = re.compile(r"\[(!?)(\w+)\?((?:[^\[\]])*)\]")
"""Pattern of an optional text in a template. ``[name? text]`` is included if the value of ``name``
is true in Python, ``[!name? text]`` if the value is false or missing.
"""

_LIST_FORMAT = re.compile(r"(,or|or|and|,|;|)(\d*)(?:\|(.*))?$")
"""Pattern of the format of a tuple: separator, maximum number of items, and ``|`` with the format
of each item; each part may be missing.
"""

_MAX_LISTED_ITEMS = 8
"""Default of the largest number of items in a list; a single further item is also shown. Chosen,
not tuned.
"""

_SEPARATORS = {
    "en": {",": ", ", ";": "; ", "or": " or ", ",or": ", or ", "and": " and "},
    "zh": {",": "、", ";": "；", "or": "或", ",or": "，或 ", "and": "和"},  # noqa: RUF001
}
"""{language: {separator in a list format: its text}}."""

_OMITTED_ITEMS = {"en": "{listed} and {left} more", "zh": "{listed}，另有 {left} 个"}  # noqa: RUF001
"""{language: template of a shortened list of names}: ``listed`` is the text of the listed items,
``left`` the number of omitted items."""

_OMITTED_FINDINGS = {"en": "{listed}; {left} more {noun}", "zh": "{listed}；另有 {left} 处{noun}"}  # noqa: RUF001
"""{language: template of a shortened list of diagnostics}, for items that are sentences. ``noun``
names the omitted items (`_name_omitted_findings`)."""


def fill_template(template: str, values: Mapping[str, Any], language: str) -> str:
    """Replace the placeholders of a template by values, and return the text.

    Args:
        template: Text with placeholders such as ``{mass:.3g}``, and optional texts such as
            ``[limit? beyond {limit}]``. The docstring of the module ``templates`` describes the
            syntax.
        values: {name of a placeholder: value}.
        language: ``"en"`` or ``"zh"``.

    Raises:
        KeyError: If the value of a placeholder is missing, except in an omitted optional text.
    """
    included = OPTIONAL_TEXT.sub(
        lambda match: match[3] if bool(values.get(match[2])) != bool(match[1]) else "", template
    )
    return _TemplateFormatter(language).vformat(included, (), values)


_COMPARED_NAMES = (
    *(("one", "two"), ("old", "new"), ("urdf", "mjcf"), ("own", "its"), ("mass", "its")),
    *(("effort", "its"), ("value", "its"), ("mass", "stated")),
)
"""Pairs of placeholders whose values a message compares. If two such numbers differ but have the
same text, more digits are printed.
"""


@dataclass(frozen=True)
class _Compared:
    """Value of a placeholder, and the second value of a comparison in the message.

    Attributes:
        value: Number, quantity or vector.
        other: Value of the same type and unit; the text of ``value`` must differ from its text.
    """

    value: Any
    other: Any


def _find_compared_value(name: str, values: Mapping[str, Any]) -> Any:
    """Return the value, of the same type and unit, with which a message compares that of ``name``.

    None if there is no such value.
    """
    value = values[name]
    if not isinstance(value, float | Quantity | Vector):
        return None
    for pair in _COMPARED_NAMES:
        if name in pair:
            other = values.get(pair[1 - pair.index(name)])
            same_unit = getattr(other, "unit", "") == getattr(value, "unit", "")
            if type(other) is type(value) and same_unit:
                return other
    return None


class _TemplateFormatter(Formatter):
    """String formatter for the template syntax of this module, in a single language."""

    def __init__(self, language: str) -> None:
        self.language = language

    def get_field(self, field_name: str, _args: Any, kwargs: Any) -> tuple[Any, str]:
        """Return the value of a placeholder and its name.

        For ``{name|singular|plural}``, the value is one of the two words, selected by the number or
        length.
        """
        name, *forms = field_name.split("|")
        value = kwargs[name]
        if forms:
            singular, plural = forms
            count = value if isinstance(value, int | float) else len(value)
            return (singular if count == 1 else plural), name
        other = _find_compared_value(name, kwargs)
        return (value if other is None else _Compared(value, other)), name

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        """Apply the conversion of a template field; ``!r`` quotes names and items of a tuple."""
        if conversion == "r" and isinstance(value, tuple):
            return tuple(repr(item) for item in value)
        if conversion == "r" and hasattr(value, "kind"):
            return f"{term(value.kind, self.language)} {value.name!r}"
        return super().convert_field(value, conversion)

    def format_field(self, value: Any, format_spec: str) -> str:
        """Return a value as text in the language of the formatter.

        Raises:
            ValueError: If the specification is not valid.
        """
        if isinstance(value, _Compared):
            return format_pair(value.value, value.other, format_spec)[0]
        if isinstance(value, tuple):
            return self._format_list(value, format_spec)
        if isinstance(value, Term):
            return term(str(value), self.language)
        if hasattr(value, "text"):  # diagnostic or phrase
            return str(value.text(self.language))
        if hasattr(value, "kind"):  # subject
            return f"{term(value.kind, self.language)} {value.name}"
        write = format_number if isinstance(value, float) else format
        return write(value, format_spec)

    def _format_list(self, values: tuple[Any, ...], spec: str) -> str:
        """Format the items of a tuple as a list, such as "a, b, c and 2 more".

        ``spec`` contains separator, maximum number of items and item format (`_LIST_FORMAT`).
        """
        match = _LIST_FORMAT.match(spec)
        if match is None:
            raise ValueError(f"{spec!r} is no format of a list")
        separator, max_items, item_format = (
            match[1] or ",",
            int(match[2] or _MAX_LISTED_ITEMS),
            match[3] or "",
        )
        shown = (
            values if len(values) <= max_items + 1 else values[:max_items]
        )  # "and 1 more" is not shorter
        text = _SEPARATORS[self.language][separator].join(
            self.format_field(item, item_format) for item in shown
        )
        omitted = values[len(shown) :]
        if not omitted:
            return text
        if all(hasattr(item, "severity") for item in omitted):  # diagnostics
            noun = _name_omitted_findings(omitted, self.language)
            return _OMITTED_FINDINGS[self.language].format(
                listed=text, left=len(omitted), noun=noun
            )
        return _OMITTED_ITEMS[self.language].format(listed=text, left=len(omitted))


def _name_omitted_findings(findings: tuple[Any, ...], language: str) -> str:
    """Return the noun for diagnostics that a list omits: failures if all are errors."""
    kind = "failure" if all(item.severity == "error" for item in findings) else "finding"
    return term(f"omitted {kind}" + ("s" if len(findings) != 1 else ""), language)
