"""Measured and simulated motions: how far they are apart, and which parameters bring them near."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from pupper_analysis.tools.fit.estimate import Linearised, Posterior, Slopes, estimate_parameters
from pupper_analysis.tools.fit.motions.rollouts import Moments, Run, Simulator
from pupper_analysis.tools.fit.parameters import KINDS

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_ROUNDS = 4
"""Of fits, each with the noise that the one before has left."""

_SAME_NOISE = 0.05
"""Of deviations: noise that changes by no more changes no interval that is shown."""

_ENOUGH = 0.04
"""Of the cost: a fifth of a standard deviation, by which an interval is 2 % too narrow."""

_ROUGHLY = 1.0
"""Of the cost: a standard deviation, which is near enough while the noise is another."""

_GLANCED = 1e-4
"""Of the cost: near enough while noise is not known, as it is some times what it begins with."""

_GLANCE = 12.0
"""s of motion that are fitted first: from there a step or two are left for all of it."""

_DRAWS = 12
"""Of parameters, each with its opposite: by them a deviation that bends is known to a sixth."""

_FINER = 4
"""Times the steps of what derivatives are made with has what is compared with measurements: its
error, that of dry friction, falls with the square. Derivatives are right to 1 % without."""

_MOST_STEPS = 16
"""Between two samples: 0.3 ms at 200 Hz. What changes still is an impact, and not the step."""


class Motion:
    """Measured and simulated runs, and how far they are apart.

    Fine steps predict; coarse ones, of which there are thirty for one, make derivatives.

    Args:
        simulator: Simulates them.
        runs: As they were measured.
        known: (n, n) what is known of moments before these runs, in the priors' widths.
    """

    def __init__(
        self, simulator: Simulator, runs: Sequence[Run], known: Array | None = None
    ) -> None:
        self.simulator, self.runs, self.table = simulator, tuple(runs), simulator.table
        self.fitted = tuple(run for run in runs if run.counts.any())
        self.moments = Moments(self.table)
        self.positive = np.array([KINDS[one.kind].positive for one in self.table], dtype=bool)
        self._noise: tuple[SeriesNoise, ...] = ()
        self._last: tuple[Array, list[Array]] | None = None
        self._slopes: list[Mapping[int, tuple[IntArray, Array]]] = []
        self._dear, self._known = Slopes(self.renew), known
        self.finer = simulator.with_steps(_FINER * simulator.steps)

    def residuals(self, x: Array) -> list[Array]:
        """Returns predicted less measured positions (n, nu) of each run that is fitted (rad)."""
        if self._last is None or not np.array_equal(self._last[0], x):
            found = [
                self.finer.predict(run, [x])[0] - np.where(run.counts, run.position, np.nan)
                for run in self.fitted
            ]
            self._last = x.copy(), found
        return self._last[1]

    def renew(self, moments: Array) -> None:
        """Makes derivatives of predicted positions by moments (n,), as they are there."""
        known = self.known
        self._slopes = [
            differentiate(self.simulator, self.moments, run, moments, known) for run in self.fitted
        ]

    @property
    def known(self) -> Array | None:
        """(n, n) what is known of moments by now, in the priors' widths; None before all."""
        if self._last is None or not self._slopes:
            return self._known
        told = _Lazy(self._last[1], self._slopes, self._noise, self.simulator.groups)
        width = self.table.width
        found: Array = width[:, None] * told.information * width + self.table.precision
        return found

    def linearise(self, moments: Array, _about: Array) -> Linearised:
        """Returns whitened residuals as sums; these are made when they are asked for."""
        left = self.residuals(self.moments.to_parameters(moments))
        return _Lazy(left, self._slopes, self._noise, self.simulator.groups)  # type: ignore[return-value]

    def with_steps(self, steps: int) -> Motion:
        """Returns the same with other steps of the simulation between two samples."""
        return Motion(self.simulator.with_steps(steps), self.runs, self.known)

    def step_error(self, x: Array) -> float:
        """Returns what finer steps change, in parts of what is left (root mean squares)."""
        if self.simulator.steps >= _MOST_STEPS:
            return 0.0
        run = self.fitted[0].until(_GLANCE)
        change = self.finer.predict(run, [x])[0] - self.simulator.predict(run, [x])[0]
        return root_mean_square([np.where(run.counts, change, np.nan)]) / root_mean_square(
            self.residuals(x)
        )

    def fit(self, start: Array | None = None, *, near: bool = True) -> Posterior:
        """Returns the parameters, with the noise that they leave.

        They are those of least squares, in which each joint counts by its noise's long-run
        deviation. Their covariance is that which noise with its memory gives such parameters
        ("sandwich"): for H = A + 1, in the priors' widths, H^-1 (B + 1) H^-1, where B is the
        covariance of the gradient.

        Args:
            start: To begin with; by default what suits the first seconds.
            near: Whether what it leaves is noise, rather than motion.

        Raises:
            FitError: If it does not converge.
        """
        first = self._glance(start) if start is None or not near else None
        x = start if first is None else first
        begin = self.moments.of_parameters(self.table.stated if x is None else x)
        posterior = self._descend(
            begin, _ROUNDS, near=first is not None or (near and start is not None)
        )
        return self._with_memory(posterior)

    def _descend(self, y: Array, rounds: int, *, near: bool) -> Posterior:
        """Returns the most probable moments, in rounds with the noise that the one before has left.

        Args:
            y: (n,) moments to begin with.
            rounds: How many at most; the last is the one that ends where it should.
            near: Whether what is left at first is noise, rather than motion.
        """
        for turn in range(rounds):
            left, before = self.residuals(self.moments.to_parameters(y)), self._noise
            self._noise = tuple(
                SeriesNoise.of([one[:, joint] for one in left])
                if turn or near
                else SeriesNoise.white(root_mean_square(one[:, joint] for one in left))
                for joint in range(left[0].shape[1])
            )
            last = turn == _ROUNDS - 1 or (turn > 0 and _alike(before, self._noise))
            rough = _ROUGHLY if turn or near else _GLANCED * sum(one.size for one in left)
            posterior = estimate_parameters(
                self.table,
                self.linearise,
                y,
                enough=_ENOUGH if last else rough,
                slopes=self._dear,
            )
            y = posterior.mean
            # What led nowhere leads nowhere with a noise that is hardly another.
            if last or (turn and posterior.open_step is not None):
                break
        return posterior

    def _with_memory(self, posterior: Posterior) -> Posterior:
        """Returns the same with the covariance that the noise's memory makes."""
        size, width = len(self.table), self.table.width
        spread = np.zeros((size, size))
        groups = self.simulator.groups
        for run, slopes in zip(self.fitted, self._slopes, strict=True):
            for number, (places, by_places) in slopes.items():
                for at, joint in enumerate(groups[number][0]):
                    noise = self._noise[joint]
                    counted = np.where(run.counts[:, joint, None], by_places[:, at], 0.0)
                    back = noise.spread(counted / noise.long_run**2)
                    spread[places[:, None], places] += back @ back.T
        narrow = np.linalg.inv(posterior.information + posterior.precision)
        spread = width[:, None] * spread * width + posterior.precision
        covariance = narrow @ spread @ narrow
        if posterior.open_step is not None:
            open_step = posterior.open_step / width
            covariance += np.outer(open_step, open_step)
        bends = self._bends(posterior, covariance)
        return self.moments.of_posterior(posterior, posterior.mean, covariance, bends)

    def _bends(self, posterior: Posterior, covariance: Array) -> Array:
        """Returns how far parameters are from where straight lines lead (draws, n), in widths.

        Moments are drawn as they are known. What measurements do not tell takes what they do with
        it where that bends: an armature is told with the inertia of its link, which goes with the
        square of a com. So each draw is led back to what suits the measurements, by one step with
        the same derivatives.

        Args:
            posterior: The moments.
            covariance: (n, n) of these, in the priors' widths.
        """
        width, size = self.table.width, len(self.table)
        drawn = np.random.default_rng(0).multivariate_normal(
            np.zeros(size), covariance, _DRAWS, method="eigh"
        )
        drawn = np.concatenate([drawn, -drawn])
        least = np.where(self.positive, -posterior.mean / width, -np.inf)
        drawn = np.maximum(drawn, least)
        begin = posterior.mean + width * drawn
        gradients = np.zeros((len(drawn), size))
        for run, slopes in zip(self.fitted, self._slopes, strict=True):
            vectors = [posterior.mean, *begin]
            found = self.simulator.predict_all(
                run, np.array([self.moments.to_parameters(one) for one in vectors])
            )
            for number, (places, by_places) in slopes.items():
                for at, joint in enumerate(self.simulator.groups[number][0]):
                    counted = run.counts[:, joint]
                    rows = by_places[counted, at] * width[places]
                    bent = found[1:, counted, joint] - found[0, counted, joint]
                    bent -= drawn[:, places] @ rows.T
                    gradients[:, places] += bent @ rows / self._noise[joint].long_run ** 2
        whole = posterior.information + posterior.precision
        led = np.maximum(drawn - np.linalg.solve(whole, gradients.T).T, least)
        mean = self.moments.to_parameters(posterior.mean)
        turn = self.moments.derivative(posterior.mean) * width / width[:, None]
        off = np.array(
            [self.moments.to_parameters(one) - mean for one in posterior.mean + width * led]
        )
        # What was known before is known still.
        bends: Array = np.clip(off / width - drawn @ turn.T, -1, 1)
        return bends

    def _glance(self, start: Array | None) -> Array | None:
        """Returns parameters that suit the first seconds, where there are many more."""
        left, first = _GLANCE, []
        for run in self.fitted:
            if left > 0:
                first.append(run.until(left))
                left -= float(first[-1].time[-1])
        if sum(len(run.time) for run in first) > 0.7 * sum(len(run.time) for run in self.fitted):
            return None
        if not any(run.counts.any() for run in first):
            return None
        motion = Motion(self.simulator, first)
        begin = motion.moments.of_parameters(self.table.stated if start is None else start)
        found = motion._descend(begin, 2, near=False)
        self._known = motion.known
        return self.moments.to_parameters(found.mean)


