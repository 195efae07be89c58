"""Units in which numbers may be given: by option, by prior, by the header of a file's column."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Final

EARTH = 9.81
"""Gravity (m/s^2), as MuJoCo has it by default, and Pinocchio for each URDF."""

DOWN = (0.0, 0.0, -EARTH)
"""The same in the world's axes."""

_ANGLES = {"rad": 1.0, "deg": math.pi / 180, "mrad": 1e-3}
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}

UNITS: Mapping[str, Mapping[str, float]] = {
    "angle": _ANGLES,
    "length": _LENGTHS,
    "position": _ANGLES | _LENGTHS,
    "velocity": {
        "rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30, "m/s": 1.0, "mm/s": 1e-3,
    },
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "mass": {"kg": 1.0, "g": 1e-3},
    "torque": {"N m": 1.0, "Nm": 1.0, "N*m": 1.0, "mN m": 1e-3, "mNm": 1e-3, "N": 1.0},
    # Kitchen scales show mass.
    "force": {"N": 1.0, "g": 9.80665e-3, "kg": 9.80665},
}  # fmt: skip
"""{quantity: {unit: its size in SI}}; the first of each is meant where none is said."""

READ_IN: Final[Mapping[str, tuple[float, str]]] = {
    "rad": (math.degrees(1.0), "deg"),
    "m": (1e3, "mm"),
}
"""{SI unit of a position: what it is multiplied by to be read, and the unit that is read}."""


class Position(float):
    """Where a joint is to be, with its unit; ``"rad or m"`` where it was given without one."""

    unit: str

    def __new__(cls, value: float, unit: str = "rad or m") -> Position:
        """Returns the position."""
        found = super().__new__(cls, value)
        found.unit = unit
        return found


DIMENSIONLESS: Final = "1"
"""Unit in the metadata of a field that is a ratio, a direction or a count."""

VARIES: Final = "varies"
"""Unit in the metadata of a field whose unit another field, or the key of the value, states."""


@cache
def units_of(kind: type) -> dict[str, str]:
    """Return {field: unit} of a dataclass, from ``field(metadata={"unit": ...})``.

    Fields without a unit, dimensionless fields and fields whose unit varies are left out.
    """
    if not is_dataclass(kind):
        return {}
    stated = {field.name: field.metadata.get("unit", DIMENSIONLESS) for field in fields(kind)}
    return {name: unit for name, unit in stated.items() if unit not in {DIMENSIONLESS, VARIES}}
