"""Formatting of numbers for files. Words of the file that are still right are kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.models.xml import NUMBER_PATTERN

NUMBER_RTOL: Final = 1e-12
"""Relative tolerance of numbers in files, relative to the largest magnitude of the vector, or to a
larger scale that the caller passes. `mjcf_side` also uses the number as an absolute tolerance.
Chosen, not tuned: far below the tolerances of comparisons.
"""


_ROUNDING_STEPS: Final = ((10, 1e-13), (16, 4e-16))
"""(largest number of digits, relative tolerance), in the order of the trials. A value is replaced
by the number with the fewest digits within the tolerance. The tolerance for up to 10 digits is
larger, since a number with so few digits is rarely this close by chance.
"""


def format_shortest(value: float, scale: float) -> str:
    """Format a number with as few digits as possible, within a small tolerance.

    The text is "0" if the magnitude is at most `NUMBER_RTOL` times ``scale``.

    Args:
        value: Number.
        scale: Reference magnitude of the relative tolerances (`_ROUNDING_STEPS`), in the unit of
            ``value``.
    """
    size = abs(value)
    if size <= NUMBER_RTOL * scale:
        return "0"
    return repr(float(np.copysign(_find_shortest(size, scale), value))).removesuffix(".0")


def format_numbers(old: Sequence[str], new: ArrayLike, floor: float = 0.0) -> str | None:
    """Format a vector for an XML attribute; unchanged numbers keep the digits of the file.

    A number counts as unchanged if the difference is at most ``NUMBER_RTOL`` times the reference
    magnitude: the larger of ``floor`` and the largest magnitude in the vector.

    Args:
        old: Texts of the numbers in the file; may have another length than ``new``.
        new: New vector.
        floor: Lower bound of the reference magnitude.

    Returns:
        Text; None if the file states all numbers, and all are unchanged.
    """
    values = np.atleast_1d(np.asarray(new, dtype=float))
    scale = max(floor, float(np.abs(values).max(initial=0.0)))
    kept_words = [
        word
        if word is not None and abs(_parse_number(word) - value) <= NUMBER_RTOL * scale
        else None
        for word, value in zip([*old, *[None] * len(values)], values, strict=False)
    ]
    if len(old) >= len(values) and all(word is not None for word in kept_words):
        return None
    return " ".join(
        word if word is not None else format_shortest(float(value), scale)
        for word, value in zip(kept_words, values, strict=True)
    )


def _parse_number(word: str) -> float:
    """Parse a number; NaN if the word is not decimal, such as 0x10, which MuJoCo accepts."""
    return float(word) if NUMBER_PATTERN.fullmatch(word) else math.nan


def _find_shortest(value: float, scale: float) -> float:
    """Round ``value`` to few digits, with a small error relative to ``scale``."""
    for max_digits, tolerance in _ROUNDING_STEPS:
        for count in range(1, max_digits + 1):
            rounded = float(f"{value:.{count}g}")
            if abs(rounded - value) <= tolerance * scale:
                return rounded
    return value