class _Lazy:
    """What ``Linearised`` has, but sums are made where they are needed: not of a trial."""

    log_noise = 0.0

    def __init__(
        self,
        left: Sequence[Array],
        slopes: Sequence[Mapping[int, tuple[IntArray, Array]]],
        noise: tuple[SeriesNoise, ...],
        groups: Sequence[tuple[list[int], list[int]]],
    ) -> None:
        self._slopes, self._noise, self._groups = slopes, noise, groups
        self._white = [one / np.array([own.long_run for own in noise]) for one in left]
        told = [np.isfinite(white) for white in self._white]
        self.rows = int(sum(one.sum() for one in told))
        self.chi2 = float(sum((white[one] ** 2).sum() for white, one in zip(self._white, told)))  # noqa: B905
        self._size = 1 + max(int(places.max()) for one in slopes for places, _ in one.values())

    @cached_property
    def _sums(self) -> tuple[Array, Array]:
        size = self._size
        information, gradient = np.zeros((size, size)), np.zeros(size)
        for white, slopes in zip(self._white, self._slopes, strict=True):
            for number, (places, by_places) in slopes.items():
                for at, joint in enumerate(self._groups[number][0]):
                    told = np.isfinite(white[:, joint])
                    rows = by_places[told, at] / self._noise[joint].long_run
                    information[places[:, None], places] += rows.T @ rows
                    gradient[places] += rows.T @ white[told, joint]
        return information, gradient

    @property
    def information(self) -> Array:
        """(n, n) sum of A^T A."""
        return self._sums[0]

    @property
    def gradient(self) -> Array:
        """(n,) sum of A^T r."""
        return self._sums[1]


