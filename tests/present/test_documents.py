"""Results are shown as golden documents have it, and each cell is the same wherever it is shown.

``golden/*.md`` are documents of results whose numbers are all different (``stubs``), as Markdown:
what a change of a builder changes is read in their diff.
``python -m tests.present.test_documents`` writes them anew.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache

import pytest

from pupper_analysis.present.document import (
    Cell,
    Column,
    Number,
    Report,
    Table,
    in_english,
)
from pupper_analysis.present.html.write import render_page
from pupper_analysis.present.markdown import write_markdown
from tests.support import printing
from tests.support.html_page import Page
from tests.support.repository import ROOT
from tests.support.stubs import (
    REPORTS,
)

GOLDEN = ROOT / "tests" / "golden"

BARS = dict.fromkeys(map(ord, "█▏▎▍▌▋▊▉"))
"""What draws shares of a whole on a terminal."""

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


def in_markdown(text: str) -> list[Rows]:
    """The tables of a Markdown text."""
    found, joiner = [], "\u2060"
    for lines in re.findall(r"(?m)(?:^\|.*\|\n)+", text.replace(joiner, "")):
        split = [re.split(r"(?<!\\)\|", line)[1:-1] for line in lines.splitlines()]
        cells = [[re.sub(r"\\(.)", r"\1", one).strip().strip("*") for one in row] for row in split]
        found.append([dict(zip(cells[0], row, strict=True)) for row in cells[2:]])
    return found


def on_a_terminal(table: Table, text: str) -> Rows:
    """The rows of a table as a wide terminal shows it: columns have two blanks between them."""
    lines = text[text.index(f"\n{in_english(table.title)}\n") :].splitlines()[2:]
    rule = next(number for number, line in enumerate(lines) if line.startswith("─"))
    shown = lines[:rule] + lines[rule + 1 : rule + 1 + len(table.rows)]
    wide = max(map(len, shown))
    blank = "".join(
        " " if all(line.ljust(wide)[at] == " " for line in shown) else "x" for at in range(wide)
    )
    places = [found.span() for found in re.finditer(r"x+( x+)*", blank)]
    split = [[" ".join(line[a:b].translate(BARS).split()) for a, b in places] for line in shown]
    heads = [" ".join(filter(None, parts)) for parts in zip(*split[:rule], strict=True)]
    return [dict(zip(heads, row, strict=True)) for row in split[rule:]]


def without_lines(rows: Rows) -> list[list[str]]:
    """What is in each row: headers and cells without what is broken into lines."""
    return [[" ".join(one.split()).replace(" (–)", "") for one in (*row, *row.values())]
            for row in rows]  # fmt: skip


@pytest.mark.parametrize("name", REPORTS)
def test_documents_are_the_golden_ones(name: str) -> None:
    assert write_markdown(report(name)) == (GOLDEN / f"{name}.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", REPORTS)
def test_cells_are_the_same_wherever_they_are_shown(name: str) -> None:
    """On a terminal, on a page and in Markdown: each in its column, under its name and unit."""
    shown = report(name)
    expected = [without_lines(said(table)) for table in tables(shown)]
    assert expected
    commented = [without_lines(rows) for rows in in_markdown(write_markdown(shown))]
    # Where something compares documents, a comment has that alone.
    assert commented == expected[: sum(isinstance(one, Table) for one in shown.overview) or None]
    read = [without_lines(rows) for rows in Page(render_page(shown)).every_table()]
    assert read == expected
    for document in shown.documents:
        text = printing.printed(document, width=600)
        for table in (block for block in document.blocks if isinstance(block, Table)):
            assert without_lines(on_a_terminal(table, text)) == without_lines(said(table))


def write(names: Iterable[str]) -> None:
    """Writes the golden documents anew."""
    for name in names:
        (GOLDEN / f"{name}.md").write_text(write_markdown(report(name)), encoding="utf-8")


if __name__ == "__main__":
    GOLDEN.mkdir(exist_ok=True)
    write(REPORTS)
