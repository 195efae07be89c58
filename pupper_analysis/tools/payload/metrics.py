"""What a study may measure: {name: the arguments of a metric of it}."""

from __future__ import annotations

from typing import Any

from pupper_analysis.tools.payload.limit import payload_limit


def _measure(design: Any) -> float:
    return payload_limit(design.robot, design.stand, design.point, **design.gains).mass


METRICS: dict[str, dict[str, Any]] = {
    "payload_limit": {"function": _measure, "unit": "kg", "simulates": True},
}
