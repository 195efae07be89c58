"""What measurements tell of parameters, and what they cannot: by name, and in combinations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.results import Result
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.parameters import Parameter

Array = NDArray[np.float64]


class Told(StrEnum):
    """How much of an estimate is from measurements."""

    DATA = "data"
    """The interval is at most a third of what was known before."""
    PARTLY = "partly"
    """It is narrower than that, but the prior counts."""
    PRIOR = "prior"
    """The prior alone holds it: measurements tell nothing."""


_BY_DATA, _BY_PRIOR = 0.1, 0.9
"""Of the prior's variance that is left: a third, and 95 %, of its width."""

_BOUND = 0.9
"""Correlation from which on two parameters are told only together."""

_AS_ONE = 0.1
"""Difference of the logarithms of two relative deviations: both are off by the same share."""


def told_by(share: float) -> Told:
    """Returns how much is from measurements, by the share of the prior's variance that is left."""
    if share < _BY_DATA:
        return Told.DATA
    return Told.PARTLY if share < _BY_PRIOR else Told.PRIOR


@dataclass(frozen=True)
class Together(Result):
    """Parameters that measurements cannot tell apart.

    Attributes:
        names: Of the parameters.
        ratio: Whether it is their ratio that is told, and not how large they are.
        std: Standard deviation of the combination that is told, in parts of its prior's.
        remedies: {what else to measure: by which factor that would narrow the widest of them},
            the best first.
    """

    names: tuple[str, ...]
    ratio: bool
    std: float
    remedies: Mapping[str, float]


def find_together(
    posterior: Posterior, more: Mapping[str, Array] | None = None
) -> tuple[Together, ...]:
    """Finds parameters that are told only in combinations.

    Two belong together if their correlation after the measurements is over 0.9 and each alone is
    not told. All that are bound to each other are one group: its widest direction is what the
    measurements leave open.

    Args:
        posterior: What is known.
        more: {what else could be measured: its information (n, n) in the priors' widths}.
    """
    widths = np.array([one.width for one in posterior.parameters])
    spread = posterior.covariance / np.outer(widths, widths)
    shares = np.diag(spread)
    deviation = np.sqrt(shares)
    correlation = spread / np.outer(deviation, deviation)
    open_ones = shares >= _BY_DATA
    bound = (np.abs(correlation) > _BOUND) & open_ones & open_ones[:, None]
    left, found = set(np.flatnonzero(open_ones).tolist()), []
    while left:
        group, waiting = set(), {left.pop()}
        while waiting:
            one = waiting.pop()
            group.add(one)
            waiting |= set(np.flatnonzero(bound[one]).tolist()) - group
        left -= group
        if len(group) > 1:
            found.append(_together(posterior, sorted(group), spread, more or {}))
    return tuple(found)


def _together(
    posterior: Posterior, group: list[int], spread: Array, more: Mapping[str, Array]
) -> Together:
    own = spread[np.ix_(group, group)]
    values, vectors = np.linalg.eigh(own)
    chosen = [posterior.parameters[place] for place in group]
    widest = vectors[:, -1] * np.array([one.width for one in chosen])
    after = {}
    for what, information in more.items():
        added = np.linalg.inv(posterior.precision + posterior.information + information)
        narrowed = vectors[:, -1] @ added[np.ix_(group, group)] @ vectors[:, -1]
        factor = math.sqrt(float(values[-1]) / float(narrowed))
        if factor > _HELPS:
            after[what] = factor
    return Together(
        names=tuple(one.name for one in chosen),
        ratio=_are_in_ratio(chosen, posterior.mean[group], widest),
        std=math.sqrt(float(values[0])),
        remedies=dict(sorted(after.items(), key=lambda one: -one[1])),
    )


_HELPS = 1.5
"""By which a remedy must narrow what is open, to be told."""


def _are_in_ratio(parameters: list[Parameter], mean: Array, widest: Array) -> bool:
    """Says whether what is open is a common factor: all change by the same share of their value."""
    if any(one.component or one.kind == "offset" for one in parameters) or (mean <= 0).any():
        return False
    shares = widest / mean
    if not ((shares > 0).all() or (shares < 0).all()):
        return False
    sizes = np.log(np.abs(shares))
    return bool(np.ptp(sizes) < _AS_ONE * len(parameters))
