"""Largest payload that position commands alone hold, without feed-forward torques.

`find_mass_by_commands_alone` searches this mass by simulations of `verify_stand`. The rate at which
the base sinks grows smoothly with the mass. If both ends of the bracket have a known rate, the next
mass is the linear interpolation (regula falsi); otherwise the bracket is halved.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from pupper_analysis.base.progress import report_progress
from pupper_analysis.simulation.verdict import Ending, classify_ending
from pupper_analysis.simulation.verify import SETTLED_DRIFT, StandVerification

_STEP_RATIO = 0.98
"""Smallest distance of an interpolated mass from an end of the bracket, relative to the resolution.
Below 1, so that the remaining interval needs no further simulation. Chosen, not tuned."""

_UNTESTED_FAILURES = 2
"""Number of failing masses after which the simulation without payload is run, if no smaller mass
holds. Chosen, not tuned."""


_MAX_SLOW_STEPS = 2
"""Number of successive interpolations that do not halve the bracket, after which the bracket is
halved. Chosen, not tuned."""


def find_mass_by_commands_alone(
    simulate: Callable[[float], StandVerification | None],
    failing_mass: float,
    tolerance: float,
    relative_tolerance: float,
) -> float:
    """Find the largest payload that holds in simulations with position commands alone.

    Args:
        simulate: Function of a payload [kg]: simulation without feed-forward (`verify_stand` with
            ``until_failure``); None if there is no stand.
        failing_mass: Payload that is known to fail [kg].
        tolerance: Absolute tolerance [kg].
        relative_tolerance: Tolerance relative to the result [1]; the larger tolerance applies.

    Returns:
        Largest simulated payload that holds [kg]: a payload that is larger by the tolerance fails.
        0 if no simulated payload holds.
    """
    low, high = 0.0, failing_mass
    low_margin = high_margin = math.nan
    failures, is_empty_tested, slow_steps, rounds = 0, False, 0, 0
    while high - low > (resolution := max(tolerance, relative_tolerance * low)):
        rounds_left = math.ceil(math.log2((high - low) / resolution))
        report_progress("payload", rounds, rounds + rounds_left)
        rounds += 1
        width, root = high - low, math.nan
        if slow_steps < _MAX_SLOW_STEPS:
            root = low + width * low_margin / (low_margin - high_margin)
        mass, is_interpolated = low + width / 2, math.isfinite(root)
        if is_interpolated:
            step = _STEP_RATIO * resolution
            mass = max(min(root, high - step), low + step)
        holds, margin = _measure_rest_margin(simulate(mass))
        if holds:
            low, low_margin = mass, margin
        else:
            high, high_margin = mass, margin
            failures += 1
        if low == 0.0 and not is_empty_tested:
            is_known = not math.isnan(high_margin)
            if is_empty_tested := is_known or failures >= _UNTESTED_FAILURES:
                holds, low_margin = _measure_rest_margin(simulate(0.0))
                if not holds:
                    return 0.0
        slow_steps = slow_steps + 1 if is_interpolated and high - low > width / 2 else 0
    return low


def _measure_rest_margin(run: StandVerification | None) -> tuple[bool, float]:
    """Return whether a simulation holds, and the margin of the base's vertical speed [m/s].

    The margin is `SETTLED_DRIFT` minus the speed before the nudge. NaN without a simulation, and if
    the robot fails for another reason than this speed.
    """
    if run is None:
        return False, math.nan
    holds, margin = classify_ending(run) is Ending.HOLDS, SETTLED_DRIFT - abs(run.height_drift)
    return holds, margin if holds == (margin > 0) and not run.collapses else math.nan
