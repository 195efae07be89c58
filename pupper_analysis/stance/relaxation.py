"""Why a stance is out of reach: the demands that are in the way, and how far they can go."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.errors import ConfigurationError, StanceUnreachableError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.clearance import Shapes
from pupper_analysis.stance.demands import (
    DEMANDS,
    differ,
    far_off,
    in_radians,
    in_words,
    rounded,
    shrunk,
)
from pupper_analysis.stance.judge import Stand, base_is_in_the_ground
from pupper_analysis.stance.problem import Goal, goal_of
from pupper_analysis.stance.search import follow, search
from pupper_analysis.stance.task import StandTask
from pupper_analysis.stance.tasks import TASK_TOLERANCE
from pupper_analysis.stance.yielding import lacking

Array = NDArray[np.float64]

RESOLUTION = 1e-3
"""To what part of itself a limit is found, before it is rounded to what is printed."""

_BEYOND = 1.02
"""Where beyond a limit it is looked whether the stance is in reach again, in parts of the limit."""

_COARSE = 0.2
"""Shares further apart than this are searched for everywhere between."""

DEAD_POINT = "the MJCF's loops are at a dead point: their motors bring the feet no nearer"
"""What is in the way where loops bind joints so."""

_DEAD = 1e-2
"""What loops leave, at most, of the joints' lever on a foot at a dead point: a thousandth of a
radian from it some thousandth."""

_FELT = 1e-6
"""Where a dead point is the cause, feet that miss by less (m) do so by the search's tolerance."""

_TYPED = (1.0, *(1 - 2.0**power * RESOLUTION for power in range(10)))
"""Parts of a limit that are tried as who types them would: the first that stands is stated."""

_NOTHING_LEFT = ("swing", "com_margin")
"""Demands of which a limit of nothing, the nominal stand's, is none to be stated."""

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
    if not at_limit and _is_dead_point(robot, nearest):
        blocked = (DEAD_POINT,)
        missed = {foot: gap for foot, gap in missed.items() if gap >= _FELT}
    return StanceUnreachableError(
        str(goal.task), missed, at_limit, possible, feasible, blocked, ends, lacking(robot, goal)
    )


def _is_dead_point(robot: Robot, nearest: Stand) -> bool:
    """Tells whether loops keep a foot from a direction in which its leg's joints could move it.

    There a motor turns, and what follows it does not, to first order.
    """
    if robot.closure is None:
        return False
    rates = Configuration(robot, nearest.qpos).foot_jacobians()
    ways = robot.closure.ways(nearest.qpos)
    for foot in nearest.stance_feet:
        joints = rates[foot][:3, robot.nv - robot.nu :]
        free, bound = (np.linalg.svd(one, compute_uv=False) for one in (joints, joints @ ways))
        if ((bound < _DEAD * free) & (free > _DEAD * free[0])).any():
            return True
    return False


def furthest(shapes: Shapes, goal: Goal, demands: Sequence[str]) -> Stand | None:
    """Finds how far demands can go from the nominal stand's towards the task's.

    Bisection between a share that is in reach and one that is not. Most shares are tried from the
    last stand alone (``follow``), which is quick; where that ends, the search everywhere has the
    last word. Demands are rounded, towards the nominal stand's, to what is printed: that is in
    reach when it is typed.

    Returns:
        The stand there; None if the demands do not differ from the nominal stand's, or giving them
        up altogether does not help.
    """
    if not differ(shapes.robot, goal.task, demands):
        return None
    way = _Way(shapes, goal, demands)
    if not way.solves(0.0):
        return None
    low, refused, leads = 0.0, 1.0, True  # refused by the search everywhere
    while True:
        high = refused
        while high - low > RESOLUTION * low and high > _LEAST:
            middle = (low + high) / 2
            if leads and way.follows(middle):
                low = middle
            elif leads and high - low <= _COARSE:
                high = middle
            elif way.solves(middle):
                low = middle
            else:
                high = refused = middle
        if high < refused and way.solves(high):
            low, leads = high, False  # there is more than the last stand leads to
            continue
        refused, again = high, min(_BEYOND * low, 1.0)
        if low == 0.0 or again == 1.0 or not (way.solves(again) or way.solves(again, afresh=True)):
            break
        low, refused = again, 1.0
    # Where a stand was only found on the way from another one, who types the limit may not find it.
    parts = _TYPED
    if len(demands) == len(DEMANDS) or not set(demands) & set(_NOTHING_LEFT):
        parts = (*parts, 0.0)
    for part in parts:
        if way.solves_as_typed(part * low):
            return way.stand
    return None


class _Way:
    """Demands on their way from the nominal stand's to the task's; ``stand`` is the last one."""

    def __init__(self, shapes: Shapes, goal: Goal, demands: Sequence[str]) -> None:
        self.shapes, self.goal, self.demands = shapes, goal, demands
        self.stand: Stand | None = None

    def solves(self, share: float, *, afresh: bool = False) -> bool:
        """Tells whether there is a stand at a share, by the search everywhere.

        Args:
            share: From 0, the nominal stand's, to 1, the task's.
            afresh: Not from the last stand first, which leads the search to what is near that.
        """
        goal, hints = self._goal(self._task(share)), []
        if self.stand is not None and not afresh:
            hints = [self.stand.joint_positions(self.shapes.robot)]
        if goal is None or base_is_in_the_ground(self.shapes, goal):
            return False
        return self._found(search(self.shapes, goal, hints))

    def solves_as_typed(self, share: float) -> bool:
        """Tells whether there is a stand at a share as it is printed.

        The search is as for someone who types it: without a hint, each angle in degrees or in
        radians. Where several demands go together, the less of one, by its digits, may ask for more
        of another.
        """
        robot, demands = self.shapes.robot, self.demands
        task = rounded(robot, self._task(share), demands)
        angles = [demand for demand in demands if in_radians(task, [demand]) != task]
        readings = [
            in_radians(task, some)
            for count in range(len(angles), -1, -1)  # degrees alone last: that is what is kept
            for some in combinations(angles, count)
        ]
        for reading in readings:
            goal = self._goal(reading)
            if goal is None or not self._found(search(self.shapes, goal)):
                return False
        return True

    def follows(self, share: float) -> bool:
        """Tells whether there is a stand at a share, as the last one leads to."""
        goal = self._goal(self._task(share))
        if goal is None or self.stand is None:
            return False
        return self._found(follow(self.shapes, goal, self.stand))

    def _task(self, share: float) -> StandTask:
        return shrunk(self.shapes.robot, self.goal.task, self.demands, share)

    def _goal(self, task: StandTask) -> Goal | None:
        try:
            return goal_of(self.shapes.robot, task, self.goal.depths)
        except ConfigurationError:
            return None

    def _found(self, stand: Stand | None) -> bool:
        if stand is None or not stand.solved:
            return False
        self.stand = stand
        return True
