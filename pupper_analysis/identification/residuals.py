"""Measured and simulated motions: how far they are apart, and which parameters bring them near."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.identification.estimate import Linearised, Posterior, estimate_parameters
from pupper_analysis.identification.noise import SeriesNoise
from pupper_analysis.identification.rollouts import Run, Simulator

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_ROUNDS = 4
"""Of fits, each with the noise that the one before has left."""

_SAME_NOISE = 0.02
"""Of deviations: noise that changes by no more changes no interval that is shown."""

_ROUGH, _FIRST_ROUGH = 1e-6, 1e-4
"""Of costs: what joints that stick and slip change for no reason; and what is near enough
while noise is not known."""

_NEAR = 0.1
"""Of the priors' widths: so far derivatives of a motion are the same within some percent, and steps
with those lead to the same within so many percent of a standard deviation."""

_GLANCE = 12.0
"""s of motion that are fitted first: from there a step or two are left for all of it."""

_MOST_STEPS = 16
"""Between two samples: 0.3 ms at 200 Hz. What changes still is an impact, and not the step."""

_SAME_SLOPES = 4
"""Points that are linearised with the same derivatives: where more are needed they mislead, and are
made again by differences to both sides."""


class Motion:
    """Measured and simulated runs, and how far they are apart.

    Args:
        simulator: Simulates them.
        runs: As they were measured.
    """

    def __init__(self, simulator: Simulator, runs: Sequence[Run]) -> None:
        self.simulator, self.runs, self.table = simulator, tuple(runs), simulator.table
        self.fitted = tuple(run for run in runs if run.counts.any())
        self._noise: tuple[SeriesNoise, ...] = ()
        self._last: tuple[Array, list[Array]] | None = None
        self._slopes: tuple[Array, list[dict[int, tuple[IntArray, Array]]]] | None = None
        self._used = 0

    def residuals(self, x: Array) -> list[Array]:
        """Returns predicted less measured positions (n, nu) of each run that is fitted (rad)."""
        if self._last is None or not np.array_equal(self._last[0], x):
            found = [
                self.simulator.predict(run, [x])[0] - np.where(run.counts, run.position, np.nan)
                for run in self.fitted
            ]
            self._last = x.copy(), found
        return self._last[1]

    def slopes(self, x: Array) -> list[dict[int, tuple[IntArray, Array]]]:
        """Returns derivatives of predicted positions of each run, from parameters near by."""
        width = self.table.width
        self._used += 1
        far = self._slopes is None or np.abs((x - self._slopes[0]) / width).max() > _NEAR
        if self._slopes is None or far or self._used > _SAME_SLOPES:
            found, self._used = [], 0
            for run, left in zip(self.fitted, self.residuals(x), strict=True):
                measured = np.where(run.counts, run.position, 0.0)
                here = np.where(run.counts, left + measured, np.nan)
                here = self.simulator.predict(run, [x])[0] if np.isnan(here).any() else here
                found.append(dict(self.simulator.jacobian(run, x, here, central=not far)))
            self._slopes = x.copy(), found
        return self._slopes[1]

    def linearise(self, x: Array, _about: Array) -> Linearised:
        """Returns whitened residuals as sums; derivatives are made when they are asked for."""
        return _Lazy(self, x.copy(), self._noise)  # type: ignore[return-value]

    def with_steps(self, steps: int) -> Motion:
        """Returns the same with other steps of the simulation between two samples."""
        return Motion(self.simulator.with_steps(steps), self.runs)

    def step_error(self, x: Array) -> float:
        """Returns what half the step changes, in parts of what is left (root mean squares)."""
        steps = self.simulator.steps
        if steps >= _MOST_STEPS:
            return 0.0
        finer, run = self.simulator.with_steps(2 * steps), self.fitted[0].until(_GLANCE)
        change = finer.predict(run, [x])[0] - self.simulator.predict(run, [x])[0]
        return root_mean_square([np.where(run.counts, change, np.nan)]) / root_mean_square(
            self.residuals(x)
        )

    def fit(self, start: Array | None = None) -> Posterior:
        """Returns the parameters, with the noise that they leave.

        They are those of least squares, in which each joint counts by its noise's long-run
        deviation. Their covariance is that which noise with its memory gives such parameters
        ("sandwich"): for H = A + 1, in the priors' widths, H^-1 (B + 1) H^-1, where B is the
        covariance of the gradient.

        Args:
            start: To begin with; the stated values by default.

        Raises:
            FitError: If it does not converge.
        """
        x = self._glance() if start is None else start
        for rough in (_FIRST_ROUGH, *(_ROUGH for _ in range(_ROUNDS - 1))):
            left, before = self.residuals(x), self._noise
            self._noise = tuple(
                # At first without memory, as what is left is no noise yet.
                SeriesNoise.of([one[:, joint] for one in left])
                if before or start is not None
                else SeriesNoise.white(root_mean_square(one[:, joint] for one in left))
                for joint in range(left[0].shape[1])
            )
            same = [
                abs(one.long_run / other.long_run - 1) < _SAME_NOISE
                for one, other in zip(self._noise, before, strict=bool(before))
            ]
            if same and all(same):
                break
            posterior = estimate_parameters(self.table, self.linearise, x, rough)
            x = posterior.mean
        return self._with_memory(posterior)

    def _with_memory(self, posterior: Posterior) -> Posterior:
        """Returns the same with the covariance that the noise's memory makes."""
        size, width = len(self.table), self.table.width
        spread = np.zeros((size, size))
        groups = self.simulator.groups
        for run, slopes in zip(self.fitted, self.slopes(posterior.mean), strict=True):
            for number, (places, by_places) in slopes.items():
                for at, joint in enumerate(groups[number][0]):
                    noise = self._noise[joint]
                    counted = np.where(run.counts[:, joint, None], by_places[:, at], 0.0)
                    back = noise.spread(counted / noise.long_run**2)
                    spread[places[:, None], places] += back @ back.T
        narrow = np.linalg.inv(posterior.information + np.eye(size))
        spread = width[:, None] * spread * width + np.eye(size)
        covariance = narrow @ spread @ narrow
        covariance = (covariance + covariance.T) / 2
        return replace(posterior, covariance=width[:, None] * covariance * width)

    def _glance(self) -> Array:
        """Returns parameters that suit the first seconds, where there are many more."""
        left, first = _GLANCE, []
        for run in self.fitted:
            if left > 0:
                first.append(run.until(left))
                left -= float(first[-1].time[-1])
        if sum(len(run.time) for run in first) > 0.7 * sum(len(run.time) for run in self.fitted):
            return self.table.stated.copy()
        if not any(run.counts.any() for run in first):
            return self.table.stated.copy()
        return Motion(self.simulator, first).fit().mean


