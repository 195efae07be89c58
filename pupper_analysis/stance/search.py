"""The search for a stand: PlaCo's quick steps, then all constraints at once, from many seeds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from itertools import islice
from operator import itemgetter

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.frozen import freeze_arrays
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
from pupper_analysis.stance.constraints import TASK_TOLERANCE, make_constraints
from pupper_analysis.stance.judge import Stand, evaluate_stand, is_base_in_ground
from pupper_analysis.stance.problem import Goal, has_spare_joints
from pupper_analysis.stance.programme import StanceProgram
from pupper_analysis.stance.solver import SearchContext, SolverResult

Array = NDArray[np.float64]

_ATTEMPTS = 256
"""The most choices of branches that are tried in full for one place of the com: four legs whose
joints turn all the way round, with four branches each."""

_BRANCH_ROUNDS = 4
"""How often the branches are looked for anew from where the feet have come much nearer."""

_CLOSE_MISS = 3e-3
"""Where feet can come nearer than this (m), places all over are tried as well."""

_SHIFTED = 32
"""How many of these at most."""

_MISS_TOLERANCE, _AGREEING_SEEDS = 0.1, 8
"""Where the feet come no nearer from so many seeds than from the best of them, by such a part of
what they miss by, they come no nearer. Of 400 stands, most at the end of reach, all but one that
took more than PlaCo were found before two agreed, that one when four had."""

_RANDOM = 32
"""Random postures of a robot whose legs lay their soles as they can: there are no branches of what
cannot be laid quite flat, and what is nearest depends on where one begins. Of 48 stands of six
bipeds one more is found."""

CLEARANCE_NAMES = ("ground-clearance", "self-clearance")
"""Constraints that a stand may miss with its feet in place: then these are what is in the way."""


def search_stand(
    context: SearchContext,
    goal: Goal,
    *,
    usual_starts_only: bool = False,
    com_at_centre_only: bool = False,
) -> Stand:
    """Looks for a stand everywhere: from the usual starts, then in every branch of the legs.

    Where the com may be anywhere inside, or joints are left over that may take parts out of each
    other's way, all constraints are then met at once, from where the feet have come nearest, and
    from other seeds.

    Args:
        context: The robot's.
        goal: The goal.
        usual_starts_only: From the usual starts alone.
        com_at_centre_only: If the CoM is free, test the centre of the feet only.

    Returns:
        A stand that is solved, or else the best failure: with the feet as near as they came, or
        where they are in place, with something in the way.
    """
    there = _Search(context, goal)
    found = there.quickly(posture_seeds(context.robot, goal))
    if found is not None or usual_starts_only:
        return found or there.result()
    found = there.in_every_branch()
    if found is not None or com_at_centre_only:
        return found or there.result()
    return there.at_once()


def follow_stand(context: SearchContext, goal: Goal, near: Stand) -> Stand | None:
    """Looks for a stand near another one, from that alone: quick, and no proof that there is none.

    Args:
        context: The robot's.
        goal: The goal.
        near: A stand of a goal that is almost the same.
    """
    found = search_from_joints(context, goal, near.joint_positions(context.robot))
    if found is None and goal.com_is_free:
        found = meet_constraints(context, goal, near.qpos)
    return found


def search_from_joints(context: SearchContext, goal: Goal, joints: Array) -> Stand | None:
    """Looks for a stand from joint positions (nu,) alone, the com or the base in its place."""
    return _Search(context, goal).add(context.solver.solve_from_joints(goal, joints))


def meet_constraints(context: SearchContext, goal: Goal, qpos: Array) -> Stand | None:
    """Looks for a stand from one configuration (nq,), with all that it must fulfil met at once."""
    there, programme = _Search(context, goal), StanceProgram(context.shapes, goal)
    stand = there.met(programme, qpos) or there.met_from_nearest(programme, qpos)
    return stand if stand is not None and stand.solved else None


def continue_stand(context: SearchContext, goal: Goal, qpos: Array) -> Stand | None:
    """Looks for a stand from a configuration (nq,) alone that is next to it."""
    return _Search(context, goal).add(context.solver.solve_from_configuration(goal, qpos))


class _Search:
    """A search, and what it came to: feet in place count first, then what is in the way."""

    def __init__(self, context: SearchContext, goal: Goal) -> None:
        self.context, self.shapes, self.robot = context, context.shapes, context.robot
        self.goal, self.iterations = goal, 0
        self.closest: Stand | None = None
        self.misses: list[float] = []
        self.points: list[SolverResult] = []
        self.reached: list[Stand] = []
        self.found: dict[Limb, tuple[Branch, ...]] = {}

    @cached_property
    def _in_vain(self) -> bool:
        """Whether no start can lead to a stand; most searches succeed and never ask."""
        return is_base_in_ground(self.shapes, self.goal)

    def quickly(self, joints: Iterable[Array]) -> Stand | None:
        """Returns the first stand that PlaCo's steps lead to, from some joint positions (nu,).

        Where none can be solved, the first whose feet are in place.
        """
        for start in joints:
            stand = self.add(self.context.solver.solve_from_joints(self.goal, start))
            if stand is None and self.reached and self._in_vain:
                stand = self.reached[0]
            if stand is not None:
                return stand
        return None

    def in_every_branch(self) -> Stand | None:
        """The same from every choice of the legs' branches that may be in reach."""
        robot, goal = self.robot, self.goal
        for _ in range(_BRANCH_ROUNDS):
            nearest = self._nearest()
            self.found = find_branches(robot, nearest.qpos, goal.targets, goal.lower, goal.upper)
            reach = 0.0 if goal.by_base else bound_com_shift(robot, nearest.qpos, self.found)
            found = self.quickly(branch_seeds(robot, goal, self.found, reach, _ATTEMPTS))
            if found is not None:
                return found
            # Much nearer, the base may be where legs have branches that they had not before.
            if self.reached or self._nearest().foot_error > nearest.foot_error / 2:
                break
        return None

    def at_once(self) -> Stand:
        """Meets all constraints at once, from one seed after the other."""
        best = self.result()
        if best.solved or (self._in_vain and self.reached):
            return best
        if not self.goal.com_is_free and not (self.reached and has_spare_joints(self.robot)):
            return best
        if self.goal.com_is_free:
            reach = support_radius(self.goal) + bound_com_shift(self.robot, best.qpos, self.found)
            if any(branches[0].foot_error > reach for branches in self.found.values()):
                return best  # too far for the com to make up
        without = CLEARANCE_NAMES if self._in_vain else ()
        programme = StanceProgram(self.shapes, self.goal, without=without)
        for qpos in self._seeds(best):
            stand = self.met(programme, qpos) or self.met_from_nearest(programme, qpos)
            if stand is not None and (stand.solved or self._in_vain):
                return stand
            if self._agreed() and not self._underactuated:
                break
        return self.result()

    @cached_property
    def _underactuated(self) -> bool:
        return has_underactuated_feet(self.robot)

    def _agreed(self) -> bool:
        """Whether the feet have come as near as they do from several seeds."""
        least = min(self.misses, default=0.0)
        return sum(one <= (1 + _MISS_TOLERANCE) * least for one in self.misses) >= _AGREEING_SEEDS

    def _seeds(self, best: Stand) -> Iterator[Array]:
        """Yields configurations (nq,) where all constraints are begun to be met."""
        robot, goal = self.robot, self.goal
        yield best.qpos
        if not goal.com_is_free:
            # A copy: from each of them another may be reached.
            yield from [stand.qpos for stand in self.reached if stand is not best]
            return
        for joints in posture_seeds(robot, goal):
            yield make_seed(robot, goal, joints, goal.centre[:2])
        if self._underactuated:
            yield from (
                make_seed(robot, goal, joints, goal.centre[:2])
                for joints in random_postures(goal, _RANDOM)
            )
        closest = self.result()
        if closest.foot_error < _CLOSE_MISS:  # something may be in the way that elsewhere is not
            yield from islice(shifted_seeds(self.shapes, goal, closest.qpos), _SHIFTED)

    def met_from_nearest(self, programme: StanceProgram, qpos: Array) -> Stand | None:
        """The same as ``met`` from where the feet come nearest first: slower, and surer."""
        if not self.goal.com_is_free or self.reached:
            return None
        closest = find_nearest(self.context, self.goal, qpos)
        self.misses.append(closest.foot_error)
        if self.closest is None or closest.foot_error < self.closest.foot_error:
            self.closest = closest
        if closest.foot_error >= NEAR_MISS:
            return None
        return self.met(programme, closest.qpos) or self._exactly(closest.qpos)

    def _nearest(self) -> SolverResult:
        return min(self.points, key=lambda point: point.foot_error)

    def add(self, point: SolverResult) -> Stand | None:
        """Adds where a solver ended; returns the stand if it is solved."""
        self.points.append(point)
        self.iterations += point.iterations
        goal = self.goal
        if not point.converged:
            goal = relax_foot_orientation(self.robot, goal, point)
        if point.foot_error >= 2 * TASK_TOLERANCE and goal is self.goal:
            return None
        stand = self._measure(point, goal)
        if goal is not self.goal:
            stand = lay_soles_flattest(self.context, self.goal, stand)
        self.reached.append(stand)
        return stand if stand.solved else None

    def met(self, programme: StanceProgram, qpos: Array) -> Stand | None:
        """Returns the stand where a programme leads, feet in place; None if it leads to none."""
        found = programme.solve(qpos)
        return None if found.violation > NEAR_MISS else self._exactly(found.qpos)

    def _exactly(self, qpos: Array) -> Stand | None:
        """Returns the stand next to a configuration (nq,), if its feet are in place.

        PlaCo places them to the last digits, and soles as their legs can lay them.
        """
        goal = self.goal
        if goal.com_is_free:
            goal = replace(goal, place=Configuration(self.robot, qpos).center_of_mass()[:2])
        point = self.context.solver.solve_from_configuration(goal, qpos)
        self.iterations += point.iterations
        stand = self._measure(point, relax_foot_orientation(self.robot, goal, point))
        if stand.foot_error >= TASK_TOLERANCE:
            return None
        self.reached.append(stand)
        return stand

    def result(self) -> Stand:
        """Returns the solved stand; or that with the least in the way; or what misses least."""
        if self.reached:
            return max(self.reached, key=lambda stand: (stand.solved, stand.constraint_slack))
        return self.closest or self._measure(self._nearest())

    def _measure(self, point: SolverResult, goal: Goal | None = None) -> Stand:
        return evaluate_stand(self.shapes, goal or self.goal, point.qpos, self.iterations)


