"""Studies on a terminal: the bar while they run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from pupper_analysis.present.terminal import make_console
from pupper_analysis.tools.study.document import duration_text

if TYPE_CHECKING:
    from pupper_analysis.tools.study.running import Progress as Done


@contextmanager
def progress_bar() -> Iterator[Callable[[Done], None]]:
    """Yields what shows how far a run has come: designs, rate, time left, failures by kind."""
    columns = (
        TextColumn("designs"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TextColumn("{task.fields[failures]}"),
    )
    with Progress(*columns, console=make_console()) as shown:
        task = shown.add_task("", total=None, rate="", failures="")

        def show(done: Done) -> None:
            rate = f"{done.rate:.1f}/s, {duration_text(done.left)} left" if done.done else ""
            shown.update(
                task,
                total=done.total,
                completed=done.there + done.done,
                rate=rate,
                failures=count_failures(done.failures),
            )

        yield show


def count_failures(failures: Mapping[str, int]) -> str:
    """Returns failures by kind, the most frequent first."""
    ordered = sorted(failures.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{count} {kind}" for kind, count in ordered)
