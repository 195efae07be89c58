"""Documents of studies: failures, Pareto front, main effects, written designs.

Inputs are the outcome of a study or a written design; outputs are documents that are independent of
the output format, with values in printed units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress

from pupper_analysis.base.units import READ_IN
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text, word
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import cite_page
from pupper_analysis.present.terminal import make_console
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.study.measures import METRICS, text_key
from pupper_analysis.tools.study.outcome import (
    StudyOutcome,
    find_column_unit,
    format_column_label,
    pareto_front,
)
from pupper_analysis.tools.study.store import number_truth_values
from pupper_analysis.tools.study.write import WrittenDesign

if TYPE_CHECKING:
    import pandas as pd

    from pupper_analysis.tools.study.running import Progress as StudyProgress

_MAIN_EFFECT_NOTE = "alone-the-variance"
"""Key of the text that explains main effects, below the table of main effects."""

MAX_TABLE_ROWS = 300
"""Maximum number of rows in a table of designs. Bounds the size of a page. Chosen, not tuned."""


_MAX_FRONT_METRICS = 4
"""Maximum number of metrics, besides the objectives, in the table of the Pareto front. Chosen, not
tuned."""


@build_document.register(StudyOutcome)
def study_document(outcome: StudyOutcome, _: Robot | None = None) -> doc.Document:
    """Create the report of a study of robot designs."""
    failed = sum(group.designs for group in outcome.failures)
    standing = outcome.table.get("stands")
    count_text = text(
        "count-designs-of-which-failed",
        count=len(outcome.table),
        failed=failed,
        # The kinds of failures state whether the robot or the computation fails.
        standing=None if failed or standing is None else str(int((standing == 1).sum())),
    )
    if outcome.failures:
        kinds = join_words(
            text("count-kind", count=group.designs, kind=word(group.kind))
            for group in outcome.failures
        )
        count_text = text("designs-kinds", designs=count_text, kinds=kinds)
    findings: list[doc.Words] = [
        *_describe_best(outcome),
        count_text,
        *_describe_metric_range(outcome),
        *map(doc.diagnostic_text, outcome.rests_on),
    ]
    if outcome.converted:
        findings.append(text("study-from-one-file"))
    if len(outcome.table) < outcome.designs:
        remaining = outcome.designs - len(outcome.table)
        findings.append(text("count-more-are-not-measured", count=remaining))
    if not outcome.is_measured and outcome.failures:
        first = outcome.failures[0]
        reason = first.reason if first.diagnostic is None else doc.diagnostic_text(first.diagnostic)
        findings.insert(1, text("first-failed-design", reason=reason))
    blocks = (
        _make_metric_table(outcome),
        *_make_failure_table(outcome),
        *_make_front_blocks(outcome),
        *_make_effect_table(outcome),
        _make_design_table(outcome),
    )
    return doc.Document(
        text("study-of-designs"),
        doc.Name(outcome.robot),
        blocks,
        passed=outcome.is_measured,
        verdict=text("designs-measured" if outcome.is_measured else "no-design-measured"),
        findings=tuple(findings),
    )


def _describe_best(outcome: StudyOutcome) -> Iterator[doc.Words]:
    """Yield the number of designs that meet the requirements, and the best design."""
    single = len(outcome.objectives) == 1
    if not outcome.requirements and not single:
        return
    values = {
        "total": len(outcome.table),
        "requirements": join_words(map(doc.Name, outcome.requirements)),
        "count": outcome.feasible,
    }
    if not outcome.requirements and outcome.front.empty:
        return
    if not outcome.feasible:
        yield text("no-design-meets", **values)
        yield join_words(
            text("requirement-alone", requirement=doc.Name(name), count=count)
            for name, count in outcome.requirements.items()
        )
        return
    if not single or outcome.front.empty:
        yield text("designs-meet", **values)
        return
    (objective,) = outcome.objectives
    best = number_truth_values(outcome.front).iloc[0]
    number = 1 + list(outcome.table["design"]).index(best["design"])
    columns = [*outcome.variables, *(name for name in (objective,) if name in outcome.front)]
    yield text(
        "best-design" if outcome.requirements else "best-of-all",
        number=number,
        values=doc.Name(_format_design(best[list(dict.fromkeys(columns))], outcome.units)),
        **values,
    )
    if len(outcome.front) > 1:
        yield text(
            "best-designs-equal", count=len(outcome.front) - 1, objective=doc.Name(objective)
        )


def _describe_metric_range(outcome: StudyOutcome) -> Iterator[doc.Words]:
    """Yield the range of the first metric that varies, and the variables of the extreme designs."""
    if not outcome.varying_metrics:
        return
    metric = outcome.varying_metrics[0]
    values = number_truth_values(outcome.table)[metric].to_numpy(dtype=float)
    scale, unit = _find_shown_unit(metric, outcome.units)
    yield text(
        "range-of-metric",
        metric=doc.Name(metric),
        unit=doc.Name(f" {unit}" if unit else ""),
        least=f"{scale * np.nanmin(values):.4g}",
        greatest=f"{scale * np.nanmax(values):.4g}",
        at_least=_describe_extreme_designs(outcome, metric, "min"),
        at_greatest=_describe_extreme_designs(outcome, metric, "max"),
    )


def _describe_extreme_designs(outcome: StudyOutcome, metric: str, sense: str) -> doc.Text:
    """Return the variables of the designs with the smallest ("min") or largest value.

    A variable that differs among these designs is named with its number of values, or as ``any``.
    """
    rows = pareto_front(outcome.table, {metric: sense})
    counts = {name: rows[name].nunique() for name in outcome.variables}
    shared = [name for name, count in counts.items() if count == 1]
    varied = [
        text(
            "extreme-design-values",
            name=doc.Name(name),
            count=count,
            any=count == outcome.table[name].nunique(),
        )
        for name, count in counts.items()
        if count > 1
    ]
    values = [doc.Name(_format_design(rows.iloc[0][shared], outcome.units))] if shared else []
    return text(
        "extreme-design",
        values=join_words([*values, *varied]) if shared else "",
        count=len(rows),
    )


def _format_design(values: pd.Series[Any], units: Mapping[str, str]) -> str:
    """Return the values of a row as ``name value unit`` in shown units, separated by commas."""
    shown = []
    for name, value in values.items():
        scale, unit = _find_shown_unit(str(name), units)
        number = f"{scale * value:.4g}" if isinstance(value, float) else str(value)
        shown.append(f"{name} {number}{f' {unit}' if unit not in ('', '1') else ''}")
    return ", ".join(shown)


def _find_shown_unit(column: str, units: Mapping[str, str]) -> tuple[float, str]:
    """Return the factor and the unit with which tables and plots of a study show a column.

    ``units`` contains the unit of each column in the table.
    """
    unit = units.get(column, "")
    metric = METRICS.get(column.partition(".")[0])
    if metric is None:
        return 1.0, unit
    if metric.unit == "1" and "utilisation" in metric.name:
        return 100.0, "%"
    return READ_IN.get(unit, (1.0, unit))


def _format_shown_label(column: str, units: Mapping[str, str]) -> str:
    """Return the name of a metric, followed by the unit of printed values in parentheses."""
    return format_column_label(column, _find_shown_unit(column, units)[1])


def _text_column(name: str) -> doc.Column:
    """Return a left-aligned column of a table; ``name`` is the key of the heading."""
    return doc.Column(text(name), left=True)


def _number_column(name: str, unit: str = "") -> doc.Column:
    """Return a column of numbers; ``name`` is the key of the heading, ``unit`` may be empty."""
    return doc.Column(text(name), unit)


def _make_metric_table(outcome: StudyOutcome) -> doc.Table:
    """Create the table of metrics: smallest, median and largest value, and number of designs."""
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(_format_shown_label(summary.metric, outcome.units)),
            *(
                doc.number_cell(
                    value, ".5g", scale=_find_shown_unit(summary.metric, outcome.units)[0]
                )
                for value in (summary.minimum, summary.median, summary.maximum)
            ),
            doc.number_cell(summary.designs, ".0f"),
        )
        for summary in outcome.measured
    ]
    return doc.Table(
        text("what-was-measured"),
        (
            _text_column("metric"),
            *map(_number_column, ("least", "median", "greatest")),
            _number_column("designs", "1"),
        ),
        tuple(rows),
    )


def _make_failure_table(outcome: StudyOutcome) -> list[doc.Block]:
    """Create the table of the failures by kind; an empty list without failures."""
    if not outcome.failures:
        return []
    rows: list[tuple[doc.Cell, ...]] = [
        (
            word(group.kind),
            doc.Name(group.metric or ""),
            doc.number_cell(group.designs, ".0f"),
            doc.Number(f"{group.share:.1%}", 100 * group.share, bar_fraction=group.share),
            doc.Name(group.reason)
            if group.diagnostic is None
            else doc.diagnostic_text(group.diagnostic),
        )
        for group in outcome.failures
    ]
    return [
        doc.Table(
            text("what-failed-by-kind"),
            (
                _text_column("failure"),
                _text_column("metric"),
                _number_column("designs", "1"),
                _number_column("share", "1"),
                _text_column("reason-of-the-first"),
            ),
            tuple(rows),
            detail=True,
        )
    ]


def _make_front_blocks(outcome: StudyOutcome) -> list[doc.Block]:
    """Create the table of the Pareto front, preceded by a plot if there are two objectives."""
    front, objectives = outcome.front, outcome.objectives
    if not objectives or front.empty:
        return []
    blocks: list[doc.Block] = []
    if len(objectives) == 2:
        x_axis, y_axis = (
            doc.Axis(doc.Name(f"{name}, {sense}"), _find_shown_unit(name, outcome.units)[1], ".4g")
            for name, sense in objectives.items()
        )
        x, y = (
            _find_shown_unit(name, outcome.units)[0] * front[name].to_numpy(float)
            for name in objectives
        )
        line = doc.Series(text("no-other-design-beats-these"), x, y, points=True)
        blocks.append(
            doc.LinePlot(text("designs-worth-building-the-front"), x_axis, y_axis, [line])
        )
    objective_text = ", ".join(f"{name} ({sense})" for name, sense in objectives.items())
    title = text("designs-worth-building-no-other", objectives=objective_text)
    variables = [name for name in outcome.variables if name not in objectives]
    measured = [summary.metric for summary in outcome.measured if summary.metric not in objectives]
    columns = [*objectives, *variables, *measured[:_MAX_FRONT_METRICS]]
    return [*blocks, _make_row_table(title, front, columns, outcome)]


def _make_effect_table(outcome: StudyOutcome) -> list[doc.Block]:
    """Create the table of main effects; no block without main effects."""
    rows: list[tuple[doc.Cell, ...]] = []
    for summary in outcome.measured:
        measured = text("measured-of", count=summary.designs, whole=outcome.designs)
        shares: list[tuple[doc.Text | doc.Name, float]] = [
            (doc.Name(name), alone) for name, alone in summary.main_effects.items()
        ]
        if summary.interaction is not None:
            shares.append((text("interaction"), summary.interaction))
        rows += [
            (doc.Name(summary.metric), name, _format_share(share), measured)
            for name, share in shares
        ]
    if not rows:
        return []
    columns = (
        _text_column("metric"),
        _text_column("number"),
        _number_column("alone", "1"),
        _text_column("designs"),
    )
    title = text("which-number-matters-shares")
    source = (cite_page("explanation/studies.md", "Sensitivities"),)
    return [doc.Table(title, columns, tuple(rows), (text(_MAIN_EFFECT_NOTE),), source, detail=True)]


def _format_share(value: float) -> doc.Number:
    """Return a table cell of a fraction, 0 to 1, as a percentage with a bar; "-" if not finite."""
    if not math.isfinite(value):
        return doc.Number("-", math.nan)
    return doc.Number(f"{value:.1%}", 100 * value, bar_fraction=min(max(value, 0.0), 1.0))


def _make_metric_cell(value: float, form: str) -> doc.Number:
    """Return a table cell of a metric: "∞" for an infinite value, such as a time; "-" for NaN."""
    if math.isinf(value):
        return doc.Number("∞" if value > 0 else "-∞", math.nan)
    return doc.number_cell(None if math.isnan(value) else value, form)


def _make_design_table(outcome: StudyOutcome) -> doc.Table:
    """Create the table of the first `MAX_TABLE_ROWS` designs, with a note about other designs."""
    measured = [summary.metric for summary in outcome.measured]
    columns = [*outcome.variables, *measured]
    return replace(
        _make_row_table(text("designs-title"), outcome.table, columns, outcome), detail=True
    )


def _make_row_table(
    title: doc.Words,
    table: pd.DataFrame,
    columns: Sequence[str],
    outcome: StudyOutcome,
) -> doc.Table:
    """Create a table of some designs of a study, with given columns and design numbers.

    The first column is the row number of the design in the complete table of ``outcome``, as for
    ``--write``.
    """
    numbers = {design: number for number, design in enumerate(outcome.table["design"], start=1)}
    present_columns = [name for name in columns if name in table]
    has_failures = "failure" in table and table["failure"].notna().any()
    rows: list[tuple[doc.Cell, ...]] = []
    shown = number_truth_values(table.head(MAX_TABLE_ROWS))
    for _, row in shown.iterrows():
        cells: list[doc.Cell] = [doc.number_cell(numbers[row["design"]], "g")]
        for name in present_columns:
            if isinstance(row[name], str):  # the name of a motor
                cells.append(doc.Name(row[name]))
                continue
            value = _find_shown_unit(name, outcome.units)[0] * float(row[name])
            cells.append(_make_metric_cell(value, ".5g"))
        if has_failures:
            kind = row["failure"]
            cells.append(word(kind) if isinstance(kind, str) else doc.Name(""))
        rows.append(tuple(cells))
    header = [
        _number_column("ordinal", "1"),
        *(
            doc.Column(doc.Name(name), _find_shown_unit(name, outcome.units)[1])
            for name in present_columns
        ),
    ]
    if has_failures:
        header.append(_text_column("failure"))
    notes: tuple[doc.Words, ...] = ()
    if len(table) > MAX_TABLE_ROWS:
        remaining = len(table) - MAX_TABLE_ROWS
        notes = (text("count-more-are-in-the-studys", count=remaining),)
    return doc.Table(title, tuple(header), tuple(rows), notes)


def format_duration(seconds: float) -> str:
    """Format a duration [s] as text in s, min or h; "-" if not finite."""
    if not math.isfinite(seconds):
        return "-"
    rounded = round(seconds)
    if rounded < 120:
        return f"{rounded} s"
    if rounded < 7200:
        return f"{rounded // 60} min"
    return f"{rounded / 3600:.1f} h"


def _find_meaning(metric: str) -> doc.Words:
    """Return the meaning of a metric from the catalogue; without an entry, the name."""
    try:
        return text(text_key(metric))
    except KeyError:
        return doc.Name(metric)


def metrics_document() -> doc.Document:
    """Create the document that lists all named metrics: name, unit, meaning."""
    rows = tuple(
        (doc.Name(metric.name), doc.Name(metric.unit), _find_meaning(metric.name))
        for metric in METRICS.values()
    )
    columns = (_text_column("metric"), _text_column("unit"), _text_column("meaning"))
    table = doc.Table(text("what-can-be-measured"), columns, rows)
    return doc.Document(text("study-of-designs"), doc.Name("study"), (table,))


# Written designs, and the progress bar of a run.


def written_document(written: WrittenDesign, robot: Robot) -> doc.Document:
    """Create the report of a design of a study of ``robot`` that was written to files."""
    rows = tuple(
        (
            doc.Name(format_column_label(name, find_column_unit(name, robot))),
            _make_metric_cell(value, ".6g"),
            _make_metric_cell(written.file_values[name], ".6g"),
        )
        for name, value in written.study_values.items()
    )
    columns = (
        _text_column("metric"),
        _number_column("measured-in-the-study"),
        _number_column("measured-of-the-files"),
    )
    numbers = ", ".join(
        f"{name} {value if isinstance(value, str) else f'{value:g}'}"
        for name, value in written.numbers.items()
    )
    return doc.Document(
        text("design-written", number=written.number),
        text("design-of", number=written.number, numbers=doc.Name(numbers)),
        (doc.Table(text("what-was-measured"), columns, rows),),
        findings=(
            *map(doc.diagnostic_text, written.warnings),
            text("its-command", command=doc.Name(written.command)),
        ),
        passed=written.passed,
        failures=tuple(map(doc.diagnostic_text, written.failures)),
    )


@contextmanager
def progress_bar() -> Iterator[Callable[[StudyProgress], None]]:
    """Yield a function that displays progress: designs, rate, remaining time, failures by kind.

    The bar is on standard error, so that standard output contains the result only.
    """
    columns = "designs", BarColumn(), MofNCompleteColumn(), "{task.description}"
    with Progress(*columns, console=make_console(stderr=True)) as bar:
        task = bar.add_task("", total=None)

        def show(progress: StudyProgress) -> None:
            """Show rate, remaining time and failures of a study in the progress bar."""
            rate = (
                f"{progress.rate:.1f}/s, {format_duration(progress.remaining_time)} left"
                if progress.done
                else ""
            )
            words = f"{rate} {format_failures(progress.failures)}"
            completed = progress.num_stored + progress.done
            bar.update(task, total=progress.total, completed=completed, description=words)

        yield show


def format_failures(failures: Mapping[str, int]) -> str:
    """Format the numbers of failures, {kind: number}, as text, the most frequent kind first."""
    ordered = sorted(failures.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{kind} ({count})" for kind, count in ordered)
