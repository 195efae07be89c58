"""Documents on a terminal: a verdict, what it rests on, and tables that fit its width.

The short view leaves out what is marked as detail; what it has left out is named in its last line.
A table that is too wide has its sentences wrapped; if that is not enough, it is printed in parts,
each with its first column. No name and no number is ever cut.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import singledispatch
from typing import Any, Literal, NamedTuple

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from pupper_analysis.present.document import (
    Block,
    Document,
    FileFinding,
    Lines,
    Listing,
    Name,
    Number,
    Report,
    Table,
    Words,
    get_english,
)
from pupper_analysis.present.formats import escape_control

MAX_SHORT_NOTES = 8
"""Lines of notes in a short view: what is read before a table."""

_LEAST_WIDTH = 40
"""Characters of a terminal: on a narrower one, tables are wider than it is."""


class _View(NamedTuple):
    """How blocks are shown: where, with which number, and how much of them."""

    out: Console
    place: int
    everything: bool


class _Line(NamedTuple):
    """A line, how far those are indented into which it is wrapped, and whether it may be."""

    text: Text
    indent: int = 0
    wrap: bool = True


_COMMAND = re.compile(r"(?<!\S):(?=:)|#(?=#\[)")
"""Begins what a CI service obeys: ``::error::`` where a line begins, ``##[error]`` anywhere.

Source: actions/runner, ActionCommand.TryParseV2 and TryParse.
"""


def _escape(text: str) -> str:
    """Returns a text with what would act on a terminal, or on what reads it as a CI log."""
    return _COMMAND.sub(lambda found: f"\\x{ord(found[0]):02x}", escape_control(text))


class SafeConsole(Console):
    """A console that shows what would act on the terminal (ESC, U+202E), and does not do it."""

    def render_str(self, text: str, **_: Any) -> Text:
        """Returns what is shown of a text, its own lines apart; nothing in it is markup."""
        return Text("\n".join(map(_escape, text.split("\n"))))


def make_console() -> Console:
    """Returns a console on standard output."""
    return SafeConsole(highlight=False, emoji=False, markup=False)


def print_report(out: Console, report: Report, *, everything: bool = False) -> None:
    """Prints documents; where something compares them, of each no more than what is to be known.

    Args:
        out: Where to.
        report: The documents.
        everything: Print what the short view leaves out, too.
    """
    several = bool(report.overview) and not everything
    for document in report.documents:
        if several:
            print_summary(out, document)
        else:
            print_document(out, document, everything=everything)
    for block in report.overview:
        _print_block(out, block, everything=everything)
    if several and any(document.blocks for document in report.documents):
        _say(out, Text("every table: -v", "dim"))


def print_document(out: Console, document: Document, *, everything: bool = False) -> None:
    """Prints a document: its verdict and key figures, its tables, what was assumed.

    Args:
        out: Where to.
        document: The document.
        everything: Print what the short view leaves out, too.
    """
    print_head(out, document, everything=everything)
    place = 0
    for block in document.blocks:
        place += isinstance(block, FileFinding)
        if everything or not _left_out(document, block):
            _print_block(out, block, place, everything=everything)
    if document.brief and not everything:
        _count_notes(out, document)
    else:
        print_notes(out, document.notes, everything=everything)
    if not everything:
        _print_left_out(out, document)


def print_summary(out: Console, document: Document) -> None:
    """Prints a document's verdict and key figures, and how many notes it has."""
    print_head(out, document)
    _count_notes(out, document)


def _count_notes(out: Console, document: Document) -> None:
    if count := len(document.notes):
        said = f"  {count} note{'s' if count > 1 else ''} on what was assumed: -v"
        _say(out, Text(said, "dim"))


def _left_out(document: Document, block: Block) -> bool:
    """Tells whether the short view leaves a block out."""
    return block.detail or (document.brief and isinstance(block, Table))


def print_head(out: Console, document: Document, *, everything: bool = False) -> None:
    """Prints a document's verdict with its first reason, then what else it rests on."""
    messages = [*document.failures, *document.findings, *(document.details if everything else ())]
    line = Text()
    if document.verdict is not None:
        line.append(_plain(document.verdict), f"bold {MARK_STYLES.get(document.mark, '')}".strip())
        line.append(" ")
    line.append(_plain(document.title), "bold")
    if messages:
        line.append(": ")
        line.append_text(_marked(messages[0]))
    _say(out, line)
    for one in messages[1:]:
        _say(out, Text("  ").append_text(_marked(one)), indent=2)