def posture_seeds(robot: Robot, goal: Goal) -> Iterator[Array]:
    """Yields joint positions to start from: the ik_seed, home, the middle of the limits."""
    if goal.task.ik_seed is not None:
        yield np.array(goal.task.ik_seed)
    yield robot.home[7:]
    bounded = np.isfinite(goal.lower) & np.isfinite(goal.upper)
    middle = (np.where(bounded, goal.lower, 0) + np.where(bounded, goal.upper, 0)) / 2
    yield np.where(bounded, middle, 0.0)


def find_nearest(context: SearchContext, goal: Goal, qpos: Array) -> Stand:
    """Finds how near the feet can come to targets that are out of reach, from a start (nq,).

    Parts may be in each other's way, or in the ground. PlaCo's Gauss-Newton steps, made for errors
    that vanish, stop short of that.
    """
    feet = StanceProgram(context.shapes, goal, without=(*CLEARANCE_NAMES, "footholds"))
    return evaluate_stand(context.shapes, goal, feet.nearest(qpos), 0)


def lay_soles_flattest(context: SearchContext, goal: Goal, stand: Stand) -> Stand:
    """Returns a stand whose soles lie flatter, if the com may be elsewhere, or the one given.

    Legs that lay their soles as they can tilt them by as much as they may, to have the com in its
    place; and servos that press them flat then give torques that no balance knows of.

    Args:
        context: The robot's.
        goal: The goal.
        stand: A stand of it, with feet where the legs have them.
    """
    robot = context.robot
    if not goal.com_is_free:
        return stand

    def off(tried: Stand) -> float:
        places = Configuration(robot, tried.qpos).foot_positions()
        return max(float(np.linalg.norm(places[f] - goal.targets[f])) for f in goal.stance_feet)

    closest = find_nearest(context, goal, stand.qpos)
    at = replace(goal, place=Configuration(robot, closest.qpos).center_of_mass()[:2])
    point = SolverResult(closest.qpos, closest.foot_error, stand.iterations)
    at = relax_foot_orientation(robot, at, point)
    other = evaluate_stand(context.shapes, at, point.qpos, stand.iterations)
    return min(other, stand, key=off) if other.solved else stand


