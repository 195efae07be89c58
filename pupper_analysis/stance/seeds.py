"""Where a search for a stand begins: the usual postures, every way to bend the legs, com places."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.branches import Branch, Limb, combine_branches
from pupper_analysis.stance.problem import Goal
from pupper_analysis.statics.support_polygon import support_polygon

Array = NDArray[np.float64]

NEAR_MISS = 1e-3
"""Feet that miss by less (m) may be in reach with the com's last micrometres."""

_OUTWARDS = 0.8
"""How far towards the support polygon's corners searches begin: there the com can still move."""

_SLACK = 1.5
"""How much further than the legs' branches shift the com the base may be off, for a com's place."""


def posture_seeds(robot: Robot, goal: Goal) -> Iterator[Array]:
    """Yields joint positions to start from: the ik_seed, home, the middle of the limits."""
    if goal.task.ik_seed is not None:
        yield np.array(goal.task.ik_seed)
    yield robot.home[7:]
    bounded = np.isfinite(goal.lower) & np.isfinite(goal.upper)
    middle = (np.where(bounded, goal.lower, 0) + np.where(bounded, goal.upper, 0)) / 2
    yield np.where(bounded, middle, 0.0)


def branch_seeds(
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
    yield from islice(combine_branches(likely, near), most)


def bound_com_shift(robot: Robot, qpos: Array, found: Mapping[Limb, tuple[Branch, ...]]) -> float:
    """Returns how far the choice of branches may move the base under a com that stays (m)."""
    total = 0.0
    for limb, ways in found.items():
        coms = []
        for branch in ways:
            bent = qpos.copy()
            bent[robot.nq - robot.nu + limb.joints] = branch.positions
            coms.append(Configuration(robot, bent).center_of_mass()[:2])
        total += float(np.max(np.linalg.norm(np.array(coms) - coms[0], axis=1)))
    return _SLACK * total + NEAR_MISS


def support_radius(goal: Goal) -> float:
    """Returns how far from the centre a com inside may be (m)."""
    return float(np.linalg.norm(support_polygon(goal.contacts) - goal.centre[:2], axis=1).max())


def com_seeds(goal: Goal) -> list[Array]:
    """Returns where a com that may be anywhere inside begins: the centre, corners and sides."""
    centre = goal.contacts[:, :2].mean(axis=0)
    corners = centre + _OUTWARDS * (support_polygon(goal.contacts) - centre)
    return [centre, *corners, *(corners + np.roll(corners, 1, axis=0)) / 2]


def make_seeds(
    robot: Robot, goal: Goal, joints: Iterable[Array], places: Sequence[Array]
) -> Iterator[Array]:
    """Yields configurations (nq,) with the com in each place, and joints as each has them."""
    joints = list(joints)
    for place in places:
        for bent in joints:
            yield make_seed(robot, goal, bent, place)


def make_seed(robot: Robot, goal: Goal, joints: Array, place: Array) -> Array:
    """Returns the configuration (nq,) with joints (nu,) inside their limits and the com at (2,)."""
    bent = np.clip(joints, goal.lower, goal.upper)
    qpos = np.array([0.0, 0.0, goal.height, *goal.turn, *bent])
    qpos[:2] = place - Configuration(robot, qpos).center_of_mass()[:2]
    return qpos


def random_seeds(robot: Robot, goal: Goal, count: int) -> Iterator[Array]:
    """Yields random configurations (nq,) with the com inside; they are the same each time."""
    random = np.random.default_rng(0)
    low, high = np.maximum(goal.lower, -np.pi), np.minimum(goal.upper, np.pi)
    for _ in range(count):
        place = random.dirichlet(np.ones(len(goal.contacts))) @ goal.contacts[:, :2]
        yield make_seed(robot, goal, random.uniform(low, np.maximum(low, high)), place)
