"""Outcome of a study: failures by kind, summary of each metric, main effects, Pareto front.

Input is the table of a study, a row per design; output is a `StudyOutcome`. No design is evaluated.
Main effects are eta squared for a full product of values, and epsilon squared for samples
(`compute_main_effects`).
"""

from __future__ import annotations

import contextlib
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import orjson
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_type, real_array
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import HINGE_UNITS, MIXED_UNITS
from pupper_analysis.prepare.own_run import own_run
from pupper_analysis.present.verdict import make_keyframe_run_clauses, make_servo_clause
from pupper_analysis.robot.joints import get_common_units
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import find_servos_used
from pupper_analysis.stance.fields import FIELDS
from pupper_analysis.tools.study.design import FAILURE_COLUMNS, FIELD_OF_VARIABLE, from_record
from pupper_analysis.tools.study.measures import METRICS
from pupper_analysis.tools.study.motors import is_motor_variable
from pupper_analysis.tools.study.parameters import (
    COM_OFFSET_KINDS,
    JOINT_STANCE_KINDS,
    LINK_STANCE_KINDS,
)
from pupper_analysis.tools.study.requirements import select_designs
from pupper_analysis.tools.study.store import Store, number_truth_values, require_library
from pupper_analysis.tools.study.study import Study, restore_truth_values

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Failures(Result):
    """Group of designs with the same kind of failure.

    Attributes:
        kind: Failure kind.
        metric: Metric that failed in the first design with this failure; None if the design could
            not be built, exceeded the time limit or ended the worker process.
        designs: Number of designs with this failure.
        share: Fraction of the stored designs of the study.
        reason: Reason for the first design with this failure, in English.
        diagnostic: Reason as a diagnostic; None if the stored record cannot be read, for example
            of an older version.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("kind", "designs")

    kind: str
    metric: str | None
    designs: int
    share: float = field(metadata={"unit": "1"})
    reason: str
    diagnostic: Diagnostic | None


@dataclass(frozen=True)
class MetricSummary(Result):
    """Range, median and main effects of a metric over all designs of a study.

    Attributes:
        metric: Column of the metric.
        unit: Unit; ``1`` for a ratio, empty for a function of the user.
        minimum: Smallest value.
        median: Median.
        maximum: Largest value.
        designs: Number of designs with a value.
        main_effects: {variable: fraction of the metric's variance due to this variable alone}, over
            the designs with a finite value. Empty for a column ``NAME.KEY``.
        interaction: Fraction of the metric's variance due to several variables together. None in
            these cases: samples, a column ``NAME.KEY``, fewer than two variables with several
            values, all main effects 0, or a design without a finite value.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("metric", "median")

    metric: str
    unit: str
    minimum: float = field(metadata={"unit": "varies"})
    median: float = field(metadata={"unit": "varies"})
    maximum: float = field(metadata={"unit": "varies"})
    designs: int
    main_effects: dict[str, float] = field(metadata={"unit": "1"})
    interaction: float | None = field(metadata={"unit": "1"})


@dataclass(frozen=True, eq=False)
class StudyOutcome(Result):
    """Results of a study: summaries of metrics, failures, and the Pareto front.

    Attributes:
        robot: Robot as named in the study.
        converted: Model that was generated from the other file, ``"urdf"`` or ``"mjcf"``; empty if
            both files exist.
        rests_on: Assumptions on which the stands depend: simulation of the published file, added
            servos.
        variables: {variable: values or distribution, as in the study file}.
        table: A row per stored design of the study, as `Study.run` returns.
        units: {variable or metric: unit in ``table``}; empty for ratios and factors.
        designs: Number of designs of the study.
        measured: Summary of each metric.
        failures: Failed designs by kind, the most frequent first.
        objectives: {column: ``min`` or ``max``} of the Pareto front; empty without a front.
        front: Designs on the Pareto front. Only designs that meet the requirements are considered
            and, if ``stands`` was measured, that stand.
        requirements: {requirement as text: number of designs that meet this requirement}.
        feasible: Number of designs that meet all requirements.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("designs", "feasible", "measured", "failures")

    robot: str
    converted: str
    rests_on: tuple[Diagnostic, ...]
    variables: dict[str, dict[str, Any]]
    table: pd.DataFrame
    units: dict[str, str]
    designs: int
    measured: tuple[MetricSummary, ...]
    failures: tuple[Failures, ...]
    objectives: dict[str, str]
    front: pd.DataFrame
    requirements: dict[str, int]
    feasible: int

    @property
    def varying_metrics(self) -> tuple[str, ...]:
        """Metrics with different values among the designs, in the order of ``measured``."""
        return tuple(
            summary.metric
            for summary in self.measured
            if summary.designs and summary.minimum < summary.maximum
        )

    @property
    def is_measured(self) -> bool:
        """Whether a stored design has no failure, or has a value of a metric despite a failure."""
        failed = sum(group.designs for group in self.failures)
        return failed < len(self.table) or any(metric.designs for metric in self.measured)


def study_outcome(
    study: Study,
    folder: str | Path,
    *,
    minimise: Sequence[str] = (),
    maximise: Sequence[str] = (),
) -> StudyOutcome:
    """Summarise the stored results of a study: metrics, failures, and Pareto front.

    Args:
        study: Study. No design is evaluated.
        folder: Folder of the results.
        minimise: Columns that the Pareto front minimises. If ``minimise`` and ``maximise`` are both
            empty, the objectives of the study are used.
        maximise: Columns that the Pareto front maximises.

    Raises:
        ConfigurationError: If a column does not exist, or no design is stored, for example.
        StudyError: If the folder contains no study, or a shard is damaged.
    """
    check_type("study", study, Study)
    check_type("minimise", minimise, Sequence[str])
    check_type("maximise", maximise, Sequence[str])
    require_library("pandas")
    Store(Path(folder)).read_request()  # raises StudyError if the folder contains no study
    table = study.stored_table(folder)
    if table.empty:
        finding = diagnose("study-has-no-design", folder=str(folder))
        raise ConfigurationError("folder", finding)
    variables = tuple(study.variables)
    metrics = list_metric_columns(table, variables)
    if not (minimise or maximise):
        minimise, maximise = study.minimise, study.maximise
    objectives = check_objectives(study, minimise, maximise)
    feasible = select_designs(table, study.requirements)
    spread_variables = list_spread_variables(table, variables)
    return StudyOutcome(
        robot=_format_source(study.source.to_dict()),
        converted=study.base.description.converted,
        rests_on=list_stand_assumptions(study.base),
        variables={name: variable.to_dict() for name, variable in study.variables.items()},
        table=restore_truth_values(table),
        units={name: find_column_unit(name, study.base) for name in (*variables, *metrics)},
        designs=len(study),
        measured=tuple(_summarise_metric(table, name, spread_variables, study) for name in metrics),
        failures=_group_failures(table),
        objectives=objectives,
        front=restore_truth_values(
            pareto_front(select_standing_designs(feasible), objectives)
            if objectives and set(objectives) <= set(table)  # no column if no design has a value
            else table.iloc[:0]
        ),
        requirements={item.text: int(item.is_met(table).sum()) for item in study.requirements},
        feasible=len(feasible),
    )


def list_stand_assumptions(robot: Robot) -> tuple[Diagnostic, ...]:
    """List the assumptions on which the simulated stands of a robot depend, as messages.

    For example, the messages state the result of a simulation of the published file from the
    keyframe.
    """
    messages = [clause.message for clause in make_keyframe_run_clauses(own_run(robot))]
    with contextlib.suppress(ModelError):  # a robot without servos, whose gains are variables
        servos = find_servos_used(robot)
        messages += [make_servo_clause(servos, good=True).message] if servos.made else []
    return tuple(messages)


def check_objectives(
    study: Study, minimise: Sequence[str], maximise: Sequence[str]
) -> dict[str, str]:
    """Check the objectives of a Pareto front, and return {column: ``min`` or ``max``}.

    Raises:
        ConfigurationError: If the study has no such metric or variable, the variable is a motor, or
            a column occurs twice.
    """
    measured = [metric.name for metric in study.metrics]
    numbers = [name for name in study.variables if not is_motor_variable(name)]
    for name in (*minimise, *maximise):
        if name.partition(".")[0] not in measured and name not in numbers:
            valid_names = (*measured, *numbers)
            finding = diagnose("study-has-no-such", column=name, known=valid_names)
            raise ConfigurationError("minimise, maximise", finding)
    objectives = {**dict.fromkeys(minimise, "min"), **dict.fromkeys(maximise, "max")}
    if len(objectives) < len(minimise) + len(maximise):
        raise ConfigurationError("minimise, maximise", diagnose("column-there-twice"))
    return objectives


def compute_main_effects(
    table: pd.DataFrame, variables: Iterable[str], metric: str, *, sampled: bool = True
) -> dict[str, float]:
    """Compute the fraction of a metric's variance due to each variable alone.

    For a full factorial (all combinations of lists of values), the fraction is eta squared: the
    variance of the group means of the metric, divided by the total variance. A group contains the
    designs with the same value of the variable.

    For samples, the fraction is epsilon squared, which corrects eta squared for the number of
    designs. If a variable has more than `MAX_VALUE_CELLS` different values, the groups are
    intervals of equal width. Designs without a finite value of the metric are left out.

    Source: Kelley, "An unbiased correlation ratio measure", 1935.

    Args:
        table: Table of a study.
        variables: Columns of the variables.
        metric: Column of the metric.
        sampled: True if the designs are samples, False for a full factorial.

    Returns:
        {variable: fraction}, at least 0; 0 for a constant metric. NaN if the samples of a metric
        that varies have as many groups as designs.
    """
    table = number_truth_values(table)
    measured_rows = table[np.isfinite(table[metric].to_numpy(float))]
    values = measured_rows[metric].to_numpy(float)
    varies = len(values) > 0 and measure_span(float(values.min()), float(values.max())) > 0
    total_squares = float(((values - values.mean()) ** 2).sum()) if varies else 0.0
    effects = {}
    for name in variables:
        levels = measured_rows[name]
        column = levels.to_numpy(float) if _is_numeric(levels) else _number_levels(levels)
        index = np.unique(_assign_cells(column) if sampled else column, return_inverse=True)[1]
        counts = np.bincount(index)
        degrees_of_freedom = len(values) - len(counts)
        if total_squares <= 0 or len(counts) < 2 or (sampled and degrees_of_freedom < 1):
            effects[name] = 0.0 if total_squares <= 0 or len(counts) < 2 else float("nan")
            continue
        means = np.bincount(index, values) / counts
        within_squares = float(((values - means[index]) ** 2).sum())
        within_fraction = (
            degrees_of_freedom / (len(values) - 1) if sampled else 1.0
        )  # expected fraction within cells, by chance
        effects[name] = max(0.0, 1 - within_squares / within_fraction / total_squares)
    return effects


def _is_numeric(column: pd.Series[Any]) -> bool:
    """Return True if a column contains numbers, not names of motors."""
    return bool(np.issubdtype(column.to_numpy().dtype, np.number))


def _number_levels(column: pd.Series[Any]) -> Array:
    """Return a number for each row of a column of names, shape (n,): equal for equal names."""
    return np.unique(column.to_numpy().astype(str), return_inverse=True)[1].astype(float)


def _summarise_metric(
    table: pd.DataFrame, name: str, spread: Sequence[str], study: Study
) -> MetricSummary:
    """Compute the smallest, median and largest value of a metric, and the main effects.

    ``name`` is the column of the metric; ``spread`` are the variables of the main effects.
    """
    column, sampled = table[name].dropna(), study.sampling.samples is not None
    main_effects = {} if "." in name else compute_main_effects(table, spread, name, sampled=sampled)
    num_finite = int(np.isfinite(column.to_numpy(float)).sum())
    is_complete = not sampled and num_finite == len(study) and len(main_effects) > 1
    metric_by_name = {entry.name: entry for entry in study.metrics}
    study_metric = metric_by_name[name if name in metric_by_name else name.partition(".")[0]]
    return MetricSummary(
        metric=name,
        unit=find_column_unit(name, study.base) or study_metric.unit,
        minimum=float(column.min()),
        median=float(column.median()),
        maximum=float(column.max()),
        designs=len(column),
        main_effects=main_effects,
        interaction=max(0.0, 1 - sum(main_effects.values()))
        if is_complete and any(main_effects.values())
        else None,
    )


def _group_failures(table: pd.DataFrame) -> tuple[Failures, ...]:
    """Return number, share and first reason of the failed designs, for each kind of failure."""
    groups = []
    for kind, count in table["failure"].value_counts().items():
        first = table[table["failure"] == kind].iloc[0]
        metric = first["failed_metric"] if isinstance(first["failed_metric"], str) else None
        share = float(count) / len(table)
        reason, diagnostic = str(first["reason"]), _read_diagnostic(first.get("diagnostic"))
        groups.append(Failures(str(kind), metric, int(count), share, reason, diagnostic))
    return tuple(groups)


def _read_diagnostic(cell: object) -> Diagnostic | None:
    """Return the diagnostic of a cell; None if the cell has no valid record of a known code."""
    try:
        return from_record(orjson.loads(cell)) if isinstance(cell, str) else None
    except (KeyError, ValueError):
        return None


def _format_source(source: Any) -> str:
    """Describe a study's robot source in a line: variant and scale factors, or file names."""
    if not isinstance(source, Mapping):
        return reprlib.repr(source)
    if "base" in source:
        scales = [
            f"{key} {value:g}" for key, value in source.items() if key != "base" and value != 1.0
        ]
        return ", ".join([str(source["base"]), *scales])
    paths = (source[name] for name in ("urdf", "mjcf") if name in source)
    return ", ".join(Path(file).name for file in (*source.get("models", ()), *paths))


OBJECTIVE_SIGNS = {"min": 1.0, "max": -1.0}
"""{``min`` or ``max``: factor that converts the values of a column to costs that are minimised}."""


def pareto_front(table: pd.DataFrame, objectives: Mapping[str, str]) -> pd.DataFrame:
    """Select the designs on the Pareto front: the designs that no other design dominates.

    Design A dominates design B if A is at least as good in all objectives, and better in an
    objective.

    Args:
        table: Table of a study, a row per design. Designs without a value of an objective are left
            out.
        objectives: {column: ``"min"`` or ``"max"``}.

    Returns:
        Rows of the front, sorted by the first objective, the best first.

    Raises:
        ConfigurationError: If a column does not exist, or there are no objectives, for example.
    """
    if not hasattr(table, "columns"):
        raise ConfigurationError("table", diagnose("no-table", given=reprlib.repr(table)))
    check_type("objectives", objectives, Mapping[str, str])
    for name, sense in objectives.items():
        if name not in table or sense not in OBJECTIVE_SIGNS:
            columns_of_table = map(str, table.columns)
            problem = diagnose(
                "no-column-to-optimise", column=name, sense=sense, known=columns_of_table
            )
            raise ConfigurationError("objectives", problem)
    if not objectives:
        raise ConfigurationError("objectives", diagnose("no-objectives"))
    complete_rows = table.dropna(subset=list(objectives))
    numbers = number_truth_values(complete_rows)
    columns = []
    for name, sense in objectives.items():
        columns.append(
            OBJECTIVE_SIGNS[sense] * real_array(f"column {name!r}", numbers[name].to_numpy())
        )
    costs = np.column_stack(columns)
    best = complete_rows[_find_unbeaten(costs)]
    first, sense = next(iter(objectives.items()))
    front: pd.DataFrame = best.sort_values(first, ascending=sense == "min", kind="stable")
    return front.reset_index(drop=True)


def _find_unbeaten(costs: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask of the rows of the costs (n, m) that no other row dominates (Pareto front).

    In lexicographic order only an earlier row can dominate a later row. Comparing with the rows of
    the front is sufficient.
    """
    order = np.lexsort(costs.T[::-1])
    front: list[int] = []
    for index in order:
        front_costs = costs[front]
        beats = (front_costs <= costs[index]).all(axis=1) & (front_costs < costs[index]).any(axis=1)
        if not beats.any():
            front.append(int(index))
    is_unbeaten = np.zeros(len(costs), bool)
    is_unbeaten[front] = True
    return is_unbeaten


MAX_VALUE_CELLS, MIN_CELLS, DESIGNS_PER_CELL = 24, 4, 3
"""Sizes of the groups (cells) into which main effects divide the values of a sampled variable. A
value is a cell; more than `MAX_VALUE_CELLS` values are divided into intervals, whose number is
sqrt(n / `DESIGNS_PER_CELL`) for n designs, within `MIN_CELLS` and `MAX_VALUE_CELLS`. Chosen, not
tuned.
"""

ROUNDING_RTOL = 1e-9
"""Relative tolerance up to which both ends of a range count as equal (rounding). Chosen, not tuned.
"""


def _assign_cells(values: Array) -> Array:
    """Return the group (cell) of each of n values, shape (n,): the value or an interval's index."""
    levels = np.unique(values)
    if len(levels) <= MAX_VALUE_CELLS:
        return values
    count = int(np.clip(np.sqrt(len(values) / DESIGNS_PER_CELL), MIN_CELLS, MAX_VALUE_CELLS))
    edges = np.linspace(levels[0], levels[-1], count + 1)
    cells: Array = np.clip(np.searchsorted(edges, values, "right") - 1, 0, count - 1)
    return cells


def find_column_unit(column: str, robot: Robot) -> str:
    """Return the unit of a column of a study's table (metric or variable), for reports.

    The result is empty for ratios, factors and functions of the user. The unit of torques and
    stiffnesses depends on the type of the joints.
    """
    joint = column.partition(".")[2]
    joints = (joint,) if joint in robot.joint_names else robot.joint_names
    quantity = _QUANTITIES.get(unit := _find_stated_unit(column))
    return unit if quantity is None else str(getattr(get_common_units(robot, joints), quantity))


_QUANTITIES = {
    asdict(units)[quantity]: quantity
    for units in (HINGE_UNITS, MIXED_UNITS)
    for quantity in ("effort", "stiffness", "damping")
}
"""{stated unit of a metric or variable: field of ``JointUnits``}, for units that depend on the
joints.
"""


def _find_stated_unit(column: str) -> str:
    """Return the unit of a column for any robot; empty for ratios and factors."""
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


def format_column_label(column: str, unit: str) -> str:
    """Format the label of a column of a study's table: name, and unit in parentheses if any."""
    return f"{column} ({unit})" if unit else column


def measure_span(low: float, high: float) -> float:
    """Return high - low; 0 if the difference is within rounding (`ROUNDING_RTOL`)."""
    return high - low if high - low > ROUNDING_RTOL * max(abs(low), abs(high)) else 0.0


def list_metric_columns(table: pd.DataFrame, variables: Sequence[str]) -> list[str]:
    """Return the metric columns of a study's table that are not empty."""
    other_columns = (*variables, "design", *FAILURE_COLUMNS)
    return [
        str(name)
        for name in table.columns
        if name not in other_columns and table[name].notna().any()
    ]


def list_spread_variables(table: pd.DataFrame, variables: Sequence[str]) -> list[str]:
    """Return the variables of a study with several values in a table, most values first."""
    spread = [name for name in variables if name in table and table[name].nunique() > 1]
    return sorted(spread, key=lambda name: -table[name].nunique())


def select_standing_designs(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of a study's table whose design stands.

    All rows are returned if the table has no column ``stands``.
    """
    return table[table["stands"] == 1] if "stands" in table else table
