"""What a robot whose base is held carries at its tool: in a posture, and in every one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.arguments import check_arguments
from pupper_analysis.posture.posture import Posture, check_held
from pupper_analysis.posture.ways import bound_together
from pupper_analysis.posture.worst import WorstPostures, worst_postures
from pupper_analysis.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool
from pupper_analysis.stance.payload.first_order import borne_by_motors
from pupper_analysis.stance.payload.limit import UNLIMITED

Array = NDArray[np.float64]

_ROUNDS = 6
"""Worst postures for lesser and lesser payloads: two or three mostly suffice."""

_SETTLED = 1e-4
"""A search ends where a payload changes by less of itself."""


@dataclass(frozen=True, eq=False)
class ToolPayload(Result):
    """The greatest point masses that the motors hold at a tool.

    Attributes:
        mass: In the posture (kg); infinite if no motor that bears it has a limit.
        joint: Whose motor then is at its limit; "" if none is.
        everywhere: In every posture (kg), by what bounds the torques: no motor is beyond its limit
            anywhere. Not a number where there is no bound.
        somewhere: With more than this, a posture was found that is not held (kg).
        weakest: The joint whose motor is beyond its limit there; "" if none is.
        posture: (nu,) that posture (rad, m).
    """

    mass: float
    joint: str
    everywhere: float
    somewhere: float
    weakest: str
    posture: Array


@check_arguments
def tool_payload(robot: Robot, posture: Posture, tool: Tool, worst: WorstPostures) -> ToolPayload:
    """Finds the greatest point masses that the motors hold at a tool.

    In a posture torques are linear in the mass, and the limit is in closed form. In every posture
    the greatest torque is convex in the mass m, as the greatest of linear ones: what bounds it at 0
    and at M bounds it between by the chord. M is lowered to what the worst postures for M hold,
    until these hold M.

    Args:
        robot: A robot whose base is held.
        posture: The posture.
        tool: Where the mass is.
        worst: The worst postures without it.

    Raises:
        ConfigurationError: If the base is free.
    """
    check_held(robot)
    mass, joint = posture_payload(robot, posture.qpos, tool)
    most, weakest, place = _least(robot, tool, [posture.qpos, *worst.postures])
    most = min(most, UNLIMITED * robot.total_mass)
    loaded = worst
    for _ in range(_ROUNDS if most > 0 else 0):
        loaded = worst_postures(robot, posture, tool, payload=most, near=loaded)
        lower, name, at = _least(robot, tool, list(loaded.postures))
        if not lower < most:
            break
        done = lower > (1 - _SETTLED) * most
        most, weakest, place = lower, name, at
        if done:
            break
    proven = _proven(worst, loaded, _bearing(robot, posture, tool), most)
    return ToolPayload(
        mass=mass,
        joint=joint,
        everywhere=math.inf if proven >= most and not weakest else proven,
        somewhere=most if weakest else math.inf,
        weakest=weakest,
        posture=place,
    )


def posture_payload(robot: Robot, qpos: Array, tool: Tool) -> tuple[float, str]:
    """Returns the greatest mass (kg) at a tool in a posture (nu,), and whose motor binds."""
    config, limits = Configuration(robot, qpos), robot.effort_limits
    empty = config.by_motors(config.load())
    rates = config.by_motors(tool.load_per_mass(config))
    over = np.abs(empty) > limits
    if over.any():
        return 0.0, robot.joint_names[int(np.argmax(np.abs(empty) - limits))]
    mass = borne_by_motors(empty, rates, limits)
    if not math.isfinite(mass):
        return math.inf, ""
    left = np.where(np.isfinite(limits), limits - np.abs(empty + mass * rates), math.inf)
    return mass, robot.joint_names[int(np.argmin(left))]


def _least(robot: Robot, tool: Tool, postures: list[Array]) -> tuple[float, str, Array]:
    """Returns the least that is carried in some postures, whose motor binds there, and where."""
    found = [(*posture_payload(robot, qpos, tool), qpos) for qpos in postures]
    return min(found, key=lambda one: one[0])


def _proven(
    empty: WorstPostures, loaded: WorstPostures, bears: NDArray[np.bool_], most: float
) -> float:
    """Returns the mass (kg) up to which bounds, without and with ``most``, prove that all hold.

    A motor without a bound that bears none of it (of those that do, ``bears`` (nu,)) is none of
    the payload's matter; nor is one without a limit.
    """
    known, limits = np.isfinite(loaded.bounds), empty.limits
    if (~known & bears & np.isfinite(limits)).any():
        return math.nan
    before, after, limits = empty.bounds[known], loaded.bounds[known], limits[known]
    if (before > limits).any():
        return 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (limits - before) / (after - before)
    return most * float(np.min(share[after > limits], initial=1.0))


def _bearing(robot: Robot, posture: Posture, tool: Tool) -> NDArray[np.bool_]:
    """Tells which motors (nu,) may bear a payload: those that move it, or what moves with them."""
    bears = np.isin(robot.joint_names, tool.chain)
    closure = robot.closure
    for joints in [] if closure is None else bound_together(closure, posture.qpos):
        bears[joints] |= bears[joints].any()
    return bears
