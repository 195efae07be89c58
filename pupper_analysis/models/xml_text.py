"""How the numbers and elements of a new model file are written."""

from __future__ import annotations

from typing import Final

import numpy as np
from lxml import etree
from numpy.typing import ArrayLike

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
