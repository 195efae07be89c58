"""Numbers with units, and words of the catalogue, as diagnostics carry them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

_SHOWN_IN = {
    ("m", "mm"): 1e3,
    ("m", "um"): 1e6,
    ("m/s", "mm/s"): 1e3,
    ("rad", "deg"): math.degrees(1.0),
    ("rad", "degrees"): math.degrees(1.0),
    ("rad", "°"): math.degrees(1.0),
    ("rad/s", "deg/s"): math.degrees(1.0),
    ("kg", "g"): 1e3,
    ("s", "ms"): 1e3,
    ("m^3", "L"): 1e3,
    ("m^3", "litres"): 1e3,
    ("1", "%"): 1e2,
}
"""{(SI unit, unit that is shown): factor}."""


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
        if colon and not shown:
            return format(self.value, digits)
        if not colon and (self.unit, digits) in _SHOWN_IN:
            shown, digits = digits, ""
        elif not colon:  # so that "g" are grams of a mass, and Python's format of all else
            shown = self.unit
        factor = 1.0 if shown == self.unit else _SHOWN_IN[self.unit, shown]
        return _with_unit(format(factor * self.value, digits or ".4g"), shown)

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
        numbers = ", ".join(format(factor * value + 0.0, digits or ".6g") for value in self.values)
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
