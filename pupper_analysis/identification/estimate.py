"""Weighted least squares with what is known before: the most probable parameters, and how sure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import FitError
from pupper_analysis.identification.parameters import KINDS, Parameter, ParameterTable

Array = NDArray[np.float64]

_MOST_STEPS = 60
"""Gauss-Newton takes 4 to 10 from a model's own numbers; those that lead nowhere need no more."""

_SETTLED = 1e-4
"""Of the cost, whose unit is one standard deviation squared: a step that promises no more is one of
a hundredth of a standard deviation, which no interval shows."""

_STALLED = 0.01
"""Of a rough cost: where a step promises more and none gives it, derivatives are wrong."""

_LEAST_DAMPING = 1e-9
"""Levenberg's, in parts of the diagonal: none to speak of."""

_MOST_DAMPING = 1e6
"""No step is left."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """Measurements about a vector of parameters: whitened residuals r + A dx, as sums over them.

    Whitened: each residual divided by its standard deviation, so that r has variance 1 at the true
    parameters.

    Attributes:
        information: (n, n) sum of A^T A.
        gradient: (n,) sum of A^T r.
        chi2: Sum of r^2.
        rows: How many residuals.
        log_noise: Logarithm of the determinant of the covariance that they were whitened by.
    """

    information: Array
    gradient: Array
    chi2: float
    rows: int
    log_noise: float = 0.0

    @staticmethod
    def of(residual: Array, jacobian: Array, log_noise: float = 0.0) -> Linearised:
        """Returns the sums of whitened residuals (m,) and their derivative (m, n)."""
        return Linearised(
            jacobian.T @ jacobian,
            jacobian.T @ residual,
            float(residual @ residual),
            len(residual),
            log_noise,
        )

    @staticmethod
    def nothing(n: int) -> Linearised:
        """Returns the sums of no residuals, of n parameters."""
        return Linearised(np.zeros((n, n)), np.zeros(n), 0.0, 0)

    def __add__(self, other: Linearised) -> Linearised:
        return Linearised(
            self.information + other.information,
            self.gradient + other.gradient,
            self.chi2 + other.chi2,
            self.rows + other.rows,
            self.log_noise + other.log_noise,
        )

    def evidence(self, table: ParameterTable, x: Array) -> float:
        """Returns the logarithm of how likely the measurements are, whatever the parameters.

        Of residuals that are linear in the parameters about x; up to a constant.
        """
        width = table.width
        whole = width[:, None] * self.information * width + table.precision
        z = (x - table.stated) / width
        downhill = width * self.gradient + table.precision @ z
        factor = cho_factor(whole)
        left = self.chi2 + z @ table.precision @ z - downhill @ cho_solve(factor, downhill)
        return float(-left / 2 - self.log_noise / 2 - np.log(np.diag(factor[0])).sum())


@dataclass(frozen=True, eq=False)
class Posterior:
    """What is known of parameters after measurements: a normal distribution about the best.

    Attributes:
        parameters: What was estimated.
        mean: (n,) the most probable values, in the parameters' units.
        covariance: (n, n) of these.
        information: (n, n) what the measurements alone tell, where the prior's widths are the
            units: a direction with 1 is told as well by the prior.
        precision: (n, n) what was known before, likewise.
        chi2: Sum of squares of the whitened residuals left.
        prior_chi2: Likewise of how far the parameters moved, in their widths.
        rows: How many residuals there are.
        steps: Gauss-Newton steps.
    """

    parameters: tuple[Parameter, ...]
    mean: Array
    covariance: Array
    information: Array
    precision: Array
    chi2: float
    prior_chi2: float
    rows: int
    steps: int

    @property
    def std(self) -> Array:
        """(n,) standard deviations."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def shares(self) -> Array:
        """(n,) variance that is left, in parts of the prior's: 1 is no more than was known."""
        widths = np.array([one.width for one in self.parameters])
        shares: Array = np.diag(self.covariance) / widths**2
        return shares

    @property
    def interval(self) -> Array:
        """(n, 2) in which a parameter is with 95 %."""
        half = NORMAL_95 * self.std
        return np.stack([self.mean - half, self.mean + half], axis=1)

    @property
    def freedom(self) -> float:
        """Residuals less the parameters that they told: what ``chi2`` is on average."""
        n = len(self.mean)
        whole = np.linalg.inv(self.precision + self.information)
        told = n - np.trace(whole @ self.precision)
        return float(self.rows - told)


