"""Results are shown as golden documents have it, and each cell is the same on a page.

``golden/*.md`` are documents of results whose numbers are all different (``stubs``), as Markdown:
what a change of a builder changes is read in their diff.
``python -m tests.present.test_documents`` writes them anew.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import pytest

from pupper_analysis.present.document import Cell, Column, Number, Report, Table, in_english
from pupper_analysis.present.html.write import render_page
from pupper_analysis.present.markdown import write_markdown
from tests.support.html_page import Page
from tests.support.repository import ROOT
from tests.support.stubs import REPORTS

GOLDEN = ROOT / "tests" / "golden"

Rows = list[dict[str, str]]


@cache
def report(name: str) -> Report:
    return REPORTS[name]()


def tables(shown: Report) -> list[Table]:
    blocks = [*shown.overview, *(block for one in shown.documents for block in one.blocks)]
    return [block for block in blocks if isinstance(block, Table)]


def header(column: Column) -> str:
    unit = {"": "", "1": " (–)"}.get(column.unit, f" ({column.unit})")
    return f"{in_english(column.name)}{unit}"


def plain(cell: Cell) -> str:
    return cell.text if isinstance(cell, Number) else in_english(cell)


def said(table: Table) -> Rows:
    """{header with unit: cell} of each row, as the document has it."""
    heads = [header(column) for column in table.columns]
    return [dict(zip(heads, map(plain, row), strict=True)) for row in table.rows]


def without_lines(rows: Rows) -> list[list[str]]:
    """What is in each row: headers and cells without what is broken into lines."""
    return [[" ".join(one.split()).replace(" (–)", "") for one in (*row, *row.values())]
            for row in rows]  # fmt: skip


@pytest.mark.parametrize("name", REPORTS)
def test_documents_are_the_golden_ones(name: str) -> None:
    assert write_markdown(report(name)) == (GOLDEN / f"{name}.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", REPORTS)
def test_cells_of_a_page_are_the_documents(name: str) -> None:
    """Each in its column, under its name and unit; a terminal's: ``test_terminal.py``."""
    expected = [without_lines(said(table)) for table in tables(report(name))]
    assert expected
    read = [without_lines(rows) for rows in Page(render_page(report(name))).every_table()]
    assert read == expected


def write(names: Iterable[str]) -> None:
    """Writes the golden documents anew."""
    for name in names:
        (GOLDEN / f"{name}.md").write_text(write_markdown(report(name)), encoding="utf-8")


if __name__ == "__main__":
    GOLDEN.mkdir(exist_ok=True)
    write(REPORTS)
