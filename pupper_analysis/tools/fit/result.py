"""What a fit tells: numbers with intervals, and what cannot be distinguished."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.results import Result
from pupper_analysis.tools.fit.estimate import NORMAL_95, Posterior
from pupper_analysis.tools.fit.parameters import OF_SURROUNDINGS, Parameter

# What measurements tell of parameters, and what they cannot: by name, and in combinations.

Array = NDArray[np.float64]


class Determined(StrEnum):
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


def determined_by(share: float) -> Determined:
    """Returns how much is from measurements, by the share of the prior's variance that is left."""
    if share < _BY_DATA:
        return Determined.DATA
    return Determined.PARTLY if share < _BY_PRIOR else Determined.PRIOR


@dataclass(frozen=True)
class Combination(Result):
    """Parameters that measurements cannot distinguish.

    Attributes:
        names: Of the parameters.
        ratio: Whether it is their ratio that is determined, and not how large they are.
        std: Standard deviation of the combination that is determined, in parts of its prior's.
        measurements: {what else to measure: by which factor that would narrow the widest of them},
            the best first.
    """

    names: tuple[str, ...]
    ratio: bool
    std: float
    measurements: Mapping[str, float]


def find_combinations(
    posterior: Posterior, more: Mapping[str, Array] | None = None
) -> tuple[Combination, ...]:
    """Finds parameters that are determined only in combinations.

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
            found.append(_combine(posterior, sorted(group), spread, more or {}))
    return tuple(found)


def _combine(
    posterior: Posterior, group: list[int], spread: Array, more: Mapping[str, Array]
) -> Combination:
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
    return Combination(
        names=tuple(one.name for one in chosen),
        ratio=_are_in_ratio(chosen, posterior.mean[group], widest),
        std=math.sqrt(float(values[0])),
        measurements=dict(sorted(after.items(), key=lambda one: -one[1])),
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


@dataclass(frozen=True)
class Estimate(Result):
    """What is known of a parameter after measurements.

    Attributes:
        name: Of the parameter.
        kind: Of number.
        subject: The link, joint or foot; ``floor`` or ``imu``.
        component: ``x``, ``y``, ``z``, ``roll``, ``pitch``, or empty.
        unit: Of the following numbers.
        stated: The model's value.
        mean: The most probable value.
        std: Standard deviation.
        low: Lower end of the interval that holds it with 95 %.
        high: Upper end.
        determined: How much of it is from measurements: ``data``, ``partly``, ``prior``.
    """

    name: str
    kind: str
    subject: str
    component: str
    unit: str
    stated: float
    mean: float
    std: float
    low: float
    high: float
    determined: Determined


@dataclass(frozen=True)
class Expected(Result):
    """What measurements will tell of a parameter.

    Attributes:
        name: Of the parameter.
        unit: Of the following numbers.
        stated: The model's value.
        before: Half of the interval that holds it with 95 %, before.
        after: The same after the measurements.
        determined: How much of it will be from them.
    """

    name: str
    unit: str
    stated: float
    before: float
    after: float
    determined: Determined


@dataclass(frozen=True, eq=False)
class Fit(Result):
    """A robot's numbers as measurements tell them.

    Attributes:
        name: The robot's name.
        source: Where the measurements are from.
        estimates: Of all parameters, those of the surroundings last.
        combinations: What cannot be distinguished.
        failures: What the model does not explain.
        diagnostics: What else there is to say.
        posterior: What is known of all parameters together.
    """

    name: str
    source: str
    estimates: tuple[Estimate, ...]
    combinations: tuple[Combination, ...]
    failures: tuple[Diagnostic, ...]
    diagnostics: tuple[Diagnostic, ...]
    posterior: Posterior
    _reported: ClassVar[tuple[str, ...]] = ("explained", "correlations")

    @property
    def explained(self) -> bool:
        """Whether the model explains the measurements."""
        return not self.failures

    @property
    def excess(self) -> float:
        """How many times what is left is what noise leaves; 1 at least."""
        return max(1.0, math.sqrt(self.posterior.chi2 / max(self.posterior.freedom, 1.0)))

    @property
    def correlations(self) -> tuple[Correlation, ...]:
        """Parameters that are off together, the strongest before."""
        return find_correlations(self.posterior)


def describe_parameters(posterior: Posterior) -> Iterator[Estimate]:
    """Yields what is known of each parameter, those of the surroundings last."""
    order = sorted(
        range(len(posterior.parameters)),
        key=lambda place: posterior.parameters[place].kind in OF_SURROUNDINGS,
    )
    for place in order:
        one = posterior.parameters[place]
        yield describe_parameter(
            one,
            float(posterior.mean[place]),
            float(posterior.std[place]),
            determined_by(float(posterior.shares[place])),
        )


def describe_parameter(one: Parameter, mean: float, std: float, determined: Determined) -> Estimate:
    """Returns what is known of a parameter."""
    return Estimate(
        name=one.name,
        kind=one.kind,
        subject=one.subject,
        component=one.component,
        unit=one.unit,
        stated=one.stated,
        mean=mean,
        std=std,
        low=mean - NORMAL_95 * std,
        high=mean + NORMAL_95 * std,
        determined=determined,
    )


# Which parameters of a fit are off together.

_SHOWN = 0.5
"""Correlation from which on two are told of: below, one tells less than a quarter of the other's
variance."""


@dataclass(frozen=True)
class Correlation(Result):
    """Two parameters that are off together.

    Attributes:
        one: Name of a parameter.
        other: Name of another.
        correlation: Of what is not known of them: 1 if both are too large together, -1 if one is
            too large where the other is too small.
    """

    one: str
    other: str
    correlation: float


def find_correlations(posterior: Posterior) -> tuple[Correlation, ...]:
    """Returns the pairs of parameters that are off together, the strongest before."""
    std, names = posterior.std, [one.name for one in posterior.parameters]
    matrix = posterior.covariance / np.outer(std, std)
    rows, columns = np.triu_indices(len(names), 1)
    strength = np.abs(matrix[rows, columns])
    order = np.argsort(-strength, kind="stable")
    return tuple(
        Correlation(names[rows[at]], names[columns[at]], float(matrix[rows[at], columns[at]]))
        for at in order[: np.count_nonzero(strength >= _SHOWN)]
    )


# What logs of motions tell, as numbers with intervals.


@dataclass(frozen=True, eq=False)
class MotionFit(Fit):
    """A robot's numbers as logs of its motions tell them.

    Attributes:
        seconds: How long the motions are.
        held_out: Root mean square of what is off in motions that were not fitted (rad); NaN if
            there are none.
        held_out_before: The same with the file's own numbers (rad).
        fitted: The same in motions that were fitted (rad).
        fitted_before: With the file's own numbers (rad).
        repeatability: How far the robot is from itself over runs of the same commands (rad); NaN
            if no two are the same.
        by_joint: {joint: what is off in motions that were not fitted, or in those that were (rad)}.
        encoder_noise: {joint: noise of its encoder (rad)}.
        steps: Of the simulation between two samples.
    """

    seconds: float
    held_out: float
    held_out_before: float
    fitted: float
    fitted_before: float
    repeatability: float
    by_joint: Mapping[str, float]
    encoder_noise: Mapping[str, float]
    steps: int

    @property
    def excess(self) -> float:
        """How many times what is off in other motions is what it was fitted to; 1 at least."""
        return max(1.0, self.held_out / self.fitted) if self.held_out > 0 else 1.0
