"""Which number matters most: Sobol's indices from samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import Term, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.tools.study.running import Progress
from pupper_analysis.tools.study.store import require_library
from pupper_analysis.tools.study.study import DesignStudy
from pupper_analysis.tools.study.variables import at_shares

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SobolIndices(Result):
    """Whose variance is whose, of one metric.

    Attributes:
        metric: Its column.
        first: {variable: share of the variance that it makes alone}.
        total: {variable: the same with all that it makes together with others}.
        uncertainty: {variable: half of the 95 % confidence interval of ``total``}.
        designs: How many were measured.
    """

    metric: str
    first: dict[str, float]
    total: dict[str, float]
    uncertainty: dict[str, float]
    designs: int


def sobol_indices(
    study: DesignStudy,
    folder: str | Path,
    metrics: Sequence[str],
    *,
    samples: int = 128,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> dict[str, SobolIndices]:
    """Measures designs by Saltelli's scheme, and takes the variance of metrics apart.

    Designs are kept in the study's folder, as those of ``Study.run``, and go on there.

    Source: Saltelli et al., "Variance based sensitivity analysis of model output", 2010; SALib.

    Args:
        study: Its variables' distributions count, not its samples.
        folder: Where results are kept.
        metrics: Columns of its table.
        samples: A power of 2; designs are this times the number of variables and two.
        executor: As in ``Study.run``.
        workers: Likewise.
        progress: Likewise.

    Returns:
        {metric: its indices}.

    Raises:
        ConfigurationError: If a column is not there, a design failed (indices need them all), or
            an argument makes no sense.
        StudyError: As ``Study.run``.
    """
    check_type("study", study, DesignStudy)
    check_type("metrics", metrics, Sequence[str])
    check_type("samples", samples, int)
    if samples < 2 or samples & (samples - 1):
        raise ConfigurationError("samples", diagnose("no-power-of-2", count=samples))
    if not study.variables:
        raise ConfigurationError("vary", diagnose("nothing-varies"))
    require_library("SALib")
    from SALib.analyze import sobol as analysis
    from SALib.sample import sobol as scheme

    names = list(study.variables)
    problem = {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
    seed = study.sampling.seed % 2**31 + 1  # SALib takes 0 for none
    shares = scheme.sample(problem, samples, calc_second_order=False, seed=seed)
    points = at_shares(study.variables, np.asarray(shares, dtype=float))
    chosen = study.at(points)
    table = chosen.run(folder, executor=executor, workers=workers, progress=progress)
    place = {name: index for index, name in enumerate(table["design"])}
    order = [place[name] for block, _ in chosen.designs() for name in block]
    found = {}
    for metric in metrics:
        if metric not in table:
            told = diagnose("none-of", value=metric, known=table.columns)
            raise ConfigurationError("metrics", told)
        values = table[metric].to_numpy(float)[order]
        lost = int((~np.isfinite(values)).sum())
        if lost:
            told = diagnose(
                "designs-without-metric",
                lost=lost,
                designs=len(values),
                metric=metric,
                reasons=[Term(str(kind)) for kind in table["failure"].dropna().unique()],
            )
            raise ConfigurationError("vary", told)
        index = analysis.analyze(problem, values, calc_second_order=False, seed=seed)
        found[metric] = SobolIndices(
            metric,
            dict(zip(names, index["S1"].tolist(), strict=True)),
            dict(zip(names, index["ST"].tolist(), strict=True)),
            dict(zip(names, index["ST_conf"].tolist(), strict=True)),
            len(values),
        )
    return found
