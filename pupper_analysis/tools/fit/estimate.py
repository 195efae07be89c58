"""Maximum a posteriori estimate of parameters: weighted least squares with a normal prior.

Minimises chi2(x) + z^T P z, with z = (x - stated) / width and P the prior precision, by damped
Gauss-Newton steps. The result is a normal distribution about the last parameter vector.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import FitError
from pupper_analysis.tools.fit.parameters import PARAMETER_KINDS, Parameter, ParameterTable

_MAX_STEPS = 60
"""Maximum number of Gauss-Newton steps of a minimisation. Chosen, not tuned."""

_MIN_PREDICTED_DECREASE = 1e-4
"""Default tolerance of the cost (chi2 plus prior): predicted decrease below which the iteration has
converged. A decrease d corresponds to a step of sqrt(d) standard deviations: 1e-4 is a hundredth of
a standard deviation. The value is also the tolerance with which `_find_decrease` accepts a step.
Chosen, not tuned.
"""

_STALL_RTOL = 0.01
"""Default of the largest predicted decrease, as a fraction of the cost, with which a stalled
iteration gives a result. A decrease below `_MAX_UNREALISED_DECREASE` is accepted, too. Chosen, not
tuned.
"""

_MAX_STALL_RATIO = 0.25
"""Upper bound of the ratio of actual decrease to the predicted decrease of the undamped step, up to
which slow progress (`min_relative_decrease` of `estimate_parameters`) is a stall. Chosen, not
tuned.
"""

_MIN_DECREASE_RATIO = 0.1
"""Required ratio of actual to predicted decrease of the cost, with which a step is accepted
(`_find_decrease`). Chosen, not tuned.
"""

_MAX_CORRECTIONS = 2
"""Maximum number of second-order corrections of an undamped step that decreases the cost too
little. Corrections are useful since the cost has curved valleys: for example, inertia is quadratic
in CoM displacements. Chosen, not tuned.
"""

_MAX_UNREALISED_DECREASE = 1.0
"""Upper bound of the predicted decrease of the cost (chi2 plus prior) with which a stalled
minimisation ends without error. `_STALL_RTOL` times the cost replaces a smaller bound. A decrease
of 1 corresponds to a standard deviation. Chosen, not tuned.
"""

_MIN_DAMPING = 1e-3
"""Smallest nonzero damping of a step, relative to the diagonal of the posterior information matrix.
Chosen, not tuned."""

_MAX_DAMPING = 1e2
"""Largest damping of a step, relative to the diagonal of the posterior information matrix. If this
matrix is diagonal, the largest damping shortens the step to 1/101. Chosen, not tuned.
"""


_MAX_BOUND_CHANGES = 10
"""Maximum number of iterations per parameter in which SciPy computes a step within the lower
bounds. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class LinearisedResiduals:
    """Sums over whitened residuals r + A dx of measurements, for Gauss-Newton steps.

    The residuals are linearised about a parameter vector, and divided by their noise (whitened).

    Attributes:
        information: Sum of A^T A, shape (n, n).
        gradient: Sum of A^T r, shape (n,).
        chi2: Sum of r^2.
        rows: Number of residuals.
        log_noise: Logarithm of the determinant of the noise covariance used for whitening.
        extra_cost: Additional term of the cost. ``gradient`` contains half its derivative.
    """

    information: Array
    gradient: Array
    chi2: float
    rows: int
    log_noise: float = 0.0
    extra_cost: float = 0.0

    @staticmethod
    def from_residuals(
        residual: Array, jacobian: Array, log_noise: float = 0.0
    ) -> LinearisedResiduals:
        """Compute the sums A^T A, A^T r and r^T r from residuals r and the Jacobian A.

        Args:
            residual: Whitened residuals r, shape (m,), dimensionless.
            jacobian: Jacobian A by the parameters, shape (m, n).
            log_noise: Logarithm of the determinant of the noise covariance used for whitening.
        """
        return LinearisedResiduals(
            jacobian.T @ jacobian,
            jacobian.T @ residual,
            float(residual @ residual),
            len(residual),
            log_noise,
        )

    @staticmethod
    def empty(n: int) -> LinearisedResiduals:
        """Return zero sums for n parameters: the initial value to which residuals are added."""
        return LinearisedResiduals(np.zeros((n, n)), np.zeros(n), 0.0, 0)

    def __add__(self, other: LinearisedResiduals) -> LinearisedResiduals:
        return LinearisedResiduals(
            self.information + other.information,
            self.gradient + other.gradient,
            self.chi2 + other.chi2,
            self.rows + other.rows,
            self.log_noise + other.log_noise,
            self.extra_cost + other.extra_cost,
        )

    def compute_log_evidence(self, table: ParameterTable, z: Array) -> float:
        """Compute the log marginal likelihood of the measurements, up to a constant.

        The marginal likelihood is the likelihood, integrated over the parameters under the prior.
        The residuals are assumed to be linear in the parameters.

        Args:
            table: Parameters.
            z: Deviation of the point of linearisation from the stated values, in units of the prior
                widths, shape (n,).

        Raises:
            LinAlgError: If the information of measurements and prior is not positive definite.
        """
        width = table.width
        posterior_information = width[:, None] * self.information * width + table.precision
        descent = width * self.gradient + table.precision @ z
        factor = cho_factor(posterior_information)
        chi2 = self.chi2 + z @ table.precision @ z - descent @ cho_solve(factor, descent)
        return float(-chi2 / 2 - self.log_noise / 2 - np.log(np.diag(factor[0])).sum())


