"""Where to begin so that no part but the feet is in the ground, with the com anywhere inside.

With height and turn given, the base has two ways to go, x and y, and where it is, a leg of three
joints has a few ways to be bent, whose heights do not hang on how the other legs are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.stance.branches import (
    Branch,
    Limb,
    combine_branches,
    find_branches,
    follow_branches,
)
from pupper_analysis.stance.clearance import ClearanceShapes
from pupper_analysis.stance.problem import Goal
from pupper_analysis.statics.support_polygon import margin_of_place

Array = NDArray[np.float64]

_FAR, _ACROSS = 0.75, 11
"""How far the base is put aside (stand heights), and to how many places each way:
some 20 mm apart on Pupper, as far as a thigh that is 20 mm in the ground has to move."""

_PER_PLACE = 4
"""Choices of clear branches for one place; a free foot's do not matter much."""

_LOWER = 5e-3
"""A branch that is less below what clears the ground (m) may clear it with the base a little aside,
between the places; limits are found by those."""

_IN_REACH = 5e-3
"""Feet that miss by less with the base where it is are in reach with the base near it (m)."""


@dataclass(frozen=True, eq=False)
class _Start:
    """A configuration, and how far it is from clearing the ground with the com inside (m)."""

    qpos: Array
    off: float


def collision_free_seeds(shapes: ClearanceShapes, goal: Goal, qpos: Array) -> Iterator[Array]:
    """Yields configurations (nq,) where to begin, those that are least in the way first.

    Args:
        shapes: The robot with its shapes.
        goal: The goal, whose com may be anywhere inside.
        qpos: (nq,) a stand of it but for what is in the ground.
    """
    robot = shapes.robot
    found = find_branches(robot, qpos, goal.targets, goal.lower, goal.upper)
    step = 2 * _FAR / (_ACROSS - 1) * robot.stand_height
    starts = _starts(shapes, goal, qpos, found, step * _grid(_ACROSS))
    yield from (start.qpos for start in sorted(starts, key=lambda start: start.off))


def _grid(across: int) -> Array:
    """Returns places (n, 3) round the origin, one apart."""
    along = np.arange(across) - (across - 1) / 2
    return np.array([(x, y, 0.0) for x in along for y in along])


def _starts(
    shapes: ClearanceShapes,
    goal: Goal,
    qpos: Array,
    found: Mapping[Limb, tuple[Branch, ...]],
    moves: Array,
) -> list[_Start]:
    """Returns starts with the base of a configuration (nq,) moved by (n, 3) (m)."""
    robot = shapes.robot
    starts: list[_Start] = []
    ways = follow_branches(robot, qpos, goal.targets, goal.lower, goal.upper, found, moves)
    for number, move in enumerate(moves):
        base = qpos.copy()
        base[:3] += move
        high = {limb: _high(shapes, goal, base, limb, ways[limb][number]) for limb in ways}
        if all(high.values()):
            starts += islice(_bent(shapes, goal, base, high), _PER_PLACE)
    return starts


def _high(
    shapes: ClearanceShapes, goal: Goal, qpos: Array, limb: Limb, found: tuple[Branch, ...]
) -> dict[Branch, float]:
    """Returns how high branches of a limb are, those that almost clear the ground or the highest.

    None where its feet are out of reach with the base where it is.
    """
    rooms, moved = {}, shapes.moved_by(limb.joints)
    for branch in found:
        if branch.miss > _IN_REACH:
            break  # those that miss least come first
        bent = qpos.copy()
        bent[shapes.robot.nq - shapes.robot.nu + limb.joints] = branch.positions
        heights = shapes.heights(bent, goal.task.ground, goal.targets, goal.depths)
        rooms[branch] = float(heights[moved].min(initial=np.inf)) - goal.task.ground_clearance
    most = max(rooms.values(), default=0.0)
    return {branch: room for branch, room in rooms.items() if room >= min(most, -_LOWER)}


def _bent(
    shapes: ClearanceShapes, goal: Goal, qpos: Array, high: dict[Limb, dict[Branch, float]]
) -> Iterator[_Start]:
    """Yields the choices of one branch per limb."""
    robot = shapes.robot
    ways = {limb: tuple(rooms) for limb, rooms in high.items()}
    for joints in combine_branches(ways, qpos[-robot.nu :]):
        bent = qpos.copy()
        bent[-robot.nu :] = joints
        lowest = min(
            room
            for limb, rooms in high.items()
            for branch, room in rooms.items()
            if np.array_equal(branch.positions, joints[limb.joints])
        )
        x, y, _ = Configuration(robot, bent).center_of_mass().tolist()
        outside = goal.task.com_margin - margin_of_place((x, y), goal.corners)
        yield _Start(bent, max(0.0, -lowest) + max(0.0, outside))
