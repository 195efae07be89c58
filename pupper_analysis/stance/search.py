"""The search for a stand: in every branch of the legs, and with the com wherever it may be."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import chain, islice

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.branches import Branch, Limb, branches
from pupper_analysis.stance.clear_starts import clear_starts
from pupper_analysis.stance.clearance import Shapes
from pupper_analysis.stance.com_places import first_places, pushed_inside
from pupper_analysis.stance.elastic import Elastic
from pupper_analysis.stance.judge import Stand, base_is_in_the_ground, measure
from pupper_analysis.stance.problem import Goal
from pupper_analysis.stance.solver import Point, Solver
from pupper_analysis.stance.starts import NEAR_MISS, choices, starts
from pupper_analysis.stance.tasks import TASK_TOLERANCE
from pupper_analysis.stance.yielding import as_the_legs_can
from pupper_analysis.statics.support_polygon import support_polygon

Array = NDArray[np.float64]

_ATTEMPTS = 256
"""The most choices of branches that are tried in full for one place of the com: four legs whose
joints turn all the way round, with four branches each."""

_ROUNDS = 4
"""How often the branches are looked for anew from where the feet have come much nearer."""

_CLEAR_STARTS = 24
"""Starts that clear the ground that are tried where feet are in place and a part is in it."""

_CLEARED = 4
"""Stands with a part in the ground from which all is tried to be met at once."""

_ALIKE = 0.2
"""Stands whose joints differ by less are bent alike (rad): what clears the one clears the other."""

_CLOSE = 5e-3
"""Where feet miss by less (m), every branch is tried from there; the com may have gone far."""

_STRETCHED = 3e-3
"""Where feet miss by less (m), starts are scattered too: at the end of reach, with the com on the
polygon's edge, what is left to stand on is small, and few starts lead there. With the best of the
usual ones 2.2 mm off a stand was missed."""

_SCATTERED = 64
"""How many: in the hardest case found, one of eight led to the stand."""

_SAME = 1e-3
"""Configurations that differ by less come to the same stand (rad, m)."""

_ATTEMPTS_INSIDE = 8
"""The same for each of the places where a com that may be anywhere inside begins."""

_SLACK = 1.5
"""How much further than the legs' branches shift the com the base may be off, for a com's place."""


def search(
    shapes: Shapes,
    goal: Goal,
    hints: Sequence[Array] = (),
    *,
    plainly: bool = False,
    centred: bool = False,
) -> Stand:
    """Looks for a stand everywhere: from the usual starts, then in every branch of the legs.

    Args:
        shapes: The robot with its shapes.
        goal: The goal.
        hints: Joint positions (nu,) from which to start first.
        plainly: From the usual starts alone.
        centred: With a com that may be anywhere inside over the centre alone, which is quick.

    Returns:
        A stand that is solved, or else the best failure: with the feet as near as they came, or
        where they are in place, with something in the way.
    """
    there = _At(shapes, goal)
    if found := there.search(hints, plainly=plainly):
        return found
    best = there.result()
    if best.solved or plainly or centred or goal.task.com != "inside" or goal.by_base:
        return best
    return _search_inside(shapes, goal, best, there.found, hints)


def follow(shapes: Shapes, goal: Goal, near: Stand) -> Stand | None:
    """Looks for a stand near another one, from that alone: quick, and no proof that there is none.

    Args:
        shapes: The robot with its shapes.
        goal: The goal.
        near: A stand of a goal that is almost the same.
    """
    joints = near.joint_positions(shapes.robot)
    found = begin_at(shapes, goal, joints)
    if found is not None:
        return found
    com = Configuration(shapes.robot, near.qpos).center_of_mass()[:2]
    inside = _inside(shapes, goal, joints, com)
    if inside is None or inside.solved or inside.foot_error >= TASK_TOLERANCE:
        return inside if inside is not None and inside.solved else None
    # A part is in the ground, out of which joints and com may take it without the feet.
    return meet(shapes, goal, inside.qpos)


def begin_inside(shapes: Shapes, goal: Goal, joints: Array, com: Array) -> Stand | None:
    """Looks for a stand with the com anywhere inside, if the task lets it, from one start alone.

    Args:
        shapes: The robot with its shapes.
        goal: The goal.
        joints: (nu,) where to start (rad).
        com: (2,) where the com begins (m).
    """
    stand = _inside(shapes, goal, joints, com)
    return stand if stand is not None and stand.solved else None


def _inside(shapes: Shapes, goal: Goal, joints: Array, com: Array) -> Stand | None:
    """Returns where one start leads with the com anywhere inside; None if feet are far off."""
    if goal.task.com != "inside" or goal.by_base:
        return None
    point = Solver(shapes, goal, inside=True).run(joints, com)
    return None if point.miss >= NEAR_MISS else _exactly(shapes, goal, point)


def begin_at(shapes: Shapes, goal: Goal, joints: Array) -> Stand | None:
    """Looks for a stand from joint positions (nu,) alone, the com or the base in its place."""
    return _At(shapes, goal).add(Solver(shapes, goal).run(joints))


def flattest(shapes: Shapes, goal: Goal, stand: Stand) -> Stand:
    """Returns a stand whose soles lie flatter, if the com may be elsewhere, or the one given.

    Legs that lay their soles as they can tilt them by as much as they may, to have the com in its
    place; and servos that press them flat then give torques that no balance knows of.

    Args:
        shapes: The robot with its shapes.
        goal: The goal.
        stand: A stand of it, with feet where the legs have them.
    """
    robot = shapes.robot
    com = Configuration(robot, stand.qpos).center_of_mass()[:2]
    other = begin_inside(shapes, goal, stand.joint_positions(robot), com)

    def off(tried: Stand) -> float:
        places = Configuration(robot, tried.qpos).foot_positions()
        return max(float(np.linalg.norm(places[f] - goal.targets[f])) for f in goal.stance_feet)

    return stand if other is None else min(other, stand, key=off)


def go_on(shapes: Shapes, goal: Goal, qpos: Array) -> Stand | None:
    """Looks for a stand from a configuration (nq,) alone that is next to it."""
    return _At(shapes, goal).add(Solver(shapes, goal).go_on(qpos))


class _At:
    """The search with the com, or the base, at the goal's place.

    What it came to: feet in place count first, then what is in the way.
    """

    def __init__(self, shapes: Shapes, goal: Goal) -> None:
        self.shapes, self.goal = shapes, goal
        self.points: list[Point] = []
        self.iterations = 0
        self.reached: list[Stand] = []
        self.found: dict[Limb, tuple[Branch, ...]] = {}

    @cached_property
    def _in_vain(self) -> bool:
        """Whether no start can lead to a stand; most searches succeed and never ask."""
        return base_is_in_the_ground(self.shapes, self.goal)

    def search(self, hints: Sequence[Array], *, plainly: bool) -> Stand | None:
        """Tries all starts, until one leads to a stand; ``result`` has what else came of them."""
        robot, goal = self.shapes.robot, self.goal
        solver = Solver(self.shapes, goal)
        found = self._any(solver, chain(hints, starts(robot, goal)))
        if found is not None or plainly:
            return found
        bent: list[Array] = []
        for _ in range(_ROUNDS):
            nearest = self._nearest()
            self.found = branches(robot, nearest.qpos, goal.targets, goal.lower, goal.upper)
            reach = 0.0 if goal.by_base else _shift(robot, nearest.qpos, self.found)
            bent += (new := tuple(choices(robot, goal, self.found, reach, _ATTEMPTS)))
            if found := self._any(solver, new):
                return found
            # Much nearer, the base may be where legs have branches that they had not before.
            if self.reached or self._nearest().miss > nearest.miss / 2:
                break
        if goal.task.self_clearance is not None:  # without the avoidance they may be apart as well
            solver = Solver(self.shapes, goal, apart=False)
            return self._any(solver, (*starts(robot, goal), *bent))
        return None

    def _nearest(self) -> Point:
        return min(self.points, key=lambda point: point.miss)

    def _any(self, solver: Solver, joints: Iterable[Array]) -> Stand | None:
        """Returns the first stand that is solved; None if no start leads to one.

        Where none can be, the first whose feet are in place.
        """
        for start in joints:
            stand = self.add(solver.run(start))
            if stand is None and self.reached and self._in_vain:
                stand = self.reached[0]
            if stand is not None:
                return stand
        return None

    def add(self, point: Point) -> Stand | None:
        """Adds where a solver ended; returns the stand if it is solved."""
        self.points.append(point)
        self.iterations += point.iterations
        goal = as_the_legs_can(self.shapes.robot, self.goal, point)
        if point.miss >= 2 * TASK_TOLERANCE and goal is self.goal:
            return None
        stand = self._measure(point, goal)
        if goal is not self.goal:
            stand = flattest(self.shapes, self.goal, stand)
        self.reached.append(stand)
        return stand if stand.solved else None

    def result(self) -> Stand:
        """Returns the solved stand; or that with the least in the way; or what misses least."""
        if self.reached:
            return max(self.reached, key=lambda stand: (stand.solved, stand.room))
        return self._measure(self._nearest())

    def _measure(self, point: Point, goal: Goal | None = None) -> Stand:
        return measure(self.shapes, goal or self.goal, point.qpos, self.iterations)


def _search_inside(
    shapes: Shapes,
    goal: Goal,
    centred: Stand,
    bent: Mapping[Limb, tuple[Branch, ...]],
    hints: Sequence[Array],
) -> Stand:
    """The search with the com anywhere inside, where the centre is out of reach.

    Args:
        shapes: The robot with its shapes.
        goal: The goal.
        centred: The best failure with the com over the centre.
        bent: The legs' branches there.
        hints: Joint positions (nu,) from which to start first.
    """
    robot = shapes.robot
    reach = _radius(goal) + _shift(robot, centred.qpos, bent)
    if any(ways[0].miss > reach for ways in bent.values()):
        return centred  # too far for the com to make up
    solver, found, seen = Solver(shapes, goal, inside=True), [centred], list[Array]()
    in_vain = base_is_in_the_ground(shapes, goal)
    candidates = (
        *(*hints, centred.joint_positions(robot), *starts(robot, goal)),
        *choices(robot, goal, bent, reach, _ATTEMPTS_INSIDE),
    )

    def solves(start: Array, place: Array) -> bool:
        point = solver.run(start, place)
        if any(np.abs(point.qpos - other).max() < _SAME for other in seen):
            return False
        seen.append(point.qpos)
        if point.miss < NEAR_MISS or point.miss < found[-1].foot_error:
            found.append(_exactly(shapes, goal, point))
        return found[-1].solved or (in_vain and found[-1].foot_error < TASK_TOLERANCE)

    for place in first_places(goal):
        if any(solves(start, place) for start in candidates):
            return found[-1]
    for _ in range(_ROUNDS):
        near = min(found, key=lambda stand: stand.foot_error)
        if near.foot_error > _CLOSE:
            break
        bent = branches(robot, near.qpos, goal.targets, goal.lower, goal.upper)
        reach = _shift(robot, near.qpos, bent)
        place = Configuration(robot, near.qpos).center_of_mass()[:2]
        if any(solves(start, place) for start in choices(robot, goal, bent, reach, _ATTEMPTS)):
            return found[-1]
        if min(stand.foot_error for stand in found) > near.foot_error / 2:
            break
    if any(TASK_TOLERANCE <= stand.foot_error < _STRETCHED for stand in found):
        random = np.random.default_rng(0)
        low, high = np.maximum(goal.lower, -np.pi), np.minimum(goal.upper, np.pi)
        for _ in range(_SCATTERED):
            place = random.dirichlet(np.ones(len(goal.contacts))) @ goal.contacts[:, :2]
            if solves(random.uniform(low, high), place):
                return found[-1]
    reached = [stand for stand in found if stand.foot_error < TASK_TOLERANCE]
    if reached and not in_vain:  # a part is in the ground: elsewhere, or bent otherwise, it is not
        bent_otherwise = (stand.qpos for stand in islice(_bent_otherwise(robot, reached), _CLEARED))
        least_off = max(reached, key=lambda stand: stand.room).qpos
        clear = islice(clear_starts(shapes, goal, least_off), _CLEAR_STARTS)
        for start in chain(bent_otherwise, clear):
            if (stand := meet(shapes, goal, start)) is not None:
                return stand
    return max(found, key=lambda stand: (stand.foot_error < TASK_TOLERANCE, -stand.foot_error))


def _bent_otherwise(robot: Robot, stands: Iterable[Stand]) -> Iterator[Stand]:
    """Yields stands with the least in the way first, of those that are bent alike one alone."""
    seen: list[Array] = []
    for stand in sorted(stands, key=lambda stand: stand.room, reverse=True):
        joints = stand.joint_positions(robot)
        if all(np.abs(joints - other).max() > _ALIKE for other in seen):
            seen.append(joints)
            yield stand


def meet(shapes: Shapes, goal: Goal, qpos: Array) -> Stand | None:
    """Looks for a stand from one configuration (nq,), with all that it must fulfil met at once.

    At the edge of what is possible the feet and the ground are each satisfied at the other's
    expense, by turns; what is left there may be micrometres wide.
    """
    met = Elastic(shapes, goal, ()).solve(qpos)
    if met.missed > NEAR_MISS:
        return None
    com = Configuration(shapes.robot, met.qpos).center_of_mass()[:2]
    at = replace(goal, place=com) if goal.task.com == "inside" and not goal.by_base else goal
    stand = measure(shapes, at, met.qpos, 0)
    if not stand.solved:
        stand = _exactly(shapes, at, Point(met.qpos, stand.foot_error, 0))
    return stand if stand.solved else None


def _exactly(shapes: Shapes, goal: Goal, point: Point) -> Stand:
    """Solves once more with the com where it is, or just inside: PlaCo's polygon is soft.

    On the polygon's edge the legs may not let the com go just there, but along the edge: where feet
    are off then, they are put in place with the com anywhere inside, and the polygon firm.
    """
    if point.miss >= NEAR_MISS:
        return measure(shapes, goal, point.qpos, point.iterations)
    com = Configuration(shapes.robot, point.qpos).center_of_mass()[:2]
    exact = replace(goal, place=pushed_inside(com, goal))
    again = Solver(shapes, exact).run(point.qpos[7:])
    exact = as_the_legs_can(shapes.robot, exact, again)
    stand = measure(shapes, exact, again.qpos, point.iterations + again.iterations)
    if stand.foot_error < TASK_TOLERANCE:
        return stand
    firm = Solver(shapes, exact, inside=True, firmly=True).run(point.qpos[7:], exact.place)
    com = Configuration(shapes.robot, firm.qpos).center_of_mass()[:2]
    iterations = stand.iterations + firm.iterations
    along = measure(shapes, replace(exact, place=com), firm.qpos, iterations)
    return min(along, stand, key=lambda tried: tried.foot_error)


def _radius(goal: Goal) -> float:
    """Returns how far from the centre a com inside may be (m)."""
    centre = goal.contacts[:, :2].mean(axis=0)
    return float(np.linalg.norm(support_polygon(goal.contacts) - centre, axis=1).max())


def _shift(robot: Robot, qpos: Array, found: Mapping[Limb, tuple[Branch, ...]]) -> float:
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
