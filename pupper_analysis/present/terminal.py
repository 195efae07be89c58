"""Print documents on a terminal: verdict, key figures, and tables that fit the width.

The short view omits, for example, blocks marked as detail, and the tables of a brief document. A
document begins with up to three lines: verdict, limit or cause, and the next command. A last line
counts the omitted messages, findings, tables and notes.

In a table that is too wide, columns of sentences are wrapped. If the table is still too wide, the
table is printed in parts that repeat the first column.

The console contains the language of the texts. A Chinese character takes two columns. The short
view prints the short form of a text in this language; a text that is still too wide is cut at the
end of a clause.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import singledispatch
from typing import Any, Literal, NamedTuple

from rich.cells import cell_len
from rich.console import Console
from rich.containers import Lines as RichLines
from rich.text import Text

from pupper_analysis.base.runs import current_language
from pupper_analysis.present.document import (
    MAX_ANSWER_WIDTH,
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
    join_words,
    text,
    translate,
)
from pupper_analysis.present.formats import escape_control

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
        out: SafeConsole, which determines the width and the language.
        place: Number of the finding that the block contains, from 1; not used by other blocks.
        everything: True to print also details and quoted lines.
    """

    out: SafeConsole
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
    """Console that escapes control characters (ESC, U+202E) of strings; callers escape ``Text``.

    Args:
        language: Language of the printed texts: ``"en"`` or ``"zh"``.
        **options: Keyword arguments of rich's ``Console``.

    Attributes:
        language: Language of the printed texts.
    """

    def __init__(self, *, language: str = "en", **options: Any) -> None:
        super().__init__(**options)
        self.language = language

    def render_str(self, text: str, **_: Any) -> Text:
        """Return a text with escaped control characters, line by line; markup has no effect."""
        return Text("\n".join(map(_escape_line, text.split("\n"))))


def make_console(*, stderr: bool = False) -> SafeConsole:
    """Create a console that escapes control characters, in the language of the running command."""
    return SafeConsole(
        language=current_language(), stderr=stderr, highlight=False, emoji=False, markup=False
    )