_YIELD = 5e-5
"""Soles give way by less (m): a tenth of what feet sink in, and no more."""

_JOINTS = 6  # of a leg that lays its sole anywhere, in any orientation


def has_underactuated_feet(robot: Robot) -> bool:
    """Tells whether a robot has soles that its legs, of fewer than six joints, lay as they can.

    A leg of four joints has three for its sole's place in a plane and its pitch. Roll and yaw are
    the leg's own, and a sole that is a microradian off level cannot be laid as it should.
    """
    return any(
        len(points) > 1 and _joints_to(robot, points[0]) < _JOINTS for points in robot.feet.values()
    )


def find_missing_joints(robot: Robot, goal: Goal) -> Diagnostic | None:
    """Tells which joints the legs lack for a sole that is lifted or moved; None if none.

    Or for loops and couplings that give way.
    """
    task = goal.task
    if goal.give is not None and goal.give.any():
        return diagnose("loops-give-way", most=Quantity(abs(goal.give).max(), "rad or m"))
    moved = [
        sole for sole in robot.feet if {sole, *robot.feet[sole]} & {*task.swing, *task.foot_offsets}
    ]
    short = {
        sole: _joints_to(robot, robot.feet[sole][0]) for sole in moved if len(robot.feet[sole]) > 1
    }
    if not short or min(short.values()) >= _JOINTS:
        return None
    sole = min(short, key=short.__getitem__)
    return diagnose("sole-needs-six-joints", subject=("foot", sole), joints=short[sole])


