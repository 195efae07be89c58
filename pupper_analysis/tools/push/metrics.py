"""What a study may measure: {name: the arguments of a metric of it}."""

from __future__ import annotations

import math
from typing import Any

from pupper_analysis.tools.push.recovery import push_recovery, unknown_push_limits


def _measure(design: Any) -> float:
    if unknown_push_limits(design.robot):
        return math.nan
    return push_recovery(design.robot, design.held).weakest_impulse


METRICS: dict[str, dict[str, Any]] = {
    "push_recovery": {"function": _measure, "unit": "N s", "simulates": True},
}
