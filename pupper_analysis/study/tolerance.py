"""How sure is a stand of numbers that are not exact, and how exact need they be?"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pupper_analysis.arguments import check_type, finite
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.results import Result
from pupper_analysis.study.running import Progress
from pupper_analysis.study.study import Study
from pupper_analysis.study.variables import LogUniform, Normal, Uniform, Variable

if TYPE_CHECKING:
    import pandas as pd

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


def chance(there: int, designs: int) -> Chance:
    """Returns a probability and its confidence interval.

    Source: Wilson, "Probable inference", 1927: good where the share is near to 0 or 1 too.

    Args:
        there: How many designs are as wanted.
        designs: Of how many.
    """
    if designs < 1:
        raise ConfigurationError("table", "it has no designs")
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
        table: Of a study with the measures ``stands`` and ``utilisation``, and with samples.

    Raises:
        ConfigurationError: If a measure is missing, or there are no designs.
    """
    if not hasattr(table, "columns"):
        raise ConfigurationError(
            "table", f"{reprlib.repr(table)} is no table: read_study reads one"
        )
    joints = [str(name) for name in table.columns if str(name).startswith("utilisation.")]
    if "stands" not in table or not joints:
        problem = f"it lacks some of {', '.join(NEEDED)}: let the study measure them"
        raise ConfigurationError("table", problem)
    count = len(table)
    up = table["stands"].fillna(0.0).to_numpy(float) > 0
    under = table[joints].to_numpy(float) < 1  # not of a design that has no stand
    return Certainty(
        stands=chance(int(up.sum()), count),
        motors={
            name.partition(".")[2]: chance(int(held.sum()), count)
            for name, held in zip(joints, under.T, strict=True)
        },
        all_motors=chance(int(under.all(axis=1).sum()), count),
        both=chance(int((up & under.all(axis=1)).sum()), count),
    )


def narrowed(study: Study, scale: float) -> Study:
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
    good = [True] * len(table)
    for name, (low, high) in criteria.items():
        if name not in table:
            known = ", ".join(str(column) for column in table.columns)
            raise ConfigurationError("criteria", f"the study measures no {name!r}; it has {known}")
        values = table[name].to_numpy(float)  # not a number is not in any range
        bounds = (-math.inf if low is None else low), (math.inf if high is None else high)
        inside = (values >= bounds[0]) & (values <= bounds[1])
        good = [one and bool(other) for one, other in zip(good, inside, strict=True)]
    return chance(sum(good), len(table))


@dataclass(frozen=True)
class Tolerance(Result):
    """The spreads with which a stand is sure enough.

    Attributes:
        scale: Factor on the study's spreads.
        spreads: {variable: its distribution with that factor, {kind: numbers}}.
        chance: With these.
        tried: {factor: probability} of all that were tried.
    """

    scale: float
    spreads: dict[str, dict[str, Any]]
    chance: Chance
    tried: dict[float, float]


def tightest_tolerance(
    study: Study,
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
    will do. ``criteria`` ask for more: ``{"push_recovery": (0.5, None)}``, ``verified``, own
    measures of paths; and so does a stance on a slope.

    Args:
        study: With the measures ``stands`` and ``utilisation``, or those of ``criteria``, and
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
        ConfigurationError: If a measure is missing, the samples cannot tell the probability, or
            even the smallest spreads do not do.
        StudyError: As ``Study.run``.
    """
    check_type("study", study, Study)
    goal, least = finite("wanted", wanted), finite("resolution", resolution)
    check_type("criteria", criteria, Mapping[str, Any] | None)
    most = finite("widest", widest)
    if not 0 < goal < 1 or not 0 < least < 1:
        raise ConfigurationError("wanted", "wanted and resolution are between 0 and 1")
    if most < 1:
        raise ConfigurationError("widest", f"{most:g} is below 1, the study's own spreads")
    samples = study.sampling.samples or 0
    if samples * (1 - goal) < 1:
        problem = f"{samples} cannot tell {goal:g}; take {math.ceil(1 / (1 - goal))} or more"
        raise ConfigurationError("samples", problem)
    tried: dict[float, Chance] = {}

    def sure(scale: float) -> bool:
        table = narrowed(study, scale).run(
            folder, executor=executor, workers=workers, progress=progress
        )
        tried[scale] = certainty(table).both if criteria is None else _kept(table, criteria)
        return tried[scale].probability >= goal

    low, high = 0.0, most
    if sure(most):
        low = most
    elif not sure(least):
        problem = f"with {least:g} of its spreads {tried[least].probability:.1%} stand"
        raise ConfigurationError("vary", f"{problem}: it is the means that do not do")
    else:
        low = least
        while high - low > least:
            middle = (low + high) / 2
            low, high = (middle, high) if sure(middle) else (low, middle)
    spreads = narrowed(study, low).spreads
    told = {scale: one.probability for scale, one in sorted(tried.items())}
    return Tolerance(low, spreads, tried[low], told)
