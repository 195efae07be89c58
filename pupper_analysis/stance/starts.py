"""Where a search for a stand begins: the usual postures, then every way to bend the legs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.branches import Branch, Limb, combinations
from pupper_analysis.stance.problem import Goal

Array = NDArray[np.float64]

NEAR_MISS = 1e-3
"""Feet that miss by less (m) may be in reach with the com's last micrometres."""


def starts(robot: Robot, goal: Goal) -> Iterator[Array]:
    """Yields joint positions to start from: the ik_seed, home, the middle of the limits."""
    if goal.task.ik_seed is not None:
        yield np.array(goal.task.ik_seed)
    yield robot.home[7:]
    bounded = np.isfinite(goal.lower) & np.isfinite(goal.upper)
    middle = (np.where(bounded, goal.lower, 0) + np.where(bounded, goal.upper, 0)) / 2
    yield np.where(bounded, middle, 0.0)


def choices(
    robot: Robot, goal: Goal, found: Mapping[Limb, tuple[Branch, ...]], reach: float, most: int
) -> Iterator[Array]:
    """Yields a start for every choice of the legs' branches that may be in reach.

    Args:
        robot: The robot.
        goal: The goal.
        found: {limb: its branches}.
        reach: How far the base may be from where they were found (m): a foot that misses by more
            stays out of reach, since its distance changes by no more than the base moves.
        most: How many at most.
    """
    near = robot.home[7:] if goal.task.ik_seed is None else np.array(goal.task.ik_seed)
    likely = {
        limb: tuple(branch for branch in ways if branch.miss <= reach + NEAR_MISS)
        for limb, ways in found.items()
    }
    yield from islice(combinations(likely, near), most)
