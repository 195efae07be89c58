"""Solve for a stand by a nonlinear program, in which requirements may be relaxed.

Variables are the horizontal base position, the joint positions, and two slacks for each number of a
relaxable requirement: a decrease and an increase. The sum of the slacks is minimised, which favours
slacks of zero. The solver is SciPy's SLSQP.

Source: Gill, Murray and Saunders, "SNOPT: an SQP algorithm for large-scale constrained
optimization", 2005 (elastic mode).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from pupper_analysis.base import lapack
from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.stance.clearance import ClearanceShapes
from pupper_analysis.stance.constraints import TASK_TOLERANCE, Constraint, make_constraints
from pupper_analysis.stance.problem import StandTargets, compute_targets
from pupper_analysis.stance.requirements import RequirementVector
from pupper_analysis.stance.task import StandTask

_DIFFERENCE_STEP = 1e-7
"""Finite-difference step for the derivative of the residuals by a relaxable value of the task, in
units of the robot's stand height (lengths) or rad. Chosen, not tuned, between truncation and
rounding errors."""

_SATISFIED_VIOLATION = 1e-6
"""Violation [m, rad] up to which the constraints of a program with slacks count as satisfied.
Chosen, not tuned."""

_SOLVE_ITERATIONS = (20, 50)
"""Upper bounds of the number of SLSQP iterations of a solve, without and with relaxable
requirements. The second value also bounds the first run of `minimise_foot_distances`. Measured on
solves that led to a stand: without relaxation, all of 1,500 solves took 12 iterations or fewer;
with relaxation, 90 % of 350 solves took 45 or fewer."""

_FINE_UNIT_DIVISOR = 200.0
"""Divisor [1] of the stand height, which gives the smallest unit of length in the second run of
`minimise_foot_distances`. Measured with flat minima: SLSQP stops before the minimum if the unit is
the stand height, or a thousandth of the stand height."""

_MAX_ITERATIONS = 100
"""Upper bound of the number of SLSQP iterations in the second run of `minimise_foot_distances`.
Chosen, not tuned."""

_MAX_PROGRESS_RATIO = 0.9
"""Upper bound of the ratio ``violation / smallest earlier violation`` with which an SLSQP iteration
counts as progress. A violation within the solver's tolerance also counts. Iterations without
progress end the solve (`_PATIENCE`). Chosen, not tuned."""

_PATIENCE = (1, 15)
"""Largest numbers of successive SLSQP iterations without progress, without and with relaxable
requirements. Measured without relaxation: 1 of 138 solves that led to a stand exceeded the bound,
and two thirds of 206 solves without a stand. Measured with relaxation: 1 of 350, and one eighth of
633."""

_INDEPENDENCE_RTOL = 1e-6
"""Diagonal element of the pivoted QR factor of the equalities' Jacobian, relative to the largest
element, up to which an equality constraint is dropped as linearly dependent. SLSQP may fail
with dependent equalities. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Result of a solve: task with changed (relaxed) values, and configuration.

    Attributes:
        task: Task with relaxed numbers.
        qpos: Configuration, shape (nq,).
        relaxations: {requirement: sum of the absolute changes of its numbers}, lengths in stand
            heights, angles in rad.
        violation: Largest violation of the program's constraints with the relaxed values [m, rad].
    """

    task: StandTask
    qpos: Array
    relaxations: dict[str, float]
    violation: float

    @property
    def is_met(self) -> bool:
        """Whether ``qpos`` satisfies the constraints, up to a violation of 1e-6 [m, rad]."""
        return self.violation <= _SATISFIED_VIOLATION

    @property
    def slack(self) -> float:
        """Sum of the absolute changes of all numbers: lengths / stand height, angles [rad]."""
        return sum(self.relaxations.values())


@dataclass(frozen=True, eq=False)
class _Point:
    """Evaluated point of the program.

    Attributes:
        x: Variables, shape (v,).
        qpos: Configuration, shape (nq,).
        targets: Targets and limits with the relaxed numbers.
        residuals: Residual of each constraint, shape (n,) each [m, rad].
    """

    x: Array
    qpos: Array
    targets: StandTargets
    residuals: tuple[Array, ...]


class _NoProgressError(Exception):
    """Raised to end SLSQP if successive iterations make no progress (`_PATIENCE`)."""


class _Progress:
    """Monitor of the constraint violation during a solve, which ends a solve without progress.

    Args:
        enough: Violation that counts as satisfied [m, rad].
        patience: Largest number of successive iterations without progress; one more ends the solve.

    Attributes:
        x: Variables with the smallest violation so far, shape (v,).
    """

    x: Array

    def __init__(self, enough: float, patience: int) -> None:
        self._enough, self._patience = enough, patience
        self._smallest, self._steps_in_vain = math.inf, 0
        self._last: Array | None = None

    def update(self, x: Array, violation: float) -> None:
        """Record the violation at variables ``x``, and store ``x`` with the smallest violation.

        Successive calls with the same ``x`` count once: in an iteration, SLSQP evaluates the
        Jacobians of equalities and of inequalities separately.

        Args:
            x: Variables of the program.
            violation: Largest violation of the constraints at ``x`` [m, rad].

        Raises:
            _NoProgressError: If more than ``patience`` successive iterations found no progress.
        """
        if self._last is not None and np.array_equal(x, self._last):
            return
        self._last = x.copy()
        helps = violation <= max(self._enough, _MAX_PROGRESS_RATIO * self._smallest)
        self._steps_in_vain = 0 if helps else self._steps_in_vain + 1
        if violation < self._smallest:
            self._smallest, self.x = violation, x.copy()
        if self._steps_in_vain > self._patience:
            raise _NoProgressError


class StanceProgram:
    """Nonlinear program that finds a configuration for a stand, with the smallest relaxations.

    The v variables ``x`` are the horizontal base position, the joint positions, and the
    relaxations. Base position and relaxations of lengths are in stand heights, joint positions and
    relaxations of angles in rad or m. At each point, the base has the height and orientation of the
    relaxed task.

    Args:
        shapes: Robot with collision shapes.
        targets: Targets and limits of the stand (`StandTargets`).
        requirements: Names of requirements that may be relaxed, from `RELAXABLE_REQUIREMENTS`.
        without: Names of constraints that are left out of the program.
    """

    def __init__(
        self,
        shapes: ClearanceShapes,
        targets: StandTargets,
        requirements: Sequence[str] = (),
        *,
        without: Collection[str] = (),
    ) -> None:
        robot = self._robot = shapes.robot
        self._shapes, self._targets, self._requirements = shapes, targets, tuple(requirements)
        own = [c for c in make_constraints(shapes, targets) if not c.is_presatisfied]
        if "joint_margin" not in requirements:  # bounds of the variables are cheaper
            own = [constraint for constraint in own if constraint.name != "joint-limits"]
        kept = [constraint for constraint in own if constraint.name not in without]
        self._constraints: list[Constraint] = sorted(kept, key=lambda c: not c.is_equality)
        self._unit = robot.stand_height
        self._numbers = numbers = RequirementVector(robot, targets.task, requirements)
        least, most = (
            (end - numbers.values) / numbers.units for end in (numbers.low, numbers.high)
        )
        within = targets.lower, targets.upper
        if "joint_margin" in requirements:  # limits of a posture stay
            placed = targets.lower == targets.upper
            within = (
                np.where(placed, targets.lower, -np.inf),
                np.where(placed, targets.upper, np.inf),
            )
        nothing, anywhere = np.zeros(2 * len(numbers.keys)), np.full(2, np.inf)
        self._low = np.concatenate([-anywhere, within[0], nothing])
        self._high = np.concatenate([anywhere, within[1], -least, most])
        self._cost = np.concatenate([np.zeros(2 + robot.nu), nothing + 1.0])
        self._moving = [0, 1, *range(robot.nv - robot.nu, robot.nv)]
        self._last: _Point | None = None
        self._at: tuple[_Point, Configuration] | None = None
        self._jacobian_there: tuple[Array, Array] | None = None

    def solve(self, qpos: Array, task: StandTask | None = None) -> Relaxation:
        """Find a configuration for the stand, with the smallest changes of the relaxable values.

        Args:
            qpos: Initial configuration, shape (nq,). The base height and orientation are ignored:
                they are those of the task.
            task: Task with the values from which the solve starts. Default: the requested values.

        Returns:
            Relaxed task and configuration, which may violate the constraints if SLSQP does not
            converge.
        """
        relaxable = bool(self._requirements)
        tolerance = _SATISFIED_VIOLATION if relaxable else TASK_TOLERANCE
        progress = _Progress(tolerance, _PATIENCE[relaxable])
        cost = self._cost
        x = self._run_slsqp(
            lambda x: (float(cost @ x), cost),
            self._make_start(qpos, task),
            1e-9,
            _SOLVE_ITERATIONS[relaxable],
            progress,
        )
        numbers, values = self._numbers, self._compute_requirement_values(x)
        given = dict.fromkeys(self._requirements, 0.0)
        slacks = np.abs(values - numbers.values) / numbers.units
        for requirement, slack in zip(numbers.requirements, slacks.tolist(), strict=True):
            given[requirement] += slack
        return Relaxation(
            numbers.make_task(values), self._get_point(x).qpos, given, self._max_violation(x)
        )

    def minimise_foot_distances(self, qpos: Array) -> Array:
        """Find the configuration (nq,) with the contact points nearest to their targets.

        The sum of squared distances is minimised subject to the constraints of this nonlinear
        program. The minimum may be local.

        Args:
            qpos: Initial configuration, shape (nq,).
        """
        x, scale = self._make_start(qpos, None), self._unit**-2
        for tolerance, most in ((1e-12, _SOLVE_ITERATIONS[1]), (1e-10, _MAX_ITERATIONS)):
            x = self._run_slsqp(partial(self._squared_distances, scale=scale), x, tolerance, most)
            scale = 1 / max(self._squared_distances(x)[0], (self._unit / _FINE_UNIT_DIVISOR) ** 2)
        return self._get_point(x).qpos

    def _squared_distances(self, x: Array, scale: float = 1.0) -> tuple[float, Array]:
        """Compute ``scale`` times the sum of squared foot errors [m^2], and the gradient (v,)."""
        at = self._get_configuration(x)
        feet, jacobians = at.foot_positions(), at.foot_jacobians()
        total, gradient = 0.0, np.zeros(self._robot.nv)
        for foot, target in self._targets.foot_targets.items():
            error = feet[foot] - target
            total += float(error @ error)
            gradient += 2 * error @ jacobians[foot]
        own = gradient[self._moving]
        own[:2] *= self._unit
        return scale * total, scale * own

    def _run_slsqp(
        self,
        function: Callable[[Array], tuple[float, Array]],
        start: Array,
        tolerance: float,
        iterations: int,
        progress: _Progress | None = None,
    ) -> Array:
        """Minimise a function under this program's constraints by SLSQP; return variables (v,).

        Args:
            function: Returns value and gradient, shape (v,), at the variables.
            start: Initial guess of the variables, shape (v,).
            tolerance: Tolerance of the function value (``ftol`` of SLSQP).
            iterations: Upper bound of iterations.
            progress: Monitor that may end the solve at the variables with the smallest violation so
                far.
        """
        from scipy import optimize  # slow to import

        equal = self._rows[1]

        def rates(x: Array, rows: slice) -> Array:
            """Return the Jacobian (m, v) of some constraint residuals; record the progress.

            ``rows`` selects equalities or inequalities.
            """
            if progress is not None:
                progress.update(x, self._max_violation(x))
            return self._get_used_jacobian(x)[rows]

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
                        "fun": lambda x, rows=rows: self._get_used_residuals(x)[rows],
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

    def _max_violation(self, x: Array) -> float:
        """Return the largest violation of the constraints [m, rad]."""
        left, equal = self._get_used_residuals(x), self._rows[1]
        off = np.abs(left[:equal]).max(initial=0.0)
        return float(max(off, -left[equal:].min(initial=0.0)))

    def _make_start(self, qpos: Array, task: StandTask | None) -> Array:
        """Convert an initial configuration (nq,) and relaxed task to variables (v,)."""
        numbers = self._numbers
        had = numbers.values if task is None else numbers.read_task(task)
        given = (had - numbers.values) / numbers.units
        parts = qpos[:2] / self._unit, qpos[7:], np.maximum(-given, 0.0), np.maximum(given, 0.0)
        start: Array = np.clip(np.concatenate(parts), self._low, self._high)
        return start

    def _compute_requirement_values(self, x: Array) -> Array:
        """Convert the variables ``x`` (v,) to the relaxed values of the task, (n,) [m, rad]."""
        less, more = np.split(x[2 + self._robot.nu :], 2)
        numbers = self._numbers
        return numbers.clip(numbers.values + numbers.units * (more - less))

    def _evaluate_point(self, x: Array) -> _Point:
        """Compute targets, configuration and constraint residuals at the variables ``x`` (v,)."""
        targets = self._compute_targets(self._compute_requirement_values(x), self._targets)
        qpos = np.empty(self._robot.nq)
        qpos[:2], qpos[2], qpos[3:7] = self._unit * x[:2], targets.height, targets.base_quaternion
        qpos[7:] = x[2 : 2 + self._robot.nu]
        at = self._shapes.move_to(qpos)
        residuals = tuple(c.residual(targets, at) for c in self._constraints)
        return _Point(x.copy(), at.qpos, targets, residuals)

    def _compute_targets(self, values: Array, like: StandTargets) -> StandTargets:
        """Convert values of relaxable requirements [m, rad] to targets; reuse parts of ``like``."""
        task, stated = self._numbers.make_task(values, checked=False), self._targets
        targets = compute_targets(self._robot, task, stated.depths, like, checked=False)
        return replace(targets, loop_opening=stated.loop_opening)

    def _get_point(self, x: Array) -> _Point:
        """Return targets, configuration and constraint residuals at the variables ``x`` (v,)."""
        if self._last is None or not (x == self._last.x).all():
            self._last = self._evaluate_point(x)
        return self._last

    def _get_configuration(self, x: Array) -> Configuration:
        """Return the robot's `Configuration` at the variables ``x`` (v,)."""
        there = self._get_point(x)
        if self._at is None or self._at[0] is not there:
            self._at = there, Configuration(self._robot, there.qpos)
        return self._at[1]

    def _get_used_residuals(self, x: Array) -> Array:
        """Return the used constraint residuals [m, rad] at ``x`` (v,), equalities first."""
        joined: Array = _stack_blocks(self._get_point(x).residuals, 0)[self._rows[0]]
        return joined

    def _get_used_jacobian(self, x: Array) -> Array:
        """Return the Jacobian of ``_get_used_residuals`` by the variables ``x`` (v,)."""
        if self._jacobian_there is None or not (x == self._jacobian_there[0]).all():
            self._jacobian_there = x.copy(), self._compute_jacobian(x)[self._rows[0]]
        return self._jacobian_there[1]

    def _compute_jacobian(self, x: Array) -> Array:
        """Compute the Jacobian (r, v) of all r constraint residuals by the v variables.

        Derivatives by robot motion are analytic, those by relaxable values partly difference
        quotients.
        """
        there, values = self._get_point(x), self._compute_requirement_values(x)
        config = self._get_configuration(x)
        rates = [c.jacobian(there.targets, config) for c in self._constraints]
        at = self._shapes.move_to(there.qpos)
        moved = _stack_blocks(rates, self._robot.nv)
        ends = np.cumsum([len(rate) for rate in rates])
        columns, numbers = [], self._numbers
        towards = np.copysign(_DIFFERENCE_STEP * numbers.units, numbers.values - values)
        for number, unit in enumerate(numbers.units):
            near = values.copy()  # towards the requested value: beyond it may be invalid
            near[number] += towards[number]
            if near[number] > numbers.high[number] > numbers.low[number]:
                near[number] -= 2 * towards[number]  # angles up to 180 deg only
            step = near[number] - values[number]
            targets = self._compute_targets(near, there.targets)
            column = moved[:, :6] @ (_base_motion(there.targets, targets) / step)
            for constraint, before, end in zip(
                self._constraints, there.residuals, ends, strict=True
            ):
                change = constraint.residual(targets, at) - before
                column[end - len(before) : end] += change / step
            columns.append(unit * column)
        by_numbers = np.array(columns).reshape(len(columns), len(moved)).T
        by_motion = moved[:, self._moving]
        by_motion[:, :2] *= self._unit
        return np.hstack([by_motion, -by_numbers, by_numbers])

    @cached_property
    def _rows(self) -> tuple[IntArray, int]:
        """Indices of independent equality and all inequality residuals; equality count."""
        random = np.random.default_rng(0)
        x = np.zeros(len(self._cost))
        low, high = np.maximum(self._targets.lower, -np.pi), np.minimum(self._targets.upper, np.pi)
        x[2 : 2 + self._robot.nu] = random.uniform(low, np.maximum(low, high))
        residuals, whole = self._get_point(x).residuals, self._compute_jacobian(x)
        pairs = zip(self._constraints, residuals, strict=True)
        equal = sum(len(rows) for constraint, rows in pairs if constraint.is_equality)
        triangle, order = lapack.pivoted_qr(whole[:equal].T)
        size = np.abs(np.diag(triangle))
        kept = np.sort(order[: int((size > _INDEPENDENCE_RTOL * size.max(initial=0.0)).sum())])
        return np.concatenate([kept, np.arange(equal, len(whole))]), len(kept)


def _stack_blocks(blocks: Sequence[Array], columns: int) -> Array:
    """Concatenate vectors (n,), or matrices (n, columns) if ``columns`` > 0, along the rows."""
    return np.concatenate([np.zeros((0, columns) if columns else 0), *blocks])


def _base_motion(targets: StandTargets, other: StandTargets) -> Array:
    """Return the small displacement (6,) of the base between two targets, in qvel's order.

    Translation [m] along world axes, vertical only; rotation vector [rad] along base axes.
    """
    (w, x, y, z), (a, b, c, d) = targets.base_quaternion, other.base_quaternion
    turned = (  # vector part of the relative quaternion
        w * b - x * a - y * d + z * c,
        w * c - y * a - z * b + x * d,
        w * d - z * a - x * c + y * b,
    )
    sign = math.copysign(2.0, w * a + x * b + y * c + z * d)
    rise = other.height - targets.height
    return np.array([0.0, 0.0, rise, *(sign * part for part in turned)])
