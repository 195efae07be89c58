"""Whether ground and IMU are as they were said to be."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.identification.estimate import Posterior
from pupper_analysis.identification.parameters import OF_SURROUNDINGS

Array = NDArray[np.float64]

_CHANCE = 0.002
"""Probability that a kind is found to be otherwise by chance: of three, 0.6 % of all fits."""

_LEAST_TOLD = 0.02
"""Of a prior's variance: a direction of which no more is told speaks against nothing."""

_ALSO = 2.0
"""Standard deviations, where feet sink otherwise: those which do."""


def doubt_surroundings(posterior: Posterior) -> Iterator[Diagnostic]:
    """Yields what of the surroundings is not as it was said to be, one kind at a time.

    Estimates move from what was said by d. If that is so, d has the covariance S by which prior and
    posterior differ, and d^T S^-1 d is distributed as chi^2: several weak signs of a slope, or of
    soft soles, are one together. What is said is S^-1 d in the prior's variances, which is not
    drawn to what was said.

    Args:
        posterior: What is known of the parameters.
    """
    from scipy import stats  # slow to import

    for kind in OF_SURROUNDINGS:
        places = [at for at, one in enumerate(posterior.parameters) if one.kind == kind]
        if not places:
            continue
        chosen = [posterior.parameters[at] for at in places]
        width = np.array([one.width for one in chosen])
        off = (posterior.mean[places] - [one.stated for one in chosen]) / width
        before = np.linalg.inv(posterior.precision)[np.ix_(places, places)]
        told = before - posterior.covariance[np.ix_(places, places)] / np.outer(width, width)
        values, vectors = np.linalg.eigh(told)
        kept = values > _LEAST_TOLD
        moved = vectors[:, kept].T @ off
        signs = float(np.sum(moved**2 / values[kept]))
        if not kept.any() or stats.chi2.sf(signs, np.count_nonzero(kept)) > _CHANCE:
            continue
        free = width * (before @ vectors[:, kept] @ (moved / values[kept]))
        each = np.abs(off) / np.sqrt(np.maximum(np.diag(told), _LEAST_TOLD))
        if kind == "slope":
            most = chosen[int(np.abs(free).argmax())]
            slope = Quantity(float(math.hypot(*free)), "rad")
            yield diagnose("ground-slopes", slope=slope, axis=most.component)
            continue
        for number, one in enumerate(chosen):
            if number != each.argmax() and each[number] < _ALSO:
                continue
            if kind == "softness":
                times = max(0.0, one.stated + float(free[number]))
                yield diagnose("feet-sink-otherwise", subject=("foot", one.subject), times=times)
            else:
                angle = Quantity(float(free[number]), "rad")
                yield diagnose("imu-is-turned", angle=angle, axis=one.component)
