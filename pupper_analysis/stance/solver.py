"""A stand task solved by PlaCo: a sequence of quadratic programmes on the whole body."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.stance.branches import find_limbs
from pupper_analysis.stance.constraints import TASK_TOLERANCE
from pupper_analysis.stance.context import Begun, Context
from pupper_analysis.stance.problem import Goal
from pupper_analysis.stance.tasks import Tasks

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Point:
    """Where a sequence of programmes has ended."""

    qpos: Array
    miss: float
    iterations: int


_STEP_TOLERANCE = 1e-13
"""Longest step (rad, m) that is not taken any more. The last one is not taken to find that out: a
step is followed by one that is smaller by the same factor at least, where steps converge at all."""

_STRAIGHT, _QUICKLY = 8, 1 / 16
"""Steps that are not looked at, as long as the square of each is so much less than that of the one
before: where steps converge as these do, the last of eight is below all rounding."""

_NEXT = 1e-10
"""Square of a first step that may be the only one: it is looked whether it has led there."""

_EXACT = 1e-14
"""Root of the sum of squares of what feet and com are off (m) that is rounding: a leg whose joints
move its foot by a centimetre a radian has them within 1e-12."""

_MAX_ITERATIONS = 200

_TRUST_RADIUS = 0.5  # rad per joint and iteration

_SIZE = 10.0  # of the robot, in heights of its stand: no foot moves by more for a radian per joint

_SLOW = 2  # iterations in a row at a pace that leads nowhere


class Solver:
    """PlaCo's tasks for one goal, solved from any start.

    The base's orientation and height and the com's place are hard constraints, which the free base
    can always satisfy; the feet are the objective, which vanishes if the stance is in reach.

    Args:
        context: The robot's.
        goal: The goal; a com that may be anywhere inside is where it has its place.

    Attributes:
        tasks: PlaCo's tasks, which other goals may have as well.
    """

    def __init__(self, context: Context, goal: Goal) -> None:
        robot = context.robot
        self.context, self.goal, self.robot = context, goal, robot
        self._size = _SIZE * robot.stand_height
        if robot.closure is not None:
            placing = np.concatenate([limb.joints for limb in find_limbs(robot)])
            self._readiness = robot.closure.readiness(placing)
        kept = context.tasks  # they differ in numbers alone
        if goal.by_base not in kept:
            kept[goal.by_base] = Tasks(context, goal)
        self.tasks = kept[goal.by_base]

    def run(self, joints: Array) -> Point:
        """Solves from joint positions (nu,); the base begins where it puts the com in its place."""
        self.tasks.aim(self.goal)
        return self._solved(self.begin(joints, self.goal.place))

    def go_on(self, qpos: Array) -> Point:
        """Solves from a configuration (nq,) that is next to the goal's, as far as can be foreseen.

        The base begins there, with the turn and the height that it shall have.
        """
        self.tasks.aim(self.goal)
        q = self._bent(qpos[7:])
        q[0], q[1], q[2] = qpos[0], qpos[1], self.goal.height
        self._put(q)
        return self._solved(q)

    def _solved(self, q: Array) -> Point:
        if self.robot.closure is not None:
            if not self._closes(q):
                return Point(self.robot.pin_convention.qpos(q), math.inf, 0)
            return self._watched(self.context.wrapper.state.q.copy())
        return self._straight() or self._watched(q)

    def _straight(self) -> Point | None:
        """Takes full steps for as long as they converge quickly.

        What is ever less of a step leads somewhere, and whether the feet are in place there is
        looked at when it has come there. None where that is not the way, or not the place.
        """
        tasks, wrapper = self.tasks, self.context.wrapper
        solve, move = tasks.solver.solve, wrapper.update_kinematics
        tasks.solver.dt = _TRUST_RADIUS
        last = math.inf
        for taken in range(1, _STRAIGHT + 1):
            try:
                step = solve(True)
            except RuntimeError:
                return None
            move()
            moved = float(step.dot(step))
            if _arrives(moved, last) or (moved < _NEXT and last == math.inf and self._exact()):
                point = self._point(wrapper.state.q, taken)
                return point if point.miss < TASK_TOLERANCE / 2 else None
            if moved > _QUICKLY * last:
                return None
            last = moved
        return None

    def _exact(self) -> bool:
        """Whether feet and com are in place to rounding."""
        self.tasks.look()
        return self.tasks.error() < _EXACT**2

    def _watched(self, q: Array) -> Point:
        """Takes steps from a q in a trust region, looking at the tasks after each.

        Where a step makes things worse it is undone, and the next one is shorter.
        """
        wrapper, tasks = self.context.wrapper, self.tasks
        convention = self.robot.pin_convention
        radius, iterations, slow = _TRUST_RADIUS, 0, 0
        error, last = math.inf, math.inf
        self._put(q)
        while iterations < _MAX_ITERATIONS and radius > _STEP_TOLERANCE and slow < _SLOW:
            iterations += 1
            left = _MAX_ITERATIONS - iterations
            if radius * self._size * left < math.sqrt(error) / 2 < math.inf:
                break  # too far for all steps that are left, though the feet are not in place
            tasks.solver.dt = radius
            tasks.bind(convention.qpos(q), q)
            try:
                step = tasks.solver.solve(True)
            except RuntimeError:
                # An infeasible programme: within a shorter step it may be feasible.
                radius /= 4
                self._put(q)
                continue
            wrapper.update_kinematics()
            closes = self._closes(wrapper.state.q)
            after, moved = wrapper.state.q.copy(), float(step.dot(step))
            tasks.look()
            new_error = tasks.error() if closes else math.inf
            if new_error > error and new_error > TASK_TOLERANCE**2:
                radius, last = radius / 4, math.inf
                self._put(q)
                continue
            nearer = math.sqrt(error) - math.sqrt(new_error)
            hopeless = new_error > TASK_TOLERANCE**2 and nearer * left < math.sqrt(new_error) / 2
            slow = slow + 1 if hopeless else 0
            error, q = new_error, after
            if _arrives(moved, last):
                break
            last = moved
        return self._point(wrapper.state.q, iterations)

    def _point(self, q: Array, iterations: int) -> Point:
        """Returns where PlaCo's robot is, at its q."""
        miss = self.tasks.miss()
        if miss >= TASK_TOLERANCE / 2:  # it may be what it was before the last step
            self.tasks.look()
            miss = self.tasks.miss()
        return Point(self.robot.pin_convention.qpos(q), miss, iterations)

    def _closes(self, q: Array) -> bool:
        """Closes the loops of PlaCo's robot, which is at q; tells if it can."""
        robot = self.robot
        if robot.closure is None:
            return True
        qpos = robot.pin_convention.qpos(q)
        closed = robot.closure.closed(qpos, self._readiness, self.goal.give)
        if closed is None:
            return False
        joints = closed[robot.nq - robot.nu :]
        beyond = np.maximum(self.goal.lower - joints, joints - self.goal.upper)
        if beyond.max(initial=0.0) > TASK_TOLERANCE:
            return False
        self._put(robot.pin_convention.with_joints(q, joints))
        return True

    def _put(self, q: Array) -> None:
        wrapper = self.context.wrapper
        wrapper.state.q = q
        wrapper.update_kinematics()

    def begin(self, joints: Array, place: Array) -> Array:
        """Puts PlaCo's robot as the goal turns it, its com or base over a place (2,) (m).

        Returns:
            Its q.
        """
        goal, begun = self.goal, self.context.begun
        # Searches begin at home, as a rule; and with it the com is where it was under the base.
        if begun is None or not self._began(begun, joints):
            begun = self.context.begun = self._at_origin(joints)
        q = begun.q.copy()
        x, y = place.tolist()
        q[0], q[1], q[2] = x - begun.over[0], y - begun.over[1], goal.height
        self._put(q)
        return q

    def _began(self, begun: Begun, joints: Array) -> bool:
        """Tells whether a search has begun as this one does."""
        goal, (low, high) = self.goal, begun.limits
        same = goal.by_base == begun.by_base and goal.turn == begun.turn
        alike = low is goal.lower and high is goal.upper
        return same and alike and joints.tolist() == begun.joints

    def _at_origin(self, joints: Array) -> Begun:
        """Begins with the base at the origin."""
        goal, q, over = self.goal, self._bent(joints), (0.0, 0.0)
        if not goal.by_base:
            self._put(q)
            x, y, _ = self.context.wrapper.com_world().tolist()
            over = x, y
        return Begun(joints.tolist(), (goal.lower, goal.upper), goal.turn, goal.by_base, q, over)

    def _bent(self, joints: Array) -> Array:
        """Returns q with the base at the origin and turned as it shall be, joints inside limits."""
        goal = self.goal
        qpos = np.empty(7 + len(joints))
        qpos[:7] = 0.0, 0.0, 0.0, *goal.turn
        np.maximum(joints, goal.lower, qpos[7:])
        np.minimum(qpos[7:], goal.upper, qpos[7:])
        return self.robot.pin_convention.unit_q(qpos)


def _arrives(moved: float, last: float) -> bool:
    """Whether no step need follow one, by its length squared, and that of the one before."""
    following = moved * min(1.0, moved / last) if last < math.inf else moved
    return following < _STEP_TOLERANCE**2