def print_table(out: Console, table: Table) -> None:
    """Prints a table alone."""
    _print_block(out, table, everything=True)


def print_notes(out: Console, notes: Sequence[Words], *, everything: bool = False) -> None:
    """Prints what is to be known, a line each; of many, the first ones.

    Args:
        out: Where to.
        notes: The notes, the most important first.
        everything: Print them all.
    """
    shown = notes
    if not everything and len(notes) > MAX_SHORT_NOTES:
        shown = notes[: MAX_SHORT_NOTES - 1]
    for note in shown:
        _say(out, Text("note: ", "yellow").append(_plain(note), "yellow"), indent=6)
    if len(shown) < len(notes):
        _say(out, Text(f"… and {len(notes) - len(shown)} more notes: -v", "yellow"))


def _print_left_out(out: Console, document: Document) -> None:
    left = [block for block in document.blocks if _left_out(document, block)]
    tables = [_plain(block.title) for block in left if isinstance(block, Table)]
    findings = sum(isinstance(block, FileFinding) for block in left)
    parts = [f"{findings} more of these"] * bool(findings) + tables
    if parts:
        _say(out, Text(f"with -v: {'; '.join(parts)}", "dim"))


@singledispatch
def _lines_of(_: object, __: _View) -> list[_Line]:
    """Returns the lines of a block; of plots and views, a terminal shows nothing."""
    return []


@_lines_of.register
def _of_table(table: Table, view: _View) -> list[_Line]:
    columns = [
        index for index, one in enumerate(table.columns) if view.everything or not one.detail
    ]
    rows = _laid_out(view.out, table, columns)
    return [
        _Line(Text("")),
        _Line(Text(_plain(table.title), "bold")),
        *(_Line(row, wrap=False) for row in rows),
        *(_Line(Text(_plain(note), "dim")) for note in table.notes),
    ]


@_lines_of.register
def _of_sides(block: FileFinding, view: _View) -> list[_Line]:
    head = Text(f"{view.place}. ")
    if block.tag is not None:
        head.append(f"{_plain(block.tag)} ", MARK_STYLES.get(block.tag.mark, "cyan"))
    files = "   ".join(_escape(one.path) or _plain(one.place) for one in block.columns)
    rows = [f"   {files}"]
    if view.everything:
        quoted = (row for one in block.columns for row in get_english(one.line).split("\n") if row)
        rows += [f"   | {_escape(row)}" for row in quoted]
    return [
        _Line(Text("")),
        _Line(head.append(_plain(block.title)), 3),
        *(_Line(Text(row, "dim"), wrap=False) for row in rows),
        *(_Line(Text("   ").append_text(_marked(note)), 3) for note in block.notes),
    ]


@_lines_of.register
def _of_lines(block: Lines, _: _View) -> list[_Line]:
    lines = [_Line(_marked(line)) for line in block.lines]
    if block.title is None:
        return lines
    style = f"bold {MARK_STYLES.get(block.mark, '')}".strip()
    return [_Line(Text("")), _Line(Text(_plain(block.title), style)), *lines]


@_lines_of.register
def _of_listing(block: Listing, _: _View) -> list[_Line]:
    rows = block.text.rstrip("\n").split("\n")
    return [_Line(Text(_escape(row)), wrap=False) for row in rows]


def _print_block(out: Console, block: Block, place: int = 0, *, everything: bool) -> None:
    for line in _lines_of(block, _View(out, place, everything)):
        _say(out, line.text, indent=line.indent, wrap=line.wrap)


def _say(out: Console, line: Text, *, indent: int = 0, wrap: bool = True) -> None:
    """Prints a line; on a terminal in its width, elsewhere as long as it is."""
    rows = [line]
    width = max(out.width, _LEAST_WIDTH)
    if wrap and out.is_terminal and cell_len(line.plain) > width:
        words = (cell_len(word) + indent for word in line.plain.split())  # none is cut
        rows = [*line.wrap(out, max(width, *words) - indent)]
    for number, row in enumerate(rows):
        out.print(Text(" " * indent if number else "").append_text(row), soft_wrap=True)


