"""The document of a study: what failed, the Pareto front, what matters."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from rich.progress import BarColumn, MofNCompleteColumn, Progress

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text, word
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import page_of
from pupper_analysis.present.terminal import make_console
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.study.measures import METRICS, text_key
from pupper_analysis.tools.study.outcome import (
    MetricSummary,
    StudyOutcome,
    column_label,
    metrics_in,
    pareto_front,
    standing_designs,
    unit_of,
)
from pupper_analysis.tools.study.plots import LINES, MeansPlot, front_plot, study_plots
from pupper_analysis.tools.study.study import Estimate
from pupper_analysis.tools.study.write import WrittenDesign

if TYPE_CHECKING:
    import pandas as pd

    from pupper_analysis.tools.study.running import Progress as Done

_ALONE = "alone-the-variance"

_PARTIAL = "of-the-designs"

MOST_ROWS = 300
"""Of a table of designs: more than anyone reads, and pages stay small."""


@build_document.register(StudyOutcome)
def study_document(outcome: StudyOutcome, _: Robot | None = None) -> doc.Document:
    """Returns what is shown of a study; see ``build``."""
    blocks: list[doc.Block] = [_variables(outcome), _measured(outcome)]
    blocks += _failures(outcome)
    blocks += _drawings(outcome)
    blocks += _front(outcome)
    blocks += _shares(outcome)
    blocks.append(_designs(outcome))
    failed = sum(one.designs for one in outcome.failures)
    finding: list[doc.Words] = [
        text("count-designs-of-which-failed", count=len(outcome.table), failed=failed)
    ]
    finding += map(doc.tell, outcome.rests_on)
    if outcome.converted:
        finding.append(text("study-from-one-file"))
    if len(outcome.table) < outcome.designs:
        left = outcome.designs - len(outcome.table)
        finding.append(text("count-more-are-not-measured", count=left))
    return doc.Document(
        text("study-of-designs"), doc.Name(outcome.robot), tuple(blocks), findings=tuple(finding)
    )


def _left(name: str) -> doc.Column:
    return doc.Column(text(name), left=True)


def _right(name: str, unit: str = "") -> doc.Column:
    return doc.Column(text(name), unit)


def _ranges() -> tuple[doc.Column, ...]:
    return *map(_right, ("least", "median", "greatest")), _right("designs", "1")


def _source() -> tuple[doc.Words, ...]:
    return (page_of("explanation/studies.md", "Sensitivities"),)


def _variables(outcome: StudyOutcome) -> doc.Table:
    rows: list[tuple[doc.Cell, ...]] = []
    for name, asked in outcome.variables.items():
        ((kind, numbers),) = asked.items()
        listed = _listed(kind, numbers)
        count = outcome.table[name].nunique() if name in outcome.table else 0
        rows.append(
            (
                doc.Name(column_label(name)),
                text(kind),
                doc.Name(listed),
                doc.number_cell(count, ".0f"),
            )
        )
    return doc.Table(
        text("what-varies"),
        (_left("number"), _left("how"), _left("range-or-values"), _right("different-values", "1")),
        tuple(rows),
        (),
        _source(),
    )


def _listed(kind: str, numbers: Sequence[float]) -> str:
    """Returns a variable's numbers; of evenly spaced ones the ends and how many."""
    if kind == "linspace":
        low, high, count = numbers
        return f"{low:g} … {high:g} ({count:g})"
    return ", ".join(f"{value:.5g}" for value in numbers)


def _measured(outcome: StudyOutcome) -> doc.Table:
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(one.metric),
            *(doc.number_cell(value, ".5g") for value in (one.least, one.median, one.greatest)),
            doc.number_cell(one.designs, ".0f"),
            doc.Name(one.unit),
            _meaning(one),
        )
        for one in outcome.measured
    ]
    return doc.Table(
        text("what-was-measured"),
        (_left("metric"), *_ranges(), _left("unit"), _left("meaning")),
        tuple(rows),
    )


def _meaning(one: MetricSummary) -> doc.Words:
    """Returns what a metric is: of one's own function what its docstring says."""
    name = one.metric.partition(".")[0]
    return text(text_key(name)) if name in METRICS else doc.Name(one.meaning)


def _failures(outcome: StudyOutcome) -> list[doc.Block]:
    if not outcome.failures:
        return [doc.Lines((text("no-design-failed"),))]
    rows: list[tuple[doc.Cell, ...]] = [
        (
            word(one.kind),
            doc.Name(one.metric or ""),
            doc.number_cell(one.designs, ".0f"),
            doc.Number(f"{one.share:.1%}", 100 * one.share, share=one.share),
            doc.Name(one.reason) if one.diagnostic is None else doc.tell(one.diagnostic),
        )
        for one in outcome.failures
    ]
    return [
        doc.Table(
            text("what-failed-by-kind"),
            (
                _left("failure"),
                _left("metric"),
                _right("designs", "1"),
                _right("share", "1"),
                _left("reason-of-the-first"),
            ),
            tuple(rows),
        )
    ]


