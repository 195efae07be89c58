"""CSV text of tables. Spreadsheets never execute a cell of this text as a formula."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from typing import Final

_FORMULA_START: Final = re.compile("[=+\\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
"""First characters of cells that spreadsheets may execute, with full-width forms (OWASP, CSV
Injection)."""

_TEXT_MARK: Final = "'"
"""Prefix by which spreadsheets take a cell as text."""


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as CSV, a line per row.

    A text that a spreadsheet would execute gets a leading apostrophe. Numbers, also as text, stay
    unchanged: ``-0.1``.
    """
    return "".join(map(_line, rows))


def _line(row: Iterable[object]) -> str:
    """Format a row as one line of CSV."""
    text = io.StringIO(newline="")
    # The writer quotes a carriage return only if its line terminator contains one.
    csv.writer(text, lineterminator="\r\n").writerow([_escape_formula(cell) for cell in row])
    return text.getvalue().removesuffix("\r\n") + "\n"


def cell_text(cell: str) -> str:
    """Return the text of a cell that ``csv_text`` wrote: without an added apostrophe."""
    if cell.startswith(_TEXT_MARK) and _FORMULA_START.match(cell, len(_TEXT_MARK)):
        return cell[len(_TEXT_MARK) :]
    return cell


def _escape_formula(cell: object) -> object:
    """Prefix a text that a spreadsheet would execute with an apostrophe; return other cells."""
    if isinstance(cell, str) and _FORMULA_START.match(cell) and not _is_float_text(cell):
        return _TEXT_MARK + cell
    return cell


def _is_float_text(text: str) -> bool:
    """Return True if Python can convert a text to a float."""
    try:
        float(text)
    except ValueError:
        return False
    return True