@dataclass(frozen=True, eq=False)
class Posterior:
    """Normal distribution of the parameters after measurements.

    Attributes:
        parameters: Estimated parameters.
        mean: Most probable values, shape (n,), in the parameters' units.
        covariance: Covariance, shape (n, n), in the parameters' units.
        information: Information of the measurements alone, shape (n, n), in units of the prior
            widths: 1 is the information of an uncorrelated prior.
        precision: Inverse of the prior covariance, shape (n, n), in units of the prior widths.
        chi2: Sum of squares of the whitened residuals.
        moved: Deviation of the mean from the stated values, shape (n,), in units of the prior
            widths and in the coordinates of the fit. A fit of stands uses logarithms of masses and
            kp as coordinates, and a fit of motions uses first moments.
        rows: Number of residuals.
        unrealised_decrease: Predicted decrease of the cost after which a stalled iteration ended; 0
            after convergence. A value of 1 corresponds to one standard deviation.
    """

    parameters: tuple[Parameter, ...]
    mean: Array = field(metadata={"unit": "varies"})
    covariance: Array = field(metadata={"unit": "varies"})
    information: Array = field(metadata={"unit": "1"})
    precision: Array = field(metadata={"unit": "1"})
    chi2: float = field(metadata={"unit": "1"})
    moved: Array = field(metadata={"unit": "1"})
    rows: int
    unrealised_decrease: float = field(default=0.0, metadata={"unit": "1"})

    @staticmethod
    def from_prior(table: ParameterTable) -> Posterior:
        """Return the prior distribution of the parameters, as if there were no measurements."""
        information, width = np.zeros((len(table), len(table))), table.width
        covariance = width[:, None] * np.linalg.inv(table.precision) * width
        remaining = information, table.precision, 0.0, np.zeros(len(table)), 0
        return Posterior(table.parameters, table.stated, covariance, *remaining)

    @property
    def kinds(self) -> NDArray[np.str_]:
        """Kind of each parameter, a key of ``parameters.PARAMETER_KINDS``, shape (n,)."""
        return np.array([parameter.kind for parameter in self.parameters], dtype=str)

    @property
    def std(self) -> Array:
        """Posterior standard deviations, shape (n,), in the parameters' units."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def variance_ratios(self) -> Array:
        """Posterior variance over prior variance of each parameter, shape (n,)."""
        widths = np.array([parameter.width for parameter in self.parameters])
        return np.asarray(np.diag(self.covariance) / widths**2)

    @property
    def interval(self) -> Array:
        """Lower and upper ends of the 95 % intervals, shape (n, 2), in the parameters' units."""
        half = HALF_WIDTH_95 * self.std
        return np.stack([self.mean - half, self.mean + half], axis=1)

    @property
    def degrees_of_freedom(self) -> float:
        """Expected value of ``chi2``: number of residuals minus effective number of parameters.

        The effective number of parameters is n - trace((P + J)^-1 P), with n parameters, prior
        precision P and information J of the measurements.
        """
        n = len(self.mean)
        covariance = np.linalg.inv(self.precision + self.information)
        num_determined = n - np.trace(covariance @ self.precision)
        return float(self.rows - num_determined)


