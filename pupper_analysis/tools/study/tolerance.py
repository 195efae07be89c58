"""How sure is a stand of numbers that are not exact, and how exact need they be?"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_finite, check_type
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.tools.study.running import Progress
from pupper_analysis.tools.study.study import DesignStudy
from pupper_analysis.tools.study.variables import (
    LogUniform,
    Normal,
    Uniform,
    Variable,
    at_shares,
)

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

_Z = 1.959963984540054
"""Of a 95 % confidence interval: the 97.5 % quantile of the normal distribution."""


@dataclass(frozen=True)
class Chance(Result):
    """A probability, estimated from designs.

    Attributes:
        probability: The share of designs.
        low: The least that it may be, with 95 % confidence.
        high: The greatest.
        designs: How many there are.
    """

    probability: float
    low: float
    high: float
    designs: int


def probability_interval(there: int, designs: int) -> Chance:
    """Returns a probability and its confidence interval.

    Source: Wilson, "Probable inference", 1927: good where the share is near to 0 or 1 too.

    Args:
        there: How many designs are as wanted.
        designs: Of how many.
    """
    if designs < 1:
        raise ConfigurationError("table", diagnose("table-without-designs"))
    share, z = there / designs, _Z**2 / designs
    middle = (share + z / 2) / (1 + z)
    half = math.sqrt(share * (1 - share) * z + z**2 / 4) / (1 + z)
    return Chance(share, max(0.0, middle - half), min(1.0, middle + half), designs)


@dataclass(frozen=True)
class Certainty(Result):
    """How sure a stand is.

    Attributes:
        stands: That it stays up on its servos; a design that fails does not.
        motors: {joint: that its motor is under its limit in the stand}.
        all_motors: That all are.
        both: That it stays up, and all motors are under their limits.
    """

    stands: Chance
    motors: dict[str, Chance]
    all_motors: Chance
    both: Chance


NEEDED = ("stands", "utilisation")
"""Measures that ``certainty`` looks at."""


def certainty(table: pd.DataFrame) -> Certainty:
    """Tells from a study's table how sure its stands are.

    Args:
        table: Of a study with the metrics ``stands`` and ``utilisation``, and with samples.

    Raises:
        ConfigurationError: If a metric is missing, or there are no designs.
    """
    if not hasattr(table, "columns"):
        raise ConfigurationError("table", diagnose("no-table", given=reprlib.repr(table)))
    joints = [str(name) for name in table.columns if str(name).startswith("utilisation.")]
    if "stands" not in table or not joints:
        raise ConfigurationError("table", diagnose("table-lacks-metrics", needed=NEEDED))
    count = len(table)
    up = table["stands"].fillna(0.0).to_numpy(float) > 0
    under = table[joints].to_numpy(float) < 1  # not of a design that has no stand
    return Certainty(
        stands=probability_interval(int(up.sum()), count),
        motors={
            name.partition(".")[2]: probability_interval(int(held.sum()), count)
            for name, held in zip(joints, under.T, strict=True)
        },
        all_motors=probability_interval(int(under.all(axis=1).sum()), count),
        both=probability_interval(int((up & under.all(axis=1)).sum()), count),
    )


def narrow_study(study: DesignStudy, scale: float) -> DesignStudy:
    """Returns a study whose distributions are narrower, or wider, about their means.

    Args:
        study: The study.
        scale: Factor on deviations and on the distances of bounds from the mean (of a log-uniform
            variable: on those of the logarithms); lists of values stay.
    """
    variables = {name: _narrowed(one, scale) for name, one in study.variables.items()}
    return study.varying(variables)


def _narrowed(variable: Variable, scale: float) -> Variable:
    if isinstance(variable, Normal):
        return Normal(variable.mean, scale * variable.deviation)
    if isinstance(variable, LogUniform):
        middle, half = math.sqrt(variable.low * variable.high), variable.high / variable.low
        return LogUniform(middle * half ** (-scale / 2), middle * half ** (scale / 2))
    if isinstance(variable, Uniform):
        middle, half = (variable.low + variable.high) / 2, (variable.high - variable.low) / 2
        return Uniform(middle - scale * half, middle + scale * half)
    return variable


def _kept(table: pd.DataFrame, criteria: Mapping[str, tuple[float | None, float | None]]) -> Chance:
    """Returns how many designs keep to criteria."""
    good = _good(table, criteria)
    return probability_interval(int(good.sum()), len(table))


def _good(
    table: pd.DataFrame, criteria: Mapping[str, tuple[float | None, float | None]] | None
) -> NDArray[np.bool_]:
    """Returns which designs (n,) keep to criteria; of none: stand and are under limits."""
    if criteria is None:
        joints = [str(name) for name in table if str(name).startswith("utilisation.")]
        under = (table[joints].to_numpy(float) < 1).all(axis=1)
        up: NDArray[np.bool_] = under & (table["stands"].fillna(0.0).to_numpy(float) > 0)
        return up
    good = np.ones(len(table), dtype=bool)
    for name, (low, high) in criteria.items():
        if name not in table:
            told = diagnose("study-without-metric", column=name, known=map(str, table.columns))
            raise ConfigurationError("criteria", told)
        values = table[name].to_numpy(float)  # not a number is not in any range
        bounds = (-math.inf if low is None else low), (math.inf if high is None else high)
        good &= (values >= bounds[0]) & (values <= bounds[1])
    return good


@dataclass(frozen=True)
class Tolerance(Result):
    """The spreads with which a stand is sure enough.

    Attributes:
        scale: Factor on the study's spreads.
        spreads: {variable: its distribution with that factor, {kind: numbers}}, of those that
            enter a criterion.
        chance: With these.
        tried: {factor: probability} of all that were tried.
        enters: {criterion: the variables that change it within ``widest`` of their spreads}.
        without: Variables that change no criterion: nothing follows for their spreads.
    """

    scale: float
    spreads: dict[str, dict[str, Any]]
    chance: Chance
    tried: dict[float, float]
    enters: dict[str, tuple[str, ...]]
    without: tuple[str, ...]


def tightest_tolerance(
    study: DesignStudy,
    folder: str | Path,
    *,
    wanted: float = 0.99,
    resolution: float = 0.02,
    criteria: Mapping[str, tuple[float | None, float | None]] | None = None,
    widest: float = 1.0,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Tolerance:
    """Finds how exact the numbers must be for the stand to be as sure as wanted.

    All spreads are narrowed by the same factor until the robot stays up, with all motors under
    their limits, in the wanted share of designs; by bisection, each step with the study's samples,
    kept in its folder. A factor of ``widest`` means that wider spreads may do, too: they were not
    tried.

    A number must enter what is asked: of a level stand friction does not, and any spread of it
    will do. So each variable alone goes from end to end of its widest range, from the design in the
    middle, from some that keep to the criteria and from some that do not: those that change no
    criterion have no spread in the result. ``criteria`` ask for more:
    ``{"push_recovery": (0.5, None)}``, ``verified``, own metrics of paths; and so does a stance on
    a slope.

    Args:
        study: With the metrics ``stands`` and ``utilisation``, or those of ``criteria``, and
            samples.
        folder: Where results are kept.
        wanted: The probability.
        resolution: Of the factor.
        criteria: {column of the study's table: (the least value, the greatest)} that a design must
            keep to, None for none; a design that has no such value does not. By default it stays
            up, with all motors under their limits.
        widest: The greatest factor that is tried, at least 1.
        executor: As in ``Study.run``.
        workers: Likewise.
        progress: Likewise.

    Raises:
        ConfigurationError: If a metric is missing, the samples cannot tell the probability, or
            even the smallest spreads do not do.
        StudyError: As ``Study.run``.
    """
    check_type("study", study, DesignStudy)
    goal, least = check_finite("wanted", wanted), check_finite("resolution", resolution)
    check_type("criteria", criteria, Mapping[str, Any] | None)
    most = check_finite("widest", widest)
    if not 0 < goal < 1 or not 0 < least < 1:
        raise ConfigurationError("wanted", diagnose("not-between-0-and-1"))
    if most < 1:
        raise ConfigurationError("widest", diagnose("widest-below-1", widest=most))
    samples = study.sampling.samples or 0
    if samples * (1 - goal) < 1:
        few = diagnose(
            "samples-cannot-tell", samples=samples, wanted=goal, least=math.ceil(1 / (1 - goal))
        )
        raise ConfigurationError("samples", few)
    tried: dict[float, Chance] = {}

    def measured(one: DesignStudy) -> pd.DataFrame:
        return one.run(folder, executor=executor, workers=workers, progress=progress)

    def sure(scale: float) -> bool:
        table = measured(narrow_study(study, scale))
        tried[scale] = certainty(table).both if criteria is None else _kept(table, criteria)
        return tried[scale].probability >= goal

    low, high = 0.0, most
    if sure(most):
        low = most
    elif not sure(least):
        share = Quantity(tried[least].probability, "1")
        raise ConfigurationError("vary", diagnose("means-do-not-do", scale=least, share=share))
    else:
        low = least
        while high - low > least:
            middle = (low + high) / 2
            low, high = (middle, high) if sure(middle) else (low, middle)
    told = {scale: one.probability for scale, one in sorted(tried.items())}
    wide = narrow_study(study, most)
    enters = screen_variables(
        wide, _points(wide, measured(wide), criteria), tuple(criteria or NEEDED), measured
    )
    some = {name for names in enters.values() for name in names}
    spreads, without = _split(narrow_study(study, low), some)
    return Tolerance(low, spreads, tried[low], told, enters, without)


_FROM = 3
"""Designs that keep to the criteria, and that do not, from which variables are varied alone."""


def _points(
    study: DesignStudy,
    table: pd.DataFrame,
    criteria: Mapping[str, tuple[float | None, float | None]] | None,
) -> Array:
    """Returns designs (n, variables): that in the middle, some that are good, some that are not."""
    good = _good(table, criteria)
    chosen = np.concatenate([np.flatnonzero(good)[:_FROM], np.flatnonzero(~good)[:_FROM]])
    middle = at_shares(study.variables, np.full((1, len(study.variables)), 0.5))
    some: Array = np.concatenate([middle, table[list(study.variables)].to_numpy(float)[chosen]])
    return some


def _split(
    study: DesignStudy, entering: set[str]
) -> tuple[dict[str, dict[str, Any]], tuple[str, ...]]:
    """Returns the spreads of the variables that enter, and the others that vary.

    What was given for each of several has one entry if all of these enter, or none.
    """
    spreads: dict[str, dict[str, Any]] = {}
    without: list[str] = []
    for name, own in study.groups.items():
        asked = study.variables[own[0]].asked()
        there = [one for one in own if one in entering]
        if len(there) in (0, len(own)):
            own, there = (name,), [name] * bool(there)
        spreads |= dict.fromkeys(there, asked)
        if len(study.variables[study.groups[name][0]].levels or (0, 1)) > 1:
            without += [one for one in own if one not in there]
    return spreads, tuple(without)


# Which numbers enter which metric: designs that differ in one number alone.


ENDS = (0.001, 0.999)
"""Shares of a distribution that stand for its ends, as a normal one has none."""

EFFECT = 1e-6
"""Relative to the metric's size: what changes by less, from end to end, is rounding of solvers."""


def screen_variables(
    study: DesignStudy,
    points: Array,
    columns: Sequence[str],
    run: Callable[[DesignStudy], pd.DataFrame],
) -> dict[str, tuple[str, ...]]:
    """Returns which of a study's variables change which columns of its table.

    Each variable alone goes to either end of its range, from several designs, as an effect may
    be there in some of them only. A value that is lost, or found, has changed.

    Source: Morris, "Factorial sampling plans for preliminary computational experiments", 1991: its
    elementary effects, over the whole range.

    Args:
        study: The study.
        points: (n, variables) the designs from which they go.
        columns: Of its table; those with several values, ``NAME.KEY``, count together.
        run: Measures the designs of a study, and returns their table.

    Returns:
        {column: the variables that change it, in the study's order}.
    """
    names = list(study.variables)
    varied = [at for at, one in enumerate(study.variables.values()) if _span(one)[1] > 0]
    designs = [np.array(points)]
    for at in varied:
        for end in _span(list(study.variables.values())[at])[0]:
            moved = np.array(points)
            moved[:, at] = end
            designs.append(moved)
    chosen = study.at(np.concatenate(designs))
    table = run(chosen)
    place = {name: index for index, name in enumerate(table["design"])}
    order = [place[name] for block, _ in chosen.designs() for name in block]
    found = {}
    for column in columns:
        own = [n for n in table if n == column or str(n).startswith(f"{column}.")]
        values = table[own].to_numpy(float)[order].reshape(len(designs), len(points), -1)
        size = EFFECT * np.nanmax(np.abs(values), initial=0.0)
        lost = np.isnan(values) != np.isnan(values[:1])
        changed = (lost | (np.abs(values - values[:1]) > size)).any(axis=(1, 2))
        pairs = changed[1:].reshape(-1, 2).any(axis=1)
        found[column] = tuple(names[at] for at, one in zip(varied, pairs, strict=True) if one)
    return found


def _span(variable: Any) -> tuple[Array, float]:
    """Returns a variable's ends (2,), and how far apart they are."""
    ends: Array = np.array(variable.range if variable.levels else variable.at(np.array(ENDS)))
    return ends, float(np.ptp(ends))
