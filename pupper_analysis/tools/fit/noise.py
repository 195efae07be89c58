"""What is left of a fitted motion, as noise that remembers itself."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

Array = NDArray[np.float64]

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
