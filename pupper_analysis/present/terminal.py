"""Print documents on a terminal: verdict, key figures, and tables that fit the width.

The short view omits, for example, blocks marked as detail, and the tables of a brief document. A
document begins with up to three lines: verdict, limit or cause, and the next command. A last line
counts the omitted findings, tables and notes.

In a table that is too wide, columns of sentences are wrapped. If the table is still too wide, the
table is printed in parts that repeat the first column.
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
from pupper_analysis.present.document import Text as TranslatedText
from pupper_analysis.present.formats import escape_control

MAX_ANSWER_WIDTH = 100
"""Maximum width [characters] of each line of messages in a short answer. A message that is too
wide is cut at the end of a clause; a message without such an end may be wider. In the second line,
messages beyond the width are only counted. Chosen, not tuned.
"""

MAX_SHORT_FINDINGS = 8
"""Largest number of findings in files that the short view (without ``-v``) prints. Chosen, not
tuned."""

MAX_SHORT_NOTES = 4
"""Largest number of notes that the short view (without ``-v``) prints. Chosen, not tuned."""

_MIN_TERMINAL_WIDTH = 40
"""Smallest width [characters] for which text is laid out. On a narrower terminal this width is
used. Chosen, not tuned.
"""


class _ViewOptions(NamedTuple):
    """Options with which a block of a document, such as a table, is printed.

    Attributes:
        out: Console, which determines the width.
        place: Number of the finding that the block contains, from 1; not used by other blocks.
        everything: True to print also details and quoted lines.
    """

    out: Console
    place: int
    everything: bool


class _PrintedLine(NamedTuple):
    """Line to print, indent [characters] of its continuation lines, and permission to wrap it."""

    text: Text
    indent: int = 0
    wrap: bool = True


_COMMAND_PATTERN = re.compile(r"(?<!\S):(?=:)|#(?=#\[)")
"""Start of a command to a CI service: ``::error::`` at the start of a line or after a space, and
``##[error]`` at any place. Source: actions/runner, ActionCommand.TryParseV2 and TryParse.
"""


def _escape_line(text: str) -> str:
    """Escape characters that a terminal or a CI system would interpret."""
    return _COMMAND_PATTERN.sub(lambda match: f"\\x{ord(match[0]):02x}", escape_control(text))


class SafeConsole(Console):
    """Console that escapes control characters (ESC, U+202E) of strings; callers escape ``Text``."""

    def render_str(self, text: str, **_: Any) -> Text:
        """Return a text with escaped control characters, line by line; markup has no effect."""
        return Text("\n".join(map(_escape_line, text.split("\n"))))


def make_console(*, stderr: bool = False) -> Console:
    """Create a console of rich that escapes control characters of strings."""
    return SafeConsole(stderr=stderr, highlight=False, emoji=False, markup=False)


def print_report(
    out: Console,
    report: Report,
    *,
    everything: bool = False,
    next_command: str = "",
    hidden_notes: int = 0,
) -> None:
    """Print the documents of a report, and then the overview.

    The short view of a report with an overview prints only a summary of each document.

    Args:
        out: Console.
        report: Report.
        everything: Whether to print all documents in full, with details and all notes (option
            ``-v``).
        next_command: Command line to run after the report; empty for none.
        hidden_notes: Number of notes on the robot that the caller does not print, for the count of
            omitted notes below a single document.
    """
    several = bool(report.overview) and not everything
    single = len(report.documents) == 1
    for document in report.documents:
        if several:
            print_summary(out, document)
        else:
            print_document(
                out,
                document,
                everything=everything,
                next_command=next_command if single else "",
                hidden_notes=hidden_notes if single else 0,
            )
    for block in report.overview:
        _print_block(out, block, everything=everything)
    if next_command and (several or not single):
        _print_next_command(out, next_command)
    if several and any(document.blocks for document in report.documents):
        _print_line(out, Text("with -v: every table and note", "dim"))


def print_document(
    out: Console,
    document: Document,
    *,
    everything: bool = False,
    next_command: str = "",
    hidden_notes: int = 0,
) -> None:
    """Print a document: verdict, key figures, blocks (tables, findings and others) and notes.

    ``everything`` adds details, all notes, and the blocks that are omitted by default.
    ``next_command`` is printed below the key figures. ``hidden_notes`` is the number of notes that
    the caller does not print.
    """
    print_head(out, document, everything=everything)
    if next_command:
        _print_next_command(out, next_command)
    place = 0
    for block in document.blocks:
        place += isinstance(block, FileFinding)
        if everything or not _is_left_out(document, block, place):
            _print_block(out, block, place, everything=everything)
    if document.brief and not everything:
        hidden_notes += len(document.notes)
    else:
        print_notes(out, document.notes, everything=everything)
    if not everything:
        _print_left_out(out, document, hidden_notes)


def _print_next_command(out: Console, command: str) -> None:
    """Print the proposed next command line. The line is not wrapped, so it can be copied."""
    _print_line(out, Text(f"  next: {_escape_line(command)}"), wrap=False)


def print_summary(out: Console, document: Document, *, next_command: str = "") -> None:
    """Print a document's verdict and key figures, and the next command."""
    print_head(out, document)
    if next_command:
        _print_next_command(out, next_command)


