"""Weighted least squares with what is known before: the most probable parameters, and how sure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import FitError
from pupper_analysis.fit.parameters import Parameter, ParameterTable

Array = NDArray[np.float64]

_MOST_STEPS = 60
"""Gauss-Newton takes 4 to 10 from a model's own numbers; those that lead nowhere need no more."""

_SETTLED = 1e-4
"""Of a prior's width: a step as short as that moves no estimate by what its interval shows."""

_LEAST_DAMPING = 1e-9
"""Levenberg's, in parts of the diagonal: none to speak of."""

_HARDLY_DAMPED = 1e-3
"""A step that is damped no more than that is the whole one."""

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
        whole = width[:, None] * self.information * width + np.eye(len(x))
        z = (x - table.stated) / width
        downhill = width * self.gradient + z
        factor = cho_factor(whole)
        left = self.chi2 + z @ z - downhill @ cho_solve(factor, downhill)
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
        chi2: Sum of squares of the whitened residuals left.
        prior_chi2: Likewise of how far the parameters moved, in their widths.
        rows: How many residuals there are.
        steps: Gauss-Newton steps.
    """

    parameters: tuple[Parameter, ...]
    mean: Array
    covariance: Array
    information: Array
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
        told = n - np.trace(np.linalg.inv(np.eye(n) + self.information))
        return float(self.rows - told)


NORMAL_95 = 1.959963984540054
"""Standard deviations on either side of a normal distribution's mean that hold 95 %."""


def estimate_parameters(
    table: ParameterTable,
    linearise: Callable[[Array, Array], Linearised],
    start: Array | None = None,
) -> Posterior:
    """Returns the parameters that measurements and priors make most probable.

    Minimises chi2(x) + |(x - stated) / width|^2 by Levenberg's damped Gauss-Newton steps. What
    noise does to residuals may depend on parameters (that of an encoder on a torque, by kp). It is
    taken as it is at the last parameters, and no derivative is taken of it: residuals would be
    made small by parameters that make noise large.

    Args:
        table: The parameters.
        linearise: Called with parameters, and those at which noise is taken: returns the
            measurements' residuals about the first.
        start: (n,) to begin with; the stated values by default.

    Raises:
        FitError: If it does not converge.
    """
    width, n = table.width, len(table)
    x = table.stated.copy() if start is None else np.array(start, dtype=float)
    damping = _LEAST_DAMPING
    for steps in range(1, _MOST_STEPS + 1):
        here = linearise(x, x)
        z = (x - table.stated) / width
        information = width[:, None] * here.information * width
        downhill = -(width * here.gradient + z)
        if not np.isfinite(information).all() or not np.isfinite(downhill).all():
            break
        whole = information + np.eye(n)
        while True:
            step = cho_solve(cho_factor(whole + damping * np.diag(np.diag(whole))), downhill)
            if np.abs(step).max(initial=0.0) < _SETTLED and damping <= _HARDLY_DAMPED:
                covariance = np.linalg.inv(whole)
                covariance = (covariance + covariance.T) / 2
                return Posterior(
                    parameters=table.parameters,
                    mean=x,
                    covariance=width[:, None] * covariance * width,
                    information=information,
                    chi2=here.chi2,
                    prior_chi2=float(z @ z),
                    rows=here.rows,
                    steps=steps,
                )
            tried = x + width * step
            there, moved = linearise(tried, x), (tried - table.stated) / width
            if there.chi2 + moved @ moved <= (here.chi2 + z @ z) * (1 + _ROUNDING):
                break
            damping *= 10
            if damping > _MOST_DAMPING:
                raise FitError(diagnose("fit-does-not-converge", steps=steps))
        x, damping = tried, max(damping / 10, _LEAST_DAMPING)
    raise FitError(diagnose("fit-does-not-converge", steps=_MOST_STEPS))


_ROUNDING = 1e-9
"""Of a cost: what two ways to the same parameters differ by."""
