"""Metric of studies: the weakest push [N s]. ``METRICS``: {name: arguments of the metric}."""

from __future__ import annotations

import math
from typing import Any

from pupper_analysis.tools.push.recovery import list_unknown_push_limits, push_recovery


def _measure_weakest_push(design: Any) -> float:
    """Compute the largest survived push in the weakest direction [N s]; NaN with unknown limits."""
    if list_unknown_push_limits(design.robot):
        return math.nan
    return push_recovery(design.robot, design.simulated_stand).weakest_impulse


METRICS: dict[str, dict[str, Any]] = {
    "push_recovery": {"function": _measure_weakest_push, "unit": "N s", "simulates": True},
}
"""{name of the metric: arguments of the `Metric`}."""
