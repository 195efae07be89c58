"""The document of a study: what failed, the Pareto front, what matters."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from rich.progress import BarColumn, MofNCompleteColumn, Progress

from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text, word
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import page_of
from pupper_analysis.present.terminal import make_console
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.study.measures import METRICS, text_key
from pupper_analysis.tools.study.outcome import (
    StudyOutcome,
    find_column_unit,
    format_column_label,
)
from pupper_analysis.tools.study.write import WrittenDesign

if TYPE_CHECKING:
    import pandas as pd

    from pupper_analysis.tools.study.running import Progress as Done

_ALONE = "alone-the-variance"

MAX_TABLE_ROWS = 300
"""Of a table of designs: more than anyone reads, and pages stay small."""


_MOST_METRICS = 4
"""Metrics beside the objectives in a table of the front."""


@build_document.register(StudyOutcome)
def study_document(outcome: StudyOutcome, _: Robot | None = None) -> doc.Document:
    """Returns what is shown of a study; see ``build``."""
    failed = sum(one.designs for one in outcome.failures)
    counted = text("count-designs-of-which-failed", count=len(outcome.table), failed=failed)
    if outcome.failures:
        named = join_words(
            text("count-kind", count=one.designs, kind=word(one.kind)) for one in outcome.failures
        )
        counted = text("designs-kinds", designs=counted, kinds=named)
    finding: list[doc.Words] = [counted, *map(doc.tell, outcome.rests_on)]
    if outcome.converted:
        finding.append(text("study-from-one-file"))
    if len(outcome.table) < outcome.designs:
        left = outcome.designs - len(outcome.table)
        finding.append(text("count-more-are-not-measured", count=left))
    blocks = (_measured(outcome), *_failures(outcome), *_front(outcome),
              *_shares(outcome), _designs(outcome))  # fmt: skip
    return doc.Document(
        text("study-of-designs"), doc.Name(outcome.robot), blocks, findings=tuple(finding)
    )


def _left(name: str) -> doc.Column:
    return doc.Column(text(name), left=True)


def _right(name: str, unit: str = "") -> doc.Column:
    return doc.Column(text(name), unit)


def _measured(outcome: StudyOutcome) -> doc.Table:
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(format_column_label(one.metric)),
            *(doc.number_cell(value, ".5g") for value in (one.least, one.median, one.greatest)),
            doc.number_cell(one.designs, ".0f"),
        )
        for one in outcome.measured
    ]
    return doc.Table(
        text("what-was-measured"),
        (
            _left("metric"),
            *map(_right, ("least", "median", "greatest")),
            _right("designs", "1"),
        ),
        tuple(rows),
    )


def _failures(outcome: StudyOutcome) -> list[doc.Block]:
    if not outcome.failures:
        return []
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
            detail=True,
        )
    ]


def _front(outcome: StudyOutcome) -> list[doc.Block]:
    front, objectives = outcome.front, outcome.objectives
    if not objectives or front.empty:
        return []
    blocks: list[doc.Block] = []
    if len(objectives) == 2:
        across, up = (
            doc.Axis(doc.Name(f"{name}, {sense}"), find_column_unit(name), ".4g")
            for name, sense in objectives.items()
        )
        x, y = (front[name].to_numpy(float) for name in objectives)
        line = doc.Series(text("no-other-design-beats-these"), x, y, points=True)
        blocks.append(doc.LinePlot(text("designs-worth-building-the-front"), across, up, [line]))
    named = ", ".join(f"{name} ({sense})" for name, sense in objectives.items())
    title = text("designs-worth-building-no-other", objectives=named)
    others = [name for name in outcome.variables if name not in objectives]
    measured = [one.metric for one in outcome.measured if one.metric not in objectives]
    columns = [*objectives, *others, *measured[:_MOST_METRICS]]
    return [*blocks, _table(title, front, columns, outcome.table)]


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
    source = (page_of("explanation/studies.md", "Sensitivities"),)
    return [doc.Table(title, columns, tuple(rows), (text(_ALONE),), source, detail=True)]


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
    shown = table if len(table) <= MAX_TABLE_ROWS else table.head(MAX_TABLE_ROWS)
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
        *(doc.Column(doc.Name(name), find_column_unit(name)) for name in places),
    ]
    if failed:
        heads.append(_left("failure"))
    notes: tuple[doc.Words, ...] = ()
    if len(table) > MAX_TABLE_ROWS:
        left = len(table) - MAX_TABLE_ROWS
        notes = (text("count-more-are-in-the-studys", count=left),)
    return doc.Table(title, tuple(heads), tuple(rows), notes)


def format_duration(seconds: float) -> str:
    """Returns a time as people say it."""
    if not math.isfinite(seconds):
        return "-"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 7200:
        return f"{whole // 60} min"
    return f"{whole / 3600:.1f} h"


def _meaning_of(metric: str) -> doc.Words:
    """Return the meaning of a metric from the catalogue; without an entry, its name."""
    try:
        return text(text_key(metric))
    except KeyError:
        return doc.Name(metric)


def metrics_document() -> doc.Document:
    """Return the metrics of a study as a table: name, unit, meaning."""
    rows = tuple(
        (doc.Name(metric.name), doc.Name(metric.unit), _meaning_of(metric.name))
        for metric in METRICS.values()
    )
    columns = (_left("metric"), _left("unit"), _left("meaning"))
    table = doc.Table(text("what-can-be-measured"), columns, rows)
    return doc.Document(text("study-of-designs"), doc.Name("study"), (table,))


# Studies on a terminal: the bar while they run.


def written_document(written: WrittenDesign) -> doc.Document:
    """Returns what a design that was written is, and what is measured of its files."""
    rows = tuple(
        (
            doc.Name(format_column_label(name)),
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
            rate = f"{done.rate:.1f}/s, {format_duration(done.left)} left" if done.done else ""
            words = f"{rate} {format_failures(done.failures)}"
            there = done.there + done.done
            shown.update(task, total=done.total, completed=there, description=words)

        yield show


def format_failures(failures: Mapping[str, int]) -> str:
    """Returns failures by kind, the most frequent first."""
    ordered = sorted(failures.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{count} {kind}" for kind, count in ordered)
