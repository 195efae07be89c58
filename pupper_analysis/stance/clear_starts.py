"""Where to begin so that no part but the feet is in the ground, with the com anywhere inside."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

import numpy as np
import shapely
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.stance.branches import Branch, Limb, branches, combinations
from pupper_analysis.stance.clearance import Shapes
from pupper_analysis.stance.problem import Goal

Array = NDArray[np.float64]

_ACROSS = 7
"""Places of the com along each side of the polygon's bounding box: some 20 mm apart on Pupper, as
far as a thigh that is 20 mm in the ground has to move."""

_PER_PLACE = 8
"""Choices of clear branches that are tried for one of them; a free foot's do not matter much."""

_CHOICES = 256
"""Of a place that are ranked: four limbs with four branches each."""

_LOWER = 5e-3
"""A branch that is less below what clears the ground (m) may clear it with the com a little aside,
between the places; limits are found by those."""

_IN_REACH = 5e-3
"""Feet that miss by less with the base where it is are in reach with the base near it (m)."""


def clear_starts(
    shapes: Shapes, goal: Goal, qpos: Array, inner: shapely.Polygon
) -> Iterator[tuple[Array, Array]]:
    """Yields where to begin, the clearest of the ground first.

    The com is put to places all over the polygon. For each the limbs' branches are found. A limb's
    height does not hang on how the others are bent, so that each takes branches that are clear, or
    almost.

    Args:
        shapes: The robot with its shapes.
        goal: The goal, whose com may be anywhere inside.
        qpos: (nq,) a stand of it but for what is in the ground.
        inner: Where the com may be (m).

    Yields:
        Joint positions (nu,), and the place (2,) of the com.
    """
    ranked, robot = [], shapes.robot
    starts = _each_branch(branches(robot, qpos, goal.targets, goal.lower, goal.upper), qpos)
    for place in _grid(inner):
        base = qpos.copy()
        base[:2] += place - Configuration(robot, qpos).center_of_mass()[:2]
        high = _high(shapes, goal, base, starts)
        if all(high.values()):
            bent = {limb: tuple(way.branch for way in ways) for limb, ways in high.items()}
            here = [
                (-min(_lowest(joints, high), 0.0), joints)
                for joints in islice(combinations(bent, qpos[-robot.nu :]), _CHOICES)
            ]
            here.sort(key=lambda one: one[0])
            ranked += [
                (below, order, place, joints)
                for order, (below, joints) in enumerate(here[:_PER_PLACE])
            ]
    for _, _, place, joints in sorted(ranked, key=lambda one: one[:2]):
        yield joints, place


def _grid(inner: shapely.Polygon) -> list[Array]:
    if inner.is_empty:
        return []
    low_x, low_y, high_x, high_y = inner.bounds
    x, y = np.meshgrid(np.linspace(low_x, high_x, _ACROSS), np.linspace(low_y, high_y, _ACROSS))
    places = np.column_stack([x.ravel(), y.ravel()])
    return list(places[shapely.intersects_xy(inner, places)])


@dataclass(frozen=True, eq=False)
class _Way:
    """A limb's branch, and how high it keeps the lowest of the limb's parts (m)."""

    branch: Branch
    room: float


def _each_branch(found: Mapping[Limb, tuple[Branch, ...]], qpos: Array) -> Array:
    """Returns joint positions (k, nu) in which each limb goes through all its branches.

    With the base some centimetres away the branches are those that these lead to: a fifth of the
    work of looking for them anew.
    """
    count = max(map(len, found.values()))
    starts = np.tile(qpos[7:], (count, 1))
    for limb, ways in found.items():
        for row in range(count):
            starts[row, limb.joints] = ways[row % len(ways)].positions
    return starts


def _high(shapes: Shapes, goal: Goal, qpos: Array, starts: Array) -> dict[Limb, list[_Way]]:
    """Returns each limb's branches that almost clear the ground, or the one that is highest.

    None where its feet are out of reach with the base where it is.
    """
    robot, high = shapes.robot, {}
    for limb, found in branches(robot, qpos, goal.targets, goal.lower, goal.upper, starts).items():
        ways = []
        for branch in found:
            if branch.miss > _IN_REACH:
                break  # those that miss least come first
            bent = qpos.copy()
            bent[robot.nq - robot.nu + limb.joints] = branch.positions
            heights = shapes.heights(bent, goal.task.ground, goal.targets, goal.depths)
            lowest = heights[shapes.moved_by(limb.joints)].min(initial=np.inf)
            ways.append(_Way(branch, float(lowest) - goal.task.ground_clearance))
        ways.sort(key=lambda way: -way.room)
        high[limb] = [way for way in ways if way.room >= -_LOWER] or ways[:1]
    return high


def _lowest(joints: Array, high: Mapping[Limb, list[_Way]]) -> float:
    """Returns how high joint positions (nu,), a way of each limb, keep the lowest part (m)."""
    return min(
        way.room
        for limb, ways in high.items()
        for way in ways
        if np.array_equal(way.branch.positions, joints[limb.joints])
    )
