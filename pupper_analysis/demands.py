"""What a task demands beyond the nominal stand, and how it gives way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pupper_analysis.configuration import Configuration
from pupper_analysis.robot import Robot
from pupper_analysis.task import StandTask

_LENGTHS = ("ground_clearance", "self_clearance")
DEMANDS = (
    *("height", "roll", "pitch", "yaw", "offset", "feet", "foot_offsets", "lifted", "ground"),
    *_LENGTHS,
)
"""The fields of a task that may put a stance out of reach."""


def differ(robot: Robot, task: StandTask, demands: Sequence[str]) -> bool:
    """Tells whether some demands are not the nominal stand's."""
    return shrunk(robot, task, demands, 0.0) != shrunk(robot, task, demands, 1.0)


def shrunk(robot: Robot, task: StandTask, demands: Sequence[str], share: float) -> StandTask:
    """Returns a task with some demands between the nominal stand's (0) and its own (1)."""
    changes: dict[str, object] = {}
    nominal = Configuration(robot, robot.neutral()).foot_positions()
    for demand in demands:
        value = getattr(task, demand)
        if demand == "height":
            height = robot.stand_height if value is None else value
            changes[demand] = robot.stand_height + share * (height - robot.stand_height)
        elif demand in ("roll", "pitch", "yaw") or (demand in _LENGTHS and value is not None):
            changes[demand] = share * value
        elif demand == "offset" and value is not None:
            changes[demand] = (share * value[0], share * value[1])
        elif demand == "feet":
            moved = {
                f: nominal[f][:2] + share * (np.array(p) - nominal[f][:2]) for f, p in value.items()
            }
            changes[demand] = {f: (float(p[0]), float(p[1])) for f, p in moved.items()}
        elif demand == "foot_offsets":
            changes[demand] = {foot: (share * x, share * y) for foot, (x, y) in value.items()}
        elif demand == "lifted":
            changes[demand] = {foot: max(share, 1e-9) * height for foot, height in value.items()}
        elif demand == "ground":
            heights = {foot: share * height for foot, height in value.heights.items()}
            changes[demand] = replace(value, slope=share * value.slope, heights=heights)
    return replace(task, **changes)  # type: ignore[arg-type]


def in_words(task: StandTask, demand: str) -> str:
    """Returns a demand's value with its unit."""
    value = getattr(task, demand)
    if demand == "height":
        return f"{value:.3f} m"
    if demand in ("roll", "pitch", "yaw"):
        return f"{math.degrees(value):.1f} deg"
    if demand == "ground":
        steps = ", ".join(f"{foot} {1e3 * h:.0f} mm" for foot, h in value.heights.items())
        return f"slope {math.degrees(value.slope):.1f} deg" + (f", steps {steps}" if steps else "")
    if demand == "lifted":
        return ", ".join(f"{foot} {1e3 * h:.0f} mm" for foot, h in value.items())
    if demand in _LENGTHS:
        return f"{1e3 * value:.1f} mm"
    if demand == "offset":
        return f"({1e3 * value[0]:.0f}, {1e3 * value[1]:.0f}) mm"
    return ", ".join(f"{foot} ({1e3 * x:.0f}, {1e3 * y:.0f}) mm" for foot, (x, y) in value.items())
