"""Documents on a terminal: a verdict, what it rests on, and tables that fit its width.

The short view leaves out what is marked as detail; what it has left out is named in its last line.
A table that is too wide has its sentences wrapped; if that is not enough, it is printed in parts,
each with its first column. No name and no number is ever cut.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from itertools import zip_longest
from typing import Any, NamedTuple

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from pupper_analysis.present.document import (
    Block,
    Cell,
    Column,
    Document,
    Lines,
    Listing,
    Name,
    Number,
    Report,
    Sides,
    Table,
    Words,
    in_english,
)
from pupper_analysis.present.formats import escape_control

MOST_NOTES = 8
"""Lines of notes in a short view: what is read before a table."""

_LEAST_WIDTH = 40
"""Characters of a terminal: on a narrower one, tables are wider than it is."""


class _View(NamedTuple):
    """How blocks are shown: in which width, with which number, and how much of them."""

    width: int
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
        place += isinstance(block, Sides)
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
        line.append(_plain(document.verdict), f"bold {STYLES.get(document.mark, '')}".strip())
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
    if not everything and len(notes) > MOST_NOTES:
        shown = notes[: MOST_NOTES - 1]
    for note in shown:
        _say(out, Text("note: ", "yellow").append(_plain(note), "yellow"), indent=6)
    if len(shown) < len(notes):
        _say(out, Text(f"… and {len(notes) - len(shown)} more notes: -v", "yellow"))


def _print_left_out(out: Console, document: Document) -> None:
    left = [block for block in document.blocks if _left_out(document, block)]
    tables = [_plain(block.title) for block in left if isinstance(block, Table)]
    findings = sum(isinstance(block, Sides) for block in left)
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
    rows = laid_out(table, columns, view.width)
    return [
        _Line(Text(f"\n{_plain(table.title)}", "bold")),
        *(_Line(row, wrap=False) for row in rows),
        *(_Line(Text(_plain(note), "dim")) for note in table.notes),
    ]


@_lines_of.register
def _of_sides(block: Sides, view: _View) -> list[_Line]:
    head = Text(f"\n{view.place}. ")
    if block.tag is not None:
        head.append(f"{_plain(block.tag)} ", STYLES.get(block.tag.mark, "cyan"))
    files = "   ".join(_escape(one.path) or _plain(one.place) for one in block.columns)
    rows = [f"   {files}"]
    if view.everything:
        quoted = (row for one in block.columns for row in in_english(one.line).split("\n") if row)
        rows += [f"   | {_escape(row)}" for row in quoted]
    return [
        _Line(head.append(_plain(block.title)), 3),
        *(_Line(Text(row, "dim"), wrap=False) for row in rows),
        *(_Line(Text("   ").append_text(_marked(note)), 3) for note in block.notes),
    ]


@_lines_of.register
def _of_lines(block: Lines, _: _View) -> list[_Line]:
    lines = [_Line(_marked(line)) for line in block.lines]
    if block.title is None:
        return lines
    style = f"bold {STYLES.get(block.mark, '')}".strip()
    return [_Line(Text(f"\n{_plain(block.title)}", style)), *lines]


@_lines_of.register
def _of_listing(block: Listing, _: _View) -> list[_Line]:
    rows = block.text.rstrip("\n").split("\n")
    return [_Line(Text(_escape(row)), wrap=False) for row in rows]


def _print_block(out: Console, block: Block, place: int = 0, *, everything: bool) -> None:
    for line in _lines_of(block, _View(max(out.width, _LEAST_WIDTH), place, everything)):
        _say(out, line.text, indent=line.indent, wrap=line.wrap)


def _say(out: Console, line: Text, *, indent: int = 0, wrap: bool = True) -> None:
    """Prints a line; on a terminal in its width, elsewhere as long as it is."""
    if not (wrap and out.is_terminal):
        out.print(line, soft_wrap=True)
        return
    lead = len(line.plain) - len(line.plain.lstrip("\n"))
    rows = textwrap.wrap(
        line.plain[lead:],
        max(out.width, _LEAST_WIDTH),
        subsequent_indent=" " * indent,
        drop_whitespace=False,
        break_long_words=False,
        break_on_hyphens=False,
    )
    if len(rows) < 2:
        out.print(line, soft_wrap=True)
        return
    begin = lead
    for number, row in enumerate(rows):
        length = len(row) - (indent if number else 0)
        piece = line[begin : begin + length]
        begin += length
        out.print(Text(" " * indent if number else "\n" * lead).append_text(piece), soft_wrap=True)


def _plain(words: Words) -> str:
    return _escape(in_english(words))


def _marked(words: Words) -> Text:
    """Returns words with their emphasis: of a verdict, on its first word alone."""
    plain = _plain(words)
    style = STYLES.get(words.mark, "")
    first = plain.partition(" ")[0]
    if style and first.isupper():
        return Text(first, f"bold {style}").append(plain[len(first) :], "")
    return Text(plain, style if words.mark == "quiet" else "")


GAP = 2
"""Characters between columns."""

BAR = 10
"""Characters of the bar beside a share, where there is room for it."""

_HEADER = 12
"""Characters of a header that stay on one line, however narrow its numbers are."""

_SENTENCE = 24
"""Characters to which a column of sentences is wrapped at the least."""

_BLOCKS = " ▏▎▍▌▋▊▉█"

STYLES = {"good": "green", "bad": "red", "warn": "yellow", "best": "bold green", "quiet": "dim"}
"""Of each emphasis."""


@dataclass(frozen=True)
class _Column:
    """A column as it is printed.

    Attributes:
        head: The lines of its header.
        cells: Per row its text.
        styles: Per row how that looks.
        left: Whether it stands on the left.
        shares: Per row the share that is drawn as a bar; empty for none.
        width: Characters.
    """

    head: list[str]
    cells: list[str]
    styles: list[str]
    left: bool
    shares: list[float | None]
    width: int


def laid_out(table: Table, chosen: Sequence[int], width: int) -> list[Text]:
    """Returns a table's lines.

    Args:
        table: The table.
        chosen: Which of its columns are shown.
        width: Characters of the terminal.
    """
    columns = [table.columns[index] for index in chosen]
    rows = [tuple(row[index] for index in chosen) for row in table.rows]
    made = _fitted(columns, rows, width)
    lines: list[Text] = []
    for part in _parts(made, width):
        lines += ([Text("")] if lines else []) + _lines(part)
    return lines


def _fitted(
    columns: Sequence[Column], rows: Sequence[tuple[Cell, ...]], width: int
) -> list[_Column]:
    """Returns columns, with sentences wrapped where they are too wide, and bars where they fit."""
    made = [_column(column, [row[index] for row in rows]) for index, column in enumerate(columns)]
    over = _wide(made) - width
    sentences = [
        index
        for index, column in enumerate(columns)
        if index and any(" " in cell and not isinstance(row[index], Name | Number)
                         for cell, row in zip(made[index].cells, rows, strict=True))
    ]  # fmt: skip
    for index in sorted(sentences, key=lambda index: -made[index].width):
        if over > 0:
            kept = max(made[index].width - over, _SENTENCE)
            over -= max(made[index].width - kept, 0)
            made[index] = replace(made[index], width=min(kept, made[index].width))
    drawn = [
        index for index, column in enumerate(made) if any(s is not None for s in column.shares)
    ]
    if over + len(drawn) * (BAR + 1) > 0:
        for index in drawn:
            made[index] = replace(made[index], shares=[])
    return [
        replace(column, width=column.width + BAR + 1)
        if column.shares and index in drawn
        else column
        for index, column in enumerate(made)
    ]


def _column(column: Column, cells: Sequence[Cell]) -> _Column:
    texts = [_shown(cell) for cell in cells]
    wide = max(map(cell_len, texts), default=0)
    head = _wrapped(_escape(in_english(column.name)), max(wide, _HEADER))
    if column.unit not in ("", "1"):
        unit = f"({_escape(column.unit)})"
        joined = f"{head[-1]} {unit}" if head else unit
        head = [*head[:-1], joined] if cell_len(joined) <= wide else [*head, unit]
    shares = [cell.share if isinstance(cell, Number) else None for cell in cells]
    return _Column(
        head,
        texts,
        [STYLES.get(cell.mark, "") for cell in cells],
        column.left,
        shares if any(share is not None for share in shares) else [],
        max([wide, *map(cell_len, head)]),
    )


def _parts(columns: list[_Column], width: int) -> list[list[_Column]]:
    """Returns groups of columns that fit, each with the first; one, where that fills the line."""
    first, *others = columns
    if first.width > width // 2:
        return [columns]
    parts, part = [], [first]
    for column in others:
        if len(part) > 1 and _wide([*part, column]) > width:
            parts.append(part)
            part = [first]
        part.append(column)
    return [*parts, part]


def _lines(columns: Sequence[_Column]) -> list[Text]:
    tall = max(len(column.head) for column in columns)
    lines = []
    for row in range(tall):
        heads = [["", *column.head] for column in columns]
        shown = [head[max(0, len(head) - tall + row)] for head in heads]
        lines.append(_row(columns, shown, ["dim"] * len(columns)))
    lines.append(Text("─" * _wide(columns), "dim"))
    for index in range(len(columns[0].cells)):
        wrapped = [_wrapped(column.cells[index], _letters(column)) for column in columns]
        styles = [column.styles[index] for column in columns]
        for number, cells in enumerate(zip_longest(*wrapped, fillvalue="")):
            drawn = list(cells)
            for place, column in enumerate(columns):
                if column.shares:
                    share = column.shares[index] if number == 0 else None
                    drawn[place] = f"{drawn[place]:>{_letters(column)}} {_bar(share)}"
            lines.append(_row(columns, drawn, styles))
    return lines


def _letters(column: _Column) -> int:
    return column.width - (BAR + 1 if column.shares else 0)


def _row(columns: Sequence[_Column], cells: Sequence[str], styles: Sequence[str]) -> Text:
    line = Text()
    for index, (column, cell, style) in enumerate(zip(columns, cells, styles, strict=True)):
        room = " " * max(column.width - cell_len(cell), 0)
        line.append(" " * GAP if index else "")
        line.append(cell + room if column.left else room + cell, style)
    line.rstrip()
    return line


def _bar(share: float | None) -> str:
    """Returns a bar of ``BAR`` characters, to an eighth of one."""
    eighths = round(8 * BAR * min(max(share or 0.0, 0.0), 1.0))
    full, part = divmod(eighths, 8)
    return (_BLOCKS[8] * full + (_BLOCKS[part] if part else "")).ljust(BAR)


def _wrapped(text: str, width: int) -> list[str]:
    lines: list[str] = []
    for word in text.split(" "):
        if lines and cell_len(lines[-1]) + 1 + cell_len(word) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines or [""]


def _shown(cell: Cell) -> str:
    return _escape(cell.text if isinstance(cell, Number) else in_english(cell))


def _wide(columns: Sequence[_Column]) -> int:
    return sum(column.width for column in columns) + GAP * (len(columns) - 1)
