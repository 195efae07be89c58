"""Documents of results equal golden Markdown files.

``golden/*.md`` contain results whose numbers are all different (``stubs``), so that exchanged
fields are visible. ``python -m tests.present.test_documents`` writes the files anew; read the diff.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache

import pytest

from pupper_analysis.present.document import Number, Report, Table, get_english
from pupper_analysis.present.html.write import render_page
from pupper_analysis.present.markdown import write_markdown
from tests.support import printing
from tests.support.html_page import Page
from tests.support.repository import ROOT
from tests.support.stubs import REPORTS

GOLDEN = ROOT / "tests" / "golden"

BARS = dict.fromkeys(map(ord, "█▏▎▍▌▋▊▉"))
"""Characters of the bars in cells on a terminal."""

Rows = list[dict[str, str]]


@cache
def report(name: str) -> Report:
    return REPORTS[name]()


@pytest.mark.parametrize("name", REPORTS)
def test_documents_equal_the_golden_files(name: str) -> None:
    assert write_markdown(report(name)) == (GOLDEN / f"{name}.md").read_text(encoding="utf-8")


def list_shown_tables(shown: Report) -> list[Table]:
    blocks = [
        *shown.overview,
        *(block for document in shown.documents for block in document.blocks),
    ]
    return [block for block in blocks if isinstance(block, Table)]


def list_rows(table: Table) -> Rows:
    """Return {header with unit: cell} of each row of a table."""
    units = {"": "", "1": " (–)"}
    headers = [
        get_english(column.name) + units.get(column.unit, f" ({column.unit})")
        for column in table.columns
    ]
    rows = []
    for row in table.rows:
        cells = [cell.text if isinstance(cell, Number) else get_english(cell) for cell in row]
        rows.append(dict(zip(headers, cells, strict=True)))
    return rows


def read_markdown_tables(text: str) -> list[Rows]:
    found, joiner = [], "\u2060"
    for lines in re.findall(r"(?m)(?:^\|.*\|\n)+", text.replace(joiner, "")):
        split = [re.split(r"(?<!\\)\|", line)[1:-1] for line in lines.splitlines()]
        cells = [
            [re.sub(r"\\(.)", r"\1", cell).strip().strip("*") for cell in row] for row in split
        ]
        found.append([dict(zip(cells[0], row, strict=True)) for row in cells[2:]])
    return found


def read_terminal_table(table: Table, text: str) -> Rows:
    """Return the rows of a table on a wide terminal, on which two blanks separate the columns."""
    lines = text[text.index(f"\n{get_english(table.title)}\n") :].splitlines()[2:]
    rule = next(number for number, line in enumerate(lines) if line.startswith("─"))
    shown = lines[:rule] + lines[rule + 1 : rule + 1 + len(table.rows)]
    width = max(map(len, shown))
    used = "".join(
        " " if all(line.ljust(width)[at] == " " for line in shown) else "x" for at in range(width)
    )
    places = [found.span() for found in re.finditer(r"x+( x+)*", used)]
    split = [[" ".join(line[a:b].translate(BARS).split()) for a, b in places] for line in shown]
    headers = [" ".join(filter(None, parts)) for parts in zip(*split[:rule], strict=True)]
    return [dict(zip(headers, row, strict=True)) for row in split[rule:]]


def join_lines(rows: Rows) -> list[list[str]]:
    """Return headers and cells of each row without line breaks."""
    return [
        [" ".join(cell.split()).replace(" (–)", "") for cell in (*row, *row.values())]
        for row in rows
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", REPORTS)
def test_cells_are_equal_on_terminals_pages_and_in_markdown(name: str) -> None:
    """Each cell is in its column, under its header and unit. If a report has tables that compare
    documents, the Markdown has these alone.
    """
    shown = report(name)
    expected = [join_lines(list_rows(table)) for table in list_shown_tables(shown)]
    assert expected
    markdown = [join_lines(rows) for rows in read_markdown_tables(write_markdown(shown))]
    assert markdown == expected[: sum(isinstance(block, Table) for block in shown.overview) or None]
    page = [join_lines(rows) for _, rows in Page(render_page(shown)).list_tables()]
    assert page == expected
    for document in shown.documents:
        text = printing.printed(document, width=600)
        for table in (block for block in document.blocks if isinstance(block, Table)):
            rows = join_lines(read_terminal_table(table, text))
            assert rows == join_lines(list_rows(table))


def write(names: Iterable[str]) -> None:
    """Write the golden documents anew."""
    for name in names:
        (GOLDEN / f"{name}.md").write_text(write_markdown(report(name)), encoding="utf-8")


if __name__ == "__main__":
    GOLDEN.mkdir(exist_ok=True)
    write(REPORTS)
