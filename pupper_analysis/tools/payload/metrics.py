"""Metric of studies: the largest payload [kg]. ``METRICS``: {name: arguments of the metric}."""

from __future__ import annotations

from typing import Any

from pupper_analysis.tools.payload.limit import payload_limit


def _measure_payload(design: Any) -> float:
    """Compute the largest payload [kg] of a design of a study; NaN if the payload is unknown."""
    return payload_limit(design.robot, design.stand, design.point, **design.gains).mass


METRICS: dict[str, dict[str, Any]] = {
    "payload_limit": {"function": _measure_payload, "unit": "kg", "simulates": True},
}
"""{name of a metric of studies: arguments of `Metric` except the name}."""
