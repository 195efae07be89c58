"""Metrics of pushes for design studies."""

from __future__ import annotations

import math
from typing import Any

from pupper_analysis.tools.push.recovery import push_recovery, unknown_push_limits


def _measure_weakest_impulse(design: Any) -> float:
    """Compute the largest push in the weakest direction [N s]; not a number if unknown."""
    if unknown_push_limits(design.robot):
        return math.nan
    return push_recovery(design.robot, design.held).weakest_impulse


METRICS: dict[str, dict[str, Any]] = {
    "push_recovery": {"function": _measure_weakest_impulse, "unit": "N s", "simulates": True},
}
"""{name of the metric: arguments of its `Metric`}."""
