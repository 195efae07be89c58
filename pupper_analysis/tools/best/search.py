"""Search for the best stance: a smooth nonlinear program, solved from many initial guesses.

The scaled objective t is the objective, divided by its magnitude in the initial task; smaller is
better. Each stance yields constraints a + b t >= 0 (`EvaluatedStance.rows`): the smooth functions
whose maximum is t, and the slacks of `StanceSpace` (b = 0). SLSQP minimises t, an additional
variable beside the coordinates, first with feet that move together
(`StanceSpace.coupled_directions`), then in all coordinates.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    NoEquilibriumError,
    StaticsInfeasibleError,
)
from pupper_analysis.base.progress import report_progress
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.robot.tool import FramePoint, find_place
from pupper_analysis.stance.stand import Stand, stand_contacts, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.equilibrium import differentiate_torques, peak_utilisation
from pupper_analysis.tools.best.first_order import SmallPayload, largest_feasible_mass
from pupper_analysis.tools.best.space import JOINT_LIMIT_OVERSHOOT, StanceSlack, StanceSpace

_SAMPLE_COUNT = 128
"""Number of stances (Latin hypercube samples of the stances whose feet move together) that are
evaluated to choose the initial guesses of the descents. Chosen, not tuned."""

_START_COUNT = 16
"""Number of descents that start at the best samples; another descent starts at the initial task.
Chosen, not tuned."""

_RANKING_ITERATIONS = 8
"""Upper bound of the SLSQP iterations of the first descent from each initial guess, which ranks the
guesses. Chosen, not tuned."""

_FINALIST_COUNT = 6
"""Number of first descents, with the best results, that are continued. Chosen, not tuned."""

_DESCENT_ITERATIONS = 25
"""Upper bound of the SLSQP iterations of two kinds of descents: from the `_FINALIST_COUNT` best
results of the first descents, and from the best stance with feet that move independently. Chosen,
not tuned."""

_INDEPENDENT_FEET_ITERATIONS = 10
"""Upper bound of the SLSQP iterations of a descent in which each foot moves independently, from the
result of a descent in which the feet move together. Chosen small: without derivatives in closed
form, an iteration evaluates a stance per coordinate (14 with four feet)."""

_MIN_RELATIVE_GAIN = 3e-4
"""Decrease of the scaled objective by a descent, relative to its value, above which another
descent starts from the result. Chosen, not tuned."""

_SLSQP_FTOL = 1e-5
"""Tolerance ``ftol`` of SLSQP, which ends a descent, for the scaled objective [1]. Chosen, not
tuned."""

_DIFFERENCE_STEP = 1e-6
"""Finite-difference step of the constraint Jacobian, relative to the interval between the bounds,
if derivatives are not known in closed form (`StanceSearch.differentiate_rows`). Chosen, not
tuned."""

_SLACK_REDUCTION = 1e-6
"""Amount by which the nonlinear program reduces the scaled slacks (distances from the bounds) of
its constraints, so that descents end at stances without violations despite SLSQP's tolerance. The
slack of the penetration is not reduced. Chosen, not tuned.
"""

_CONSTRAINT_PENALTY = 10.0
"""Weight of the sum of constraint violations in `StanceSearch.merit`, which adds the weighted sum
to the scaled objective. A descent also lowers all constraints by this amount if no stance exists.
Chosen, not tuned.
"""


class Objective(StrEnum):
    """Objective of a search.

    UTILISATION: minimise the peak motor utilisation.
    MARGIN: maximise the distance of the projected CoM from the edge of the support polygon.
    PAYLOAD: maximise the payload limit at a point (`payload_limit`).
    """

    UTILISATION = "utilisation"
    MARGIN = "margin"
    PAYLOAD = "payload"


@dataclass(frozen=True, eq=False)
class EvaluatedStance:
    """Stance that a search has evaluated: stand, scaled objective and constraints.

    Attributes:
        coordinates: Coordinates in the `StanceSpace`, shape (n,) [m or rad].
        stand: Stand at the coordinates.
        scaled_objective: Objective in units of `StanceSearch.scale`; smaller is better. Negative
            for a positive margin or payload.
        rows: Constraints a + b t >= 0, shape (k, 2): rows that define the scaled objective t,
            then the slacks (b = 0).
        allowed: True if the slacks are >= 0, up to `JOINT_LIMIT_OVERSHOOT` at the joint limits.
    """

    coordinates: Array
    stand: Stand
    scaled_objective: float
    rows: Array
    allowed: bool


_MIN_OBJECTIVE_STEP = 0.2
"""Smallest step of the objective to the next stance that is simulated before the initial stance,
relative to the difference between the initial and the best stance. Chosen, not tuned.
"""


class StanceSearch:
    """Search for the best stance.

    Args:
        robot: Robot with a floating base.
        objective: Objective.
        task: Initial task. Default: the nominal stand.
        point: Position of the payload, as in ``with_payload``.
        kp: Servo stiffness for the payload [N m/rad, N/m], scalar or shape (nu,). Default: the
            model's.

    Attributes:
        robot: Robot.
        objective: Objective.
        point: Position of the payload.
        limits: Effort limits, shape (nu,) [N m, N].
        bears: Mask of the motors with a finite effort limit, shape (nu,).
        evaluations: Number of stances that were tried so far.
        space: Search space.
        payload: First-order payload; only with the objective payload.
        scale: Magnitude of the initial objective [1, m or kg], the unit of scaled objectives. If
            the initial objective is zero: 1 for utilisation, the nominal stand height for the
            margin, the mass of the robot for the payload.
        nominal: Stance of the initial task.
        best: Best allowed stance so far, or ``nominal``.
        known: {coordinates: evaluated stance, or None if there is no stance}.
    """

    def __init__(
        self,
        robot: Robot,
        objective: Objective,
        task: StandTask | None = None,
        point: FramePoint = (0.0, 0.0, 0.0),
        kp: ArrayLike | None = None,
    ) -> None:
        self.robot, self.objective = robot, objective
        self.point = find_place(robot, point)
        self.limits = robot.effort_limits
        self.bears = np.isfinite(self.limits)
        self.evaluations = 0
        if objective is not Objective.MARGIN and robot.floating:
            self._check_effort_limits()  # first: the bounds of the space take seconds
        self.space = StanceSpace(robot, task or StandTask())
        if objective is Objective.PAYLOAD:
            stiffness = model_with_servos(robot, kp, None if kp is None else 0.0).kp
            self.payload = SmallPayload(robot, self.point, stiffness)
        self.scale = 1.0
        first = self.evaluate_stand(self.space.start, self.space.nominal)
        self.scale = abs(first.scaled_objective) or self._default_scale
        self.nominal = self.best = self.evaluate_stand(self.space.start, self.space.nominal)
        self.known: dict[tuple[float, ...], EvaluatedStance | None] = {}

    @property
    def _default_scale(self) -> float:
        """Magnitude by which the objective [1, m or kg] is divided if its initial value is zero."""
        if self.objective is Objective.PAYLOAD:
            return self.robot.total_mass
        return self.robot.stand_height if self.objective is Objective.MARGIN else 1.0

    def _check_effort_limits(self) -> None:
        """Raise a ConfigurationError if no motor has an effort limit, or if a limit is zero."""
        robot = self.robot
        if not self.bears.any():
            message = diagnose("no-effort-limits", robot=robot.name)
            raise ConfigurationError("objective", message)
        without_torque = np.flatnonzero(self.limits <= 0)
        if len(without_torque):
            message = diagnose("effort-limit-is-zero", joint=robot.joint_names[without_torque[0]])
            raise ConfigurationError("objective", message)

    def compute_objective(self, stand: Stand) -> float:
        """Return the CoM margin [m] of a stand if this is the objective; else the peak utilisation.

        The peak utilisation [1] is the largest |motor torque| / limit of the motors with a known
        limit.
        """
        statics = stand_statics(self.robot, stand)
        assert statics.com_margin is not None
        if self.objective is Objective.MARGIN:
            return statics.com_margin
        return peak_utilisation(statics.motor_utilisation)

    def evaluate(self, coordinates: Array, near: Stand | None = None) -> EvaluatedStance | None:
        """Evaluate the stance with given coordinates, and update the best stance of this search.

        ``coordinates`` has the shape (n,) [m or rad]. Results are cached by the coordinates,
        whatever ``near`` (`StanceSpace.find_stand`) is.

        Returns:
            Evaluated stance, even if it violates a constraint (``allowed`` is False). None if no
            stand is found, or the objective cannot be computed.
        """
        key = tuple(coordinates.tolist())
        if key not in self.known:
            self.evaluations += 1
            self.known[key] = None
            with suppress(StaticsInfeasibleError, NoEquilibriumError, ConfigurationError):
                stand = self.space.find_stand(coordinates, near)
                if stand is not None:
                    self.known[key] = self.evaluate_stand(coordinates, stand)
        stance = self.known[key]
        if (
            stance is not None
            and stance.allowed
            and stance.scaled_objective < self.best.scaled_objective
        ):
            self.best = stance
        return stance

    def list_next_best(self) -> Iterator[EvaluatedStance]:
        """Yield alternatives to the best stance by ascending objective; the initial stance is last.

        The alternatives are allowed, and better than the initial stance. An alternative is skipped
        if its objective nearly equals that of the stance before (`_MIN_OBJECTIVE_STEP`).
        """
        allowed = [stance for stance in self.known.values() if stance and stance.allowed]
        step = _MIN_OBJECTIVE_STEP * (self.nominal.scaled_objective - self.best.scaled_objective)
        scaled_objective = self.best.scaled_objective
        for stance in sorted(allowed, key=lambda stance: stance.scaled_objective):
            if scaled_objective + step <= stance.scaled_objective < self.nominal.scaled_objective:
                scaled_objective = stance.scaled_objective
                yield stance
        yield self.nominal

    def evaluate_stand(self, coordinates: Array, stand: Stand) -> EvaluatedStance:
        """Compute the scaled objective of a stand, and the values of its constraints.

        Raises:
            NoEquilibriumError: If the objective is the payload, and the servos do not hold the
                stand without payload.
            StaticsInfeasibleError: If no contact forces balance the stand, for example.
        """
        slack = self.space.compute_slack(stand)
        scaled_objective, rows = self._compute_scaled_objective(stand, slack)
        slacks = slack.to_vector(_SLACK_REDUCTION)
        allowed = bool(
            slack.singular_values.min() >= 0
            and slack.joints.min() >= -JOINT_LIMIT_OVERSHOOT
            and slack.edges.min() >= 0
            and slack.penetration >= 0
        )
        slack_rows = np.column_stack([slacks, np.zeros(len(slacks))])
        rows = np.concatenate([rows, slack_rows])
        return EvaluatedStance(coordinates, stand, scaled_objective, rows, allowed)

    def _compute_scaled_objective(self, stand: Stand, slack: StanceSlack) -> tuple[float, Array]:
        """Compute the scaled objective t [1] of a stand, and the constraints that define it.

        In units of ``scale``, t is the largest utilisation of a motor, the negative CoM margin or
        the negative payload.

        Returns:
            Scaled objective t; coefficients (a, b) of the constraints a + b t >= 0, shape (k, 2).
        """
        if self.objective is Objective.PAYLOAD:
            return self._compute_payload_objective(stand)
        if self.objective is Objective.MARGIN:
            distances = slack.edges + self.space.edge_reserve + stand.task.com_margin
            margins = distances / self.scale
            return -float(margins.min()), np.column_stack([margins, np.ones(len(margins))])
        torques = stand_statics(self.robot, stand).joint_torques
        utilisation = torques[self.bears] / self.limits[self.bears] / self.scale
        signed = np.concatenate([utilisation, -utilisation])
        return float(signed.max()), np.column_stack([-signed, np.ones(len(signed))])

    def differentiate_rows(self, stance: EvaluatedStance) -> Array | None:
        """Compute the derivatives of a stance's constraints a + b t >= 0 by its coordinates.

        Returns:
            Derivatives of a, shape (k, n); b is constant. None if these are not known in closed
            form.
        """
        if self.objective is Objective.PAYLOAD or stance.rows[-1, 0] < 0:
            return None
        robot, stand = self.robot, stance.stand
        config = Configuration(robot, stand.qpos)
        motions = self.space.compute_motions(stand, config)
        if motions is None:
            return None
        slack_rates = self.space.differentiate_slack(stand, config, motions)
        if slack_rates is None:
            return None
        if self.objective is Objective.MARGIN:
            count = len(stance.rows) - len(slack_rates)
            edge_rates = slack_rates[-1 - count : -1] / 10  # see StanceSlack.to_vector
            return np.vstack([edge_rates / self.scale, slack_rates])
        carrying, statics = stand_contacts(robot, stand), stand_statics(robot, stand)
        forces = np.array([statics.contact_forces[foot] for foot in carrying.feet])
        torque_rates = differentiate_torques(config, carrying, forces, motions)
        if torque_rates is None:
            return None
        rates = torque_rates[self.bears] / self.limits[self.bears, None] / self.scale
        return np.vstack([-rates, rates, slack_rates])

    def _compute_payload_objective(self, stand: Stand) -> tuple[float, Array]:
        """Compute the scaled objective of a stand for the objective "payload".

        Returns:
            -m / ``scale`` for the largest payload m [kg]; rows (a, b) of its constraints, shape (k,
            2).

        Raises:
            NoEquilibriumError: If the servos do not hold the stand without payload.
            StaticsInfeasibleError: If no contact forces balance the stand, for example.
        """
        rows = self.payload.compute_rows(stand)
        if rows is None:
            raise NoEquilibriumError(None, diagnose("servos-too-soft-unloaded"))
        return -largest_feasible_mass(rows) / self.scale, rows * (1.0, -self.scale)

    def run(self) -> None:
        """Search for the best stance, and store it in ``best``.

        Descents in which the feet move together provide initial guesses for descents with
        independent feet.
        """
        space = self.space
        if not (space.high > space.low).any():
            return
        coupled = Subspace(space, space.start, space.coupled_directions())
        starts = (coupled.start, *self._select_samples(coupled))
        for scaled_objective, scaled in self._rank_descents(coupled, starts):
            scaled_objective, scaled = self._repeat_descent(coupled, scaled_objective, scaled)
            if np.isfinite(scaled_objective):
                self._minimise_with_independent_feet(
                    coupled.compute_coordinates(scaled), _INDEPENDENT_FEET_ITERATIONS
                )
        last_objective = np.inf
        while last_objective - self.best.scaled_objective > _MIN_RELATIVE_GAIN * abs(
            self.best.scaled_objective
        ):
            last_objective = self.best.scaled_objective
            self._minimise_with_independent_feet(self.best.coordinates, _DESCENT_ITERATIONS)

    def _select_samples(self, subspace: Subspace) -> Array:
        """Evaluate stances spread over a subspace, and return the `_START_COUNT` best of these.

        The result contains scaled coordinates, 0 to 1, shape (`_START_COUNT`, subspace.size).
        """
        samples = _draw_latin_hypercube(subspace.size)
        stances = []
        for count, sample in enumerate(samples):
            report_progress("samples", count, len(samples))
            stances.append(self.evaluate(subspace.compute_coordinates(sample)))
        order = np.argsort([self.merit(stance) for stance in stances], kind="stable")
        selected: Array = samples[order[:_START_COUNT]]
        return selected

    def _rank_descents(
        self, subspace: Subspace, starts: Sequence[Array]
    ) -> Iterator[tuple[float, Array]]:
        """Run a short descent from each start, and yield the best results.

        A result is the scaled objective with its scaled coordinates, 0 to 1, shape
        (subspace.size,).
        """
        ends = []
        for count, start in enumerate(starts):
            report_progress("descents", count, len(starts))
            ends.append(self._minimise_objective(subspace, start, _RANKING_ITERATIONS))
        order = np.argsort([scaled_objective for scaled_objective, _ in ends], kind="stable")
        for count, index in enumerate(order[:_FINALIST_COUNT]):
            report_progress("final descents", count, _FINALIST_COUNT)
            yield ends[index]

    def _repeat_descent(
        self, subspace: Subspace, scaled_objective: float, scaled: Array
    ) -> tuple[float, Array]:
        """Restart a descent at its result while the scaled objective decreases noticeably.

        Returns:
            Scaled objective and scaled coordinates of the last result.
        """
        last_objective = np.inf
        while last_objective - scaled_objective > _MIN_RELATIVE_GAIN * abs(scaled_objective):
            last_objective = scaled_objective
            scaled_objective, scaled = self._minimise_objective(
                subspace, scaled, _DESCENT_ITERATIONS
            )
        return scaled_objective, scaled

    def _minimise_with_independent_feet(self, coordinates: Array, iterations: int) -> None:
        """Minimise the scaled objective over all coordinates [m, rad], and update ``best``."""
        subspace = Subspace(self.space, coordinates, np.eye(len(coordinates)))
        self._minimise_objective(subspace, subspace.start, iterations)

    def merit(self, stance: EvaluatedStance | None) -> float:
        """Return the merit of a stance [1], to be minimised: scaled objective + penalty.

        The penalty is `_CONSTRAINT_PENALTY` times the sum of constraint violations. Infinite for
        None.
        """
        if stance is None:
            return np.inf
        slacks = stance.rows[stance.rows[:, 1] == 0, 0]  # rows that do not depend on t
        return stance.scaled_objective - _CONSTRAINT_PENALTY * float(np.minimum(slacks, 0).sum())

    def _minimise_objective(
        self, subspace: Subspace, start: Array, iterations: int
    ) -> tuple[float, Array]:
        """Minimise the scaled objective over a subspace by SLSQP, and update ``best``.

        Returns:
            Smallest scaled objective of the allowed stances that SLSQP evaluated, and its scaled
            coordinates, 0 to 1; infinity and ``start`` without such a stance.
        """
        first = self.evaluate(subspace.compute_coordinates(start))
        if first is None:
            return np.inf, start
        return _Descent(self, subspace, start, first).run(iterations)


class _Descent:
    """Minimisation of the scaled objective t over a subspace of stances by SLSQP.

    The variables of SLSQP are the scaled coordinates, 0 to 1, and t: shape (size + 1,). The
    constraints are a + b t >= 0, with the rows (a, b) of each evaluated stance.

    Args:
        search: Search that evaluates stances, and keeps the best.
        subspace: Subspace of the stances.
        start: Initial scaled coordinates, shape (size,).
        first: Stance at the start.

    Attributes:
        best: Smallest scaled objective of the allowed stances that SLSQP evaluated, and its scaled
            coordinates; infinity and ``start`` without such a stance.
    """

    def __init__(
        self, search: StanceSearch, subspace: Subspace, start: Array, first: EvaluatedStance
    ) -> None:
        self._search, self._subspace, self._first = search, subspace, first
        self._missing: Array = first.rows - np.array([_CONSTRAINT_PENALTY, 0.0])
        self.best: tuple[float, Array] = (np.inf, start)

    def run(self, iterations: int) -> tuple[float, Array]:
        """Run SLSQP, and return the best scaled objective and its scaled coordinates (``best``)."""
        from scipy import optimize  # slow to import

        start = self.best[1]
        optimize.minimize(
            lambda values: values[-1],
            np.append(start, self._first.scaled_objective),
            jac=lambda values: np.eye(len(values))[-1],
            method="SLSQP",
            bounds=[(0.0, 1.0)] * len(start) + [(None, None)],
            constraints={
                "type": "ineq",
                "fun": lambda values: self._evaluate_rows(values[:-1]) @ (1.0, values[-1]),
                "jac": self._constraint_jacobian,
            },
            options={"maxiter": iterations, "ftol": _SLSQP_FTOL},
        )
        return self.best

    def _evaluate_scaled(self, scaled: Array, near: Stand | None = None) -> EvaluatedStance | None:
        """Evaluate the stance with scaled coordinates ``scaled`` (`StanceSearch.evaluate`)."""
        return self._search.evaluate(self._subspace.compute_coordinates(scaled), near)

    def _evaluate_rows(self, scaled: Array) -> Array:
        """Evaluate a stance, update ``best``, and return the constraint rows (a, b), (k, 2).

        Without a stance, the rows are those of the first stance with violated constraints.
        """
        stance = self._evaluate_scaled(scaled)
        if stance is None:
            return self._missing
        if stance.allowed and stance.scaled_objective < self.best[0]:
            self.best = stance.scaled_objective, scaled.copy()
        return stance.rows

    def _constraint_jacobian(self, values: Array) -> Array:
        """Return the Jacobian of the constraint functions a + b t, shape (k, size + 1).

        The columns are derivatives by the scaled coordinates, then by t; ``values`` has the same
        order.
        """
        scaled = values[:-1]
        rows, stance = self._evaluate_rows(scaled), self._evaluate_scaled(scaled)
        exact = None if stance is None else self._search.differentiate_rows(stance)
        if exact is not None:
            rates = exact @ (self._subspace.directions * self._subspace.width)
            jacobian: Array = np.column_stack([rates, rows[:, 1]])
            return jacobian
        near = None if stance is None else stance.stand
        columns = [
            self._difference_constraints(values, index, rows, near) for index in range(len(scaled))
        ]
        return np.column_stack([*columns, rows[:, 1]])

    def _difference_constraints(
        self, values: Array, index: int, rows: Array, near: Stand | None
    ) -> Array:
        """Return the one-sided difference quotient of the constraints a + b t, shape (k,).

        ``values`` contains the scaled coordinates, then t; ``rows`` (k, 2) are (a, b) at these
        coordinates. ``index`` is the index of the varied coordinate. Zeros if no stance exists at
        the steps.
        """
        scaled, scaled_objective = values[:-1], values[-1]
        forward = scaled[index] + _DIFFERENCE_STEP <= 1
        for length in (1, -1) if forward else (-1, 1):
            step = np.zeros(len(scaled))
            step[index] = length * _DIFFERENCE_STEP
            ahead = self._evaluate_scaled(scaled + step, near)
            if ahead is not None:
                quotient: Array = ((ahead.rows - rows) @ (1.0, scaled_objective)) / step[index]
                return quotient
        return np.zeros(len(rows))


def _draw_latin_hypercube(size: int) -> Array:
    """Draw Latin hypercube samples in [0, 1), shape (`_SAMPLE_COUNT`, size), from a fixed seed.

    McKay, Beckman and Conover, "A comparison of three methods for selecting values of input
    variables", 1979. SciPy's samplers are slow to import.
    """
    generator = np.random.default_rng(0)
    layers = np.array([generator.permutation(_SAMPLE_COUNT) for _ in range(size)]).T
    samples: Array = (layers + generator.random((_SAMPLE_COUNT, size))) / _SAMPLE_COUNT
    return samples


class Subspace:
    """Box of scaled coordinates, 0 to 1, along some directions in a space of stances.

    Each scaled coordinate interpolates along one direction, between the two points at which a
    coordinate of the space first reaches a bound. Directions without such an interval are omitted.

    Args:
        space: Space of stances.
        origin: Coordinates through which the subspace passes, shape (n,) [m or rad].
        directions: A direction per column, shape (n, k). Two directions with a common coordinate
            could exceed the bounds.

    Attributes:
        origin: Coordinates through which the subspace passes, shape (n,) [m or rad].
        directions: Remaining directions, shape (n, size).
        low: Multiple of each direction at the scaled coordinate 0, shape (size,).
        width: Difference between the multiples at 1 and at 0, shape (size,).
        size: Number of scaled coordinates.
        start: Scaled coordinates of the origin, shape (size,), clipped to 0 to 1.
    """

    def __init__(self, space: StanceSpace, origin: Array, directions: Array) -> None:
        low, high = [], []
        for column in directions.T:
            moved = column != 0
            ends = np.sort(
                [(limit - origin)[moved] / column[moved] for limit in (space.low, space.high)],
                axis=0,
            )
            low.append(ends[0].max())
            high.append(ends[1].min())
        movable = np.array(high) > np.array(low)
        self.origin, self.directions = origin, directions[:, movable]
        self.low, self.width = np.array(low)[movable], (np.array(high) - np.array(low))[movable]
        self.size = int(movable.sum())
        self.start = np.clip(-self.low / self.width, 0, 1)

    def compute_coordinates(self, scaled: Array) -> Array:
        """Return the coordinates of a stance, shape (n,) [m or rad], from scaled coordinates.

        ``scaled`` has the shape (size,), and is clipped to 0 to 1.
        """
        multiples = self.low + np.clip(scaled, 0, 1) * self.width
        coordinates: Array = self.origin + self.directions @ multiples
        return coordinates
