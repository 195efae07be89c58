"""Numbers as a file writes them: with its digits. Old words that are still right stay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.models.xml import NUMBER_PATTERN

Array = NDArray[np.float64]


NUMBER_RTOL: Final = 1e-12
"""Relative to the greatest number of a vector: a hundredth of a thousandth of what may be left."""


_ROUNDING: Final = ((10, 1e-13), (16, 4e-16))
"""Numbers of so many digits are taken for the one that is meant, if they are so near: few digits
are no accident, and may be further off."""


def format_number(value: float, scale: float) -> str:
    """Writes a number.

    Args:
        value: The number.
        scale: What its error is relative to.
    """
    size = abs(value)
    if size <= NUMBER_RTOL * scale:
        return "0"
    return repr(float(np.copysign(_shortest(size, scale), value))).removesuffix(".0")


def format_numbers(old: Sequence[str], new: ArrayLike, floor: float = 0.0) -> str | None:
    """Writes a vector, with the old words where they still are right.

    Args:
        old: The words that state it now; may be fewer, or none.
        new: The vector.
        floor: The least scale.

    Returns:
        The text; None if all the old words are right.
    """
    values = np.atleast_1d(np.asarray(new, dtype=float))
    scale = max(floor, float(np.abs(values).max(initial=0.0)))
    kept = [
        word if word is not None and abs(_read(word) - value) <= NUMBER_RTOL * scale else None
        for word, value in zip([*old, *[None] * len(values)], values, strict=False)
    ]
    if len(old) >= len(values) and all(word is not None for word in kept):
        return None
    return " ".join(
        word if word is not None else format_number(float(value), scale)
        for word, value in zip(kept, values, strict=True)
    )


def _read(word: str) -> float:
    """Returns a number as it is written; not a number if it is no decimal, as MuJoCo's 0x10."""
    return float(word) if NUMBER_PATTERN.fullmatch(word) else math.nan


def _shortest(value: float, scale: float) -> float:
    for most, error in _ROUNDING:
        for count in range(1, most + 1):
            rounded = float(f"{value:.{count}g}")
            if abs(rounded - value) <= error * scale:
                return rounded
    return value
