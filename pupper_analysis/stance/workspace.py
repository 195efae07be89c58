"""How far a robot's stand can go with its feet planted: heights, angles and shifts."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot, lend
from pupper_analysis.stance.problem import can_move_com, make_goal
from pupper_analysis.stance.search import follow_stand, search_stand
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.stand import Stand, solve_stand
from pupper_analysis.stance.task import StandTask

Array = NDArray[np.float64]

BISECTION_RTOL = 1e-3
"""To what part of the step first tried a limit is found."""

_COARSE = 0.4
"""Longer parts of the step first tried are searched for everywhere."""

_RESTART = 0.2
"""The step, in parts of the first, with which it goes on where there was more than expected."""

_GAP = 8e-3
"""Where a stand is out of reach, one further on by this part of the step first tried may not be:
with the legs bent another way. v3's pitch has such a gap of 1.3 mrad."""

DIRECTIONS = ("height", "roll", "pitch", "yaw", "x", "y")
_FIRST_STEP = {"height": 0.1, "roll": 0.4, "pitch": 0.4, "yaw": 0.4, "x": 0.05, "y": 0.05}
_WIDEST = {"roll": math.pi, "pitch": math.pi / 2, "yaw": math.pi}


@dataclass(frozen=True)
class Interval(Result):
    """How far one coordinate can go, all others as they are.

    Attributes:
        low: The least value (m, or rad).
        high: The greatest (m, or rad).
    """

    low: float = field(metadata={"unit": "m"})
    high: float = field(metadata={"unit": "m"})


@dataclass(frozen=True, eq=False)
class BaseWorkspace(Result):
    """How far the base can go from a stand, in each direction alone, with the feet planted.

    Attributes:
        name: The robot's name.
        start: The stand where the search began.
        intervals: {``height`` (m, absolute), ``roll``, ``pitch``, ``yaw`` (rad, absolute), ``x``,
            ``y`` (m, of the base from the centre of the feet)}.
    """

    name: str
    start: Stand
    intervals: dict[str, Interval] = field(metadata={"unit": "m or rad"})


@check_arguments
def reachable_heights(robot: Robot, task: StandTask | None = None) -> Interval:
    """Finds the least and the greatest height of the base (m) with all else as the task has it.

    As ``base_workspace`` does, com included.

    Args:
        robot: The robot.
        task: Its height is where the search begins; the nominal stand by default.

    Raises:
        StanceUnreachableError: If the task itself is out of reach.
        ConfigurationError: If the robot cannot stand.
    """
    start = solve_stand(robot, task)
    return find_interval(start.check(robot), start, "height")


@check_arguments
def base_workspace(robot: Robot, task: StandTask | None = None) -> BaseWorkspace:
    """Finds how far the base can rise, roll, pitch, yaw and shift with its feet planted.

    Each direction is searched on its own, outwards from the task, to where a stand is first out of
    reach, with the com where the task has it; if that may lie anywhere inside the support polygon,
    where the task's stand has it, or anywhere for legs that cannot hold it there (those of two
    joints). Shifts are those of the base; the com follows, and must stay
    inside with the task's margin. Roll and yaw are searched up to pi, pitch up to pi / 2: beyond
    that, angles of roll, pitch and yaw name turns that others name, too.

    Args:
        robot: The robot.
        task: Where the search begins; the nominal stand by default.

    Raises:
        StanceUnreachableError: If the task itself is out of reach.
        ConfigurationError: If the robot cannot stand.
    """
    start = solve_stand(robot, task)
    robot = start.check(robot)
    intervals = {direction: find_interval(robot, start, direction) for direction in DIRECTIONS}
    return BaseWorkspace(name=robot.name, start=start, intervals=intervals)


def find_interval(
    robot: Robot,
    start: Stand,
    direction: str,
    enough: float = math.inf,
    *,
    usual_starts_only: bool = False,
) -> Interval:
    """Finds how far the base can go in one direction, both ways; see ``base_workspace``.

    Args:
        robot: The robot.
        start: Where the search begins.
        direction: One of ``DIRECTIONS``.
        enough: How far (m, or rad) is not asked beyond: an end that is further may be any.
        usual_starts_only: Search from the usual initial guesses only, not in all IK branches.
    """
    low, high = (
        _limit(robot, start, direction, way, enough, usual_starts_only) for way in (-1.0, 1.0)
    )
    return Interval(low, high)


def _limit(
    robot: Robot, start: Stand, direction: str, sign: float, enough: float, usual_starts_only: bool
) -> float:
    """Steps outwards until a stand is out of reach, then halves the step.

    Short steps are tried from the last stand alone, which is quick; where that ends, the search
    everywhere has the last word.
    """
    first, most = _FIRST_STEP[direction], _WIDEST.get(direction, math.inf)
    begin = value = _value(robot, start, direction)
    step, least, last = first, BISECTION_RTOL * first, start
    shortest = _COARSE * first  # of the steps that are searched for everywhere

    def goes(further: float, near: Stand | None = None) -> bool:
        nonlocal value, last
        if abs(further) > most:
            return False
        found = _reached(robot, start, direction, further, near, usual_starts_only)
        if found is not None:
            value, last = further, found
        return found is not None

    while step > least and abs(value - begin) < enough:
        further, gap = value + sign * step, value + sign * _GAP * first
        if goes(further, last) or (step > shortest and goes(further)):
            continue
        if step <= 2 * least < shortest and (goes(further) or goes(gap)):
            step, shortest = _RESTART * first, 0.0  # there is more than the last stand leads to
        else:
            step /= 2
    while value != begin and not goes(value):  # it must be in reach of who asks for that alone
        value = begin + sign * max(0.0, abs(value - begin) - least)
        least *= 2
    return value


def _value(robot: Robot, start: Stand, direction: str) -> float:
    if direction in ("x", "y"):
        return float(_offset(robot, start)["xy".index(direction)])
    return float(getattr(start.task, direction))


def _offset(robot: Robot, start: Stand) -> Array:
    """Returns the base's place from the centre of the feet (2,) (m)."""
    offset: Array = start.qpos[:2] - start.centre(robot)[:2]
    return offset


def _reached(
    robot: Robot,
    start: Stand,
    direction: str,
    value: float,
    near: Stand | None,
    usual_starts_only: bool,
) -> Stand | None:
    """Returns a stand that is reached, and can be held: from another one near it, or from all."""
    try:
        goal = make_goal(robot, _task_at(robot, start, direction, value), {})
    except ConfigurationError:
        return None
    with lend(robot, SearchContext) as context:
        if near is None:
            stand: Stand | None = search_stand(context, goal, usual_starts_only=usual_starts_only)
        else:
            stand = follow_stand(context, goal, near)
    if stand is None or not stand.solved:
        return None
    if direction in ("x", "y") and stand.com_margin < start.task.com_margin:
        return None
    return stand


def _task_at(robot: Robot, start: Stand, direction: str, value: float) -> StandTask:
    changes: dict[str, Any] = {direction: value}
    if start.task.com == "inside" and can_move_com(robot):
        x, y, _ = Configuration(robot, start.qpos).center_of_mass().tolist()
        changes |= {"com": (x, y), "com_margin": 0.0}
    if direction in ("x", "y"):
        x, y = _offset(robot, start).tolist()
        place = (value, y) if direction == "x" else (x, value)
        changes = {"com": "centre", "offset": place}
    return replace(start.task, **changes)