NORMAL_95 = 1.959963984540054
"""Standard deviations on either side of a normal distribution's mean that hold 95 %."""


def estimate_parameters(
    table: ParameterTable,
    linearise: Callable[[Array, Array], Linearised],
    start: Array | None = None,
    rough: float = 0.0,
) -> Posterior:
    """Returns the parameters that measurements and priors make most probable.

    Minimises chi2(x) + z^T P z, z = (x - stated) / width, P being the prior's precision, by
    Levenberg's damped Gauss-Newton steps. What noise does to residuals may depend on parameters
    (that of an encoder on a torque, by kp). It is taken as it is at the last parameters, and no
    derivative is taken of it: residuals would be made small by parameters that make noise large.
    What means nothing below zero stays above.

    Args:
        table: The parameters.
        linearise: Called with parameters, and those at which noise is taken: returns the
            measurements' residuals about the first.
        start: (n,) to begin with; the stated values by default.
        rough: By what costs of near parameters differ for no reason, in parts of them: where
            joints stick and slip, a simulation's have steps. Where they cannot be made less by
            more than that, they are least.

    Raises:
        FitError: If it does not converge.
    """
    width, before = table.width, table.precision
    x = table.stated.copy() if start is None else np.array(start, dtype=float)
    positive = np.array([KINDS[one.kind].positive for one in table], dtype=bool)
    damping, stalled = _LEAST_DAMPING, 0
    for steps in range(1, _MOST_STEPS + 1):
        here = linearise(x, x)
        z = (x - table.stated) / width
        cost = here.chi2 + z @ before @ z
        information = width[:, None] * here.information * width
        downhill = -(width * here.gradient + before @ z)
        if not np.isfinite(information).all() or not np.isfinite(downhill).all():
            break
        whole = information + before
        covariance = np.linalg.inv(whole)
        covariance = (covariance + covariance.T) / 2
        # What is zero, and would be less, stays there.
        free = ~(positive & (x <= 0) & (downhill < 0))
        whole_step = _step(whole, downhill, free, 0.0)
        promised, least = float(whole_step @ downhill), max(_SETTLED, rough * cost)
        done = promised < least
        moved_on = False
        while not done:
            tried = x + width * _step(whole, downhill, free, damping)
            tried[positive] = np.maximum(tried[positive], 0.0)
            there, moved = linearise(tried, x), (tried - table.stated) / width
            gain = cost - there.chi2 - moved @ before @ moved
            if gain >= -_SETTLED:
                moved_on = True
                break
            damping *= 10
            if damping > _MOST_DAMPING:
                break
        if moved_on:
            x, damping = tried, max(damping / 10, _LEAST_DAMPING)
            stalled = stalled + 1 if gain < least else 0
        if done or (rough > 0 and promised < _STALLED * cost and (not moved_on or stalled > 1)):
            return Posterior(
                parameters=table.parameters,
                mean=x,
                covariance=width[:, None] * covariance * width,
                information=information,
                precision=before,
                chi2=here.chi2,
                prior_chi2=float(z @ before @ z),
                rows=here.rows,
                steps=steps,
            )
        if not moved_on:
            break
    raise FitError(diagnose("fit-does-not-converge", steps=steps))


def _step(whole: Array, downhill: Array, free: NDArray[np.bool_], damping: float) -> Array:
    """Returns Levenberg's step of those parameters that are free, and zero of others."""
    step = np.zeros(len(downhill))
    own = whole[np.ix_(free, free)]
    step[free] = cho_solve(cho_factor(own + damping * np.diag(np.diag(own))), downhill[free])
    return step
