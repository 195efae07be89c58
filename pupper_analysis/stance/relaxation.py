"""Why a stance is out of reach: as few demands as are found that must give, and how far."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, StanceUnreachableError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.constraints import TASK_TOLERANCE
from pupper_analysis.stance.demands import (
    DEMANDS,
    DemandVector,
    describe_limit,
    differs_from_nominal,
    relax_further,
    reset_to_nominal,
    round_outward,
)
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.problem import Goal, make_goal
from pupper_analysis.stance.programme import Relaxation, StanceProgram
from pupper_analysis.stance.search import find_missing_joints, search_stand
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.task import StandTask

Array = NDArray[np.float64]

_DEAD_POINT_RATIO = 1e-2
"""What loops leave, at most, of the joints' lever on a foot at a dead point: a thousandth of a
radian from it some thousandth."""

_LEAST_MISS = 1e-6
"""Where a dead point is the cause, feet that miss by less (m) do so by the search's tolerance."""

_FURTHER = (0.0, 1e-3, 4e-3, 1.6e-2, 6.4e-2)
"""By what parts demands give more, if they are not met as they are printed: at the end of reach a
search from scratch may not find what the elastic problem leads to."""

_NOTHING_LEFT = ("swing", "com_margin")
"""Demands of which next to nothing is no limit to be stated: a foot that is not lifted carries, and
without a margin a com with an offset may be outside the support polygon."""

_NOTHING = 1e-3
"""How much is next to nothing (stand heights)."""

_LESS = (0.03, 0.01)
"""By what parts a demand is tried to give less than the problem says, as long as that helps: v3's
slope ended at two edges in turn, 6 % and 1 % of what it gave before the last."""

_GIVES = 1e-6
"""A demand that gives less does not (stand heights, rad)."""


def explain_refusal(
    context: SearchContext, goal: Goal, nearest: Stand, *, explain: bool
) -> StanceUnreachableError:
    """Returns the error for a goal that no stand satisfies.

    Args:
        context: The robot's.
        goal: The goal.
        nearest: The best failure.
        explain: Find out which demands are in the way, as few as possible, and how far they can go.
    """
    robot = context.robot
    feet = Configuration(robot, nearest.qpos).foot_positions()
    gaps = {foot: float(np.linalg.norm(feet[foot] - goal.targets[foot])) for foot in feet}
    joints = nearest.joint_positions(robot)
    at_limit: dict[str, float] = {}
    placed = goal.lower == goal.upper  # in a posture: at no limit
    for limits in (goal.lower, goal.upper):
        for index in np.flatnonzero((np.abs(joints - limits) < 1e-6) & ~placed):
            at_limit[robot.joint_names[index]] = float(limits[index])
    missed = {foot: gap for foot, gap in gaps.items() if gap >= TASK_TOLERANCE}
    blocked = () if missed else nearest.blocked
    if not missed and not blocked:  # the feet are in place with loops or couplings open
        blocked = (diagnose("loops-stay-open", most=Quantity(nearest.foot_error, "rad or m")),)
    if not at_limit and _is_dead_point(robot, nearest):
        blocked = (diagnose("motors-at-dead-point"),)
        missed = {foot: gap for foot, gap in missed.items() if gap >= _LEAST_MISS}
    basis = _Search(context, goal, nearest).found() if explain else []
    named = {" and ".join(way.demands): way for way in basis}
    least = min(basis, key=lambda way: way.slack, default=None)
    return StanceUnreachableError(
        goal.task.phrase(),
        missed,
        at_limit,
        {
            name: describe_limit(robot, goal.task, way.stand.task, way.demands)
            for name, way in named.items()
        },
        None if least is None else least.stand,
        blocked,
        {
            name: {demand: getattr(way.stand.task, demand) for demand in way.demands}
            for name, way in named.items()
        },
        find_missing_joints(robot, goal),
    )


def _is_dead_point(robot: Robot, nearest: Stand) -> bool:
    """Tells whether loops keep a foot from a direction in which its leg's joints could move it.

    There a motor turns, and what follows it does not, to first order.
    """
    if robot.closure is None:
        return False
    rates = Configuration(robot, nearest.qpos).foot_jacobians()
    basis = robot.closure.null_space(nearest.qpos)
    for foot in nearest.stance_feet:
        joints = rates[foot][:3, robot.nv - robot.nu :]
        free, bound = (np.linalg.svd(one, compute_uv=False) for one in (joints, joints @ basis))
        if ((bound < _DEAD_POINT_RATIO * free) & (free > _DEAD_POINT_RATIO * free[0])).any():
            return True
    return False


@dataclass(frozen=True, eq=False)
class _Way:
    """Demands that give, and a stand that fulfils what is left of them and all else."""

    demands: tuple[str, ...]
    slack: float
    stand: Stand