HALF_WIDTH_95 = 1.959963984540054
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""


def estimate_parameters(
    table: ParameterTable,
    linearise: Callable[[Array, Array], LinearisedResiduals],
    start: Array | None = None,
    *,
    lower_bounds: Array | None = None,
    min_decrease: float = _MIN_PREDICTED_DECREASE,
    min_relative_decrease: float = 0.0,
    stall_rtol: float = _STALL_RTOL,
) -> Posterior:
    """Compute the most probable parameters by damped Gauss-Newton steps (Levenberg-Marquardt).

    Step: each step minimises the linearised cost chi2 + prior within the lower bounds.

    Acceptance: the cost must decrease by at least 10 % of the predicted decrease, minus
    `_MIN_PREDICTED_DECREASE`. Otherwise the step is corrected to second order, or damped more.

    Convergence: the predicted decrease of the undamped step is below ``min_decrease``.

    Stall: the cost hardly decreases, although a decrease is predicted. The cause may be jumps of
    the cost, for example in a simulation of joints that stick and slip. A stalled iteration gives a
    result if the predicted decrease is below 1, or below ``stall_rtol`` times the cost. The
    covariance of this result is widened by the outer product of the undamped step.

    Noise: the noise of the residuals may depend on the parameters; for example, encoder noise times
    kp is a noise of torques. The noise is evaluated at the last parameters and not differentiated.
    Otherwise the minimisation would prefer parameters with large noise.

    Args:
        table: Parameters.
        linearise: Function of two vectors, shape (n,): the parameters at which residuals are
            linearised, and the parameters at which the noise is evaluated.
        start: Initial guess, shape (n,); the stated values by default.
        lower_bounds: Lower bounds, shape (n,); by default 0 for kinds that are positive.
        min_decrease: Tolerance of the cost, used for convergence and stall.
        min_relative_decrease: Tolerance of the decrease relative to the cost, used for stall.
        stall_rtol: Largest predicted decrease of a stalled result, relative to the cost.

    Raises:
        FitError: If the iteration does not converge, for example because the cost has no minimum.
    """
    x = table.stated.copy() if start is None else np.array(start, dtype=float)
    if lower_bounds is None:
        lower_bounds = np.array(
            [0.0 if PARAMETER_KINDS[parameter.kind].positive else -np.inf for parameter in table]
        )
    damping = 0.0
    for steps in range(1, _MAX_STEPS + 1):
        cost = _QuadraticCost(table, linearise(x, x), x, lower_bounds)
        if not cost.has_minimum:
            break
        step = cost.compute_step(0.0)
        predicted = cost.predict_decrease(step)
        if predicted < min_decrease:
            return cost.make_posterior()
        accepted, damping = _find_decrease(cost, linearise, damping)
        # The cost has jumps, or its noise changes: the unrealised step widens the intervals.
        slow_gain = min(min_relative_decrease * cost.cost, _MAX_STALL_RATIO * predicted)
        min_gain = max(min_decrease, slow_gain)
        if accepted is None or accepted[1] <= min_gain or steps == _MAX_STEPS:
            if predicted < max(_MAX_UNREALISED_DECREASE, stall_rtol * cost.cost):
                return cost.make_posterior(step)
            if accepted is None:
                break
        x = accepted[0]
    raise FitError(diagnose("fit-does-not-converge", steps=steps))