def _drawings(outcome: StudyOutcome) -> Iterable[doc.Block]:
    """Yields the plots; below a metric's, what is missing in its means."""
    for shown in study_plots(outcome.table, tuple(outcome.variables), outcome.axes).values():
        yield from shown
        if any(isinstance(one, MeansPlot) and one.found.partial.any() for one in shown):
            yield doc.Lines((text(_PARTIAL),), "warn")


def _front(outcome: StudyOutcome) -> list[doc.Block]:
    front, objectives = outcome.front, outcome.objectives
    if not objectives or front.empty:
        return []
    blocks: list[doc.Block] = []
    if len(objectives) == 2:
        blocks.append(front_plot(standing_designs(outcome.table), front, objectives))
    blocks.append(_front_table(front, objectives, tuple(outcome.variables), outcome.table))
    return blocks


def _front_table(
    front: pd.DataFrame,
    objectives: Mapping[str, str],
    variables: Sequence[str],
    whole: pd.DataFrame,
) -> doc.Table:
    named = ", ".join(f"{name} ({sense})" for name, sense in objectives.items())
    title = text("designs-worth-building-no-other", objectives=named)
    others = [name for name in variables if name not in objectives]
    measured = [name for name in metrics_in(front, tuple(variables)) if name not in objectives]
    return _table(title, front, [*objectives, *others, *measured[:LINES]], whole)


def _shares(outcome: StudyOutcome) -> list[doc.Block]:
    rows: list[tuple[doc.Cell, ...]] = []
    for one in outcome.measured:
        measured = text("measured-of", count=one.designs, whole=outcome.designs)
        shares: list[tuple[doc.Text | doc.Name, float]] = [
            (doc.Name(name), alone) for name, alone in one.alone.items()
        ]
        if one.interaction is not None:
            shares.append((text("interaction"), one.interaction))
        rows += [(doc.Name(one.metric), name, _share(share), measured) for name, share in shares]
    if not rows:
        return []
    columns = (_left("metric"), _left("number"), _right("alone", "1"), _left("designs"))
    title = text("which-number-matters-shares")
    return [doc.Table(title, columns, tuple(rows), (text(_ALONE),), _source())]


def _share(value: float) -> doc.Number:
    if not math.isfinite(value):
        return doc.Number("-", math.nan)
    return doc.Number(f"{value:.1%}", 100 * value, share=min(max(value, 0.0), 1.0))


def _designs(outcome: StudyOutcome) -> doc.Table:
    measured = [one.metric for one in outcome.measured]
    columns = [*outcome.variables, *measured]
    return replace(_table(text("designs-title"), outcome.table, columns), detail=True)


def _table(
    title: doc.Words, table: pd.DataFrame, columns: Sequence[str], whole: pd.DataFrame | None = None
) -> doc.Table:
    """Returns rows of a study's table, with their numbers in the whole of it (``--write N``)."""
    whole = table if whole is None else whole
    numbers = {design: number for number, design in enumerate(whole["design"], start=1)}
    places = [name for name in columns if name in table]
    failed = "failure" in table and table["failure"].notna().any()
    rows: list[tuple[doc.Cell, ...]] = []
    shown = table if len(table) <= MOST_ROWS else table.head(MOST_ROWS)
    for _, row in shown.iterrows():
        cells: list[doc.Cell] = [doc.number_cell(numbers[row["design"]], "g")]
        for name in places:
            value = float(row[name])
            cells.append(doc.number_cell(value if math.isfinite(value) else None, ".5g"))
        if failed:
            kind = row["failure"]
            cells.append(word(kind) if isinstance(kind, str) else doc.Name(""))
        rows.append(tuple(cells))
    heads = [
        _right("ordinal", "1"),
        *(doc.Column(doc.Name(name), unit_of(name)) for name in places),
    ]
    if failed:
        heads.append(_left("failure"))
    notes: tuple[doc.Words, ...] = ()
    if len(table) > MOST_ROWS:
        left = len(table) - MOST_ROWS
        notes = (text("count-more-are-in-the-studys", count=left),)
    return doc.Table(title, tuple(heads), tuple(rows), notes)


