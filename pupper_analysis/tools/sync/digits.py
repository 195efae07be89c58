"""Numbers and orientations as a file writes them: with its digits, in its forms.

Old words that are still right stay.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.inputs import read_text
from pupper_analysis.models.urdf_tree import origin_of
from pupper_analysis.models.xml import NUMBER, parse_numbers
from pupper_analysis.tools.sync.xml_bytes import Element

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


# Orientations in the forms that the files have: rpy, quaternions, Euler angles, axes.


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


def origin_changes(owner: Element | None, pose: pin.SE3, digits: Digits) -> dict[str, str]:
    """Returns the attributes of a URDF's <origin> that must change for it to state a pose.

    Args:
        owner: The element that it is in, or is to be put into.
        pose: The pose.
        digits: Writes the numbers.
    """
    changes = {}
    element = None if owner is None else owner.find("origin")
    xyz = None if element is None else element.get("xyz")
    text = digits.words((xyz or "0 0 0").split(), np.array(pose.translation), 1.0)
    if text is not None:
        changes["xyz"] = text
    rotation = np.array(pose.rotation)
    if float(np.abs(np.array(origin_of(owner).rotation) - rotation).max()) > 1e-12:
        rpy = None if element is None else element.get("rpy")
        near = parse_numbers(rpy, "0 0 0")
        text = digits.words((rpy or "0 0 0").split(), _angles("XYZ", rotation, near), 1.0)
        if text is not None:
            changes["rpy"] = text
    return changes


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


def orientation_change(
    element: Element, now: Array, wanted: Array, units: AngleUnits, digits: Digits
) -> dict[str, str]:
    """Returns what must change for an element of an MJCF to have another orientation.

    Args:
        element: The element.
        now: (3, 3) what it has.
        wanted: (3, 3) what it shall have.
        units: Of the file.
        digits: Writes the numbers.
    """
    if float(np.abs(now - wanted).max()) <= 1e-12:
        return {}
    form = stated_orientation(element) or "quat"
    old = parse_numbers(element.get(form), "1 0 0 0" if form == "quat" else "")
    if form == "axisangle":
        vector = pin.log3(wanted)
        angle = float(np.linalg.norm(vector))
        axis = vector / angle if angle else np.array([0.0, 0.0, 1.0])
        if float(axis @ old[:3]) < 0:
            axis, angle = -axis, -angle
        values = np.array([*axis, angle / units.factor])
    elif form == "euler":
        values = _angles(units.eulerseq, wanted, old * units.factor) / units.factor
    elif form == "xyaxes":
        values = wanted.T[:2].flatten()
    else:
        x, y, z, w = pin.Quaternion(wanted).coeffs()
        values = np.array([w, x, y, z])
        if form == "quat" and float(values @ old) < 0:
            values = -values
    text = digits.words((element.get(form) or "").split() if form != "zaxis" else [], values, 1.0)
    # A direction of z leaves the turn about it open, so that a quaternion takes its place.
    return {} if text is None else {"quat" if form == "zaxis" else form: text}


def _composed(sequence: str, angles: Array) -> Array:
    """Returns the rotation of MuJoCo's Euler angles: small letters turn along, great ones not."""
    result = np.eye(3)
    for letter, angle in zip(sequence, angles, strict=True):
        turn = pin.exp3(float(angle) * np.eye(3)["xyz".index(letter.lower())])
        result = result @ turn if letter.islower() else turn @ result
    return result


def _angles(sequence: str, rotation: Array, near: Array) -> Array:
    """Returns Euler angles of a rotation, near others; also where they are not unique.

    Newton's method with the least step: where the first and the last axis are one, it changes
    what it must. It begins at the others, and then at quarter turns.
    """
    quarters = (np.pi / 2) * np.array(list(itertools.product((0, 1, -1, 2), repeat=3)), dtype=float)
    best, least = near, np.inf
    for start in (near, *quarters):
        angles = np.array(start)
        for _ in range(30):
            made = _composed(sequence, angles)
            error = pin.log3(made.T @ rotation)
            size = float(np.linalg.norm(error))
            if size < least:
                best, least = np.array(angles), size
            if size < 1e-15:
                break
            columns = [
                pin.log3(made.T @ _composed(sequence, angles + 1e-6 * unit)) / 1e-6
                for unit in np.eye(3)
            ]
            angles = angles + np.linalg.lstsq(np.array(columns).T, error, rcond=1e-5)[0]
        if least < 1e-13:
            break
    return best + 2 * np.pi * np.round((near - best) / (2 * np.pi))