def _is_left_out(document: Document, block: Block, place: int) -> bool:
    """Return True if the short view (without ``-v``) omits a block of a document.

    ``place`` is the number of findings up to the block, including the block.
    """
    if isinstance(block, FileFinding) and place > MAX_SHORT_FINDINGS:
        return True
    return block.detail or (document.brief and isinstance(block, Table))


def print_head(out: Console, document: Document, *, everything: bool = False) -> None:
    """Print a document's verdict, title, failures and findings.

    If ``everything`` is True, details follow. Otherwise, the short form of the messages is printed.
    """
    short = not everything
    messages = [*document.failures, *document.findings, *(document.details if everything else ())]
    line, first = Text(), _style_words(messages[0], short=short) if messages else Text()
    if document.verdict is not None:
        line.append(
            _get_short_form(document.verdict) if short else _to_plain_text(document.verdict),
            f"bold {MARK_STYLES.get(document.mark, '')}".strip(),
        )
        line.append(" ")
    title = _get_short_form(document.title) if short else _to_plain_text(document.title)
    if short and cell_len(f"{line.plain}{title}: {first.plain}") > MAX_ANSWER_WIDTH:
        title = _drop_suffix(title)
    line.append(title, "bold")
    if messages:
        line.append(": ")
        line.append_text(
            _end_at_clause(first, MAX_ANSWER_WIDTH - cell_len(line.plain)) if short else first
        )
    _print_line(out, line)
    if short:
        joined = _join_short_messages(messages[1:])
        if joined.plain:
            _print_line(out, joined, indent=2)
        return
    for message in messages[1:]:
        _print_line(out, Text("  ").append_text(_style_words(message)), indent=2)


_MODEL_SUFFIX_PATTERN = re.compile(r"^([^+ ]+)\.(?:urdf|xml|mjcf)(?=$| \+ )", re.IGNORECASE)
"""Name of a single model file at the start of a title, before its end or a payload."""


def _drop_suffix(title: str) -> str:
    """Return the title of a document about a single model file without the suffix of the file."""
    return _MODEL_SUFFIX_PATTERN.sub(r"\1", title)


def _join_short_messages(messages: Sequence[Words]) -> Text:
    """Join the short forms of messages into a line of about `MAX_ANSWER_WIDTH` characters.

    Messages that do not fit are counted.
    """
    line, left = Text(), len(messages)
    for message in messages:
        part = _style_words(message, short=True)
        more = f"; {left - 1} more: -v" if left > 1 else ""
        room = MAX_ANSWER_WIDTH - cell_len(line.plain) - 2 - len(more)
        if line.plain and cell_len(part.plain) > room:
            line.append(f"; {left} more: -v", "dim")
            break
        line.append("; " if line.plain else "  ").append_text(_end_at_clause(part, room))
        left -= 1
    return line


