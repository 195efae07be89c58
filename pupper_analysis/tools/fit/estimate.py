"""Weighted least squares with what is known before: the most probable parameters, and how sure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

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

_NEAR = 100.0
"""Times the step that is let go: derivatives from so near, a standard deviation as a rule, do."""

_KEPT = 0.5
"""Of what a step promised: where less came, or twice as much, derivatives are made anew."""

_LEAST_KEPT = 0.1
"""Of what a step promised: with less it is not taken, and a shorter one tried."""

_BENDS = 2
"""How often a step that is not damped is led back to less cost: where mass moves far, inertia goes
with the square, and what nobody weighed follows kp along a valley that bends."""

_OPEN = 1.0
"""Of the cost: a standard deviation, that is not looked for any more and widens intervals."""

_MUDDY = 10.0
"""Of the cost: where no more is gained, and little of what was promised, derivatives to one side
misled, as where a joint begins to slip; of a longer step it is the way that bends."""

_LEAST_DAMPING = 1e-3
"""Levenberg's, in parts of the diagonal: less is none to speak of."""

_MOST_DAMPING = 1e2
"""A step of a hundredth."""


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

    def evidence(self, table: ParameterTable, z: Array) -> float:
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
        steps: Gauss-Newton steps.
        open_step: (n,) a step that was promised to be better and was not found; None as a rule.
    """

    parameters: tuple[Parameter, ...]
    mean: Array
    covariance: Array
    information: Array
    precision: Array
    chi2: float
    moved: Array
    rows: int
    steps: int
    open_step: Array | None = None

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
        finding = n - np.trace(whole @ self.precision)
        return float(self.rows - finding)


NORMAL_95 = 1.959963984540054
"""Standard deviations on either side of a normal distribution's mean that hold 95 %."""