def _plain(words: Words) -> str:
    return _escape(get_english(words))


def _marked(words: Words) -> Text:
    """Returns words with their emphasis: of a verdict, on its first word alone."""
    plain = _plain(words)
    style = MARK_STYLES.get(words.mark, "")
    first = plain.partition(" ")[0]
    if style and first.isupper():
        return Text(first, f"bold {style}").append(plain[len(first) :], "")
    return Text(plain, style if words.mark == "quiet" else "")


COLUMN_GAP = 2
"""Characters between columns."""

_HEADER = 12
"""Characters of a header that stay on one line, however narrow its numbers are."""

_SENTENCE = 24
"""Characters to which a column of sentences is wrapped at the least."""

MARK_STYLES = {
    "good": "green",
    "bad": "red",
    "warn": "yellow",
    "best": "bold green",
    "quiet": "dim",
}
"""Of each emphasis."""


_BOX = "    \n    \n ── \n" + "    \n" * 5
"""A rule under the header, and no other line."""


class _Column(NamedTuple):
    """A column as it is printed.

    Attributes:
        head: Its header, with its unit.
        cells: Per row its text.
        left: Whether it stands on the left.
        width: Characters of its longest line.
        least: Characters to which it may be wrapped; as many, where it is none of sentences.
    """

    head: str
    cells: list[Text]
    left: bool
    width: int
    least: int


def _laid_out(out: Console, table: Table, chosen: Sequence[int]) -> list[Text]:
    """Returns a table's lines, in parts that fit, each with the first column.

    Args:
        out: Where to.
        table: The table.
        chosen: Which of its columns are shown.
    """
    first, *others = [_column(table, index, wraps=index != chosen[0]) for index in chosen]
    width, parts = max(out.width, _LEAST_WIDTH), [[first]]
    for column in others:
        if len(parts[-1]) > 1 and _least([*parts[-1], column]) > width >= 2 * first.width:
            parts.append([first])
        parts[-1].append(column)
    return [line for part in parts for line in (Text(""), *_lines(out, part, width))][1:]


def _column(table: Table, index: int, *, wraps: bool) -> _Column:
    column, cells = table.columns[index], [row[index] for row in table.rows]
    texts = [_escape(one.text if isinstance(one, Number) else get_english(one)) for one in cells]
    name = _escape(get_english(column.name))
    unit = f"({_escape(column.unit)})" if column.unit not in ("", "1") else ""
    heads = map(cell_len, (*name.split(), unit))
    width = least = max(*heads, min(cell_len(name), _HEADER), *map(cell_len, texts), 0)
    written = zip(texts, cells, strict=True)
    if wraps and any(" " in one for one, cell in written if not isinstance(cell, Name | Number)):
        words = (cell_len(word) for one in texts for word in one.split())
        least = min(width, max(_SENTENCE, *words))
    shown = [
        Text(one, MARK_STYLES.get(cell.mark, "")) for one, cell in zip(texts, cells, strict=True)
    ]
    return _Column(f"{name}\n{unit}".strip(), shown, column.left, width, least)


def _least(columns: Sequence[_Column]) -> int:
    return sum(column.least + COLUMN_GAP for column in columns) - COLUMN_GAP


def _lines(out: Console, columns: Sequence[_Column], width: int) -> list[Text]:
    from rich.box import Box  # no table is printed without -v, and both are slow to import
    from rich.table import Table as Grid

    grid = Grid(box=Box(_BOX), padding=(0, COLUMN_GAP - 1, 0, 0), pad_edge=False, show_edge=False,
                header_style="dim", border_style="dim")  # fmt: skip
    for column in columns:
        fixed = column.width if column.least == column.width else None
        side: Literal["left", "right"] = "left" if column.left else "right"
        grid.add_column(Text(column.head), justify=side, width=fixed, min_width=column.least)
    for row in zip(*(column.cells for column in columns), strict=True):
        grid.add_row(*row)
    options = out.options.update(width=max(width, _least(columns)))
    rows = out.render_lines(grid, options, pad=False)
    lines = [Text.assemble(*((one.text, one.style or "") for one in row)) for row in rows]
    for line in lines:
        line.rstrip()
    return lines