_CLAUSE_END_PATTERN = re.compile(r"[,;:] | \(")
"""Place at which a message may end: a comma, semicolon or colon before a space, or a bracket."""

_PATH_PATTERN = re.compile(r"[/\\][^/\\]*\.\w+")
"""End of a path with a folder: separator, name and suffix of a file."""

_MIN_CUT_SHARE = 1 / 3
"""Smallest width of a cut message, as a share of the available width. Shorter clauses, for example
the name of a link before a colon, state nothing. Chosen, not tuned."""


def _end_at_clause(message: Text, room: int) -> Text:
    """Cut a message that is wider than ``room`` characters at the last clause that fits; add "…".

    The message is returned as is without a suitable clause, and if the cut would remove a path.
    """
    if cell_len(message.plain) <= room:
        return message
    starts = [
        message.plain[: match.start()] for match in _CLAUSE_END_PATTERN.finditer(message.plain)
    ]
    fitting = [
        start
        for start in starts
        if _MIN_CUT_SHARE * room <= cell_len(start) <= room - 2
        and start.count("(") == start.count(")")
    ]
    if not fitting or _PATH_PATTERN.search(message.plain, len(fitting[-1])):
        return message
    return message[: len(fitting[-1])].append(" …")


def print_table(out: Console, table: Table) -> None:
    """Print a table with all columns."""
    _print_block(out, table, everything=True)


def print_notes(out: Console, notes: Sequence[Words], *, everything: bool = False) -> None:
    """Print notes in the given order.

    Unless ``everything``, of more than `MAX_SHORT_NOTES` notes only the first are printed, and the
    number of the omitted notes.
    """
    shown = notes
    if not everything and len(notes) > MAX_SHORT_NOTES:
        shown = notes[: MAX_SHORT_NOTES - 1]
    for note in shown:
        _print_line(out, Text("note: ", "yellow").append(_to_plain_text(note), "yellow"), indent=6)
    if len(shown) < len(notes):
        _print_line(out, Text(f"… and {len(notes) - len(shown)} more notes: -v", "yellow"))


def _print_left_out(out: Console, document: Document, notes: int) -> None:
    """Print how many findings, tables and notes the short view omits, and the option ``-v``."""
    left, place = [], 0
    for block in document.blocks:
        place += isinstance(block, FileFinding)
        if _is_left_out(document, block, place):
            left.append(block)
    counts = {
        "finding": sum(isinstance(block, FileFinding) for block in left),
        "table": sum(isinstance(block, Table) for block in left),
        "note": notes,
    }
    parts = [f"{count} {name}{'s' * (count > 1)}" for name, count in counts.items() if count]
    if parts:
        _print_line(out, Text(f"  with -v: {', '.join(parts)}", "dim"))


@singledispatch
def _make_lines(_: object, __: _ViewOptions) -> list[_PrintedLine]:
    """Convert a block of a document to lines to print; none for plots and 3-D views."""
    return []


@_make_lines.register
def _make_table_lines(table: Table, view: _ViewOptions) -> list[_PrintedLine]:
    """Convert a table to lines: an empty line, the title, the header, the rows and the notes."""
    columns = [
        index for index, one in enumerate(table.columns) if view.everything or not one.detail
    ]
    rows = _lay_out_table(view.out, table, columns)
    return [
        _PrintedLine(Text("")),
        _PrintedLine(Text(_to_plain_text(table.title), "bold")),
        *(_PrintedLine(row, wrap=False) for row in rows),
        *(_PrintedLine(Text(_to_plain_text(note), "dim")) for note in table.notes),
    ]


