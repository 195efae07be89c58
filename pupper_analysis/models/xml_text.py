"""How the numbers and elements of a new model file are written."""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from lxml import etree
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.inputs import read_text
from pupper_analysis.models.xml import NUMBER

NOISE = 1e-13
"""Relative size of what products of rotations make of a zero."""

DIGITS: Final = 12
"""Significant digits: a thousand times finer than what `crosscheck --strict` tells apart, coarse
enough for a number that went through rotations to be what it was."""


ANGLE_DIGITS = 15
"""Of angles: half of pi is what it is to a hundredth of a rounding error."""


def write_numbers(values: ArrayLike, scale: float = 0.0, digits: int | None = DIGITS) -> str:
    """Writes numbers, separated by spaces.

    Args:
        values: The numbers.
        scale: What their errors are relative to, if it is more than the greatest of them.
        digits: How many significant ones; None: all.
    """
    array = np.atleast_1d(np.asarray(values, dtype=float))
    noise = NOISE * max(scale, float(np.abs(array).max(initial=0.0)))
    rounded = repr if digits is None else f"{{:.{digits}g}}".format
    return " ".join("0" if abs(v) <= noise else rounded(v) for v in array.tolist())


def is_zero(text: str) -> bool:
    """Tells whether all numbers of a text are zero."""
    return all(float(word) == 0 for word in text.split())


def write_halves(text: str) -> str:
    """Writes the halves of numbers: a URDF gives lengths, an MJCF half of them."""
    return write_numbers([float(word) / 2 for word in text.split()])


def add_element(parent: etree._Element, tag: str, **attributes: str | None) -> etree._Element:
    """Adds an element; attributes that are None are left out, ``class_`` is ``class``."""
    given = {name.rstrip("_"): text for name, text in attributes.items() if text is not None}
    return etree.SubElement(parent, tag, given)


def free_name(wanted: str, taken: set[str]) -> str:
    """Returns a name that is not taken, and takes it: the wanted one, or one with a number."""
    name, number = wanted, 1
    while name in taken:
        number += 1
        name = f"{wanted}_{number}"
    taken.add(name)
    return name


Array = NDArray[np.float64]

SAME: Final = 1e-12
"""Relative to the greatest number of a vector: a hundredth of a thousandth of what may be left."""

_ROUNDING: Final = ((10, 1e-13), (16, 4e-16))
"""Numbers of so many digits are taken for the one that is meant, if they are so near: few digits
are no accident, and may be further off."""


class Digits:
    """Writes numbers with the digits of a file.

    A number that went through a product of rotations is known to some 1e-15; where the other file
    has the number that it came from, that is written.
    """

    def __init__(self, *sources: Iterable[str]) -> None:
        """Knows the numbers of some texts; those of the first sources go before the others'."""
        self._known = [
            sorted({abs(float(found)) for text in texts for found in NUMBER.findall(text)})
            for texts in sources
        ]

    @staticmethod
    def of(*sources: Iterable[Path]) -> Digits:
        """Knows the numbers of some files."""
        return Digits(*([read_text(f) for f in files] for files in sources))

    def word(self, value: float, scale: float) -> str:
        """Writes a number.

        Args:
            value: The number.
            scale: What its error is relative to.
        """
        size = abs(value)
        if size <= SAME * scale:
            return "0"
        best = _shortest(size, scale)
        for numbers in self._known:
            at = bisect.bisect_left(numbers, size)
            near = [known for known in numbers[max(at - 1, 0) : at + 1] if known]
            known = min(near, key=lambda number: abs(number - size), default=np.inf)
            if abs(known - size) <= SAME * scale:
                best = known
                break
        return repr(float(np.copysign(best, value))).removesuffix(".0")

    def words(self, old: Sequence[str], new: Array, floor: float = 0.0) -> str | None:
        """Writes a vector, with the old words where they still are right.

        Args:
            old: The words that state it now; may be fewer, or none.
            new: The vector.
            floor: The least scale.

        Returns:
            The text; None if all the old words are right.
        """
        scale = max(floor, float(np.abs(new).max(initial=0.0)))
        kept = [
            word if word is not None and abs(_read(word) - value) <= SAME * scale else None
            for word, value in zip([*old, *[None] * len(new)], new, strict=False)
        ]
        if len(old) >= len(new) and all(word is not None for word in kept):
            return None
        return " ".join(
            word if word is not None else self.word(float(value), scale)
            for word, value in zip(kept, new, strict=True)
        )


def _read(word: str) -> float:
    """Returns a number as it is written; not a number if it is no decimal, as MuJoCo's 0x10."""
    return float(word) if NUMBER.fullmatch(word) else math.nan


def _shortest(value: float, scale: float) -> float:
    for most, error in _ROUNDING:
        for count in range(1, most + 1):
            rounded = float(f"{value:.{count}g}")
            if abs(rounded - value) <= error * scale:
                return rounded
    return value
