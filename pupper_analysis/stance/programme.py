"""A stand as a programme: all constraints at once, and demands that may give where they must.

Source: Gill, Murray and Saunders, "SNOPT: an SQP algorithm for large-scale constrained
optimization", 2005, section 1.2: demands that cannot be met together get slacks, whose sum is
minimised. A sum of absolute values leaves most of them at zero. SciPy's SLSQP solves it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.stance.clearance import ClearanceShapes
from pupper_analysis.stance.constraints import TASK_TOLERANCE, Constraint, make_constraints
from pupper_analysis.stance.demands import DemandVector
from pupper_analysis.stance.problem import Goal, make_goal
from pupper_analysis.stance.task import StandTask

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_DIFFERENCE_STEP = 1e-7
"""Of difference quotients by a demand's numbers (stand heights, rad): with longer ones steps and
slopes are less exact, with shorter ones rounding counts."""

_MET = 1e-6
"""Constraints that are missed by less are met (m, rad): the search does the rest."""

_ITERATIONS = (20, 50)
"""How many at most without demands to give, and with some: 1,500 of 1,500 that led to a stand took
12 or fewer, and of 350 nine in ten 45 or fewer."""

_FINE_UNIT = 200.0
"""Parts of a stand height in which distances of the feet are when these are to be least and little
is left: where a valley is flat, by a tenth of a millimetre in 30, whole heights end at its side,
and thousands of parts on the way. At the end of reach it takes some 45 steps."""

_MAX_ITERATIONS = 100
"""How many they are at most."""

_HARDLY, _STALLED = 0.9, (4, 32)
"""A solution ends after so many steps, without demands to give and with some, each of which leaves
more than such a part of what has been missed least: demands that give go by way of such steps. Of
138 and 350 that led to a stand one each took more; of 206 that led to none two thirds did, and of
633 one in eight."""

_DEPENDENT = 1e-6
"""Equalities of which less is independent follow from the others: SLSQP cannot have them twice."""


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Demands that give, and where what is left is met as well as it can be.

    Attributes:
        task: The task with other numbers.
        qpos: (nq,) the configuration.
        given: {demand: how much it gives} (stand heights, rad).
        violation: By how much what is left is missed (m, rad).
    """

    task: StandTask
    qpos: Array
    given: dict[str, float]
    violation: float

    @property
    def is_met(self) -> bool:
        """Whether what is left is met, but for what the search mends."""
        return self.violation <= _MET

    @property
    def slack(self) -> float:
        """How much all demands give together."""
        return sum(self.given.values())


@dataclass(frozen=True, eq=False)
class _Point:
    """Where the problem is looked at: the configuration and the goal there, and the residuals."""

    x: Array
    qpos: Array
    goal: Goal
    residuals: tuple[Array, ...]


class _NoProgressError(Exception):
    """Steps do not lead on."""


class _Progress:
    """How the steps of a solution get on.

    Args:
        enough: What is missed by no more is met (m, rad).
        patience: After how many steps in a row that did not help it ends.

    Attributes:
        x: Where the constraints have been missed least.
    """

    x: Array

    def __init__(self, enough: float, patience: int) -> None:
        self._enough, self._patience = enough, patience
        self._least, self._in_vain = math.inf, 0

    def look(self, x: Array, missed: float) -> None:
        """Takes notice of where a step has led.

        Raises:
            _NoProgressError: After some steps in a row that did not help.
        """
        helps = missed <= max(self._enough, _HARDLY * self._least)
        self._in_vain = 0 if helps else self._in_vain + 1
        if missed < self._least:
            self._least, self.x = missed, x.copy()
        if self._in_vain > self._patience:
            raise _NoProgressError