@_make_lines.register
def _make_finding_lines(block: FileFinding, view: _ViewOptions) -> list[_PrintedLine]:
    """Convert a finding in a file to lines: title, places and notes."""
    head = Text(f"{view.place}. ")
    if block.tag is not None:
        head.append(f"{_to_plain_text(block.tag)} ", MARK_STYLES.get(block.tag.mark, "cyan"))
    files = "   ".join(
        _escape_line(place.path) or _to_plain_text(place.place) for place in block.columns
    )
    rows = [f"   {files}"]
    if view.everything:
        lines = (get_english(place.line) for place in block.columns)
        quoted = (row for line in lines for row in line.split("\n") if row)
        rows += [f"   | {_escape_line(row)}" for row in quoted]
    return [
        _PrintedLine(Text("")),
        _PrintedLine(head.append(_to_plain_text(block.title)), 3),
        *(_PrintedLine(Text(row, "dim"), wrap=False) for row in rows),
        *(_PrintedLine(Text("   ").append_text(_style_words(note)), 3) for note in block.notes),
    ]


@_make_lines.register
def _make_remark_lines(block: Lines, _: _ViewOptions) -> list[_PrintedLine]:
    """Convert remarks to lines: the title, if there is one, and a line per remark."""
    lines = [_PrintedLine(_style_words(line)) for line in block.lines]
    if block.title is None:
        return lines
    style = f"bold {MARK_STYLES.get(block.mark, '')}".strip()
    return [_PrintedLine(Text("")), _PrintedLine(Text(_to_plain_text(block.title), style)), *lines]


@_make_lines.register
def _make_listing_lines(block: Listing, _: _ViewOptions) -> list[_PrintedLine]:
    """Convert a listing to its lines, which are not wrapped; the title is omitted."""
    rows = block.text.rstrip("\n").split("\n")
    return [_PrintedLine(Text(_escape_line(row)), wrap=False) for row in rows]


def _print_block(out: Console, block: Block, place: int = 0, *, everything: bool) -> None:
    """Print a block of a document; ``place`` is the number of a finding, from 1."""
    for line in _make_lines(block, _ViewOptions(out, place, everything)):
        _print_line(out, line.text, indent=line.indent, wrap=line.wrap)


def _print_line(out: Console, line: Text, *, indent: int = 0, wrap: bool = True) -> None:
    """Print a line, wrapped to the width of a terminal; unwrapped if the output is no terminal."""
    rows = [line]
    width = max(out.width, _MIN_TERMINAL_WIDTH)
    if wrap and out.is_terminal and cell_len(line.plain) > width:
        words = (cell_len(word) + indent for word in line.plain.split())  # no word is cut
        rows = [*line.wrap(out, max(width, *words) - indent)]
    for number, row in enumerate(rows):
        out.print(Text(" " * indent if number else "").append_text(row), soft_wrap=True)


def _to_plain_text(words: Words) -> str:
    """Return the English text of words, with control characters escaped, without style."""
    return _escape_line(get_english(words))


def _get_short_form(words: Words) -> str:
    """Return the short English form of words, escaped; the whole English text without one."""
    short = words.short if isinstance(words, TranslatedText) else ""
    return _escape_line(short) or _to_plain_text(words)


def _style_words(words: Words, *, short: bool = False) -> Text:
    """Convert words to a text for the terminal, with a style for their emphasis (``mark``).

    The style applies to a first word in capitals, such as HOLDS. Other texts have a style only if
    the mark is ``quiet``. ``short`` selects the short form.
    """
    plain = _get_short_form(words) if short else _to_plain_text(words)
    style = MARK_STYLES.get(words.mark, "")
    first = plain.partition(" ")[0]
    if style and first.isupper():
        return Text(first, f"bold {style}").append(plain[len(first) :], "")
    return Text(plain, style if words.mark == "quiet" else "")


COLUMN_GAP = 2
"""Space between the columns of a table [characters]. Chosen, not tuned."""

_MIN_HEADER_WIDTH = 12
"""Smallest width [characters] to which the header of a table's column is wrapped. Chosen, not
tuned."""

_MIN_SENTENCE_WIDTH = 24
"""Smallest width [characters] to which a table's column of sentences is wrapped. Chosen, not
tuned."""

MARK_STYLES = {
    "good": "green",
    "bad": "red",
    "warn": "yellow",
    "best": "bold green",
    "quiet": "dim",
}
"""{emphasis of a text or number (``mark``): style of the package rich}."""


