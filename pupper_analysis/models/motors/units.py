"""Quantities of motors with their units, as written in data files: ``"80 mN m/A"``, ``"25 degC"``.

The unit is part of the text, so that nobody mistakes mN m, kgf cm and rpm for SI units. A number
without unit is accepted only for a quantity without unit, such as a gear ratio.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError

_NEWTONS_PER_KGF = 9.80665
"""Weight of a kilogram in standard gravity [N] (ISO 80000-3)."""

_TORQUE_FACTORS = {
    **{"N m": 1.0, "mN m": 1e-3, "kgf cm": _NEWTONS_PER_KGF * 1e-2, "kgf m": _NEWTONS_PER_KGF},
    "ozf in": 7.061552e-3,
}
"""{accepted unit of torque: factor to N m}."""

_RAD_PER_S_PER_RPM = 2 * math.pi / 60
"""One revolution per minute [rad/s]."""


@dataclass(frozen=True)
class UnitKind:
    """Kind of quantity, such as torque: accepted units and range of values.

    Attributes:
        unit: Unit of the result: SI unit, degC for temperatures, US dollars for prices.
        factors: {accepted unit: factor to ``unit``}; "" for a number without unit.
        offset: {unit: value that is added after the multiplication}, for temperatures.
        signed: Whether zero and negative values down to -273.15 are accepted (temperatures in
            degC); otherwise values are positive, or zero if ``zero`` is set.
        zero: Whether zero is accepted if ``signed`` is not set.
        most: Largest accepted value, in ``unit``.
    """

    unit: str
    factors: dict[str, float]
    offset: dict[str, float] = field(default_factory=dict)
    signed: bool = False
    zero: bool = False
    most: float = math.inf


UNIT_KINDS = {
    "torque": UnitKind("N m", _TORQUE_FACTORS),
    "friction torque": UnitKind("N m", _TORQUE_FACTORS, zero=True),
    "torque constant": UnitKind(
        "N m/A", {f"{unit}/A": factor for unit, factor in _TORQUE_FACTORS.items()}
    ),
    "resistance": UnitKind("ohm", {"ohm": 1.0, "mohm": 1e-3}),
    "relative rise": UnitKind("1/K", {"1/K": 1.0, "%/K": 1e-2}, zero=True, most=0.1),
    "ratio": UnitKind("1", {"": 1.0}),
    "fraction": UnitKind("1", {"": 1.0, "%": 1e-2}, zero=True, most=1.0),
    "efficiency": UnitKind("1", {"": 1.0, "%": 1e-2}, most=1.0),
    "inertia": UnitKind("kg m^2", {"kg m^2": 1.0, "g cm^2": 1e-7, "kg cm^2": 1e-4}),
    "viscous friction": UnitKind(
        "N m s/rad",
        {"N m s/rad": 1.0, "mN m s/rad": 1e-3, "N m/rpm": 1 / _RAD_PER_S_PER_RPM},
        zero=True,
    ),
    "stiffness": UnitKind("N m/rad", {"N m/rad": 1.0, "mN m/rad": 1e-3}),
    "voltage": UnitKind("V", {"V": 1.0}),
    "current": UnitKind("A", {"A": 1.0, "mA": 1e-3}),
    "speed": UnitKind("rad/s", {"rad/s": 1.0, "rpm": _RAD_PER_S_PER_RPM, "deg/s": math.pi / 180}),
    "thermal resistance": UnitKind("K/W", {"K/W": 1.0}),
    "heat capacity": UnitKind("J/K", {"J/K": 1.0}),
    "temperature": UnitKind("degC", {"degC": 1.0, "K": 1.0}, {"K": -273.15}, signed=True),
    "mass": UnitKind("kg", {"kg": 1.0, "g": 1e-3}),
    "price": UnitKind("USD", {"USD": 1.0}),
}
"""{kind of quantity: unit of the result, accepted units with their factors, and range}."""

_NUMBER_AND_UNIT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*\Z")
"""Pattern of a number and its unit, as in ``1.2 N m``; the unit may be missing."""


def parse_motor_quantity(name: str, text: object, kind: UnitKind) -> float:
    """Convert a text with number and unit to a number in ``kind.unit``, for example N m or degC.

    Args:
        name: Name of the quantity, for messages.
        text: Text with number and unit; a number if the quantity has no unit.
        kind: Kind of quantity.

    Raises:
        ConfigurationError: If the number or the unit is missing, the unit does not belong to the
            quantity, or the value is out of the permitted range.
    """
    units = [unit for unit in kind.factors if unit]
    if isinstance(text, bool) or not isinstance(text, str | int | float):
        raise ConfigurationError(name, diagnose("motor-no-quantity", given=repr(text), units=units))
    match = _NUMBER_AND_UNIT.match(str(text))
    if match is None or not math.isfinite(float(match[1])):
        raise ConfigurationError(name, diagnose("motor-no-quantity", given=str(text), units=units))
    number, unit = float(match[1]), " ".join(match[2].replace("Nm", "N m").split())
    if unit not in kind.factors:
        code = "motor-other-unit" if unit else "motor-without-unit"
        raise ConfigurationError(name, diagnose(code, given=str(text), unit=unit, units=units))
    value = number * kind.factors[unit] + kind.offset.get(unit, 0.0)
    check_motor_number(name, value, kind, str(text))
    return value


def check_motor_number(name: str, value: float, kind: UnitKind, given: str) -> None:
    """Check that the value of a motor's quantity is finite and in the range of its kind.

    Raises:
        ConfigurationError: If the value is out of range.
    """
    low = -273.15 if kind.signed else 0.0
    valid = low <= value if kind.signed or kind.zero else low < value
    if valid and value <= kind.most and math.isfinite(value):
        return
    raise ConfigurationError(
        name,
        diagnose(
            "motor-out-of-range",
            given=given,
            low=low,
            least=kind.signed or kind.zero,
            most=kind.most if math.isfinite(kind.most) else None,
            unit="" if kind.unit == "1" else kind.unit,
        ),
    )