class _Search:
    """The ways in which a goal that is out of reach may give.

    Args:
        context: The robot's.
        goal: The goal.
        nearest: The best failure.
    """

    def __init__(self, context: SearchContext, goal: Goal, nearest: Stand) -> None:
        self.context, self.goal = context, goal
        home = context.robot.home.copy()
        home[:2] = goal.centre[:2]
        self.starts = [nearest.qpos, home]

    def found(self) -> list[_Way]:
        """Returns each demand that alone may give, or else as few as are found that together do."""
        robot, task = self.context.robot, self.goal.task
        differing = [demand for demand in DEMANDS if differs_from_nominal(robot, task, [demand])]
        alone = [self._stated(self._alone(demand)) for demand in differing]
        if found := [way for way in alone if way is not None]:
            return found
        least = self._least(differing, self.starts)
        fewest = self._stated(self._fewest(least)) or self._stated(least)
        return [] if fewest is None else [fewest]

    def _least(self, demands: Sequence[str], starts: Iterable[Array]) -> Relaxation | None:
        """Returns how demands give least, from the best of some starts; None if they do not help.

        One more is a stand without the demands, if there is one: from there they are taken as far
        as they go. Where several demands must give, that led to the best in 27 of 28 refusals.
        """
        elastic = StanceProgram(self.context.shapes, self.goal, demands)
        basis = [elastic.solve(start) for start in starts]
        without = reset_to_nominal(self.context.robot, self.goal.task, demands)
        stand = search_stand(self.context, self._goal(without), usual_starts_only=True)
        if stand.solved:
            basis.append(elastic.solve(stand.qpos, without))
        return min((way for way in basis if way.is_met), key=lambda way: way.slack, default=None)

    def _alone(self, demand: str) -> Relaxation | None:
        """Returns how a demand alone gives least; None if it does not help.

        What the problem ends at may be least among its neighbours alone: stands further on are
        tried, and where there is one, it begins anew from there.
        """
        way = self._least([demand], self.starts)
        shares = list(_LESS)
        while way is not None and shares:
            less = relax_further(self.context.robot, way.task, self.goal.task, [demand], -shares[0])
            stand = search_stand(self.context, self._goal(less), com_at_centre_only=True)
            if not stand.solved:
                shares.pop(0)
                continue
            better = StanceProgram(self.context.shapes, self.goal, [demand]).solve(stand.qpos, less)
            if not better.is_met or better.slack > (1 - shares[0] / 2) * way.slack:
                break
            way = better
        return way

    def _fewest(self, way: Relaxation | None) -> Relaxation | None:
        """Returns a way in which no demand gives that need not, those that give little first."""
        if way is None:
            return None
        given = {demand: slack for demand, slack in way.given.items() if slack > _GIVES}
        for demand in sorted(given, key=given.__getitem__):
            rest = [
                other for other in given if other != demand and way.given.get(other, 0.0) > _GIVES
            ]
            if way.given.get(demand, 0.0) > _GIVES and len(rest) > 1:
                way = self._least(rest, (way.qpos,)) or way
        return way

    def _stated(self, way: Relaxation | None) -> _Way | None:
        """Returns a way as it can be reported; None if it cannot be typed and found."""
        if way is None:
            return None
        robot = self.context.robot
        demands = tuple(demand for demand, slack in way.given.items() if slack > _GIVES)
        if not demands:
            return None
        for share in _FURTHER:
            task = self._rounded(way, demands, share)
            if task is None or any(_is_nothing(robot, task, demand) for demand in demands):
                continue
            if (stand := self._stand(task)) is not None:
                return _Way(demands, way.slack, stand)
        return None

    def _rounded(self, way: Relaxation, demands: Sequence[str], share: float) -> StandTask | None:
        """Returns the task of a way as it is reported, its demands giving more by a share.

        One after the other, those that give most first: where one has been rounded, the others
        give as little as that leaves them.
        """
        robot, asked, task, left = self.context.robot, self.goal.task, self.goal.task, [*demands]
        while way.is_met:
            demand = max(left, key=way.given.__getitem__)
            left.remove(demand)
            there = relax_further(robot, way.task, asked, [demand], share)
            end = round_outward(robot, there, asked, [demand])
            task = replace(task, **{demand: getattr(end, demand)})
            if not left:
                return task
            elastic = StanceProgram(self.context.shapes, self._goal(task), left)
            way = elastic.solve(way.qpos, way.task)
        return None

    def _stand(self, task: StandTask) -> Stand | None:
        """Returns the stand of a task, as who types it finds it."""
        try:
            goal = self._goal(task, checked=True)
        except ConfigurationError:
            return None
        stand = search_stand(self.context, goal)
        return stand if stand.solved else None

    def _goal(self, task: StandTask, *, checked: bool = False) -> Goal:
        """Returns a task's goal, with feet as deep and loops as open as the refused one's."""
        goal = make_goal(self.context.robot, task, self.goal.depths, checked=checked)
        return replace(goal, give=self.goal.give)


def _is_nothing(robot: Robot, task: StandTask, demand: str) -> bool:
    """Tells whether next to nothing is left of a demand of which that is no limit."""
    least = _NOTHING * robot.stand_height
    return demand in _NOTHING_LEFT and bool(
        (DemandVector(robot, task, [demand]).values < least).any()
    )
