"""Weighted least squares with what is known before: the most probable parameters, and how sure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import FitError
from pupper_analysis.tools.fit.parameters import KINDS, Parameter, ParameterTable

Array = NDArray[np.float64]

_MOST_STEPS = 60
"""Gauss-Newton takes 4 to 10 from a model's own numbers; those that lead nowhere need no more."""

_SETTLED = 1e-4
"""Of the cost, whose unit is one standard deviation squared: a step that promises no more is one of
a hundredth of a standard deviation, which no interval shows."""

_STALLED = 0.01
"""Of a rough cost: where a step promises more and none gives it, derivatives are wrong."""


_LEAST_KEPT = 0.1
"""Of what a step promised: with less it is not taken, and a shorter one tried."""

_BENDS = 2
"""How often a step that is not damped is led back to less cost: where mass moves far, inertia goes
with the square, and what nobody weighed follows kp along a valley that bends."""

_OPEN = 1.0
"""Of the cost: a standard deviation, that is not looked for any more and widens intervals."""

_LEAST_DAMPING = 1e-3
"""Levenberg's, in parts of the diagonal: less is none to speak of."""

_MOST_DAMPING = 1e2
"""A step of a hundredth."""


@dataclass(frozen=True, eq=False)
class LinearisedResiduals:
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
    def from_residuals(
        residual: Array, jacobian: Array, log_noise: float = 0.0
    ) -> LinearisedResiduals:
        """Returns the sums of whitened residuals (m,) and their derivative (m, n)."""
        return LinearisedResiduals(
            jacobian.T @ jacobian,
            jacobian.T @ residual,
            float(residual @ residual),
            len(residual),
            log_noise,
        )

    @staticmethod
    def empty(n: int) -> LinearisedResiduals:
        """Returns the sums of no residuals, of n parameters."""
        return LinearisedResiduals(np.zeros((n, n)), np.zeros(n), 0.0, 0)

    def __add__(self, other: LinearisedResiduals) -> LinearisedResiduals:
        return LinearisedResiduals(
            self.information + other.information,
            self.gradient + other.gradient,
            self.chi2 + other.chi2,
            self.rows + other.rows,
            self.log_noise + other.log_noise,
        )

    def compute_log_evidence(self, table: ParameterTable, z: Array) -> float:
        """Returns the logarithm of how likely the measurements are, whatever the parameters.

        Of residuals that are linear in the parameters; up to a constant.

        Args:
            table: The parameters.
            z: (n,) how far they are from what was said, in their widths.
        """
        width = table.width
        whole = width[:, None] * self.information * width + table.precision
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
            units: a direction with 1 is determined as well by the prior.
        precision: (n, n) what was known before, likewise.
        chi2: Sum of squares of the whitened residuals left.
        moved: (n,) how far the parameters moved, in what were their widths.
        rows: How many residuals there are.
    """

    parameters: tuple[Parameter, ...]
    mean: Array = field(metadata={"unit": "varies"})
    covariance: Array = field(metadata={"unit": "varies"})
    information: Array = field(metadata={"unit": "1"})
    precision: Array = field(metadata={"unit": "1"})
    chi2: float = field(metadata={"unit": "1"})
    moved: Array = field(metadata={"unit": "1"})
    rows: int

    @staticmethod
    def from_prior(table: ParameterTable) -> Posterior:
        """Returns what is known without measurements."""
        none, width = np.zeros((len(table), len(table))), table.width
        covariance = width[:, None] * np.linalg.inv(table.precision) * width
        known = none, table.precision, 0.0, np.zeros(len(table)), 0
        return Posterior(table.parameters, table.stated, covariance, *known)

    @property
    def kinds(self) -> NDArray[np.str_]:
        """(n,) of each parameter."""
        return np.array([one.kind for one in self.parameters], dtype=str)

    @property
    def std(self) -> Array:
        """(n,) standard deviations."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def variance_ratios(self) -> Array:
        """(n,) variance that is left, in parts of the prior's: 1 is no more than was known."""
        widths = np.array([one.width for one in self.parameters])
        return np.asarray(np.diag(self.covariance) / widths**2)

    @property
    def interval(self) -> Array:
        """(n, 2) in which a parameter is with 95 %."""
        half = HALF_WIDTH_95 * self.std
        return np.stack([self.mean - half, self.mean + half], axis=1)

    @property
    def degrees_of_freedom(self) -> float:
        """Residuals less the parameters that they told: what ``chi2`` is on average."""
        n = len(self.mean)
        whole = np.linalg.inv(self.precision + self.information)
        finding = n - np.trace(whole @ self.precision)
        return float(self.rows - finding)


HALF_WIDTH_95 = 1.959963984540054
"""Standard deviations on either side of a normal distribution's mean that hold 95 %."""


