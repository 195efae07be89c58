"""Studies in the terminal: the bar while they run, and what came of them."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from pupper_analysis.report.console import console, titled_table
from pupper_analysis.study.cells import labelled, measures_in

if TYPE_CHECKING:
    import pandas as pd

    from pupper_analysis.study.estimate import Estimate
    from pupper_analysis.study.running import Progress as Done
    from pupper_analysis.study.variables import Variable


@contextmanager
def bar() -> Iterator[Callable[[Done], None]]:
    """Yields what shows how far a run has come: designs, rate, time left, failures by kind."""
    columns = (
        TextColumn("designs"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TextColumn("{task.fields[failures]}"),
    )
    with Progress(*columns, console=console()) as shown:
        task = shown.add_task("", total=None, rate="", failures="")

        def show(done: Done) -> None:
            rate = f"{done.rate:.1f}/s, {duration(done.left)} left" if done.done else ""
            shown.update(
                task,
                total=done.total,
                completed=done.there + done.done,
                rate=rate,
                failures=counted(done.failures),
            )

        yield show


def counted(failures: Mapping[str, int]) -> str:
    """Returns failures by kind, the most frequent first."""
    ordered = sorted(failures.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{count} {kind}" for kind, count in ordered)


def duration(seconds: float) -> str:
    """Returns a time as people say it."""
    if not math.isfinite(seconds):
        return "-"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 7200:
        return f"{whole // 60} min"
    return f"{whole / 3600:.1f} h"


def print_estimate(out: Console, expected: Estimate, workers: int | None) -> None:
    """Prints what a study would take."""
    count = workers or os.cpu_count() or 1
    out.print(f"{expected.designs} designs, of which {expected.there} are there")
    out.print(
        f"{1e3 * expected.seconds_each:.0f} ms each on average of a few that were timed here, "
        f"{1e3 * expected.slowest:.0f} ms the slowest"
    )
    out.print(f"about {duration(expected.seconds(count))} on {count} workers")
    if expected.left_out:
        out.print(
            f"not imported, and so neither timed nor counted: {', '.join(expected.left_out)}, code "
            "that runs without --dry-run"
        )
    if expected.failures:
        out.print(f"of those that were timed some failed: {', '.join(expected.failures)}")


def print_summary(out: Console, variables: Mapping[str, Variable], table: pd.DataFrame) -> None:
    """Prints the range of each measure, and failures by kind."""
    shown = titled_table(out, "Measured", "measure", "least", "median", "greatest", "designs")
    for name in measures_in(table, tuple(variables)):
        column = table[name].dropna()
        numbers = (column.min(), column.median(), column.max())
        shown.add_row(labelled(name), *(f"{value:.5g}" for value in numbers), str(len(column)))
    out.print(shown)
    failed = table["failure"].dropna().value_counts().to_dict()
    text = counted({str(kind): int(count) for kind, count in failed.items()})
    out.print(f"{len(table)} designs" + (f"; failed: {text}" if text else ""))