@build_document.register(Estimate)
def estimate_document(
    expected: Estimate, _: Robot | None = None, workers: int | None = None
) -> doc.Document:
    """Returns what a study would take; see ``build``.

    Args:
        expected: The estimate.
        workers: On how many processes; by default as many as this machine has cores.
    """
    count = workers or os.cpu_count() or 1
    each, slowest = (f"{1e3 * one:.0f}" for one in (expected.seconds_each, expected.slowest))
    time = duration_text(expected.seconds(count))
    finding = [
        text("count-designs-of-which-there", count=expected.designs, there=expected.there),
        text("mean-ms-each-on-average", mean=each, slowest=slowest),
        text("about-time-on-count-workers", time=time, count=count),
    ]
    if expected.left_out:
        finding.append(text("not-timed", names=join_words(map(doc.Name, expected.left_out))))
    if expected.failures:
        kinds = join_words(map(word, expected.failures))
        finding.append(text("timed-that-failed", kinds=kinds))
    return doc.Document(
        text("study-of-designs"), text("estimate-title"), (), findings=tuple(finding)
    )


def duration_text(seconds: float) -> str:
    """Returns a time as people say it."""
    if not math.isfinite(seconds):
        return "-"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 7200:
        return f"{whole // 60} min"
    return f"{whole / 3600:.1f} h"


def measured_document(
    name: str,
    variables: Mapping[str, object],
    table: pd.DataFrame,
    rests_on: Sequence[Diagnostic] = (),
    objectives: Mapping[str, str] = MappingProxyType({}),
) -> doc.Document:
    """Returns the range of each metric, failures by kind, and the front if one is asked for.

    Args:
        name: What was studied.
        variables: Of the study, by name.
        table: Of the study.
        rests_on: What its stands rest on; see ``StudyOutcome``.
        objectives: {column: ``min`` or ``max``} of the front.
    """
    rows: list[tuple[doc.Cell, ...]] = []
    for metric in metrics_in(table, tuple(variables)):
        column = table[metric].dropna()
        ends = (column.min(), column.median(), column.max())
        numbers = (doc.number_cell(float(value), ".5g") for value in ends)
        rows.append((doc.Name(column_label(metric)), *numbers, doc.number_cell(len(column), ".0f")))
    measured = doc.Table(
        text("what-was-measured"),
        (_left("metric"), *_ranges()),
        tuple(rows),
    )
    kinds = table["failure"].dropna().value_counts()
    finding = text("count-designs-of-which-failed", count=len(table), failed=int(kinds.sum()))
    if len(kinds):
        named = join_words(
            text("count-kind", count=int(count), kind=word(str(kind)))
            for kind, count in kinds.items()
        )
        finding = text("designs-kinds", designs=finding, kinds=named)
    lines = (finding, *map(doc.tell, rests_on))
    blocks = [measured]
    if objectives:
        front = pareto_front(standing_designs(table), objectives)
        blocks.append(_front_table(front, objectives, tuple(variables), table))
    return doc.Document(text("study-of-designs"), doc.Name(name), tuple(blocks), findings=lines)


def metrics_document() -> doc.Document:
    """Returns what can be measured of a design: names, units, meanings."""
    rows = tuple(
        (doc.Name(one.name), doc.Name(one.unit), text(text_key(one.name)))
        for one in METRICS.values()
    )
    columns = (_left("metric"), _left("unit"), _left("meaning"))
    table = doc.Table(text("what-can-be-measured"), columns, rows)
    return doc.Document(text("study-of-designs"), doc.Name("study"), (table,))


# Studies on a terminal: the bar while they run.


def written_document(written: WrittenDesign) -> doc.Document:
    """Returns what a design that was written is, and what is measured of its files."""
    rows = tuple(
        (
            doc.Name(column_label(name)),
            doc.number_cell(value, ".6g"),
            doc.number_cell(written.found[name], ".6g"),
        )
        for name, value in written.measured.items()
    )
    columns = (_left("metric"), _right("measured-in-the-study"), _right("measured-of-the-files"))
    numbers = ", ".join(f"{name} {value:g}" for name, value in written.numbers.items())
    return doc.Document(
        text("design-written", number=written.number),
        text("design-of", number=written.number, numbers=doc.Name(numbers)),
        (doc.Table(text("what-was-measured"), columns, rows),),
        findings=(text("its-command", command=doc.Name(written.command)),),
        passed=written.passed,
        failures=tuple(map(doc.tell, written.failures)),
    )


@contextmanager
def progress_bar() -> Iterator[Callable[[Done], None]]:
    """Yields what shows how far a run has come: designs, rate, time left, failures by kind."""
    with Progress(
        "designs", BarColumn(), MofNCompleteColumn(), "{task.description}", console=make_console()
    ) as shown:
        task = shown.add_task("", total=None)

        def show(done: Done) -> None:
            rate = f"{done.rate:.1f}/s, {duration_text(done.left)} left" if done.done else ""
            words = f"{rate} {count_failures(done.failures)}"
            there = done.there + done.done
            shown.update(task, total=done.total, completed=there, description=words)

        yield show


def count_failures(failures: Mapping[str, int]) -> str:
    """Returns failures by kind, the most frequent first."""
    ordered = sorted(failures.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{count} {kind}" for kind, count in ordered)
