"""What a model does not explain of stands: noise, numbers, and what surrounds the robot."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.parameters import OF_SURROUNDINGS, Parameter
from pupper_analysis.tools.fit.stands.rows import StandNoise

Array = NDArray[np.float64]

_CHANCE = 0.002
"""Probability that a kind is found to be otherwise by chance: of three, 0.6 % of all fits."""

_LEAST_TOLD = 0.02
"""Of a prior's variance: a direction of which no more is told speaks against nothing."""

_ALSO = 2.0
"""Standard deviations, where feet sink otherwise: those which do."""

_NOISY = 5.0
"""Times what was expected: noise of which there is so much hides a cause."""

_FAR = 4.5
"""Standard deviations: of a hundred numbers that are as was said, none is so far off."""

_DOUBTED = ("slope", "softness", "imu")
"""Of the surroundings: kinds that somebody says something of."""

_NEVER_NOTHING, _NOTHING = ("mass", "kp"), 0.01
"""Kinds of numbers that no robot has none of, and what is none, in parts of the stated value."""

_RESIDUALS_CHANCE = 1e-3
"""Probability of residuals that are larger by chance."""


def doubt_stands(
    posterior: Posterior, found: StandNoise, expected: StandNoise
) -> Iterator[Diagnostic]:
    """Yields what the model does not explain of the measurements.

    Args:
        posterior: What is known of the parameters.
        found: The noise that was found.
        expected: The noise that was expected.
    """
    from scipy import stats  # slow to import

    if stats.chi2.sf(posterior.chi2, max(posterior.freedom, 1.0)) < _RESIDUALS_CHANCE:
        ratio = posterior.chi2 / max(posterior.freedom, 1.0)
        yield diagnose("residuals-too-large", times=math.sqrt(ratio))
    if found.flatness > _NOISY * expected.flatness:
        yield diagnose("feet-off-the-plane", off=Quantity(found.flatness, "m"))
    if found.friction > _NOISY * expected.friction:
        yield diagnose("torques-off", times=found.friction / expected.friction)
    own = [place for place, one in enumerate(posterior.parameters) if _is_own(one)]
    # What is known before and after differ in variance by what an estimate is surprised by, if the
    # parameter is as it was said to be: one by poor measurements stays near the stated value, and
    # tells as much by a smaller step.
    surprise = np.sqrt(np.maximum(1 - posterior.shares, _LEAST_TOLD))
    moved = posterior.moved / surprise
    far = [
        place
        for place in own
        if abs(moved[place]) > _FAR
        or (
            (posterior.parameters[place].kind in _NEVER_NOTHING and moved[place] < 0)
            and posterior.mean[place] < _NOTHING * posterior.parameters[place].stated
        )
    ]
    if far:
        worst = max(far, key=lambda place: abs(moved[place]))
        names = [posterior.parameters[place].name for place in far]
        yield diagnose("far-from-the-file", names=names, widths=abs(float(moved[worst])))
    flatter = min(1.0, found.flatness / expected.flatness)
    yield from doubt_surroundings(posterior, {"softness": flatter**2})


def _is_own(one: Parameter) -> bool:
    return one.kind not in OF_SURROUNDINGS


def doubt_surroundings(
    posterior: Posterior, shares: Mapping[str, float] | None = None
) -> Iterator[Diagnostic]:
    """Yields what of the surroundings is not as it was said to be, one kind at a time.

    Estimates move from what was said by d. If that is so, d has the covariance S by which prior and
    posterior differ, and d^T S^-1 d is distributed as chi^2: several weak signs of a slope, or of
    soft soles, are one together. What is said is S^-1 d in the prior's variances, which is not
    drawn to what was said.

    Args:
        posterior: What is known of the parameters.
        shares: {kind: what its signs are worth, in parts}. Feet that sink and ground that is uneven
            look alike: where ground came out flatter than expected, by few stands, signs of the
            other are worth what they were on the expected one.
    """
    from scipy import stats  # slow to import

    for kind in _DOUBTED:
        places = [at for at, one in enumerate(posterior.parameters) if one.kind == kind]
        if not places:
            continue
        chosen = [posterior.parameters[at] for at in places]
        width = np.array([one.width for one in chosen])
        off = posterior.moved[places]
        before = np.linalg.inv(posterior.precision)[np.ix_(places, places)]
        told = before - posterior.covariance[np.ix_(places, places)] / np.outer(width, width)
        values, vectors = np.linalg.eigh(told)
        kept = values > _LEAST_TOLD
        moved = vectors[:, kept].T @ off
        signs = (shares or {}).get(kind, 1.0) * float(np.sum(moved**2 / values[kept]))
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