def print_report(
    out: SafeConsole,
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
        _print_line(out, Text(translate(text("verbose-prints-all"), out.language), "dim"))


def print_document(
    out: SafeConsole,
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
    omitted = print_head(out, document, everything=everything)
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
        _print_left_out(out, document, omitted + len(document.details), hidden_notes)


def _print_next_command(out: SafeConsole, command: str) -> None:
    """Print the proposed next command line. The line is not wrapped, so it can be copied."""
    line = translate(text("next-command", command=_escape_line(command)), out.language)
    _print_line(out, Text(f"  {line}"), wrap=False)


def print_summary(out: SafeConsole, document: Document, *, next_command: str = "") -> None:
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


def print_head(out: SafeConsole, document: Document, *, everything: bool = False) -> int:
    """Print a document's verdict, title, failures and findings.

    If ``everything`` is True, details follow. Otherwise, the short form of the messages is printed.

    Returns:
        Number of omitted messages.
    """
    short, language = not everything, out.language
    messages = [*document.failures, *document.findings, *(document.details if everything else ())]
    line, first = Text(), Text()
    if messages:
        first = _style_words(messages[0], language, short=short)
    if document.verdict is not None:
        line.append(
            _to_plain_text(document.verdict, language, short=short),
            f"bold {MARK_STYLES.get(document.mark, '')}".strip(),
        )
        line.append(" ")
    title = _to_plain_text(document.title, language, short=short)
    if short and cell_len(f"{line.plain}{title}: {first.plain}") > MAX_ANSWER_WIDTH:
        title = _drop_suffix(title)
    line.append(title, "bold")
    if messages:
        line.append(translate(text("colon"), language))
        line.append_text(
            _end_at_clause(first, MAX_ANSWER_WIDTH - cell_len(line.plain)) if short else first
        )
    _print_line(out, line)
    if short:
        joined, omitted = _join_short_messages(messages[1:], language)
        if joined.plain:
            _print_line(out, joined, indent=2)
        return omitted
    for message in messages[1:]:
        _print_line(out, Text("  ").append_text(_style_words(message, language)), indent=2)
    return 0


_MODEL_SUFFIX_PATTERN = re.compile(r"^([^+ /]+)\.(?:urdf|xml|mjcf)(?=$| \+ )", re.IGNORECASE)
"""Name of a single model file without folders at the start of a title, before its end or a payload.

The names of several files in an answer have folders: their suffix is kept, as in the tables.
"""


def _drop_suffix(title: str) -> str:
    """Return the title of a document about a single model file without the suffix of the file."""
    return _MODEL_SUFFIX_PATTERN.sub(r"\1", title)


def _join_short_messages(messages: Sequence[Words], language: str) -> tuple[Text, int]:
    """Join the short forms of messages into a line of about `MAX_ANSWER_WIDTH` characters.

    Returns:
        Line; number of messages that do not fit and are omitted.
    """
    line, left = Text(), len(messages)
    semicolon = translate(text("semicolon"), language)
    for message in messages:
        part = _style_words(message, language, short=True)
        room = MAX_ANSWER_WIDTH - cell_len(line.plain) - 2
        if line.plain and cell_len(part.plain) > room:
            break
        line.append(semicolon if line.plain else "  ").append_text(_end_at_clause(part, room))
        left -= 1
    return line, left


_CLAUSE_END_PATTERN = re.compile(r"[,;:] | \(|[，；：。、（]")  # noqa: RUF001
"""Place at which a message may end: a comma, semicolon or colon before a space, or a bracket; or
one of the Chinese punctuation marks."""

_PATH_PATTERN = re.compile(r"[/\\][^/\\\s]*\.[A-Za-z]\w*")
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
        and start.count("（") == start.count("）")  # noqa: RUF001
    ]
    if not fitting or _PATH_PATTERN.search(message.plain, len(fitting[-1])):
        return message
    return message[: len(fitting[-1])].append(" …")


def print_table(out: SafeConsole, table: Table) -> None:
    """Print a table with all columns."""
    _print_block(out, table, everything=True)


def print_notes(out: SafeConsole, notes: Sequence[Words], *, everything: bool = False) -> None:
    """Print notes in the given order.

    Unless ``everything``, of more than `MAX_SHORT_NOTES` notes only the first are printed, and the
    number of the omitted notes.
    """
    shown = notes
    if not everything and len(notes) > MAX_SHORT_NOTES:
        shown = notes[: MAX_SHORT_NOTES - 1]
    prefix = translate(text("note-line", note=""), out.language)
    for note in shown:
        line = f"{prefix}{_to_plain_text(note, out.language)}"
        _print_line(out, Text(line, "yellow"), indent=cell_len(prefix))
    if len(shown) < len(notes):
        left = text("more-notes", count=len(notes) - len(shown))
        _print_line(out, Text(translate(left, out.language), "yellow"))


def _print_left_out(out: SafeConsole, document: Document, lines: int, notes: int) -> None:
    """Print how much the short view omits, and the option ``-v``.

    ``lines`` is the number of omitted messages, ``notes`` the number of omitted notes.
    """
    left, place = [], 0
    for block in document.blocks:
        place += isinstance(block, FileFinding)
        if _is_left_out(document, block, place):
            left.append(block)
    counts = {
        "counted-lines": lines,
        "counted-findings": sum(isinstance(block, FileFinding) for block in left),
        "counted-tables": sum(isinstance(block, Table) for block in left),
        "counted-notes": notes,
    }
    parts = [text(key, count=count) for key, count in counts.items() if count]
    if parts:
        line = translate(text("verbose-prints", parts=join_words(parts)), out.language)
        _print_line(out, Text(f"  {line}", "dim"))


@singledispatch
def _make_lines(_: object, __: _ViewOptions) -> list[_PrintedLine]:
    """Convert a block of a document to lines to print; none for plots and 3-D views."""
    return []


@_make_lines.register
def _make_table_lines(table: Table, view: _ViewOptions) -> list[_PrintedLine]:
    """Convert a table to lines: an empty line, the title, the header, the rows and the notes."""
    columns = [
        index for index, column in enumerate(table.columns) if view.everything or not column.detail
    ]
    rows = _lay_out_table(view.out, table, columns)
    return [
        _PrintedLine(Text("")),
        _PrintedLine(Text(_to_plain_text(table.title, view.out.language), "bold")),
        *(_PrintedLine(row, wrap=False) for row in rows),
        *(
            _PrintedLine(Text(_to_plain_text(note, view.out.language), "dim"))
            for note in table.notes
        ),
    ]


@_make_lines.register
def _make_finding_lines(block: FileFinding, view: _ViewOptions) -> list[_PrintedLine]:
    """Convert a finding in a file to lines: title, places and notes."""
    head, language = Text(f"{view.place}. "), view.out.language
    if block.tag is not None:
        tag = _to_plain_text(block.tag, language)
        head.append(f"{tag} ", MARK_STYLES.get(block.tag.mark, "cyan"))
    files = "   ".join(
        _escape_line(place.path) or _to_plain_text(place.place, language) for place in block.columns
    )
    rows = [f"   {files}"]
    if view.everything:
        lines = (translate(place.line, language) for place in block.columns)
        quoted = (row for line in lines for row in line.split("\n") if row)
        rows += [f"   | {_escape_line(row)}" for row in quoted]
    return [
        _PrintedLine(Text("")),
        _PrintedLine(head.append(_to_plain_text(block.title, language)), 3),
        *(_PrintedLine(Text(row, "dim"), wrap=False) for row in rows),
        *(
            _PrintedLine(Text("   ").append_text(_style_words(note, language)), 3)
            for note in block.notes
        ),
    ]


@_make_lines.register
def _make_remark_lines(block: Lines, view: _ViewOptions) -> list[_PrintedLine]:
    """Convert remarks to lines: the title, if there is one, and a line per remark."""
    language = view.out.language
    lines = [_PrintedLine(_style_words(line, language)) for line in block.lines]
    if block.title is None:
        return lines
    style = f"bold {MARK_STYLES.get(block.mark, '')}".strip()
    title = Text(_to_plain_text(block.title, language), style)
    return [_PrintedLine(Text("")), _PrintedLine(title), *lines]


@_make_lines.register
def _make_listing_lines(block: Listing, _: _ViewOptions) -> list[_PrintedLine]:
    """Convert a listing to its lines, which are not wrapped; the title is omitted."""
    rows = block.text.rstrip("\n").split("\n")
    return [_PrintedLine(Text(_escape_line(row)), wrap=False) for row in rows]


def _print_block(out: SafeConsole, block: Block, place: int = 0, *, everything: bool) -> None:
    """Print a block of a document; ``place`` is the number of a finding, from 1."""
    for line in _make_lines(block, _ViewOptions(out, place, everything)):
        _print_line(out, line.text, indent=line.indent, wrap=line.wrap)


def _print_line(out: SafeConsole, line: Text, *, indent: int = 0, wrap: bool = True) -> None:
    """Print a line, wrapped to the width of a terminal; unwrapped if the output is no terminal."""
    rows = [line]
    width = max(out.width, _MIN_TERMINAL_WIDTH)
    if wrap and out.is_terminal and cell_len(line.plain) > width:
        words = [cell_len(word) + indent for word in _split_words(line.plain)]  # no word is cut
        rows = [*_WrappedText().append_text(line).wrap(out, max(width, *words) - indent)]
    for number, row in enumerate(rows):
        out.print(Text(" " * indent if number else "").append_text(row), soft_wrap=True)


def _to_plain_text(words: Words, language: str, *, short: bool = False) -> str:
    """Return the text of words, with control characters escaped, without style.

    ``short`` selects the short form of a text that has one in the language.
    """
    return _escape_line(translate(words, language, short=short))


def _style_words(words: Words, language: str, *, short: bool = False) -> Text:
    """Convert words to a text for the terminal, with a style for their emphasis (``mark``).

    The style applies to a first word that has capitals in English, such as HOLDS. Other texts have
    a style only if the mark is ``quiet``. ``short`` selects the short form.
    """
    plain = _to_plain_text(words, language, short=short)
    style = MARK_STYLES.get(words.mark, "")
    first, space, _ = plain.partition(" ")
    english = plain if language == "en" else _to_plain_text(words, "en")
    if style and english.partition(" ")[0].isupper() and (space or language == "en"):
        return Text(first, f"bold {style}").append(plain[len(first) :], "")
    return Text(plain, style if words.mark == "quiet" else "")


_WIDE = "\u2e80-\u9fff\uf900-\ufaff\uff01-\uff60"
"""Ranges of Chinese characters and punctuation marks, for a pattern."""

_WIDE_PATTERN = re.compile(f"[{_WIDE}]")
"""Chinese character or punctuation mark."""

_WORD_PATTERN = re.compile(
    rf"\s*[（“]*(?:[{_WIDE}]|[^\s{_WIDE}]+)[，。；：、！？）”]*\s*"  # noqa: RUF001
)
"""Part of a line that is not divided: a word, or a Chinese character, with the punctuation marks
that must not begin or end a row."""


def _split_words(line: str) -> list[str]:
    """Divide a line into words. In Chinese, the line may also break after most characters."""
    return [part for word in _WORD_PATTERN.findall(line) for part in word.split()]


class _WrappedText(Text):
    """Text of rich that also breaks lines between Chinese characters."""

    def wrap(self, console: Console, width: int, **options: Any) -> RichLines:
        """Wrap this text to ``width`` cells; called by rich.

        Names and numbers in a Chinese text are not cut. Other texts are wrapped by rich.
        """
        if self.plain.isascii() or not _WIDE_PATTERN.search(self.plain):
            return super().wrap(console, width, **options)
        rows = RichLines()
        for line in self.split(allow_blank=True):
            breaks, filled = [], 0
            for word in _WORD_PATTERN.finditer(line.plain):
                if filled and filled + cell_len(word[0].rstrip()) > width:
                    breaks.append(word.start())
                    filled = 0
                filled += cell_len(word[0])
            rows.extend(line.divide(breaks))
        for row in rows:
            row.rstrip()
        return rows


COLUMN_GAP = 2
"""Space between the columns of a table [characters]. Chosen, not tuned."""

_MIN_HEADER_WIDTHS = {"en": 12, "zh": 16}
"""{language: smallest width [characters] to which the header of a table's column is wrapped}.
Chosen, not tuned."""

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
            unit (at most `_MIN_HEADER_WIDTHS`).
        least: Smallest width to which the column may be wrapped [characters]; equal to ``width`` if
            the column is not wrapped.
    """

    head: str
    cells: list[Text]
    left: bool
    width: int
    least: int


def _lay_out_table(out: SafeConsole, table: Table, chosen: Sequence[int]) -> list[Text]:
    """Lay out a table as lines; divide a table that is too wide into parts below each other.

    ``chosen`` contains the indices of the displayed columns. Each part begins with the first
    column.
    """
    first, *others = [
        _measure_column(table, index, out.language, wraps=index != chosen[0]) for index in chosen
    ]
    width, parts = max(out.width, _MIN_TERMINAL_WIDTH), [[first]]
    for column in others:
        if len(parts[-1]) > 1 and _sum_min_widths([*parts[-1], column]) > width >= 2 * first.width:
            parts.append([first])
        parts[-1].append(column)
    return [line for part in parts for line in (Text(""), *_render_columns(out, part, width))][1:]


def _measure_column(table: Table, index: int, language: str, *, wraps: bool) -> _PrintedColumn:
    """Format a column of a table, and compute the widths [characters] with and without wrapping.

    Sentences are wrapped only if ``wraps`` is True.
    """
    column, cells = table.columns[index], [row[index] for row in table.rows]
    texts = [
        _escape_line(cell.text) if isinstance(cell, Number) else _to_plain_text(cell, language)
        for cell in cells
    ]
    name = _to_plain_text(column.name, language)
    unit = f"({_escape_line(column.unit)})" if column.unit not in ("", "1") else ""
    heads = map(cell_len, (*_split_words(name), unit))
    width = least = max(
        *heads, min(cell_len(name), _MIN_HEADER_WIDTHS[language]), *map(cell_len, texts), 0
    )
    written = zip(texts, cells, strict=True)
    if wraps and any(
        len(_split_words(shown)) > 1
        for shown, cell in written
        if not isinstance(cell, Name | Number)
    ):
        words = (cell_len(word) for shown in texts for word in _split_words(shown))
        least = min(width, max(_MIN_SENTENCE_WIDTH, *words))
    styled: list[Text] = [
        _WrappedText(shown, MARK_STYLES.get(cell.mark, ""))
        for shown, cell in zip(texts, cells, strict=True)
    ]
    return _PrintedColumn(f"{name}\n{unit}".strip(), styled, column.left, width, least)


def _sum_min_widths(columns: Sequence[_PrintedColumn]) -> int:
    """Return the smallest width [characters] of columns side by side, including the gaps."""
    return sum(column.least + COLUMN_GAP for column in columns) - COLUMN_GAP


def _render_columns(out: SafeConsole, columns: Sequence[_PrintedColumn], width: int) -> list[Text]:
    """Render columns with rich, to about ``width`` characters, as far as they can be wrapped."""
    from rich.box import Box  # both are slow to import, and short answers contain no table
    from rich.table import Table as Grid

    grid = Grid(box=Box(_HEADER_RULE_BOX), padding=(0, COLUMN_GAP - 1, 0, 0),
                pad_edge=False, show_edge=False,
                header_style="dim", border_style="dim")  # fmt: skip
    for column in columns:
        fixed = column.width if column.least == column.width else None
        side: Literal["left", "right"] = "left" if column.left else "right"
        grid.add_column(
            _WrappedText(column.head), justify=side, width=fixed, min_width=column.least
        )
    for row in zip(*(column.cells for column in columns), strict=True):
        grid.add_row(*row)
    options = out.options.update(width=max(width, _sum_min_widths(columns)))
    rows = out.render_lines(grid, options, pad=False)
    lines = [Text.assemble(*((part.text, part.style or "") for part in row)) for row in rows]
    for line in lines:
        line.rstrip()
    return lines
