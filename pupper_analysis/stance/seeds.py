"""Where a search begins that the usual postures do not end: legs bent in every way, and more."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.branches import (
    Branch,
    Limb,
    combine_branches,
    find_branches,
    follow_branches,
)
from pupper_analysis.stance.clearance import ClearanceShapes
from pupper_analysis.stance.constraints import constraints_of
from pupper_analysis.stance.problem import Goal
from pupper_analysis.statics.support_polygon import support_polygon

Array = NDArray[np.float64]

NEAR_MISS = 1e-3
"""Feet that miss by less (m) may be in reach with the com's last micrometres."""

_ASIDE_DISTANCE, _ASIDE_PLACES = 0.75, 11
"""How far the base is put aside (stand heights), and to how many places each way: some 20 mm apart
on Pupper, as far as a thigh that is 20 mm in the ground has to move. With 5 a stand was missed."""

_TRIED, _PER_PLACE = 64, 4
"""Choices of branches that are looked at for one place, and how many of these are begun from. Of 16
the one was not among them by which a Mini Cheetah stands on 62 degrees."""

_IN_REACH = 5e-3
"""Feet that miss by less with the base where it is are in reach with the base near it (m)."""

_SLACK = 1.5
"""How much further than the legs' branches shift the com the base may be off, for a com's place."""


def random_postures(goal: Goal, count: int) -> Iterator[Array]:
    """Yields joint positions (nu,) anywhere within their limits, the same in every search."""
    low, high = np.maximum(goal.lower, -np.pi), np.minimum(goal.upper, np.pi)
    random = np.random.default_rng(0)
    yield from random.uniform(low, np.maximum(low, high), (count, len(low)))


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


def make_seed(robot: Robot, goal: Goal, joints: Array, place: Array) -> Array:
    """Returns the configuration (nq,) with joints (nu,) inside their limits and the com at (2,)."""
    bent = np.clip(joints, goal.lower, goal.upper)
    qpos = np.array([0.0, 0.0, goal.height, *goal.turn, *bent])
    qpos[:2] = place - Configuration(robot, qpos).center_of_mass()[:2]
    return qpos


def shifted_seeds(shapes: ClearanceShapes, goal: Goal, qpos: Array) -> Iterator[Array]:
    """Yields configurations (nq,) with the base aside and the feet in reach, in every branch.

    Those that miss least of what a stand must fulfil come first: of a part in the ground, or a com
    outside, none may be left where another leg bears it out.

    Args:
        shapes: The robot with its shapes.
        goal: The goal, whose com may be anywhere inside.
        qpos: (nq,) where feet are in their places, or almost.
    """
    robot = shapes.robot
    found = find_branches(robot, qpos, goal.targets, goal.lower, goal.upper)
    along = np.linspace(-_ASIDE_DISTANCE, _ASIDE_DISTANCE, _ASIDE_PLACES) * robot.stand_height
    moves = np.array([(x, y, 0.0) for x in along for y in along])
    followed = follow_branches(robot, qpos, goal.targets, goal.lower, goal.upper, found, moves)
    constraints = [one for one in constraints_of(shapes, goal) if one.name != "footholds"]
    starts: list[tuple[float, Array]] = []
    for number, move in enumerate(moves):
        near = {
            limb: tuple(branch for branch in ways[number] if branch.miss < _IN_REACH)
            for limb, ways in followed.items()
        }
        here = []
        for joints in islice(combine_branches(near, qpos[-robot.nu :]), _TRIED):
            start = np.concatenate([qpos[:3] + move, qpos[3:7], joints])
            at = shapes.at(start)
            here.append((sum(one.missed(goal, at) for one in constraints), start))
        starts += sorted(here, key=itemgetter(0))[:_PER_PLACE]
    yield from (start for _, start in sorted(starts, key=itemgetter(0)))
