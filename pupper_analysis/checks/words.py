"""Differences of numbers in words, with a guess at the mistake."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sides:
    """What two models are called that are compared.

    Attributes:
        first: The first.
        second: The second.
        alike: Whether both are of one format, so that what one states the other could state, too.
    """

    first: str
    second: str
    alike: bool

    @property
    def one(self) -> str:
        """Where the first's numbers stand."""
        return f"in {self.first}"

    @property
    def two(self) -> str:
        """Where the second's stand."""
        return f"in {self.second}"

    def pair(self, one: float, two: float, unit: str) -> str:
        """Gives the first's number and the second's."""
        first, second = (
            f"{value:.6g} {unit}" if math.isfinite(value) else "unlimited" for value in (one, two)
        )
        return f"{first} {self.one}, {second} {self.two}"

    def triple(self, one: Array, two: Array, unit: str) -> str:
        """Gives the first's vector and the second's."""
        text = f"{vector(one)} {unit} {self.one}, {vector(two)} {unit} {self.two}"
        return text.replace("  ", " ")


FORMATS = Sides("the URDF", "the MJCF", alike=False)
"""A URDF and an MJCF."""

VERSIONS = Sides("the old file", "the new file", alike=True)
"""Two files of one format."""


def vector(values: Array) -> str:
    """Writes a vector with 6 digits, rounded to 1e-9."""
    return "(" + ", ".join(f"{value + 0.0:.6g}" for value in np.round(values, 9)) + ")"


def mm(length: float) -> str:
    """Writes a length (m) in mm."""
    return f"{1e3 * length:.4g} mm"


def ratio(urdf: float, mjcf: float) -> str:
    """Gives the difference, and the ratio where it is telling."""
    if urdf == 0 or mjcf == 0:
        return ""
    ratio = mjcf / urdf
    for factor, meaning in (
        (1e3, "g for kg?"),
        (1e-3, "g for kg?"),
        (10.0, "ten times: a decimal point?"),
        (0.1, "a tenth: a decimal point?"),
        (-1.0, "the other sign"),
    ):
        if math.isclose(ratio, factor, rel_tol=1e-3):
            return f" ({meaning})"
    return f" ({100 * (ratio - 1):+.3g} %)"


def in_degrees(urdf: float, mjcf: float) -> str:
    """Guesses degrees for radians, where the ratio is theirs."""
    if urdf == 0 or not math.isfinite(urdf) or not math.isfinite(mjcf):
        return ""
    ratio = mjcf / urdf
    if any(math.isclose(ratio, math.degrees(1.0) ** sign, rel_tol=1e-2) for sign in (1, -1)):
        return " (degrees for radians?)"
    return ""


def mirrored(urdf: Array, mjcf: Array, tolerance: float) -> str:
    """Names the coordinate that has the other sign, if that is the whole difference."""
    for index, name in enumerate("xyz"):
        flipped = urdf.copy()
        flipped[index] *= -1
        if np.linalg.norm(flipped - mjcf) <= tolerance:
            return f" ({name} has the other sign)"
    return ""


def quaternion_order(urdf: Array, mjcf: Array) -> str:
    """Tells whether reading the MJCF's quaternion as (x, y, z, w) would end the difference."""
    x, y, z, w = pin.Quaternion(mjcf).coeffs()
    # The file's four numbers were taken for (w, x, y, z); in another order they are (x, y, z, w).
    quaternion = pin.Quaternion(np.array([w, x, y, z]))
    if np.allclose(quaternion.toRotationMatrix(), urdf, atol=1e-4):
        return " (a quaternion in another order: MJCF has (w, x, y, z)?)"
    return ""