def _alike(one: Sequence[SeriesNoise], other: Sequence[SeriesNoise]) -> bool:
    """Says whether two noises of all joints are the same."""
    return all(
        abs(own.long_run / its.long_run - 1) < _SAME_NOISE
        for own, its in zip(one, other, strict=True)
    )


# What is left of a fitted motion, as noise that remembers itself.


_MOST_LAGS = 20
"""100 ms at 200 Hz: what remembers longer is seen by what it does in that time."""

_LEAST = 1e-6
"""rad, m: no encoder's noise is less, and no weight is infinite."""

_SAMPLES_PER_LAG = 20
"""Fewer tell nothing of a coefficient."""


@dataclass(frozen=True, eq=False)
class SeriesNoise:
    """Noise of one joint: e_k = sum_i c_i e_(k-i) + w_k, with w of standard deviation s.

    Residuals of a motion follow each other: an encoder that is still says the same for long, and
    what a model lacks lasts. A sum over many samples is as uncertain as that of independent ones of
    the deviation s / (1 - sum c), its long-run deviation.

    Attributes:
        coefficients: (lags,) c.
        innovation: s.
        deviation: Of e.
    """

    coefficients: Array
    innovation: float
    deviation: float

    @staticmethod
    def white(deviation: float) -> SeriesNoise:
        """Returns noise without memory."""
        deviation = max(deviation, _LEAST) if math.isfinite(deviation) else _LEAST
        return SeriesNoise(np.zeros(0), deviation, deviation)

    @staticmethod
    def of(series: Sequence[Array]) -> SeriesNoise:
        """Returns the noise that some series (n,) are; NaN are missing.

        By Yule's and Walker's equations, whose noise never grows; so many lags as Schwarz's
        criterion has worth it.
        """
        filled = [np.where(np.isfinite(one), one, 0.0) for one in series]
        count = int(sum(np.isfinite(one).sum() for one in series))
        if count == 0:
            return SeriesNoise.white(_LEAST)
        moments = np.array(
            [sum(float(one[lag:] @ one[: max(len(one) - lag, 0)]) for one in filled) / count
             for lag in range(_MOST_LAGS + 1)]
        )  # fmt: skip
        deviation = math.sqrt(moments[0])
        best = SeriesNoise.white(deviation)
        if count < _SAMPLES_PER_LAG * _MOST_LAGS or deviation <= _LEAST:
            return best
        least = math.inf
        for lags in range(_MOST_LAGS + 1):
            given = solve_toeplitz(moments[:lags], moments[1 : lags + 1]) if lags else np.zeros(0)
            variance = max(float(moments[0] - given @ moments[1 : lags + 1]), _LEAST**2)
            worth = count * math.log(variance) + lags * math.log(count)
            if worth < least:
                least, best = worth, SeriesNoise(given, math.sqrt(variance), deviation)
        return best

    @property
    def long_run(self) -> float:
        """Standard deviation of independent samples that tell as little; that of e at least."""
        return max(self.innovation / (1 - float(self.coefficients.sum())), self.deviation)

    def spread(self, weights: Array) -> Array:
        """Returns B^T with B^T B the covariance of sums of the noise with weights (n, m): (m, n).

        The noise is w through a filter; so its sums are those of w with the weights through the
        filter backwards.
        """
        back = lfilter([self.innovation], [1.0, *-self.coefficients], weights[::-1], axis=0)
        turned: Array = back.T
        return turned


