"""What a stand must fulfil, as constraints: each has a residual and its derivative.

A refusal says which of them would have to give. The base has the height and the turn that the goal
gives it in every configuration that is tried: these two are no constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.closure import Closure
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.clearance import Shapes
from pupper_analysis.stance.footholds import fixing
from pupper_analysis.stance.problem import Goal
from pupper_analysis.statics.support_polygon import polygon_sides

Array = NDArray[np.float64]
Function: TypeAlias = Callable[[Goal, Configuration], Array]

_PAIRS = 12
"""Pairs of links that are looked at, the nearest: of a quadruped's 300 no more touch at once."""


@dataclass(frozen=True, eq=False)
class Constraint:
    """Something that a stand must fulfil.

    Attributes:
        name: As ``stance/fields.toml`` has it.
        residual: Tells what shall be zero, or not negative (n,) (m, rad).
        rates: Tells the derivative (n, nv) of that by the robot's motion.
        equal: Whether the residual shall be zero.
        reads: Fields of the task that it depends on, besides the base's height and turn.
    """

    name: str
    residual: Function
    rates: Function
    equal: bool = False
    reads: frozenset[str] = frozenset()


def constraints_of(shapes: Shapes, goal: Goal) -> Iterator[Constraint]:
    """Yields what a stand of a goal must fulfil, also where its numbers become others."""
    robot, task = shapes.robot, goal.task
    yield _footholds(robot, goal)
    if robot.closure is not None:
        yield _loops(robot, robot.closure)
    yield from place_of(goal)
    yield _joint_limits(goal)
    yield _ground_clearance(shapes, goal)
    if task.self_clearance is not None:
        yield _self_clearance(shapes)


def place_of(goal: Goal) -> Iterator[Constraint]:
    """Yields where the com, or the base with an offset, shall be."""
    if goal.by_base or goal.task.com != "inside":
        name = "base-place" if goal.by_base else "com-place"
        yield Constraint(name, *_PLACE, equal=True, reads=_WHERE)
    if not goal.by_base or goal.task.com_margin > 0.0:
        yield Constraint("support-margin", *_INSIDE, reads=frozenset({*_FEET, "com_margin"}))


_FEET = frozenset({"feet", "foot_offsets", "ground"})
_WHERE = _FEET | {"offset", "com"}


def _footholds(robot: Robot, goal: Goal) -> Constraint:
    """The feet's centres are in their places: of a sole as many coordinates as fix it."""
    rows: list[tuple[str, Array]] = []
    for points in robot.soles.values():
        pins = fixing([goal.targets[point] for point in points])
        for count, (number, axes) in zip((3, 2, 1), pins, strict=False):
            rows.append((points[number], axes[:count]))

    def residual(goal: Goal, at: Configuration) -> Array:
        feet = at.foot_positions()
        return np.concatenate([axes @ (feet[one] - goal.targets[one]) for one, axes in rows])

    def rates(_: Goal, at: Configuration) -> Array:
        jacobians = at.foot_jacobians()
        return np.concatenate([axes @ jacobians[one] for one, axes in rows])

    return Constraint("footholds", residual, rates, equal=True, reads=_FEET | {"swing"})


def _loops(robot: Robot, closure: Closure) -> Constraint:
    """Loops and couplings of joints are closed, or as open as they give way."""

    def residual(goal: Goal, at: Configuration) -> Array:
        left = closure.residual(at.qpos)
        return left if goal.give is None else left - goal.give

    def rates(_: Goal, at: Configuration) -> Array:
        rows = closure.rows(at.qpos)
        return np.hstack([np.zeros((len(rows), robot.nv - robot.nu)), rows])

    return Constraint("loops", residual, rates, equal=True)


def _off_place(goal: Goal, at: Configuration) -> Array:
    here: Array = at.qpos[:2] if goal.by_base else at.center_of_mass()[:2]
    return here - goal.place


def _off_place_rates(goal: Goal, at: Configuration) -> Array:
    return np.eye(2, at.robot.nv) if goal.by_base else at.com_jacobian()[:2]


def _inside(goal: Goal, at: Configuration) -> Array:
    sides = _sides(goal)
    inside: Array = sides[:, :2] @ at.center_of_mass()[:2] + sides[:, 2]
    return inside - goal.task.com_margin


def _inside_rates(goal: Goal, at: Configuration) -> Array:
    rates: Array = _sides(goal)[:, :2] @ at.com_jacobian()[:2]
    return rates


def _sides(goal: Goal) -> Array:
    """Returns as many sides of the support polygon as feet carry, the last one again if need be.

    A foot that moves may come to be inside the polygon of the others, and a side is lost.
    """
    sides = polygon_sides(goal.contacts)
    return np.vstack([sides, np.repeat(sides[-1:], len(goal.contacts) - len(sides), axis=0)])


_PLACE = _off_place, _off_place_rates
_INSIDE = _inside, _inside_rates


def _joint_limits(goal: Goal) -> Constraint:
    """Joints keep off their limits by the task's margin."""
    low, high = np.isfinite(goal.lower), np.isfinite(goal.upper)

    def residual(goal: Goal, at: Configuration) -> Array:
        joints = at.qpos[-at.robot.nu :]
        return np.concatenate([(joints - goal.lower)[low], (goal.upper - joints)[high]])

    def rates(_: Goal, at: Configuration) -> Array:
        each = np.eye(at.robot.nu, at.robot.nv, k=at.robot.nv - at.robot.nu)
        return np.concatenate([each[low], -each[high]])

    return Constraint("joint-limits", residual, rates, reads=frozenset({"joint_margin"}))


def _ground_clearance(shapes: Shapes, goal: Goal) -> Constraint:
    """Every part but the feet is above the ground by the task's clearance."""
    reads = {"ground", "ground_clearance"}
    if any(goal.task.ground.heights.values()):  # steps are where feet are
        reads |= {"feet", "foot_offsets", "swing"}
    nowhere = shapes.heights(shapes.robot.home, goal.task.ground, goal.targets, goal.depths)
    parts = np.isfinite(nowhere)  # feet are not looked at

    def residual(goal: Goal, at: Configuration) -> Array:
        heights = shapes.heights(at.qpos, goal.task.ground, goal.targets, goal.depths)
        above: Array = heights[parts] - goal.task.ground_clearance
        return above

    def rates(goal: Goal, at: Configuration) -> Array:
        rates = shapes.height_rates(at.qpos, goal.task.ground, goal.targets, goal.depths)
        own: Array = rates[parts]
        return own

    return Constraint("ground-clearance", residual, rates, reads=frozenset(reads))


def _self_clearance(shapes: Shapes) -> Constraint:
    """Links that are not neighbours are apart by the task's clearance."""

    def residual(goal: Goal, at: Configuration) -> Array:
        return shapes.distances(at.qpos, _PAIRS) - (goal.task.self_clearance or 0.0)

    def rates(_: Goal, at: Configuration) -> Array:
        return shapes.distance_rates(at, _PAIRS)

    return Constraint("self-clearance", residual, rates, reads=frozenset({"self_clearance"}))
