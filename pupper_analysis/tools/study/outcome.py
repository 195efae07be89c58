"""The results of a study, to be shown: failures, fronts, shares, maps."""

from __future__ import annotations

import contextlib
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import orjson
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_type, real_array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.base.results import Result
from pupper_analysis.prepare.own_run import own_run
from pupper_analysis.present.verdict import on_servos, own_clauses
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import servos_used
from pupper_analysis.stance.fields import FIELDS
from pupper_analysis.tools.study.design import FAILURE_COLUMNS, FIELD_OF_VARIABLE, from_record
from pupper_analysis.tools.study.measures import METRICS
from pupper_analysis.tools.study.parameters import (
    COM_OFFSET_KINDS,
    JOINT_STANCE_KINDS,
    LINK_STANCE_KINDS,
)
from pupper_analysis.tools.study.store import Store, require_library
from pupper_analysis.tools.study.study import Study

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Failures(Result):
    """Designs that failed alike.

    Attributes:
        kind: How.
        metric: In measuring what, the first of them; None if there is no such design to measure.
        designs: How many.
        share: Of all designs.
        reason: What the first of them says.
        diagnostic: The same as data; None in a folder of an older version.
    """

    kind: str
    metric: str | None
    designs: int
    share: float = field(metadata={"unit": "1"})
    reason: str
    diagnostic: Diagnostic | None


@dataclass(frozen=True)
class MetricSummary(Result):
    """What was measured, of all designs together.

    Attributes:
        metric: Its column.
        unit: Its unit; ``1`` of a ratio, empty of one's own functions.
        least: The least value.
        median: The median.
        greatest: The greatest.
        designs: Of how many it was measured.
        alone: {variable: share of its variance that the variable makes alone, among the designs of
            which it was measured}; empty of single joints.
        interaction: The share that they make only together, on the full product of lists; None of
            samples, and where not all designs were measured: shares overlap there.
    """

    metric: str
    unit: str
    least: float = field(metadata={"unit": "varies"})
    median: float = field(metadata={"unit": "varies"})
    greatest: float = field(metadata={"unit": "varies"})
    designs: int
    alone: dict[str, float] = field(metadata={"unit": "1"})
    interaction: float | None = field(metadata={"unit": "1"})


@dataclass(frozen=True, eq=False)
class StudyOutcome(Result):
    """The results of a study.

    Attributes:
        robot: Whose it is, as it was asked.
        converted: ``"urdf"`` or ``"mjcf"``: which of its models was made of the other one; empty if
            each has a file.
        rests_on: What its stands rest on: what its file does by itself, servos that were added.
        variables: {number: what it varies over, as a study's file says it}.
        table: One row per design that is there.
        designs: How many the study asks for.
        measured: What was measured.
        failures: What failed, the most frequent first.
        objectives: {column: ``min`` or ``max``} of the front; empty if there is none.
        front: The designs that no other beats in these, of those that stay up where that was
            measured.
    """

    robot: str
    converted: str
    rests_on: tuple[Diagnostic, ...]
    variables: dict[str, dict[str, Any]]
    table: pd.DataFrame
    designs: int
    measured: tuple[MetricSummary, ...]
    failures: tuple[Failures, ...]
    objectives: dict[str, str]
    front: pd.DataFrame


def study_outcome(
    study: Study,
    folder: str | Path,
    *,
    minimise: Sequence[str] = (),
    maximise: Sequence[str] = (),
) -> StudyOutcome:
    """Collects the results of a study; nothing is run.

    Args:
        study: The study.
        folder: Where its results are.
        minimise: Columns in which the designs of the front are least.
        maximise: Columns in which they are greatest. If neither is given, there is no front.

    Raises:
        ConfigurationError: If a column is not there, or no design is.
        StudyError: If the folder is no study's, or damaged.
    """
    check_type("study", study, Study)
    check_type("minimise", minimise, Sequence[str])
    check_type("maximise", maximise, Sequence[str])
    require_library("pandas")
    Store(Path(folder)).read_request()  # that it is a study's folder
    table = study.table(folder)
    if table.empty:
        finding = diagnose("study-has-no-design", folder=str(folder))
        raise ConfigurationError("folder", finding)
    variables = tuple(study.variables)
    metrics = list_metric_columns(table, variables)
    objectives = check_objectives(study, minimise, maximise)
    spread = list_spread_variables(table, variables)
    return StudyOutcome(
        robot=_named(study.source.asked()),
        converted=study.base.description.converted,
        rests_on=list_stand_assumptions(study.base),
        variables={name: one.to_dict() for name, one in study.variables.items()},
        table=table,
        designs=len(study),
        measured=tuple(_measured(table, name, spread, study) for name in metrics),
        failures=_failures(table),
        objectives=objectives,
        front=pareto_front(select_standing_designs(table), objectives)
        if objectives
        else table.iloc[:0],
    )


