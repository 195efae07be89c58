"""The sliders of a page: how far each goes, for one robot."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import own_servos


@dataclass(frozen=True)
class Range:
    """How a slider goes.

    Attributes:
        low: Where it begins.
        high: Where it ends.
        step: From notch to notch.
        value: Where it is on a page just opened.
    """

    low: float
    high: float
    step: float
    value: float


def ranges_of(robot: Robot, scales: dict[str, float]) -> dict[str, Range]:
    """Returns the range of each slider: in mm, degrees, kg and N m/rad.

    Lengths are parts of the height of the nominal stand, so that they suit a robot of any size.

    Args:
        robot: The robot.
        scales: {name of a scale that it can be made with: its own}.
    """
    size = 1e3 * robot.stand_height
    aside, lift = round_up(0.6 * size), round_up(0.8 * size)
    found = {
        "height": Range(round_up(0.3 * size), round_up(1.8 * size), fine(1.5 * size), size),
        "roll": Range(-45.0, 45.0, 0.1, 0.0),
        "pitch": Range(-45.0, 45.0, 0.1, 0.0),
        "yaw": Range(-60.0, 60.0, 0.1, 0.0),
        "com_margin": Range(0.0, round_up(0.4 * size), fine(0.4 * size), 0.0),
        "joint_margin": Range(0.0, 45.0, 0.1, 0.0),
        "ground_clearance": Range(0.0, round_up(0.8 * size), fine(0.8 * size), 0.0),
        "self_clearance": Range(0.0, round_up(0.2 * size), fine(0.2 * size), 0.0),
        "lift_height": Range(fine(lift), lift, fine(lift), min(20.0, lift)),
        "step": Range(-lift, lift, fine(lift), 0.0),
        "slope": Range(0.0, 45.0, 0.1, 0.0),
        "uphill": Range(-180.0, 180.0, 1.0, 0.0),
        "payload": Range(0.0, round_up(2 * robot.total_mass), fine(2 * robot.total_mass), 0.0),
    }
    for name in ("offset_x", "offset_y", "move_x", "move_y"):
        found[name] = Range(-aside, aside, fine(aside), 0.0)
    reach = round_up(1.5 * size)
    for name in ("payload_x", "payload_y", "payload_z"):
        found[name] = Range(-reach, reach, fine(reach), 0.0)
    for name, own in scales.items():
        found[name] = Range(min(0.5, own), max(2.5, own), 0.01, own)
    return found | _gains(robot)


def _gains(robot: Robot) -> dict[str, Range]:
    """Returns the ranges of kp and kd, around the model's own."""
    own = own_servos(robot)
    found = {}
    for number, name in enumerate(("kp", "kd")):
        values = [gains[number] for gains in own.values()]
        middle = float(np.median(values)) if values else 0.0
        middle = middle or (20.0 if name == "kp" else 0.5)
        high = round_up(8 * middle)
        low = fine(high) if name == "kp" else 0.0
        found[name] = Range(low, high, fine(high), middle)
    return found


def fine(span: float) -> float:
    """Returns a step of which a span has some hundreds: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(span / 200))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= span / 400)


def round_up(value: float) -> float:
    """Returns the next number of one digit, or of one and a half."""
    power = 10.0 ** math.floor(math.log10(value))
    factors = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return next(round(f * power, 9) for f in factors if f * power >= value * (1 - 1e-9))
