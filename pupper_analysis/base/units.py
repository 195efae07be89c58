"""Units: accepted units of input values, and the units of the fields of results.

Inputs are options, priors of a fit and column headers of measurement files.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, fields, is_dataclass
from decimal import Decimal
from functools import cache
from typing import Any, Final

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
"""{quantity: {accepted unit: factor to SI}}. A value without unit is in SI units: a position in rad
or m by the type of joint."""

READ_IN: Final[Mapping[str, tuple[float, str]]] = {
    "rad": (math.degrees(1.0), "deg"),
    "m": (1e3, "mm"),
}
"""{SI unit of an angle or length: (factor, printed unit)}; printed value = factor x SI value."""


@dataclass(frozen=True)
class JointUnits:
    """SI units of the quantities of a joint.

    Attributes:
        position: Unit of joint positions and their deviations.
        velocity: Unit of joint velocities.
        effort: Unit of motor torques or forces, effort limits and dry friction.
        stiffness: Unit of servo stiffness kp and of joint springs.
        damping: Unit of servo damping kd and of viscous damping.
        armature: Unit of the rotor inertia.
    """

    position: str
    velocity: str
    effort: str
    stiffness: str
    damping: str
    armature: str


HINGE_UNITS: Final = JointUnits("rad", "rad/s", "N m", "N m/rad", "N m s/rad", "kg m^2")
"""Units of a hinge: a revolute or continuous joint in a URDF."""

SLIDE_UNITS: Final = JointUnits("m", "m/s", "N", "N/m", "N s/m", "kg")
"""Units of a slide: a prismatic joint in a URDF."""


def select_joint_units(*, slides: bool) -> JointUnits:
    """Return `SLIDE_UNITS` if ``slides`` is True, else `HINGE_UNITS`."""
    return SLIDE_UNITS if slides else HINGE_UNITS


def find_joint_units(unit: str) -> JointUnits:
    """Return the units of a joint from the unit of its position or effort.

    The result is `SLIDE_UNITS` for m or N, and `HINGE_UNITS` for all other units.
    """
    return select_joint_units(slides=unit in (SLIDE_UNITS.position, SLIDE_UNITS.effort))


MIXED_UNITS: Final = JointUnits(
    *(
        f"{hinge} or {slide}"
        for hinge, slide in zip(astuple(HINGE_UNITS), astuple(SLIDE_UNITS), strict=True)
    )
)
"""Units of values of hinges and slides together, such as ``N m or N``."""


def combine_joint_units(units: Iterable[JointUnits]) -> JointUnits:
    """Return the units for a table of several joints: the common units, or `MIXED_UNITS`.

    Without joints, the result is `HINGE_UNITS`.
    """
    different = set(units)
    return MIXED_UNITS if len(different) > 1 else next(iter(different), HINGE_UNITS)


def find_common_units(units: Iterable[str]) -> JointUnits:
    """Return the units for a table of several joints, from each joint's position or effort unit.

    `MIXED_UNITS` if hinges and slides are mixed.
    """
    return combine_joint_units(find_joint_units(unit) for unit in units)


POSITION_UNIT: Final = MIXED_UNITS.position
"""Unit in the metadata of a field with positions of hinges and slides: rad or m."""

VELOCITY_UNIT: Final = MIXED_UNITS.velocity
"""Unit in the metadata of a field with velocities of hinges and slides: rad/s or m/s."""

EFFORT_UNIT: Final = MIXED_UNITS.effort
"""Unit in the metadata of a field with motor torques of hinges and forces of slides: N m or N."""

STIFFNESS_UNIT: Final = MIXED_UNITS.stiffness
"""Unit in the metadata of a field with stiffnesses of hinges and slides: N m/rad or N/m."""

DAMPING_UNIT: Final = MIXED_UNITS.damping
"""Unit in the metadata of a field with dampings of hinges and slides: N m s/rad or N s/m."""

ARMATURE_UNIT: Final = MIXED_UNITS.armature
"""Unit in the metadata of a field with armatures of hinges and slides: kg m^2 or kg."""


def convert_to_display(value: float, unit: str) -> tuple[str, float]:
    """Return the unit that tables show for a joint position (° or mm), and the converted value.

    Args:
        value: Position or deviation [rad, m].
        unit: Unit of ``value``: rad or m.

    Returns:
        Displayed unit; value in this unit.
    """
    factor, shown = READ_IN[unit]
    return "°" if shown == "deg" else shown, factor * value


class Position(float):
    """Requested joint position with the unit; ``"rad or m"`` if the user typed no unit."""

    unit: str

    def __new__(cls, value: float, unit: str = "rad or m") -> Position:
        """Return the position ``value`` [rad or m] with the unit ``unit``."""
        position = super().__new__(cls, value)
        position.unit = unit
        return position


_TYPED_DIGITS = 4
"""Largest number of significant digits of an angle that a user may have typed in degrees. Chosen,
not tuned.
"""


def find_untyped_degrees(angle: float, low: float, high: float) -> float | None:
    """Return an angle [rad] as a number of degrees if its user may have meant degrees, else None.

    For example, 20 rad is out of range, so a user who types 20 probably means 20 deg. The number
    must have at most `_TYPED_DIGITS` significant digits, and as an angle in degrees be within the
    limits.

    Args:
        angle: Angle that is out of range [rad].
        low: Lower limit of the angle [rad].
        high: Upper limit of the angle [rad].
    """
    is_typed = float(f"{angle:.{_TYPED_DIGITS}g}") == angle
    return angle if is_typed and low <= math.radians(angle) <= high else None


MAX_BARE_NUMBERS: Final[Mapping[str, float]] = {
    # Probably mm or cm: no two parts of a legged robot are 5 m apart (chosen, not tuned).
    "length": math.nextafter(5.0, 0.0),  # 5 m itself is refused
    # Probably degrees: more than one turn (chosen, not tuned).
    "angle": 2 * math.pi,
    # Probably milliseconds: the largest delay of a controller that is accepted is 0.5 s
    # (`simulation.controlled_stand.MAX_DELAY`), and time steps are shorter.
    "time": 0.5,
    # Probably grams: no published legged robot carries 200 kg (chosen, not tuned).
    "mass": math.nextafter(200.0, 0.0),  # 200 kg itself is refused
}
"""{quantity: upper bound of the absolute value of a number without a unit [SI unit]}. A larger
finite number is probably in another unit: the command line refuses such a number, and errors of the
Python API suggest the other unit.
"""


def lacks_unit(kind: str, value: float) -> bool:
    """Return True if a number without a unit is probably not in the SI unit.

    Such a number is finite and beyond the bound of its quantity in `MAX_BARE_NUMBERS`.
    """
    return MAX_BARE_NUMBERS.get(kind, math.inf) < abs(value) < math.inf


DIMENSIONLESS_UNIT: Final = "1"
"""Unit in the metadata of a field that is a ratio, a direction or a count."""

VARYING_UNIT: Final = "varies"
"""Unit in the metadata of a field whose unit another field, or the key of the value, states."""


@cache
def units_of(kind: type) -> dict[str, str]:
    """Return {field: unit} of a result class, from ``field(metadata={"unit": ...})``.

    Fields without a unit, and fields with a varying unit, are left out.
    """
    if not is_dataclass(kind):
        return {}
    stated = {field.name: field.metadata.get("unit", DIMENSIONLESS_UNIT) for field in fields(kind)}
    return {
        name: unit
        for name, unit in stated.items()
        if unit not in {DIMENSIONLESS_UNIT, VARYING_UNIT}
    }


def get_field_units(result: object) -> dict[str, str | Mapping[str, str]]:
    """Return {field: unit} of a result, ``1`` for ratios; empty for texts and unknown units.

    A varying unit is in the field or property ``unit``. A field such as ``joint_error_unit``
    contains the unit of ``joint_error``. Units of joint quantities are those of the result's
    joints, if the result contains them. A unit {key: unit} belongs to the entries of a mapping.
    """
    kind: Any = type(result)
    stated = {field.name: field.metadata.get("unit", "") for field in fields(kind)}
    own = getattr(result, "unit", "")
    for name, unit in stated.items():
        beside = getattr(result, f"{name}_unit", "")
        if unit == VARYING_UNIT:
            stated[name] = own if isinstance(own, str) else ""
        elif isinstance(beside, str) and beside:
            stated[name] = beside
    special: Mapping[str, str | Mapping[str, str]] = getattr(result, "_field_units", dict)()
    return {**replace_joint_units(result, stated), **special}


def replace_joint_units(result: object, units: Mapping[str, str]) -> dict[str, str]:
    """Replace units of hinges and slides, such as ``N m or N``, by the unit of a result's joints.

    Units are unchanged if the result contains no units of joints, or units of hinges and slides.
    """
    found: Any = getattr(result, "torque_units", None)
    found = found or getattr(getattr(result, "statics", None), "torque_units", None)
    common = getattr(result, "units", None)
    if found:
        common = find_common_units(found.values() if isinstance(found, Mapping) else found)
    if not isinstance(common, JointUnits):
        return dict(units)
    replaced = dict(zip(astuple(MIXED_UNITS), astuple(common), strict=True))
    return {name: replaced.get(unit, unit) for name, unit in units.items()}


_ROUNDING_TOLERANCE = 1e-12
"""Relative distance below an integer within which `floor_within_rounding` returns this integer.
Chosen: above rounding errors of a few operations, below every displayed digit.
"""


def floor_within_rounding(number: float) -> int:
    """Round a number from 0 to 1e11 down to an integer, with a tolerance for rounding errors.

    Products such as 100 * 0.57 are a rounding error below 57.
    """
    return math.floor(number * (1 + _ROUNDING_TOLERANCE))


def round_down(limit: float, digits: int) -> float:
    """Round a limit that is not negative down to significant digits.

    A user may enter the printed limit, for example a largest payload. 0, infinity and NaN are
    returned unchanged.
    """
    if not limit or not math.isfinite(limit):
        return limit
    decimals = digits - 1 - math.floor(math.log10(limit) + _ROUNDING_TOLERANCE)
    # 10.0**decimals would overflow for a denormal limit.
    return float(f"{floor_within_rounding(float(Decimal(limit).scaleb(decimals)))}e{-decimals}")


def round_up(limit: float, digits: int) -> float:
    """Round a lower limit that is not negative up to significant digits.

    A user may enter the printed limit, for example a smallest stiffness. 0, infinity and NaN are
    returned unchanged.
    """
    if not limit or not math.isfinite(limit):
        return limit
    decimals = digits - 1 - math.floor(math.log10(limit) + _ROUNDING_TOLERANCE)
    number = float(Decimal(limit).scaleb(decimals)) * (1 - _ROUNDING_TOLERANCE)
    return float(f"{math.ceil(number)}e{-decimals}")
