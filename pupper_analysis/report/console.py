"""The console: tables and their titles."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich import markup
from rich.box import SIMPLE_HEAD
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from pupper_analysis.diagnostics import Diagnostic
from pupper_analysis.report.formats import visible

Array = NDArray[np.float64]

WIDTH = 120
"""Least width of the output: a narrow terminal wraps its lines, but no number is cut off."""

_UNBOUNDED = 10_000  # characters: more than any table of robots' names needs


def escape(text: object) -> str:
    """Returns what holds others' names as the console shows it: no markup, one line."""
    return str(markup.escape(visible(str(text))))


class SafeConsole(Console):
    """A console that shows what would act on the terminal (ESC, U+202E), and does not do it."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Returns what is shown of a text, its own lines apart."""
        return super().render_str("\n".join(map(visible, text.split("\n"))), **options)

    def print(self, *objects: Any, **options: Any) -> None:
        """Prints; a table as wide as it is, however long the names in it: no header is cut off."""
        before, unbounded = self.width, self.options.update(max_width=_UNBOUNDED)
        tables = [thing for thing in objects if isinstance(thing, Table)]
        wide = [self.measure(table, options=unbounded).maximum for table in tables]
        self.width = max(before, *wide, 0)
        try:
            super().print(*objects, **options)
        finally:
            self.width = before


class SafeTable(Table):
    """A table in whose cells a name is one line."""

    def add_row(self, *cells: RenderableType | None, **options: Any) -> None:
        """Adds a row."""
        shown = (visible(cell) if isinstance(cell, str) else cell for cell in cells)
        super().add_row(*shown, **options)


def console() -> Console:
    """Returns a console on standard output."""
    out = SafeConsole(highlight=False, emoji=False)
    out.width = max(WIDTH, out.width)
    return out


def print_notes(out: Console, notes: Iterable[Diagnostic | str]) -> None:
    """Prints what is to be known, a line each however long."""
    for note in notes:
        out.print(f"note: {escape(str(note))}", style="yellow", soft_wrap=True)


def titled_table(out: Console, title: str, *columns: str, left: int = 1) -> Table:
    """Prints a title; returns a table with ``left`` columns of text, the others of numbers."""
    out.print(f"\n{title}", style="bold")
    table = SafeTable(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, header_style="dim")
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index < left else "right", no_wrap=True)
    return table
