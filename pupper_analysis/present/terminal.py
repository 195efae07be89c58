"""Documents on a terminal: a verdict, what it rests on, and tables that fit its width.

The short view leaves out what is marked as detail; what it has left out is told in its last line.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from functools import singledispatch
from typing import Any, NamedTuple

from rich.console import Console
from rich.text import Text

from pupper_analysis.present.columns import STYLES, laid_out
from pupper_analysis.present.document import (
    Block,
    Document,
    Lines,
    Listing,
    Report,
    Sides,
    Table,
    Words,
)
from pupper_analysis.present.formats import escape_control
from pupper_analysis.present.words import in_english

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


class SafeConsole(Console):
    """A console that shows what would act on the terminal (ESC, U+202E), and does not do it."""

    def render_str(self, text: str, **_: Any) -> Text:
        """Returns what is shown of a text, its own lines apart; nothing in it is markup."""
        return Text("\n".join(map(escape_control, text.split("\n"))))


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
    print_head(out, document)
    place = 0
    for block in document.blocks:
        place += isinstance(block, Sides)
        if everything or not block.detail:
            _print_block(out, block, place, everything=everything)
    print_notes(out, document.notes, everything=everything)
    if not everything:
        _print_left_out(out, document)


def print_summary(out: Console, document: Document) -> None:
    """Prints a document's verdict and key figures, and how many notes it has."""
    print_head(out, document)
    if count := len(document.notes):
        said = f"  {count} note{'s' if count > 1 else ''} on what was assumed: -v"
        _say(out, Text(said, "dim"))


def print_head(out: Console, document: Document) -> None:
    """Prints a document's verdict with its first reason, then what else it rests on."""
    told = [*document.failures, *document.told]
    line = Text()
    if document.verdict is not None:
        line.append(_plain(document.verdict), f"bold {STYLES.get(document.mark, '')}".strip())
        line.append(" ")
    line.append(_plain(document.title), "bold")
    if told:
        line.append(": ")
        line.append_text(_marked(told[0]))
    _say(out, line)
    for one in told[1:]:
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
    """Says what the short view has left out."""
    left = [block for block in document.blocks if block.detail]
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
    files = "   ".join(escape_control(one.path) or _plain(one.place) for one in block.columns)
    rows = [f"   {files}"]
    if view.everything:
        quoted = (row for one in block.columns for row in in_english(one.line).split("\n") if row)
        rows += [f"   | {escape_control(row)}" for row in quoted]
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
    return [_Line(Text(escape_control(row)), wrap=False) for row in rows]


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
    """Returns words in a line that does nothing to a terminal."""
    return escape_control(in_english(words))


def _marked(words: Words) -> Text:
    """Returns words with their emphasis: of a verdict, on its first word alone."""
    plain = _plain(words)
    style = STYLES.get(words.mark, "")
    first = plain.partition(" ")[0]
    if style and first.isupper():
        return Text(first, f"bold {style}").append(plain[len(first) :], "")
    return Text(plain, style if words.mark == "quiet" else "")
