"""The console: tables and their titles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

Array = NDArray[np.float64]

WIDTH = 120
"""Least width of the output: a narrow terminal wraps its lines, but no number is cut off."""


def console() -> Console:
    """Returns a console on standard output."""
    out = Console(highlight=False)
    out.width = max(WIDTH, out.width)
    return out


def titled_table(out: Console, title: str, *columns: str, left: int = 1) -> Table:
    """Prints a title; returns a table with ``left`` columns of text, the others of numbers."""
    out.print(f"\n{title}", style="bold")
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, header_style="dim")
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index < left else "right", no_wrap=True)
    return table
