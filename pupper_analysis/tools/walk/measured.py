"""Where a real robot's numbers are, by a fit's file, in the quantities that are varied."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import orjson

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.base.inputs import MOST_TEXT, read_input
from pupper_analysis.robot.robot import Robot

KINDS: Mapping[str, str] = {"mass": "mass", "com": "com", "kp": "kp", "kd": "kd", "delay": "delay"}
"""{kind of a fit's parameters: the quantity}. A fit's friction is that of joints, not of ground."""


def measured_intervals(
    path: str | Path, robot: Robot, latency: float = 0.0
) -> dict[str, tuple[float, float]]:
    """Returns where a real robot's quantities are with 95 %, as ``fit`` found.

    Mass and centre of mass are the base's; of several joints' gains the widest interval counts, as
    a factor of what is stated; a delay is what there is more than the policy's latency.

    Args:
        path: A fit's JSON: ``fit.json``, or that of ``--json``.
        robot: The robot.
        latency: Of the policy (s).

    Raises:
        ModelError: If it is no fit's, or has nothing of what can be varied.
    """
    try:
        data = orjson.loads(read_input(Path(path), MOST_TEXT))
    except InputError as error:
        raise ModelError(error.path, error.cause) from error
    except orjson.JSONDecodeError as error:
        raise ModelError(path, diagnose("policy-not-json", problem=str(error))) from error
    bases = {robot.mj_base, robot.base}
    found: dict[str, tuple[float, float]] = {}
    for one in _estimates(data):
        try:
            kind, subject, component = one["kind"], one["subject"], one["component"]
            stated, low, high = (float(one[name]) for name in ("stated", "low", "high"))
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(path, diagnose("no-fit")) from error
        if kind not in KINDS or not all(map(math.isfinite, (stated, low, high))):
            continue
        if kind in ("mass", "com") and (subject not in bases or component not in ("", "x")):
            continue
        if kind == "delay":
            low, high = max(low - latency, 0.0), max(high - latency, 0.0)
        elif kind == "com":
            low, high = low - stated, high - stated
        elif stated > 0:
            low, high = low / stated, high / stated
        else:
            continue
        before = found.get(KINDS[kind], (low, high))
        found[KINDS[kind]] = (min(low, before[0]), max(high, before[1]))
    if not found:
        raise ModelError(path, diagnose("no-fit"))
    return found


def _estimates(data: Any) -> list[Any]:
    """Returns the rows of a fit's JSON, whichever of the two it is."""
    for key in ("estimates", "parameters"):
        rows = data.get(key) if isinstance(data, dict) else None
        if isinstance(rows, list):
            return rows
    return []
