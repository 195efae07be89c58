"""Why a stance is out of reach: the demands that are in the way, and how far they can go."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.errors import ConfigurationError, StanceUnreachableError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.stance.clearance import Shapes
from pupper_analysis.stance.demands import DEMANDS, differ, far_off, in_words, rounded, shrunk
from pupper_analysis.stance.problem import Goal, goal_of
from pupper_analysis.stance.search import search
from pupper_analysis.stance.solver import TASK_TOLERANCE, Stand

Array = NDArray[np.float64]

RESOLUTION = 1e-3
"""To what part of itself a limit is found, before it is rounded to what is printed."""

_BEYOND = 1.02
"""Where beyond a limit it is looked whether the stance is in reach again, in parts of the limit."""

_LEAST = 1e-7
"""A share of what is asked that is as good as none: 1e7 times too much."""


def unreachable(
    shapes: Shapes, goal: Goal, nearest: Stand, *, explain: bool
) -> StanceUnreachableError:
    """Returns the error for a goal that no stand satisfies.

    Args:
        shapes: The robot with its shapes.
        goal: The goal.
        nearest: The best failure.
        explain: Find out which demands are in the way, as few as possible, and how far they can go.
    """
    robot = shapes.robot
    feet = Configuration(robot, nearest.qpos).foot_positions()
    gaps = {foot: float(np.linalg.norm(feet[foot] - goal.targets[foot])) for foot in feet}
    joints = nearest.joint_positions(robot)
    at_limit: dict[str, float] = {}
    for limits in (goal.lower, goal.upper):
        for index in np.flatnonzero(np.abs(joints - limits) < 1e-6):
            at_limit[robot.joint_names[index]] = float(limits[index])
    missed = {foot: gap for foot, gap in gaps.items() if gap >= TASK_TOLERANCE}
    possible: dict[str, str] = {}
    ends: dict[str, dict[str, object]] = {}
    feasible = stand = None
    if explain:
        differing = [d for d in DEMANDS if differ(robot, goal.task, [d])]
        for size in range(1, len(differing) + 1):
            for demands in combinations(differing, size):
                stand = furthest(shapes, goal, demands)
                if stand is not None:
                    name = " and ".join(demands)
                    possible[name] = " and ".join(f"{d} {in_words(stand.task, d)}" for d in demands)
                    if far_off(robot, goal.task, stand.task, demands):
                        possible[name] += " (was that in metres, or radians?)"
                    ends[name] = {demand: getattr(stand.task, demand) for demand in demands}
            if possible:
                break
        if len(differing) > 1 or not possible:
            stand = furthest(shapes, goal, DEMANDS)
        feasible = stand
    blocked = () if missed else nearest.blocked
    return StanceUnreachableError(
        str(goal.task), missed, at_limit, possible, feasible, blocked, ends
    )


def furthest(shapes: Shapes, goal: Goal, demands: Sequence[str]) -> Stand | None:
    """Finds how far demands can go from the nominal stand's towards the task's.

    Bisection between a share that is in reach and one that is not. Demands are rounded, towards the
    nominal stand's, to what is printed: that is in reach when it is typed.

    Returns:
        The stand there; None if the demands do not differ from the nominal stand's, or giving them
        up altogether does not help.
    """
    robot, task = shapes.robot, goal.task
    if not differ(robot, task, demands):
        return None
    hints: list[Array] = []

    def at(share: float, *, round_off: bool = False) -> Stand | None:
        smaller = shrunk(robot, task, demands, share)
        if round_off:
            smaller = rounded(robot, smaller, demands)
        try:
            stand = search(shapes, goal_of(robot, smaller, goal.depths), hints)
        except ConfigurationError:
            return None
        if not stand.solved:
            return None
        hints[:] = [stand.joint_positions(robot)]
        return stand

    best = at(0.0)
    if best is None:
        return None
    low, high = 0.0, 1.0
    while True:
        while high - low > RESOLUTION * low and high > _LEAST:
            middle = (low + high) / 2
            stand = at(middle)
            if stand is None:
                high = middle
            else:
                best, low = stand, middle
        again = min(_BEYOND * low, 1.0)
        if low == 0.0 or again == 1.0 or at(again) is None:
            break
        low, high = again, 1.0
    for less in (0.0, 1.0, 2.0, 4.0, 8.0):
        stand = at(low * (1 - less * RESOLUTION), round_off=True)
        if stand is not None:
            return stand
    return best
