"""Inertias that are probably defaults of an exporter, such as 1 kg m^2 about every axis."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pupper_analysis.base.array_types import Array

MIN_REPEATED_LINKS = 2
"""Smallest number of moving links with the same inertia, a power of ten times the identity, at
which the inertia is reported; for a mass that is a power of ten, one more. A single link may have
the value by chance. Chosen, not tuned.
"""

ROUND_LOG_ATOL = 1e-9
"""Largest difference between the decimal logarithm of a power of ten and an integer. Chosen, above
binary rounding.
"""


def is_power_of_ten(value: float) -> bool:
    """Return True if ``value`` is a positive power of ten, within `ROUND_LOG_ATOL`."""
    return value > 0 and bool(abs(np.log10(value) - round(np.log10(value))) < ROUND_LOG_ATOL)


def find_placeholder_inertias(inertias: Iterable[tuple[str, Array]]) -> dict[float, list[str]]:
    """Find the inertias that at least two links share, with three moments of a power of ten.

    Args:
        inertias: (moving link, inertia about its CoM (3, 3) [kg m^2]).

    Returns:
        {moment [kg m^2]: names of the links}.
    """
    balls: dict[float, list[str]] = {}
    for name, inertia in inertias:
        moment = float(inertia[0, 0])
        is_ball = np.allclose(inertia, moment * np.eye(3), rtol=1e-9, atol=1e-9 * moment)
        if is_ball and is_power_of_ten(moment):
            balls.setdefault(moment, []).append(name)
    return {moment: names for moment, names in balls.items() if len(names) >= MIN_REPEATED_LINKS}
