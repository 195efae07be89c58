"""What is left of a fitted motion, as noise that remembers itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MOST_LAGS = 10
"""50 ms at 200 Hz: what remembers longer is seen by its sum."""

_LEAST = 1e-6
"""rad, m: no encoder's noise is less, and no weight is infinite."""

_SAMPLES_PER_LAG = 20
"""Fewer tell nothing of a coefficient."""


@dataclass(frozen=True, eq=False)
class SeriesNoise:
    """Noise of one joint: e_k = sum_i c_i e_(k-i) + w_k, with w of standard deviation s.

    Residuals of a motion follow each other: an encoder that is still says the same for long, and
    what a model lacks lasts. Whitened by this, as many samples count as tell something. (The
    method of generalised least squares with estimated autoregression: Prais and Winsten.)

    Attributes:
        coefficients: (lags,) c.
        deviation: s.
    """

    coefficients: Array
    deviation: float

    @staticmethod
    def white(deviation: float) -> SeriesNoise:
        """Returns noise without memory."""
        return SeriesNoise(np.zeros(0), max(deviation, _LEAST))

    @staticmethod
    def of(series: Sequence[Array]) -> SeriesNoise:
        """Returns the noise that some series (n,) are; NaN are missing.

        So many lags as Schwarz's criterion has worth it.
        """
        lagged = [_lagged(one, _MOST_LAGS) for one in series]
        rows = np.concatenate([one[np.isfinite(one).all(axis=1)] for one in lagged])
        if len(rows) < _SAMPLES_PER_LAG * _MOST_LAGS:
            told = np.concatenate([one[np.isfinite(one)] for one in series] or [np.zeros(0)])
            return SeriesNoise.white(float(np.sqrt(np.mean(told**2))) if told.size else _LEAST)
        best = (np.inf, SeriesNoise.white(float(np.sqrt(np.mean(rows[:, 0] ** 2)))))
        for lags in range(_MOST_LAGS + 1):
            before = rows[:, 1 : lags + 1]
            given = np.linalg.lstsq(before, rows[:, 0], rcond=None)[0]
            left = rows[:, 0] - before @ given
            variance = max(float(left @ left) / (len(rows) - lags), _LEAST**2)
            worth = len(rows) * np.log(variance) + lags * np.log(len(rows))
            if worth < best[0]:
                best = worth, SeriesNoise(given, float(np.sqrt(variance)))
        return best[1]

    def whiten(self, series: Array) -> Array:
        """Returns w / s (n, ...) of a series (n, ...); NaN where it or what it needs is missing."""
        lags = len(self.coefficients)
        white = series.copy()
        for lag, share in enumerate(self.coefficients, 1):
            white[lag:] -= share * series[:-lag]
        white[:lags] = np.nan
        white /= self.deviation
        return white


def _lagged(series: Array, lags: int) -> Array:
    """Returns a series (n,) with those before it as columns (n - lags, 1 + lags)."""
    return np.column_stack([series[lags - lag : len(series) - lag] for lag in range(lags + 1)])
