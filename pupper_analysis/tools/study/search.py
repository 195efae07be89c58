"""Search among designs: the best of one metric, or the front of several, by Optuna."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import Term, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.tools.study.pareto import pareto_front
from pupper_analysis.tools.study.running import Progress
from pupper_analysis.tools.study.store import require_library
from pupper_analysis.tools.study.variables import LogUniform, Normal, Variable

if TYPE_CHECKING:
    import pandas as pd

    from pupper_analysis.tools.study.study import DesignStudy

Bounds = tuple[float | None, float | None]

BATCH = 16
"""Designs that are asked for at a time, whatever the number of workers: so that a search that goes
on, there or elsewhere, asks for the same ones."""


@dataclass(frozen=True, eq=False)
class SearchOptimum(Result):
    """What a search has found.

    Attributes:
        best: The designs that keep to the bounds and that no other beats; of one metric, one row.
        table: All designs that were tried.
        kept: How many of these keep to the bounds.
    """

    best: pd.DataFrame
    table: pd.DataFrame
    kept: int


def optimise_study(
    study: DesignStudy,
    folder: str | Path,
    *,
    minimise: Sequence[str] = (),
    maximise: Sequence[str] = (),
    subject_to: Mapping[str, Bounds] | None = None,
    trials: int = 200,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> SearchOptimum:
    """Searches a study's ranges for the designs that are best.

    Optuna's tree-structured Parzen estimator proposes designs from what is known of the others
    (Bergstra et al., "Algorithms for hyper-parameter optimization", 2011). They are measured as all
    others, and kept in the folder; a search that was ended asks for the same designs again, finds
    them there, and goes on.

    Args:
        study: Its variables' ranges and lists are searched.
        folder: Where results are kept.
        minimise: Columns of its table.
        maximise: Likewise.
        subject_to: {column: (least, greatest)}; None where there is no bound.
        trials: How many designs are tried.
        executor: As in ``Study.run``.
        workers: Likewise.
        progress: Likewise.

    Raises:
        ConfigurationError: If an argument makes no sense, or nothing that was tried keeps to the
            bounds.
        StudyError: As ``Study.run``, and if Optuna is not installed.
    """
    check_type("trials", trials, int)
    check_type("minimise", minimise, Sequence[str])
    check_type("maximise", maximise, Sequence[str])
    objectives = {**dict.fromkeys(minimise, "min"), **dict.fromkeys(maximise, "max")}
    bounds = dict(subject_to or {})
    if not objectives or len(objectives) < len(minimise) + len(maximise):
        raise ConfigurationError("minimise", diagnose("no-objective-each-once"))
    if trials < 1:
        raise ConfigurationError("trials", diagnose("too-few", count=trials))
    _check(study, (*objectives, *bounds), bounds)
    require_library("optuna")
    search = _Search(study.variables, objectives, bounds, study.sampling.seed)
    tables = []
    for start in range(0, trials, BATCH):
        asked = search.ask(min(BATCH, trials - start))
        points = np.array([[one[name] for name in study.variables] for one in asked])
        table = study.at(points).run(folder, executor=executor, workers=workers, progress=progress)
        search.tell(table, points)
        tables.append(table)
    import pandas as pd

    tried = pd.concat(tables).drop_duplicates("design").reset_index(drop=True)
    kept = tried[_kept(tried, bounds)].dropna(subset=list(objectives))
    if kept.empty:
        failures = [
            diagnose("count-of-kind", kind=Term(str(kind)), count=count)
            for kind, count in tried["failure"].value_counts().items()
        ]
        told = diagnose("none-keeps-to-bounds", designs=len(tried), failures=failures)
        raise ConfigurationError("subject_to", told)
    return SearchOptimum(pareto_front(kept, objectives), tried, len(kept))


def _check(study: DesignStudy, columns: Sequence[str], bounds: Mapping[str, Any]) -> None:
    measured = [one.name for one in study.metrics]
    for name in columns:
        if name.partition(".")[0] not in measured and name not in study.variables:
            problem = diagnose("study-does-not-measure", column=name, known=measured)
            raise ConfigurationError("minimise, maximise, subject_to", problem)
    for name, pair in bounds.items():
        if not isinstance(pair, tuple | list) or len(pair) != 2 or pair == (None, None):
            problem = diagnose("no-pair-of-bounds", name=name, given=repr(pair))
            raise ConfigurationError("subject_to", problem)
    for name, variable in study.variables.items():
        if isinstance(variable, Normal):
            raise ConfigurationError(f"vary[{name!r}]", diagnose("normal-has-no-ends"))


def _violations(row: Mapping[str, Any], bounds: Mapping[str, Bounds]) -> list[float]:
    """Returns how far a design is beyond each bound: <= 0 if it keeps to it."""
    found = []
    for name, (least, greatest) in bounds.items():
        value = float(row[name])
        if least is not None:
            found.append(least - value)
        if greatest is not None:
            found.append(value - greatest)
    return found


def _kept(table: pd.DataFrame, bounds: Mapping[str, Bounds]) -> list[bool]:
    rows = table[list(bounds)].to_dict("records")
    return [
        all(size <= 0 for size in _violations({str(n): v for n, v in row.items()}, bounds))
        for row in rows
    ]


class _Search:
    """Optuna's side: it proposes designs, and is told what came of them."""

    def __init__(
        self,
        variables: Mapping[str, Variable],
        objectives: Mapping[str, str],
        bounds: Mapping[str, Bounds],
        seed: int,
    ) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._optuna, self.variables = optuna, variables
        self.objectives, self.bounds = objectives, bounds
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that its options are experimental
            sampler = optuna.samplers.TPESampler(
                seed=seed % 2**32, multivariate=True, constraints_func=self._constraints
            )
        senses = {"min": "minimize", "max": "maximize"}
        self._study = optuna.create_study(
            sampler=sampler, directions=[senses[sense] for sense in objectives.values()]
        )
        self._asked: list[Any] = []

    @staticmethod
    def _constraints(trial: Any) -> Sequence[float]:
        found: Sequence[float] = trial.user_attrs.get("violations", (0.0,))
        return found

    def ask(self, count: int) -> list[dict[str, float]]:
        """Returns the numbers of some designs."""
        self._asked = [self._study.ask() for _ in range(count)]
        return [self._numbers(trial) for trial in self._asked]

    def _numbers(self, trial: Any) -> dict[str, float]:
        found = {}
        for name, variable in self.variables.items():
            if variable.levels is not None:
                ordered = sorted(variable.levels)
                found[name] = ordered[trial.suggest_int(name, 0, len(ordered) - 1)]
            else:
                low, high = variable.range
                log = isinstance(variable, LogUniform)
                found[name] = trial.suggest_float(name, low, high, log=log)
        return found

    def tell(self, table: pd.DataFrame, points: np.ndarray[Any, Any]) -> None:
        """Takes what came of the designs that were asked for last."""
        rows = {
            tuple(row[name] for name in self.variables): row for row in table.to_dict("records")
        }
        for trial, point in zip(self._asked, points.tolist(), strict=True):
            row = rows[tuple(point)]
            values = [float(row.get(name, np.nan)) for name in self.objectives]
            violations = _violations({n: row.get(n, np.nan) for n in self.bounds}, self.bounds)
            if not np.isfinite([*values, *violations]).all():
                self._study.tell(trial, state=self._optuna.trial.TrialState.FAIL)
                continue
            trial.set_user_attr("violations", violations or [0.0])
            self._study.tell(trial, values)
