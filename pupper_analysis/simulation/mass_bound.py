"""Bisection of the largest mass with which a robot holds.

`bisect_mass` narrows a bracket between a mass that holds and a mass that fails. `find_holding_mass`
searches below a mass that fails; the result is usually near this mass.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

from pupper_analysis.base.progress import report_progress

Cause = TypeVar("Cause")
"""Reason why a mass fails."""

SIMULATION_RTOL = 0.01
"""Relative tolerance [1] of the bisection in which nudged simulations decide whether a payload
holds. Chosen, not tuned.
"""

_FIRST_DISTANCE_RATIO = 0.9
"""Distance of the first reduced mass from the failing mass, relative to the tolerance times the
failing mass. Each further distance is doubled. Bisected intervals then meet the tolerance without a
further simulation if the result is more than this fraction of the failing mass.
"""

TOLERANCE_FACTOR = 1 + 1e-9
"""Factor on the tolerance of a bisection [1], so that a bracket whose width equals the tolerance up
to rounding is not bisected again. Chosen far above rounding errors.
"""


def bisect_mass(
    find_cause: Callable[[float], Cause | None],
    low: float,
    high: float,
    cause: Cause,
    tolerance: float,
    relative_tolerance: float = 0.0,
) -> tuple[float, Cause]:
    """Bisect the largest mass that holds, between ``low`` [kg], which holds, and ``high``.

    Args:
        find_cause: Function of a mass [kg]: reason why the mass fails, or None.
        low: Mass that holds [kg].
        high: Mass that fails [kg].
        cause: Reason why ``high`` fails.
        tolerance: Absolute tolerance [kg].
        relative_tolerance: Tolerance relative to the result [1]; the larger tolerance applies.

    Returns:
        Largest mass that holds [kg], and the reason why the next larger evaluated mass fails.
    """
    rounds = 0
    while high - low > TOLERANCE_FACTOR * (resolution := max(tolerance, relative_tolerance * low)):
        rounds_left = math.ceil(math.log2((high - low) / resolution))
        report_progress("payload", rounds, rounds + rounds_left)
        rounds += 1
        middle = (low + high) / 2
        if (middle_cause := find_cause(middle)) is None:
            low = middle
        else:
            high, cause = middle, middle_cause
    return low, cause


def find_holding_mass(
    find_cause: Callable[[float], Cause | None], failing_mass: float, cause: Cause
) -> tuple[float, Cause]:
    """Find the largest mass that holds, to `SIMULATION_RTOL`, below a mass that fails.

    Args:
        find_cause: Function of a mass [kg]: reason why the mass fails, or None. A mass of 0 holds.
        failing_mass: Mass that fails [kg].
        cause: Reason why ``failing_mass`` fails.

    Returns:
        Largest mass that holds [kg], and the reason why the next larger evaluated mass fails.
    """
    # The result is usually just below the failing mass: search downwards with doubled steps.
    high, distance = failing_mass, _FIRST_DISTANCE_RATIO * SIMULATION_RTOL * failing_mass
    low = high - distance
    while low > 0.0 and (low_cause := find_cause(low)) is not None:
        high, cause, distance = low, low_cause, 2 * distance
        low = high - distance
    tolerance = SIMULATION_RTOL**2 * failing_mass
    return bisect_mass(find_cause, max(low, 0.0), high, cause, tolerance, SIMULATION_RTOL)