def estimate_parameters(
    table: ParameterTable,
    linearise: Callable[[Array, Array], Linearised],
    start: Array | None = None,
    *,
    least: Array | None = None,
    enough: float = _SETTLED,
    jacobian: JacobianReuse | None = None,
) -> Posterior:
    """Returns the parameters that measurements and priors make most probable.

    Minimises chi2(x) + z^T P z, z = (x - stated) / width, P being the prior's precision, by
    Levenberg's damped Gauss-Newton steps. What noise does to residuals may depend on parameters
    (that of an encoder on a torque, by kp). It is taken as it is at the last parameters, and no
    derivative is taken of it: residuals would be made small by parameters that make noise large.
    What means nothing below zero stays above.

    Derivatives that cost much are used again as long as steps keep what they promise; they are made
    anew at the end. Where joints stick and slip a simulation's cost has steps, and even then there
    may be none that gains: what was promised is added to what is not known.

    Args:
        table: The parameters.
        linearise: Called with parameters, and those at which noise is taken: returns the
            measurements' residuals about the first.
        start: (n,) to begin with; the stated values by default.
        least: (n,) below which parameters mean nothing; 0 of kinds that are positive, by default.
        enough: A step that promises no more is not taken.
        jacobian: The derivatives that ``linearise`` uses. By default it makes its own each time.

    Raises:
        FitError: If it does not converge.
    """
    x = table.stated.copy() if start is None else np.array(start, dtype=float)
    if least is None:
        least = np.array([0.0 if KINDS[one.kind].positive else -np.inf for one in table])
    costly, damping = jacobian is not None, 0.0
    jacobian = jacobian or JacobianReuse()
    made = jacobian.made
    for steps in range(1, _MOST_STEPS + 1):
        jacobian.prepare(x)
        here = _Quadratic(table, linearise(x, x), x, least)
        if not here.has_minimum:
            break
        whole_step = here.step(0.0)
        promised = here.promise(whole_step)
        if promised < enough:
            if jacobian.are_near(x, here.curvature, _NEAR * enough):
                return here.posterior(steps)
            jacobian.outdated = True
            continue
        spent = jacobian.spent(made) and promised < _STALLED * here.cost
        if spent or (steps == _MOST_STEPS and promised < _OPEN):
            return here.posterior(steps, whole_step)
        moved, damping = _move(here, linearise, damping, plain=not jacobian.are_at(x))
        at_x = jacobian.are_at(x)
        if (moved is not None and moved.gain > enough) and (
            not (at_x and costly)
            or moved.gain > _KEPT * promised
            or moved.gain > max(_LEAST_KEPT * promised, _MUDDY)
        ):
            x, jacobian.outdated = moved.x, not _KEPT <= moved.kept <= 1 / _KEPT
        elif not at_x:
            jacobian.outdated, damping = True, 0.0
        elif promised < (_STALLED * here.cost if costly and moved is None else _OPEN):
            return here.posterior(steps, whole_step)
        elif moved is not None:
            x, jacobian.outdated = moved.x, True
        else:
            break
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
    """

    def __init__(
        self, table: ParameterTable, linearised: Linearised, x: Array, least: Array
    ) -> None:
        self.table, self.linearised, self.x, self.least = table, linearised, x, least
        self._z = (x - table.stated) / table.width
        self.cost = linearised.chi2 + float(self._z @ table.precision @ self._z)

    @cached_property
    def information(self) -> Array:
        """(n, n) of the measurements, in the priors' widths."""
        width = self.table.width
        found: Array = width[:, None] * self.linearised.information * width
        return found

    @cached_property
    def whole(self) -> Array:
        """(n, n) with what was known before."""
        return self.information + self.table.precision

    @cached_property
    def downhill(self) -> Array:
        """(n,) half the negative gradient."""
        found: Array = -(
            self.table.width * self.linearised.gradient + self.table.precision @ self._z
        )
        return found

    @property
    def curvature(self) -> Array:
        """(n, n) the same in the parameters' units."""
        found: Array = self.whole / np.outer(self.table.width, self.table.width)
        return found

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

    def posterior(self, steps: int, open_step: Array | None = None) -> Posterior:
        """Returns what is known, if these are the best parameters.

        Args:
            steps: How many were taken.
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
            steps=steps,
            open_step=None if open_step is None else width * open_step,
        )


@dataclass(frozen=True, eq=False)
class _Moved:
    """A step that was taken: to where, what it gained, and which part of its promise that is."""

    x: Array
    gain: float
    kept: float


def _move(
    here: _Quadratic,
    linearise: Callable[[Array, Array], Linearised],
    damping: float,
    *,
    plain: bool,
) -> tuple[_Moved | None, float]:
    """Returns parameters of less cost, if there are any; and the damping.

    Args:
        here: Where it begins.
        linearise: As ``estimate_parameters`` has it.
        damping: To begin with.
        plain: Whether other dampings are not tried, as derivatives may be at fault.
    """
    table, x = here.table, here.x
    while damping <= _MOST_DAMPING:
        step = here.step(damping)
        promised, tried = here.promise(step), x + table.width * step
        for bends_left in range(0 if damping else _BENDS, -1, -1):
            there = _Quadratic(table, linearise(tried, x), tried, here.least)
            gain = here.cost - there.cost
            if gain >= _LEAST_KEPT * promised - _SETTLED:
                less = damping / 10 if damping > _LEAST_DAMPING else 0.0
                return _Moved(tried, gain, gain / promised), less
            if not bends_left or not there.has_minimum:
                break
            # What the same derivatives make of what is left there is how the way bends.
            tried = tried + table.width * there.step(0.0)
        if plain:
            break
        damping = max(10 * damping, _LEAST_DAMPING)
    return None, damping


# Derivatives that cost much: made when they are needed, and used as long as they do.


_MOST = 6
"""Times: fits that end make them one to four times with the same noise."""


class JacobianReuse:
    """Derivatives that are made when they are needed, and how good they are.

    Args:
        renew: Makes those that ``linearise`` uses, at parameters. None: it makes its own each time.

    Attributes:
        outdated: Whether they are to be made anew.
        made: How often they were.
    """

    def __init__(self, renew: Callable[[Array], None] | None = None) -> None:
        self._renew = renew
        self._at: Array | None = None
        self.outdated, self.made = True, 0

    def prepare(self, x: Array) -> None:
        """Makes them at some parameters, if those that there are have misled."""
        if self._renew is not None and self.outdated:
            self._renew(x)
            self._at = x.copy()
            self.made += 1
        self.outdated = False

    def spent(self, before: int) -> bool:
        """Says whether they were made so often since then that it leads nowhere."""
        return self.made - before >= _MOST

    def are_at(self, x: Array) -> bool:
        """Says whether they were made at some parameters."""
        return self._renew is None or (self._at is not None and np.array_equal(self._at, x))

    def are_near(self, x: Array, curvature: Array, most: float) -> bool:
        """Says whether they were made near by.

        Args:
            x: (n,) the parameters.
            curvature: (n, n) of the cost.
            most: By what the cost may rise from here to there.
        """
        if self._renew is None or self._at is None:
            return True
        off = x - self._at
        return float(off @ curvature @ off) < most