class _Lazy:
    """What ``Linearised`` has, but derivatives are made where they are needed: not of a trial."""

    log_noise = 0.0

    def __init__(self, motion: Motion, x: Array, noise: tuple[SeriesNoise, ...]) -> None:
        self._motion, self._x, self._noise = motion, x, noise
        self._white = [
            left / np.array([one.long_run for one in noise]) for left in motion.residuals(x)
        ]
        told = [np.isfinite(white) for white in self._white]
        self.rows = int(sum(one.sum() for one in told))
        self.chi2 = float(sum((white[one] ** 2).sum() for white, one in zip(self._white, told)))  # noqa: B905

    @cached_property
    def _sums(self) -> tuple[Array, Array]:
        size = len(self._motion.table)
        information, gradient = np.zeros((size, size)), np.zeros(size)
        groups = self._motion.simulator.groups
        for white, slopes in zip(self._white, self._motion.slopes(self._x), strict=True):
            for number, (places, by_places) in slopes.items():
                for at, joint in enumerate(groups[number][0]):
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


def root_mean_square(series: Iterable[Array]) -> float:
    """Returns the root mean square of what is not NaN; NaN of nothing."""
    whole = np.concatenate([one.ravel() for one in series])
    told = whole[np.isfinite(whole)]
    return float(np.sqrt(np.mean(told**2))) if told.size else math.nan