class _QuadraticCost:
    """Quadratic model of the cost (chi2 plus prior) about a parameter vector.

    Args:
        table: Parameters.
        linearised: Linearised measurements.
        x: Parameter values, shape (n,).
        lower_bounds: Lower bounds of the values, shape (n,).

    Attributes:
        table: Parameters.
        linearised: Linearised measurements.
        x: Parameter values, shape (n,).
        lower_bounds: Lower bounds of the values, shape (n,).
        cost: chi2 + z^T P z + ``extra_cost`` at ``x``.
        information: Information of the measurements, shape (n, n), in units of the prior widths.
        posterior_information: Information of measurements and prior, shape (n, n), same units.
        descent: Half the negative gradient of the cost, shape (n,), in units of the prior widths.
    """

    def __init__(
        self, table: ParameterTable, linearised: LinearisedResiduals, x: Array, lower_bounds: Array
    ) -> None:
        self.table, self.linearised, self.x, self.lower_bounds = table, linearised, x, lower_bounds
        width, self._z = table.width, (x - table.stated) / table.width
        prior = float(self._z @ table.precision @ self._z)
        self.cost = linearised.chi2 + prior + linearised.extra_cost
        self.information: Array = width[:, None] * linearised.information * width
        self.posterior_information = self.information + table.precision
        self.descent: Array = -(width * linearised.gradient + table.precision @ self._z)

    @property
    def has_minimum(self) -> bool:
        """Whether this quadratic model has a minimum, with a finite gradient and Hessian."""
        if not (np.isfinite(self.posterior_information).all() and np.isfinite(self.descent).all()):
            return False
        try:
            cho_factor(self.posterior_information)
        except np.linalg.LinAlgError:
            return False
        return True

    def compute_step(self, damping: float) -> Array:
        """Return the damped Gauss-Newton step, shape (n,), in units of the prior widths.

        The step minimises the damped quadratic cost within the lower bounds. Damping [1] times the
        diagonal of the posterior information is added to the posterior information.
        """
        lower_bounds = (self.lower_bounds - self.x) / self.table.width
        damped = self.posterior_information + damping * np.diag(np.diag(self.posterior_information))
        factor = cholesky(damped)  # the cost is |factor step - right_side|^2 plus a constant
        right_side = solve_triangular(factor, self.descent, trans="T")
        step: Array = solve_triangular(factor, right_side)
        if (step < lower_bounds).any():
            from scipy.optimize import lsq_linear  # slow to import

            bounds = lower_bounds, np.full(len(step), np.inf)
            max_iterations = _MAX_BOUND_CHANGES * len(step)
            step = lsq_linear(factor, right_side, bounds, method="bvls", max_iter=max_iterations).x
        return step

    def predict_decrease(self, step: Array) -> float:
        """Return the decrease of the quadratic cost (dimensionless) for a step.

        ``step`` has the shape (n,), in units of the prior widths.
        """
        return float(step @ (2 * self.descent - self.posterior_information @ step))

    def make_posterior(self, unrealised_step: Array | None = None) -> Posterior:
        """Return the normal distribution with the parameters ``x`` as the mean.

        The covariance is the inverse of the posterior information, plus the outer product of
        ``unrealised_step``. This step, shape (n,), in units of the prior widths, did not decrease
        the cost as predicted.
        """
        width = self.table.width
        covariance = np.linalg.inv(self.posterior_information)
        covariance = (covariance + covariance.T) / 2
        if unrealised_step is not None:
            covariance = covariance + np.outer(unrealised_step, unrealised_step)
        return Posterior(
            parameters=self.table.parameters,
            mean=self.x,
            covariance=width[:, None] * covariance * width,
            information=self.information,
            precision=self.table.precision,
            chi2=self.linearised.chi2,
            moved=self._z,
            rows=self.linearised.rows,
            unrealised_decrease=(
                0.0 if unrealised_step is None else self.predict_decrease(unrealised_step)
            ),
        )


def _find_decrease(
    cost: _QuadraticCost, linearise: Callable[[Array, Array], LinearisedResiduals], damping: float
) -> tuple[tuple[Array, float] | None, float]:
    """Find a step that decreases the cost enough (`_MIN_DECREASE_RATIO`), with growing damping.

    Returns:
        Accepted parameters and decrease of the cost, or None without an accepted step; damping of
        the next step. The decrease may be slightly negative.
    """
    table, x = cost.table, cost.x
    while damping <= _MAX_DAMPING:
        step = cost.compute_step(damping)
        predicted, candidate = cost.predict_decrease(step), x + table.width * step
        for corrections_left in range(0 if damping else _MAX_CORRECTIONS, -1, -1):
            new_cost = _QuadraticCost(table, linearise(candidate, x), candidate, cost.lower_bounds)
            gain = cost.cost - new_cost.cost
            if gain >= _MIN_DECREASE_RATIO * predicted - _MIN_PREDICTED_DECREASE:
                next_damping = damping / 10 if damping > _MIN_DAMPING else 0.0
                return (candidate, gain), next_damping
            if not corrections_left or not new_cost.has_minimum:
                break
            # Second-order correction: another step, linearised at the candidate.
            candidate = candidate + table.width * new_cost.compute_step(0.0)
        damping = max(10 * damping, _MIN_DAMPING)
    return None, damping
