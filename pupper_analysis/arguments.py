"""Checks of arguments."""

from __future__ import annotations

import math
from numbers import Real

from pupper_analysis.errors import ConfigurationError


def finite(name: str, value: object) -> float:
    """Returns a finite number.

    Args:
        name: The argument's name, for the message.
        value: What was given.

    Raises:
        ConfigurationError: If it is no finite number.
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ConfigurationError(name, f"{value!r} is not a number")
    number = float(value)
    if not math.isfinite(number):
        raise ConfigurationError(name, f"{number} is not finite")
    return number