class StanceProgram:
    """The problem: in the base's x and y, the joints, and how much less and more numbers become.

    Lengths are in stand heights, so that a robot that is scaled gives alike. The base has the
    height and the turn of the goal in every configuration that is tried.

    Args:
        shapes: The robot with its shapes.
        goal: What is asked.
        demands: Which demands may give.
        without: Constraints that are left out, by name.
    """

    def __init__(
        self,
        shapes: ClearanceShapes,
        goal: Goal,
        demands: Sequence[str] = (),
        *,
        without: Collection[str] = (),
    ) -> None:
        robot = self._robot = shapes.robot
        self._shapes, self._goal, self._demands = shapes, goal, tuple(demands)
        own = [one for one in make_constraints(shapes, goal) if not one.is_presatisfied]
        if "joint_margin" not in demands:  # bounds of the joints are the same, and cost nothing
            own = [one for one in own if one.name != "joint-limits"]
        kept = [one for one in own if one.name not in without]
        self._constraints: list[Constraint] = sorted(kept, key=lambda one: not one.is_equality)
        self._unit = robot.stand_height
        self._numbers = numbers = DemandVector(robot, goal.task, demands)
        least, most = (
            (end - numbers.values) / numbers.units for end in (numbers.low, numbers.high)
        )
        within = goal.lower, goal.upper
        if "joint_margin" in demands:  # all but a posture may give
            placed = goal.lower == goal.upper
            within = np.where(placed, goal.lower, -np.inf), np.where(placed, goal.upper, np.inf)
        nothing, anywhere = np.zeros(2 * len(numbers.keys)), np.full(2, np.inf)
        self._low = np.concatenate([-anywhere, within[0], nothing])
        self._high = np.concatenate([anywhere, within[1], -least, most])
        self._cost = np.concatenate([np.zeros(2 + robot.nu), nothing + 1.0])
        self._moving = [0, 1, *range(robot.nv - robot.nu, robot.nv)]
        self._last: _Point | None = None
        self._at: tuple[_Point, Configuration] | None = None
        self._jacobian_there: tuple[Array, Array] | None = None

    def solve(self, qpos: Array, task: StandTask | None = None) -> Relaxation:
        """Finds how the demands give least, from one start.

        Args:
            qpos: (nq,) where to start.
            task: What the demands are there; by default what is asked.
        """
        gives = bool(self._demands)
        progress = _Progress(_MET if gives else TASK_TOLERANCE, _STALLED[gives])
        cost = self._cost
        x = self._minimised(
            lambda x: (float(cost @ x), cost),
            self._start(qpos, task),
            1e-9,
            _ITERATIONS[gives],
            progress,
        )
        numbers, values = self._numbers, self._values(x)
        given = dict.fromkeys(self._demands, 0.0)
        slacks = np.abs(values - numbers.values) / numbers.units
        for demand, slack in zip(numbers.demands, slacks.tolist(), strict=True):
            given[demand] += slack
        return Relaxation(numbers.make_task(values), self._point(x).qpos, given, self._missed(x))

    def nearest(self, qpos: Array) -> Array:
        """Returns where the feet are as near to their places as they can come (nq,), from a start.

        The sum of the squared distances is minimised, with all constraints that are not left out:
        in stand heights first, and then in parts of what that has left.
        """
        x, scale = self._start(qpos, None), self._unit**-2
        for tolerance, most in ((1e-12, _ITERATIONS[1]), (1e-10, _MAX_ITERATIONS)):
            x = self._minimised(partial(self._distances, scale=scale), x, tolerance, most)
            scale = 1 / max(self._distances(x)[0], (self._unit / _FINE_UNIT) ** 2)
        return self._point(x).qpos

    def _distances(self, x: Array, scale: float = 1.0) -> tuple[float, Array]:
        """Returns the sum of the feet's squared distances times a scale, and its gradient."""
        at = self._configuration(x)
        feet, jacobians = at.foot_positions(), at.foot_jacobians()
        total, gradient = 0.0, np.zeros(self._robot.nv)
        for foot, target in self._goal.targets.items():
            error = feet[foot] - target
            total += float(error @ error)
            gradient += 2 * error @ jacobians[foot]
        own = gradient[self._moving]
        own[:2] *= self._unit
        return scale * total, scale * own

    def _minimised(
        self,
        function: Callable[[Array], tuple[float, Array]],
        start: Array,
        tolerance: float,
        iterations: int,
        progress: _Progress | None = None,
    ) -> Array:
        """Returns where a function is least, from one start, by SLSQP.

        Args:
            function: Its value and its gradient.
            start: Where to begin.
            tolerance: Of the value.
            iterations: How many at most.
            progress: What ends it where steps do not help to meet the constraints.
        """
        from scipy import optimize  # slow to import

        equal = self._rows[1]

        def rates(x: Array, rows: slice) -> Array:  # asked for at the end of each step
            if progress is not None:
                progress.look(x, self._missed(x))
            return self._jacobian(x)[rows]

        total = len(self._rows[0])
        kinds = ("eq", slice(0, equal)), ("ineq", slice(equal, total))
        try:
            x = optimize.minimize(
                function,
                start,
                jac=True,
                method="SLSQP",
                bounds=list(zip(self._low, self._high, strict=True)),
                constraints=[
                    {
                        "type": kind,
                        "fun": lambda x, rows=rows: self._residuals(x)[rows],
                        "jac": partial(rates, rows=rows),
                    }
                    for kind, rows in kinds
                    if rows.start < rows.stop
                ],
                options={"ftol": tolerance, "maxiter": iterations},
            ).x
        except _NoProgressError:
            assert progress is not None
            x = progress.x
        inside: Array = np.clip(x, self._low, self._high)
        return inside

    def _missed(self, x: Array) -> float:
        """Returns by how much the constraints are missed there, at most (m, rad)."""
        left, equal = self._residuals(x), self._rows[1]
        off = np.abs(left[:equal]).max(initial=0.0)
        return float(max(off, -left[equal:].min(initial=0.0)))

    def _start(self, qpos: Array, task: StandTask | None) -> Array:
        numbers = self._numbers
        had = numbers.values if task is None else numbers.read_task(task)
        given = (had - numbers.values) / numbers.units
        parts = qpos[:2] / self._unit, qpos[7:], np.maximum(-given, 0.0), np.maximum(given, 0.0)
        start: Array = np.clip(np.concatenate(parts), self._low, self._high)
        return start

    def _values(self, x: Array) -> Array:
        """Returns the demands' numbers there (m, rad)."""
        less, more = np.split(x[2 + self._robot.nu :], 2)
        numbers = self._numbers
        return numbers.clip(numbers.values + numbers.units * (more - less))

    def _look(self, x: Array) -> _Point:
        goal = self._goal_at(self._values(x), self._goal)
        qpos = np.empty(self._robot.nq)
        qpos[:2], qpos[2], qpos[3:7] = self._unit * x[:2], goal.height, goal.base_quaternion
        qpos[7:] = x[2 : 2 + self._robot.nu]
        at = self._shapes.move_to(qpos)
        residuals = tuple(one.residual(goal, at) for one in self._constraints)
        return _Point(x.copy(), at.qpos, goal, residuals)

    def _goal_at(self, values: Array, like: Goal) -> Goal:
        return make_goal(
            self._robot, self._numbers.make_task(values), self._goal.depths, like, checked=False
        )

    def _point(self, x: Array) -> _Point:
        """Returns what is there; each constraint asks for it in turn, and it is made once."""
        if self._last is None or not (x == self._last.x).all():
            self._last = self._look(x)
        return self._last

    def _configuration(self, x: Array) -> Configuration:
        there = self._point(x)
        if self._at is None or self._at[0] is not there:
            self._at = there, Configuration(self._robot, there.qpos)
        return self._at[1]

    def _residuals(self, x: Array) -> Array:
        joined: Array = _stack(self._point(x).residuals, 0)[self._rows[0]]
        return joined

    def _jacobian(self, x: Array) -> Array:
        if self._jacobian_there is None or not (x == self._jacobian_there[0]).all():
            self._jacobian_there = x.copy(), self._derivative(x)[self._rows[0]]
        return self._jacobian_there[1]

    def _derivative(self, x: Array) -> Array:
        """Returns the derivative of all residuals (m, n).

        By the robot's motion it is exact; by a number it is that of the base's motion with it, and
        a difference quotient of the residuals with the robot at rest, where they depend on it.
        """
        there, values = self._point(x), self._values(x)
        config = self._configuration(x)
        rates = [one.jacobian(there.goal, config) for one in self._constraints]
        at = self._shapes.move_to(there.qpos)
        moved = _stack(rates, self._robot.nv)
        ends = np.cumsum([len(rate) for rate in rates])
        columns, numbers = [], self._numbers
        towards = np.copysign(_DIFFERENCE_STEP * numbers.units, numbers.values - values)
        for number, unit in enumerate(numbers.units):
            near = values.copy()  # towards what is asked: beyond it there may be nothing
            near[number] += towards[number]
            if near[number] > numbers.high[number] > numbers.low[number]:
                near[number] -= 2 * towards[number]  # nothing is turned by more than 180 degrees
            step = near[number] - values[number]
            goal = self._goal_at(near, there.goal)
            column = moved[:, :6] @ (_twist(there.goal, goal) / step)
            for one, before, end in zip(self._constraints, there.residuals, ends, strict=True):
                change = one.residual(goal, at) - before
                column[end - len(before) : end] += change / step
            columns.append(unit * column)
        by_numbers = np.array(columns).reshape(len(columns), len(moved)).T
        by_motion = moved[:, self._moving]
        by_motion[:, :2] *= self._unit
        return np.hstack([by_motion, -by_numbers, by_numbers])

    @cached_property
    def _rows(self) -> tuple[IntArray, int]:
        """Rows of which no equality follows from others, and how many of them are equalities."""
        random = np.random.default_rng(0)
        x = np.zeros(len(self._cost))
        low, high = np.maximum(self._goal.lower, -np.pi), np.minimum(self._goal.upper, np.pi)
        x[2 : 2 + self._robot.nu] = random.uniform(low, np.maximum(low, high))
        residuals, whole = self._point(x).residuals, self._derivative(x)
        pairs = zip(self._constraints, residuals, strict=True)
        equal = sum(len(one) for constraint, one in pairs if constraint.is_equality)
        _, triangle, order = linalg.qr(whole[:equal].T, mode="economic", pivoting=True)
        size = np.abs(np.diag(triangle))
        kept = np.sort(order[: int((size > _DEPENDENT * size.max(initial=0.0)).sum())])
        return np.concatenate([kept, np.arange(equal, len(whole))]), len(kept)


def _stack(blocks: Sequence[Array], columns: int) -> Array:
    """Stack residuals (n,), or rows (n, columns) if ``columns`` > 0; there may be no block."""
    return np.concatenate([np.zeros((0, columns) if columns else 0), *blocks])


def _twist(goal: Goal, other: Goal) -> Array:
    """Returns how the base moves (6,) from one goal's height and turn to another's nearby."""
    (w, x, y, z), (a, b, c, d) = goal.base_quaternion, other.base_quaternion
    turned = (  # the vector of the first one's inverse times the second
        w * b - x * a - y * d + z * c,
        w * c - y * a - z * b + x * d,
        w * d - z * a - x * c + y * b,
    )
    sign = math.copysign(2.0, w * a + x * b + y * c + z * d)
    rise = other.height - goal.height
    return np.array([0.0, 0.0, rise, *(sign * part for part in turned)])