def _joints_to(robot: Robot, point: str) -> int:
    """Returns how many joints move a contact point against the base."""
    model = robot.pin_model
    frame = model.getFrameId(robot.contact_frames[point], pin.FrameType.BODY)
    above = model.supports[model.frames[frame].parentJoint]
    return sum(model.names[joint] in robot.joint_names for joint in above)


def relax_foot_orientation(robot: Robot, goal: Goal, point: SolverResult) -> Goal:
    """Returns a goal whose feet are where a configuration has them, if they miss by micrometres.

    Args:
        robot: The robot.
        goal: The goal.
        point: Where a solver ended.
    """
    if point.converged or point.foot_error >= _YIELD or not has_underactuated_feet(robot):
        return goal
    places = Configuration(robot, point.qpos).foot_positions()
    return replace(goal, targets=freeze_arrays({foot: places[foot] for foot in goal.targets}))


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
        limb: tuple(branch for branch in branches if branch.foot_error <= reach + NEAR_MISS)
        for limb, branches in found.items()
    }
    yield from islice(combine_branches(likely, near), most)


def bound_com_shift(robot: Robot, qpos: Array, found: Mapping[Limb, tuple[Branch, ...]]) -> float:
    """Returns how far the choice of branches may move the base under a com that stays (m)."""
    total = 0.0
    for limb, branches in found.items():
        coms = []
        for branch in branches:
            bent = qpos.copy()
            bent[robot.nq - robot.nu + limb.joints] = branch.positions
            coms.append(Configuration(robot, bent).center_of_mass()[:2])
        total += float(np.max(np.linalg.norm(np.array(coms) - coms[0], axis=1)))
    return _SLACK * total + NEAR_MISS


def support_radius(goal: Goal) -> float:
    """Return the largest horizontal distance [m] between the feet's centre and the support polygon.

    If all feet are welded there is no support polygon: then the distance to the welded feet.
    """
    corners = goal.corners or [target[:2] for target in goal.targets.values()]
    distances = [np.linalg.norm(corner - goal.centre[:2]) for corner in np.array(corners)]
    return float(max(distances, default=0.0))


def make_seed(robot: Robot, goal: Goal, joints: Array, place: Array) -> Array:
    """Returns the configuration (nq,) with joints (nu,) inside their limits and the com at (2,)."""
    bent = np.clip(joints, goal.lower, goal.upper)
    qpos = np.array([0.0, 0.0, goal.height, *goal.base_quaternion, *bent])
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
    constraints = [one for one in make_constraints(shapes, goal) if one.name != "footholds"]
    starts: list[tuple[float, Array]] = []
    for number, move in enumerate(moves):
        near = {
            limb: tuple(branch for branch in branches[number] if branch.foot_error < _IN_REACH)
            for limb, branches in followed.items()
        }
        here = []
        for joints in islice(combine_branches(near, qpos[-robot.nu :]), _TRIED):
            start = np.concatenate([qpos[:3] + move, qpos[3:7], joints])
            at = shapes.move_to(start)
            here.append((sum(one.violation(goal, at) for one in constraints), start))
        starts += sorted(here, key=itemgetter(0))[:_PER_PLACE]
    yield from (start for _, start in sorted(starts, key=itemgetter(0)))