def root_mean_square(series: Iterable[Array]) -> float:
    """Returns the root mean square of what is not NaN; NaN of nothing."""
    whole = np.concatenate([one.ravel() for one in series])
    told = whole[np.isfinite(whole)]
    return float(np.sqrt(np.mean(told**2))) if told.size else math.nan


# How predicted motions change with parameters: differences along what is known to be uncertain.


_STEP = 0.1
"""Of a standard deviation: by that parameters are changed for a derivative. From 0.1 to 1 the
intervals of a v3 are the same to 1 %, and motions hardly bend in the least of these."""

_FIRST_STEP = 1e-2
"""Of a prior's width, while nothing else is known."""


def differentiate(
    simulator: Simulator,
    moments: Moments,
    run: Run,
    at: Array,
    known: Array | None = None,
) -> Mapping[int, tuple[IntArray, Array]]:
    """Returns how predicted positions change with parameters by moments.

    kp, friction, masses all larger by the same factor move nothing, but each alone moves much: by
    parameters one at a time, errors of large derivatives add up to what looks as if the factor were
    told, and intervals are a quarter too narrow. So steps are along principal directions of what is
    known, each as long as it is uncertain.

    Joints that move no body of each other's are changed together, as they do not feel it.

    Args:
        simulator: Predicts them.
        moments: Makes parameters of moments.
        run: The run.
        at: (n,) moments.
        known: (n, n) what is known of these, in the priors' widths: inverse of a covariance. None:
            the priors alone, and steps are one parameter at a time.

    Returns:
        {group of joints: (numbers of the parameters that act on it, (n, joints, parameters))}.
    """
    groups, shared = simulator.groups, simulator.bodies.shared(simulator.table)
    turns, width = max(len(columns) for _, columns in groups), simulator.table.width
    changes = np.zeros((turns + len(shared), len(at)))
    steps = []
    for columns in (*(own for _, own in groups), shared):
        steps.append(_steps(columns, known))
        rows = slice(len(columns)) if len(steps) <= len(groups) else slice(turns, None)
        changes[rows, columns] = steps[-1]
    changes *= width

    vectors = [moments.to_parameters(one) for one in (at, *(at + changes))]
    predicted = simulator.predict_all(run, np.array(vectors))
    moved = predicted[1:] - predicted[0]
    found: dict[int, tuple[IntArray, Array]] = {}
    for number, (joints, columns) in enumerate(groups):
        places = np.array([*columns, *shared], dtype=np.int64)
        by_step = np.moveaxis(moved[:, :, joints], 0, 2)
        slopes = np.concatenate(
            [
                by_step[..., : len(columns)] @ np.linalg.inv(steps[number]).T,
                by_step[..., turns:] @ np.linalg.inv(steps[-1]).T,
            ],
            axis=2,
        )
        found[number] = places, slopes / width[places]
    return found


def _steps(columns: list[int], known: Array | None) -> Array:
    """Returns steps (rows) of some parameters in their priors' widths."""
    if known is None:
        return _FIRST_STEP * np.eye(len(columns))
    values, directions = np.linalg.eigh(known[np.ix_(columns, columns)])
    steps: Array = _STEP * (directions / np.sqrt(values)).T
    return steps