def list_stand_assumptions(robot: Robot) -> tuple[Diagnostic, ...]:
    """Returns what stands of a robot rest on; see ``StudyOutcome``."""
    finding = [clause.message for clause in own_clauses(own_run(robot))]
    with contextlib.suppress(ModelError):  # without servos gains are given
        servos = servos_used(robot)
        finding += [on_servos(servos, good=True).message] if servos.made else []
    return tuple(finding)


def check_objectives(
    study: Study, minimise: Sequence[str], maximise: Sequence[str]
) -> dict[str, str]:
    """Returns {column: ``min`` or ``max``} of a front; none if none are asked for.

    Raises:
        ConfigurationError: If the study has no such metric or number, or one is there twice.
    """
    measured = [one.name for one in study.metrics]
    for name in (*minimise, *maximise):
        if name.partition(".")[0] not in measured and name not in study.variables:
            known = (*measured, *study.variables)
            finding = diagnose("study-has-no-such", column=name, known=known)
            raise ConfigurationError("minimise, maximise", finding)
    objectives = {**dict.fromkeys(minimise, "min"), **dict.fromkeys(maximise, "max")}
    if len(objectives) < len(minimise) + len(maximise):
        raise ConfigurationError("minimise, maximise", diagnose("column-there-twice"))
    return objectives


def compute_main_effects(
    table: pd.DataFrame, variables: Iterable[str], metric: str, *, sampled: bool = True
) -> dict[str, float]:
    """Returns what share of a metric's variance each variable makes alone, in some designs.

    That is the variance of the means over the variable's values, in parts of the whole variance. On
    the full product of lists it is so as it stands (eta squared): with every design measured these
    are the main effects, and what they leave of 1 is made by several variables together. Of samples
    it is without what chance makes of so few designs (Kelley's epsilon squared), over cells of
    values. Designs of which the metric was not measured are left out.

    Source: Kelley, "An unbiased correlation ratio measure", 1935.

    Args:
        table: Of a study.
        variables: Columns.
        metric: A column.
        sampled: Whether the designs are samples, and not the full product of lists.
    """
    known = table[np.isfinite(table[metric].to_numpy(float))]
    values = known[metric].to_numpy(float)
    varies = len(values) > 0 and measure_span(float(values.min()), float(values.max())) > 0
    whole = float(((values - values.mean()) ** 2).sum()) if varies else 0.0
    found = {}
    for name in variables:
        column = known[name].to_numpy(float)
        index = np.unique(_cells(column) if sampled else column, return_inverse=True)[1]
        counts = np.bincount(index)
        free = len(values) - len(counts)
        if whole <= 0 or len(counts) < 2 or (sampled and free < 1):
            found[name] = 0.0 if whole <= 0 or len(counts) < 2 else float("nan")
            continue
        means = np.bincount(index, values) / counts
        within = float(((values - means[index]) ** 2).sum())
        least = free / (len(values) - 1) if sampled else 1.0  # of the whole: what chance leaves
        found[name] = max(0.0, 1 - within / least / whole)
    return found


def _measured(table: pd.DataFrame, name: str, spread: Sequence[str], study: Study) -> MetricSummary:
    column, sampled = table[name].dropna(), study.sampling.samples is not None
    alone = {} if "." in name else compute_main_effects(table, spread, name, sampled=sampled)
    whole = not sampled and len(column) == len(study) and len(alone) > 1
    own = {one.name: one for one in study.metrics}
    kind = own[name if name in own else name.partition(".")[0]]
    return MetricSummary(
        metric=name,
        unit=kind.unit,
        least=float(column.min()),
        median=float(column.median()),
        greatest=float(column.max()),
        designs=len(column),
        alone=alone,
        interaction=max(0.0, 1 - sum(alone.values())) if whole and any(alone.values()) else None,
    )


def _failures(table: pd.DataFrame) -> tuple[Failures, ...]:
    found = []
    for kind, count in table["failure"].value_counts().items():
        first = table[table["failure"] == kind].iloc[0]
        metric = first["failed_metric"] if isinstance(first["failed_metric"], str) else None
        share = float(count) / len(table)
        reason, finding = str(first["reason"]), _read_diagnostic(first.get("diagnostic"))
        found.append(Failures(str(kind), metric, int(count), share, reason, finding))
    return tuple(found)


def _read_diagnostic(kept: object) -> Diagnostic | None:
    """Returns the diagnostic of a cell; None where it has none, or one whose code is gone."""
    try:
        return from_record(orjson.loads(kept)) if isinstance(kept, str) else None
    except (KeyError, ValueError):
        return None


def _named(source: Any) -> str:
    """Returns a robot in a line: its base and scales, or its files' names."""
    if not isinstance(source, Mapping):
        return reprlib.repr(source)
    if "base" in source:
        scales = [f"{n} {v:g}" for n, v in source.items() if n != "base" and v != 1.0]
        return ", ".join([str(source["base"]), *scales])
    named = (source[name] for name in ("urdf", "mjcf") if name in source)
    return ", ".join(Path(file).name for file in (*source.get("models", ()), *named))


