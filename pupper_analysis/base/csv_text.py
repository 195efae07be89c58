"""CSV text of tables, in which texts that spreadsheets may execute as formulas are marked.

A text gets a leading apostrophe if it begins with a character of `_FORMULA_START`. Texts that
Python can convert to a float, such as "-1.5", are not changed.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from typing import Final

_FORMULA_START: Final = re.compile("[=+\\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
"""Pattern of the first character of a text that spreadsheets may execute as a formula. The last
four characters are full-width forms (OWASP, CSV Injection)."""

_TEXT_MARK: Final = "'"
"""Apostrophe at the start of a cell, with which spreadsheets display the cell as text."""


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Format rows as CSV, one record per row, and mark texts that spreadsheets may execute.

    A text that a spreadsheet may execute as a formula gets a leading apostrophe. Numbers, also as
    text, stay unchanged: ``-0.1``.
    """
    return "".join(map(_format_record, rows))


def _format_record(row: Iterable[object]) -> str:
    """Format a row as one record of CSV, with a line feed at the end."""
    text = io.StringIO(newline="")
    # Some versions of Python quote a carriage return only if the line terminator contains one.
    csv.writer(text, lineterminator="\r\n").writerow([_escape_formula(cell) for cell in row])
    return text.getvalue().removesuffix("\r\n") + "\n"


def cell_text(cell: str) -> str:
    """Return the text of a cell that ``csv_text`` wrote, without the added apostrophe.

    An apostrophe before a formula character in the original text is removed, too.
    """
    if cell.startswith(_TEXT_MARK) and _FORMULA_START.match(cell, len(_TEXT_MARK)):
        return cell[len(_TEXT_MARK) :]
    return cell


def _escape_formula(cell: object) -> object:
    """Prefix an apostrophe to a text that a spreadsheet would execute as a formula."""
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