_HEADER_RULE_BOX = "    \n    \n ── \n" + "    \n" * 5
"""Characters of a table's lines, in the format of rich's ``Box``: one line below the header."""


class _PrintedColumn(NamedTuple):
    """Column in the form in which the column is printed.

    Attributes:
        head: Header with unit.
        cells: Text of each row.
        left: True if the column is left-aligned.
        width: Width of the column [characters], the largest of four values: the longest cell, the
            longest word of the header, the unit with brackets, and the width of the header without
            unit (at most `_MIN_HEADER_WIDTH`).
        least: Smallest width to which the column may be wrapped [characters]; equal to ``width`` if
            the column is not wrapped.
    """

    head: str
    cells: list[Text]
    left: bool
    width: int
    least: int


def _lay_out_table(out: Console, table: Table, chosen: Sequence[int]) -> list[Text]:
    """Lay out a table as lines; divide a table that is too wide into parts below each other.

    ``chosen`` contains the indices of the displayed columns. Each part begins with the first
    column.
    """
    first, *others = [_measure_column(table, index, wraps=index != chosen[0]) for index in chosen]
    width, parts = max(out.width, _MIN_TERMINAL_WIDTH), [[first]]
    for column in others:
        if len(parts[-1]) > 1 and _sum_min_widths([*parts[-1], column]) > width >= 2 * first.width:
            parts.append([first])
        parts[-1].append(column)
    return [line for part in parts for line in (Text(""), *_render_columns(out, part, width))][1:]


def _measure_column(table: Table, index: int, *, wraps: bool) -> _PrintedColumn:
    """Format a column of a table, and compute the widths [characters] with and without wrapping.

    Sentences are wrapped only if ``wraps`` is True.
    """
    column, cells = table.columns[index], [row[index] for row in table.rows]
    texts = [
        _escape_line(cell.text if isinstance(cell, Number) else get_english(cell)) for cell in cells
    ]
    name = _escape_line(get_english(column.name))
    unit = f"({_escape_line(column.unit)})" if column.unit not in ("", "1") else ""
    heads = map(cell_len, (*name.split(), unit))
    width = least = max(*heads, min(cell_len(name), _MIN_HEADER_WIDTH), *map(cell_len, texts), 0)
    written = zip(texts, cells, strict=True)
    if wraps and any(" " in text for text, cell in written if not isinstance(cell, Name | Number)):
        words = (cell_len(word) for text in texts for word in text.split())
        least = min(width, max(_MIN_SENTENCE_WIDTH, *words))
    shown = [
        Text(text, MARK_STYLES.get(cell.mark, "")) for text, cell in zip(texts, cells, strict=True)
    ]
    return _PrintedColumn(f"{name}\n{unit}".strip(), shown, column.left, width, least)


def _sum_min_widths(columns: Sequence[_PrintedColumn]) -> int:
    """Return the smallest width [characters] of columns side by side, including the gaps."""
    return sum(column.least + COLUMN_GAP for column in columns) - COLUMN_GAP


def _render_columns(out: Console, columns: Sequence[_PrintedColumn], width: int) -> list[Text]:
    """Render columns with rich, to about ``width`` characters, as far as they can be wrapped."""
    from rich.box import Box  # both are slow to import, and short answers contain no table
    from rich.table import Table as Grid

    grid = Grid(box=Box(_HEADER_RULE_BOX), padding=(0, COLUMN_GAP - 1, 0, 0),
                pad_edge=False, show_edge=False,
                header_style="dim", border_style="dim")  # fmt: skip
    for column in columns:
        fixed = column.width if column.least == column.width else None
        side: Literal["left", "right"] = "left" if column.left else "right"
        grid.add_column(Text(column.head), justify=side, width=fixed, min_width=column.least)
    for row in zip(*(column.cells for column in columns), strict=True):
        grid.add_row(*row)
    options = out.options.update(width=max(width, _sum_min_widths(columns)))
    rows = out.render_lines(grid, options, pad=False)
    lines = [Text.assemble(*((part.text, part.style or "") for part in row)) for row in rows]
    for line in lines:
        line.rstrip()
    return lines
