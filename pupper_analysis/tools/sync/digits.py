"""Numbers as a file writes them: with its digits. Old words that are still right stay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.models.xml import NUMBER
from pupper_analysis.tools.sync.xml_bytes import Element

Array = NDArray[np.float64]


SAME: Final = 1e-12
"""Relative to the greatest number of a vector: a hundredth of a thousandth of what may be left."""


_ROUNDING: Final = ((10, 1e-13), (16, 4e-16))
"""Numbers of so many digits are taken for the one that is meant, if they are so near: few digits
are no accident, and may be further off."""


def written_word(value: float, scale: float) -> str:
    """Writes a number.

    Args:
        value: The number.
        scale: What its error is relative to.
    """
    size = abs(value)
    if size <= SAME * scale:
        return "0"
    return repr(float(np.copysign(_shortest(size, scale), value))).removesuffix(".0")


def written_words(old: Sequence[str], new: ArrayLike, floor: float = 0.0) -> str | None:
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
        word if word is not None and abs(_read(word) - value) <= SAME * scale else None
        for word, value in zip([*old, *[None] * len(values)], values, strict=False)
    ]
    if len(old) >= len(values) and all(word is not None for word in kept):
        return None
    return " ".join(
        word if word is not None else written_word(float(value), scale)
        for word, value in zip(kept, values, strict=True)
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


FORMS: Final = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
"""The attributes of an MJCF that state an orientation."""


@dataclass(frozen=True)
class AngleUnits:
    """What an MJCF's compiler says of angles.

    Attributes:
        degrees: Whether angles are degrees.
        eulerseq: The order of Euler angles, small letters for axes that turn along.
    """

    degrees: bool
    eulerseq: str

    @property
    def factor(self) -> float:
        """Of a number in the file to radians."""
        return float(np.pi / 180) if self.degrees else 1.0


def stated_rotation(element: Element, units: AngleUnits) -> Array:
    """Returns the orientation that an MJCF's element states, by MuJoCo's own reading."""
    form = stated_orientation(element)
    if form is None:
        return np.eye(3)
    angle = "degree" if units.degrees else "radian"
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="{angle}" eulerseq="{units.eulerseq}"/>'
        f'<worldbody><site {form}="{element.get(form)}"/></worldbody></mujoco>'
    )
    return rotation_from_quaternion(model.site_quat[0])


def stated_orientation(element: Element) -> str | None:
    """Returns the attribute by which an MJCF's element states its orientation itself."""
    return next((form for form in FORMS if element.get(form) is not None), None)
