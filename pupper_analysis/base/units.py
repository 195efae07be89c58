"""Units: accepted units of input values, and the units of the fields of results.

Inputs are options, priors of a fit and column headers of measurement files.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Final

EARTH_GRAVITY = 9.81
"""Gravitational acceleration [m/s^2]: the default of MuJoCo and of Pinocchio's URDF import."""

DOWNWARD_GRAVITY = (0.0, 0.0, -EARTH_GRAVITY)
"""Gravitational acceleration, shape (3,) [m/s^2], expressed in the world frame."""

_ANGLES = {"rad": 1.0, "deg": math.pi / 180, "mrad": 1e-3}
"""{unit of an angle: factor to rad}."""

_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
"""{unit of a length: factor to m}."""

UNIT_FACTORS: Mapping[str, Mapping[str, float]] = {
    "angle": _ANGLES,
    "length": _LENGTHS,
    "direction": _LENGTHS,  # a vector whose length does not count
    "position": _ANGLES | _LENGTHS,
    "velocity": {
        "rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30, "m/s": 1.0, "mm/s": 1e-3,
    },
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "mass": {"kg": 1.0, "g": 1e-3},
    "torque": {"N m": 1.0, "Nm": 1.0, "N*m": 1.0, "mN m": 1e-3, "mNm": 1e-3, "N": 1.0},
    # Kitchen scales show kilograms: 1 kg is the weight of 1 kg on Earth.
    "force": {"N": 1.0, "g": 9.80665e-3, "kg": 9.80665},
}  # fmt: skip
"""{quantity: {unit: factor to SI}}. The first unit applies if a value has no unit."""

READ_IN: Final[Mapping[str, tuple[float, str]]] = {
    "rad": (math.degrees(1.0), "deg"),
    "m": (1e3, "mm"),
}
"""{SI unit of a joint position: (factor, printed unit)}; printed value = factor x SI value."""


class Position(float):
    """Requested joint position with the unit; ``"rad or m"`` if the user typed no unit."""

    unit: str

    def __new__(cls, value: float, unit: str = "rad or m") -> Position:
        """Return the position ``value`` [rad or m] with the unit ``unit``."""
        position = super().__new__(cls, value)
        position.unit = unit
        return position


_TYPED_DIGITS = 4
"""Largest number of significant digits of a typed angle. An angle that was converted from degrees
to radians has more."""


def find_untyped_degrees(angle: float, low: float, high: float) -> float | None:
    """Return an angle [rad] as a number of degrees if its user may have meant degrees, else None.

    A user who types 20 means 20 deg where 20 rad is out of range. The number must be in range as
    degrees, and must look typed: at most four significant digits (20 deg in rad is 0.34907).

    Args:
        angle: Angle that is out of range [rad].
        low: Lower limit of the angle [rad].
        high: Upper limit of the angle [rad].
    """
    is_typed = float(f"{angle:.{_TYPED_DIGITS}g}") == angle
    return angle if is_typed and low <= math.radians(angle) <= high else None


DIMENSIONLESS_UNIT: Final = "1"
"""Unit in the metadata of a field that is a ratio, a direction or a count."""

VARYING_UNIT: Final = "varies"
"""Unit in the metadata of a field whose unit another field, or the key of the value, states."""


@cache
def units_of(kind: type) -> dict[str, str]:
    """Return {field: unit} of a dataclass, from ``field(metadata={"unit": ...})``.

    Fields without a unit, dimensionless fields and fields whose unit varies are left out.
    """
    if not is_dataclass(kind):
        return {}
    stated = {field.name: field.metadata.get("unit", DIMENSIONLESS_UNIT) for field in fields(kind)}
    return {
        name: unit
        for name, unit in stated.items()
        if unit not in {DIMENSIONLESS_UNIT, VARYING_UNIT}
    }