OBJECTIVE_SIGNS = {"min": 1.0, "max": -1.0}


def pareto_front(table: pd.DataFrame, objectives: Mapping[str, str]) -> pd.DataFrame:
    """Returns the designs that no other beats: none is as good in all objectives, better in one.

    Args:
        table: Of a study. Designs without a value of an objective count as beaten.
        objectives: {column: ``"min"`` or ``"max"``}.

    Returns:
        Their rows, sorted by the first objective, the best first.

    Raises:
        ConfigurationError: If a column is not there, or a sense is neither.
    """
    if not hasattr(table, "columns"):
        raise ConfigurationError("table", diagnose("no-table", given=reprlib.repr(table)))
    check_type("objectives", objectives, Mapping[str, str])
    for name, sense in objectives.items():
        if name not in table or sense not in OBJECTIVE_SIGNS:
            known = map(str, table.columns)
            problem = diagnose("no-column-to-optimise", column=name, sense=sense, known=known)
            raise ConfigurationError("objectives", problem)
    if not objectives:
        raise ConfigurationError("objectives", diagnose("no-objectives"))
    whole = table.dropna(subset=list(objectives))
    columns = []
    for name, sense in objectives.items():
        columns.append(
            OBJECTIVE_SIGNS[sense] * real_array(f"column {name!r}", whole[name].to_numpy())
        )
    costs = np.column_stack(columns)
    best = whole[_unbeaten(costs)]
    first, sense = next(iter(objectives.items()))
    front: pd.DataFrame = best.sort_values(first, ascending=sense == "min", kind="stable")
    return front.reset_index(drop=True)


def _unbeaten(costs: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tells which rows of costs (n, m) no other row beats.

    Rows are looked at in the order of their first cost: only an earlier one can beat a later one,
    and only one that is unbeaten itself need be looked at.
    """
    order = np.lexsort(costs.T[::-1])
    front: list[int] = []
    for index in order:
        held = costs[front]
        beats = (held <= costs[index]).all(axis=1) & (held < costs[index]).any(axis=1)
        if not beats.any():
            front.append(int(index))
    found = np.zeros(len(costs), bool)
    found[front] = True
    return found


MAX_VALUE_CELLS, MIN_CELLS, DESIGNS_PER_CELL = 24, 4, 3
"""Values of a sampled variable that are cells of their own; of more, fewest cells, and how many
designs each has on average."""

ROUNDING_RTOL = 1e-9
"""Relative: what differs by less differs by rounding."""


def _cells(values: Array) -> Array:
    """Returns in which cell each value is: one per value, or evenly wide ones of many."""
    levels = np.unique(values)
    if len(levels) <= MAX_VALUE_CELLS:
        return values
    count = int(np.clip(np.sqrt(len(values) / DESIGNS_PER_CELL), MIN_CELLS, MAX_VALUE_CELLS))
    edges = np.linspace(levels[0], levels[-1], count + 1)
    found: Array = np.clip(np.searchsorted(edges, values, "right") - 1, 0, count - 1)
    return found


def find_column_unit(column: str) -> str:
    """Returns the unit of a metric or of a number that varies; empty of ratios and factors."""
    if column.partition(":")[0] in COM_OFFSET_KINDS:
        return "m"
    if column.partition(":")[0] in (*JOINT_STANCE_KINDS, *LINK_STANCE_KINDS):
        return FIELDS[column.partition(":")[0]].unit
    metric = METRICS.get(column.partition(".")[0])
    unit = (
        metric.unit
        if metric
        else FIELD_OF_VARIABLE[column].unit
        if column in FIELD_OF_VARIABLE
        else ""
    )
    return "" if unit in ("1", "-") else unit


def format_column_label(column: str) -> str:
    """Returns the name of a metric or of a number that varies, with its unit."""
    unit = find_column_unit(column)
    return f"{column} ({unit})" if unit else column


def measure_span(low: float, high: float) -> float:
    """Returns how far apart two values are; 0 if they are the same but for rounding."""
    return high - low if high - low > ROUNDING_RTOL * max(abs(low), abs(high)) else 0.0


def list_metric_columns(table: pd.DataFrame, variables: Sequence[str]) -> list[str]:
    """Returns the columns of a study's table with metrics, of which something was measured."""
    given = (*variables, "design", *FAILURE_COLUMNS)
    return [str(name) for name in table.columns if name not in given and table[name].notna().any()]


def list_spread_variables(table: pd.DataFrame, variables: Sequence[str]) -> list[str]:
    """Returns the variables with several values in a table, those of most values first."""
    several = [name for name in variables if name in table and table[name].nunique() > 1]
    return sorted(several, key=lambda name: -table[name].nunique())


def select_standing_designs(table: pd.DataFrame) -> pd.DataFrame:
    """Returns the designs that stay up, or all where that was not measured."""
    return table[table["stands"] == 1] if "stands" in table else table
