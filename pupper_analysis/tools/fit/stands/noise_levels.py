"""How large noise is that nobody states: what the measurements themselves make most likely."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.tools.fit.estimate import Linearised, Posterior
from pupper_analysis.tools.fit.parameters import ParameterTable
from pupper_analysis.tools.fit.stands.equations import StandEquations
from pupper_analysis.tools.fit.stands.rows import StandNoise

Array = NDArray[np.float64]

_SPREAD = 1.5
"""Standard deviation of a level's logarithm before: a factor of 4.5 either way."""

_FLATTEST = 1e-4
"""m: links and floors are no better; simulated ones are, but feet sink by more than is modelled."""

_LEAST_MOMENT = 1e-4
"""m: what feet keep alike in all stands, which are come to alike, hides in the zeros of encoders.
No evidence tells of it. Feet of v3 in MuJoCo keep 2e-5 to 1e-3 after 12 s."""

_SETTLES = 4
"""Steps after which stands' own unknowns change no evidence that is told."""

_EVALUATIONS = 40
"""Of the evidence, in search of three levels: they are wanted to some ten per cent."""


def find_noise(
    equations: StandEquations, known: Posterior, more: Callable[[Array], Linearised]
) -> StandNoise:
    """Returns the noise with moments on feet, flatness and joints' friction that are most likely.

    The greatest evidence: probability of the measurements, whatever the parameters are, times that
    of the levels, which are log-normal about those that are expected.

    Args:
        equations: Of the stands, with the noise that is expected.
        known: With that noise; about its parameters residuals are taken.
        more: Returns further residuals.
    """
    from scipy import optimize  # slow to import

    expected, x, table = equations.noise, known.mean, ParameterTable(known.parameters)
    equations.linearise(x, x, _SETTLES)  # finds stands' own unknowns
    about = x.copy()  # so that they stay as they are: no level is better by when it is tried

    def at(levels: Array) -> StandNoise:
        moment, flatness, friction = np.exp(levels)
        return replace(
            expected,
            moment=max(_LEAST_MOMENT, expected.moment * moment),
            flatness=max(_FLATTEST, expected.flatness * flatness),
            friction=expected.friction * friction,
        )

    def unlikely(levels: Array) -> float:
        equations.noise = at(levels)
        told = equations.linearise(x, about, 1) + more(x)
        # Moments that all stands have alike are as large as those of each.
        alike = table.scaled("moment", equations.noise.moment / expected.moment)
        evidence = told.evidence(alike, known.moved)
        return float(levels @ levels) / (2 * _SPREAD**2) - evidence

    simplex = np.vstack([np.zeros(3), -np.eye(3)])
    options = {"initial_simplex": simplex, "maxfev": _EVALUATIONS, "xatol": 0.05, "fatol": 0.02}
    found = optimize.minimize(unlikely, np.zeros(3), method="Nelder-Mead", options=options)
    equations.noise = expected
    return at(found.x)
