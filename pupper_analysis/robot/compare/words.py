"""What two models are called that are compared, and guesses at the mistake behind a difference."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    Vector,
    describe_bound,
    diagnose,
)
from pupper_analysis.base.frozen import FrozenDict

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ModelNames:
    """What two models are called that are compared.

    Attributes:
        first: The first.
        second: The second.
        alike: Whether both are of one format, so that what one states the other could state, too.
    """

    first: Term
    second: Term
    alike: bool

    @property
    def named(self) -> dict[str, Any]:
        """Both names, as values of a diagnostic."""
        return {"first": self.first, "second": self.second}


FORMATS = ModelNames(Term("the URDF"), Term("the MJCF"), alike=False)
"""A URDF and an MJCF."""

VERSIONS = ModelNames(Term("the old file"), Term("the new file"), alike=True)
"""Two files of one format."""


def with_names_of_models(told: Diagnostic, names: Mapping[str, Term]) -> Diagnostic:
    """Returns a difference with other names of the models, {name: other name}."""

    def renamed(value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(renamed(one) for one in value)
        if isinstance(value, Diagnostic):
            return with_names_of_models(value, names)
        return names.get(str(value), value) if isinstance(value, Term) else value

    values = {key: renamed(value) for key, value in told.values.items()}
    return replace(told, values=FrozenDict(values)) if names else told


def number_pair(one: float, two: float, unit: str) -> dict[str, Any]:
    """Returns the first's number and the second's, as values of a diagnostic."""
    return {"one": describe_bound(one, unit), "two": describe_bound(two, unit)}


def vector_pair(one: Array, two: Array, unit: str = "1") -> dict[str, Any]:
    """Returns the first's vector and the second's, as values of a diagnostic."""
    return {"one": Vector.rounded(one, unit), "two": Vector.rounded(two, unit)}


def describe_ratio(urdf: float, mjcf: float) -> Diagnostic | None:
    """Returns the difference, or the mistake where the ratio is telling."""
    if urdf == 0 or mjcf == 0:
        return None
    ratio = mjcf / urdf
    if any(math.isclose(ratio, factor, rel_tol=1e-3) for factor in (1e3, 1e-3)):
        return diagnose("guess-grams-for-kilograms")
    if math.isclose(ratio, 10.0, rel_tol=1e-3):
        return diagnose("guess-ten-times")
    if math.isclose(ratio, 0.1, rel_tol=1e-3):
        return diagnose("guess-a-tenth")
    if math.isclose(ratio, -1.0, rel_tol=1e-3):
        return diagnose("guess-other-sign")
    return diagnose("relative-change", change=Quantity(ratio - 1, "1"))


def in_degrees(urdf: float, mjcf: float) -> Diagnostic | None:
    """Guesses degrees for radians, where the ratio is theirs."""
    if urdf == 0 or not math.isfinite(urdf) or not math.isfinite(mjcf):
        return None
    ratio = mjcf / urdf
    if any(math.isclose(ratio, math.degrees(1.0) ** sign, rel_tol=1e-2) for sign in (1, -1)):
        return diagnose("guess-degrees-for-radians")
    return None


def name_mirrored(urdf: Array, mjcf: Array, tolerance: float) -> Diagnostic | None:
    """Names the coordinate that has the other sign, if that is the whole difference."""
    for index, name in enumerate("xyz"):
        flipped = urdf.copy()
        flipped[index] *= -1
        if np.linalg.norm(flipped - mjcf) <= tolerance:
            return diagnose("guess-coordinate-mirrored", axis=name)
    return None


def quaternion_order(urdf: Array, mjcf: Array) -> Diagnostic | None:
    """Tells whether reading the MJCF's quaternion as (x, y, z, w) would end the difference."""
    x, y, z, w = pin.Quaternion(mjcf).coeffs()
    # The file's four numbers were taken for (w, x, y, z); in another order they are (x, y, z, w).
    quaternion = pin.Quaternion(np.array([w, x, y, z]))
    if np.allclose(quaternion.toRotationMatrix(), urdf, atol=1e-4):
        return diagnose("guess-quaternion-order")
    return None