def estimate_parameters(
    table: ParameterTable,
    linearise: Callable[[Array, Array], LinearisedResiduals],
    start: Array | None = None,
    *,
    least: Array | None = None,
    enough: float = _SETTLED,
) -> Posterior:
    """Returns the parameters that measurements and priors make most probable.

    Minimises chi2(x) + z^T P z, z = (x - stated) / width, P being the prior's precision, by
    Levenberg's damped Gauss-Newton steps. What noise does to residuals may depend on parameters
    (that of an encoder on a torque, by kp). It is taken as it is at the last parameters, and no
    derivative is taken of it: residuals would be made small by parameters that make noise large.
    What means nothing below zero stays above.

    Where joints stick and slip a simulation's cost has steps, and there may be none that gains:
    what was promised is added to what is not known.

    Args:
        table: The parameters.
        linearise: Called with parameters, and those at which noise is taken: returns the
            measurements' residuals about the first.
        start: (n,) to begin with; the stated values by default.
        least: (n,) below which parameters mean nothing; 0 of kinds that are positive, by default.
        enough: A step that promises no more is not taken.

    Raises:
        FitError: If it does not converge.
    """
    x = table.stated.copy() if start is None else np.array(start, dtype=float)
    if least is None:
        least = np.array([0.0 if KINDS[one.kind].positive else -np.inf for one in table])
    damping = 0.0
    for steps in range(1, _MOST_STEPS + 1):
        here = _Quadratic(table, linearise(x, x), x, least)
        if not here.has_minimum:
            break
        step = here.step(0.0)
        promised = here.promise(step)
        if promised < enough:
            return here.posterior()
        moved, damping = _move(here, linearise, damping)
        # A rough cost, or one whose noise follows: what is promised and not found widens intervals.
        if moved is None or moved[1] <= enough or steps == _MOST_STEPS:
            if promised < max(_OPEN, _STALLED * here.cost):
                return here.posterior(step)
            if moved is None:
                break
        x = moved[0]
    raise FitError(diagnose("fit-does-not-converge", steps=steps))


class _Quadratic:
    """What is to be minimised, about a vector of parameters.

    Args:
        table: The parameters.
        linearised: The measurements.
        x: (n,) values.
        least: (n,) of them.

    Attributes:
        table: The parameters.
        linearised: The measurements.
        x: (n,) values.
        least: (n,) of them.
        cost: What is minimised.
        information: (n, n) of the measurements, in the priors' widths.
        whole: (n, n) with what was known before.
        downhill: (n,) half the negative gradient.
    """

    def __init__(
        self, table: ParameterTable, linearised: LinearisedResiduals, x: Array, least: Array
    ) -> None:
        self.table, self.linearised, self.x, self.least = table, linearised, x, least
        width, self._z = table.width, (x - table.stated) / table.width
        self.cost = linearised.chi2 + float(self._z @ table.precision @ self._z)
        self.information: Array = width[:, None] * linearised.information * width
        self.whole = self.information + table.precision
        self.downhill: Array = -(width * linearised.gradient + table.precision @ self._z)

    @property
    def has_minimum(self) -> bool:
        """Whether it can be minimised: where derivatives overflow it is no longer definite."""
        if not (np.isfinite(self.whole).all() and np.isfinite(self.downhill).all()):
            return False
        try:
            cho_factor(self.whole)
        except np.linalg.LinAlgError:
            return False
        return True

    def step(self, damping: float) -> Array:
        """Returns Levenberg's step (n,) in the priors' widths; what would be below zero ends there.

        The others' steps are those that are best then.
        """
        least = (self.least - self.x) / self.table.width
        step, free = np.zeros(len(self.x)), np.ones(len(self.x), dtype=bool)
        whole = self.whole + damping * np.diag(np.diag(self.whole))
        while free.any():
            own = self.downhill[free] - whole[np.ix_(free, ~free)] @ step[~free]
            step[free] = cho_solve(cho_factor(whole[np.ix_(free, free)]), own)
            below = free & (step < least)
            if not below.any():
                break
            step[below], free = least[below], free & ~below
        return step

    def promise(self, step: Array) -> float:
        """Returns by how much a step makes the cost less, if derivatives are right."""
        return float(step @ (2 * self.downhill - self.whole @ step))

    def posterior(self, open_step: Array | None = None) -> Posterior:
        """Returns what is known, if these are the best parameters.

        Args:
            open_step: (n,) one that was promised and not found.
        """
        width = self.table.width
        covariance = np.linalg.inv(self.whole)
        covariance = (covariance + covariance.T) / 2
        if open_step is not None:
            covariance = covariance + np.outer(open_step, open_step)
        return Posterior(
            parameters=self.table.parameters,
            mean=self.x,
            covariance=width[:, None] * covariance * width,
            information=self.information,
            precision=self.table.precision,
            chi2=self.linearised.chi2,
            moved=self._z,
            rows=self.linearised.rows,
        )


def _move(
    here: _Quadratic, linearise: Callable[[Array, Array], LinearisedResiduals], damping: float
) -> tuple[tuple[Array, float] | None, float]:
    """Returns parameters of less cost and what they gain, if there are any; and the damping."""
    table, x = here.table, here.x
    while damping <= _MOST_DAMPING:
        step = here.step(damping)
        promised, tried = here.promise(step), x + table.width * step
        for bends_left in range(0 if damping else _BENDS, -1, -1):
            there = _Quadratic(table, linearise(tried, x), tried, here.least)
            gain = here.cost - there.cost
            if gain >= _LEAST_KEPT * promised - _SETTLED:
                less = damping / 10 if damping > _LEAST_DAMPING else 0.0
                return (tried, gain), less
            if not bends_left or not there.has_minimum:
                break
            # What the same derivatives make of what is left there is how the way bends.
            tried = tried + table.width * there.step(0.0)
        damping = max(10 * damping, _LEAST_DAMPING)
    return None, damping
