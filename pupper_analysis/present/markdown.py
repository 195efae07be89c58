"""Documents as Markdown for comments on pull requests (GitHub's dialect, which GitLab also reads).

Blocks marked as detail are folded. Names are escaped: markup, mentions (``@name``) and references
(``#12``).

Source: GitHub Flavored Markdown Spec, version 0.29-gfm.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable
from functools import singledispatch

from pupper_analysis.present.document import (
    Cell,
    Column,
    Document,
    FileFinding,
    FilePlace,
    Lines,
    Listing,
    Number,
    Report,
    Table,
    Words,
    get_english,
)
from pupper_analysis.present.formats import escape_control

VERDICT_SIGNS = {"good": "✅", "bad": "❌", "warn": "⚠️"}
"""{mark of a verdict: sign before the verdict}."""

MAX_COMMENT_LENGTH = 60_000
"""Largest number of characters of a comment, without the remark that the text was shortened. GitHub
accepts 65,536; the rest is available for text that the caller adds.
"""

_MARKUP_PATTERN = re.compile(r"([\\`*_\[\]<>#|~&$])|^(\s*(?:[-+]|\d+[.)])(?=\s))")
"""Characters to escape in Markdown: markup (group 1), and list markers at the start (group 2)."""

_REFERENCE_PATTERN = re.compile(
    r"(?<=[@#])(?=\w)|(?<=GH-)(?=\d)|(?<=:)(?=//)|(?<=www)(?=\.)|(?<=:)(?=[\w+-]+:)"
)
"""Positions (empty matches) at which a `_WORD_JOINER` is inserted, because GitHub would convert the
text there to a mention, reference, link or emoji.
"""

_WORD_JOINER = "\u2060"
"""Zero-width character that is inserted into texts such as ``@name`` and ``#12``. Its purpose is
that GitHub does not convert these texts to mentions or links.
"""


def write_markdown(report: Report) -> str:
    """Convert a report to Markdown for a comment: the overview, then the documents.

    With an overview, the tables and other blocks of the documents are omitted. If the text is
    longer than `MAX_COMMENT_LENGTH` characters, the overview and all blocks are omitted, and the
    rest is cut if necessary.
    """
    parts = [part for block in report.overview for part in _write_block(block)]
    for document in report.documents:
        parts += _write_document(document, whole=not report.overview)
    text = "\n\n".join(parts) + "\n"
    if len(text) <= MAX_COMMENT_LENGTH:
        return text
    short = "\n\n".join(
        [part for document in report.documents for part in _write_document(document, whole=False)]
    )
    message = "*Its tables are longer than a comment may be: `--json` has all numbers.*"
    return f"{short[:MAX_COMMENT_LENGTH]}\n\n{message}\n"


def fold_lines(title: str, lines: Iterable[str]) -> str:
    """Format lines as a folded HTML section with a title and preformatted text."""
    content = "\n".join(html.escape(line) for line in lines)
    return f"<details><summary>{html.escape(title)}</summary><pre>{content}</pre></details>\n"


def _write_document(document: Document, *, whole: bool) -> list[str]:
    """Convert a document to Markdown sections: title, messages, blocks if ``whole``, and notes."""
    sign = VERDICT_SIGNS.get(document.mark, "")
    verdict = "" if document.verdict is None else f"{_escape_words(document.verdict)} "
    title = f"### {f'{sign} ' if sign else ''}{verdict}{_escape_words(document.title)}"
    messages = [f"- **{_escape_words(failure)}**" for failure in document.failures]
    messages += [
        f"- {_escape_words(finding)}" for finding in (*document.findings, *document.details)
    ]
    parts = [title, "\n".join(messages)] if messages else [title]
    if whole:
        for block in document.blocks:
            parts += _write_block(block)
    if document.notes:
        notes = "\n".join(f"- {_escape_words(note)}" for note in document.notes)
        parts.append(_fold_text(f"{len(document.notes)} notes", notes))
    return parts


def _write_block(block: object) -> list[str]:
    """Convert a block, such as a table, to Markdown sections; fold a block that is a detail."""
    parts = _make_parts(block)
    if parts and getattr(block, "detail", False):
        return [_fold_text(_escape_words(_get_title(block)), "\n\n".join(parts))]
    return parts


def _get_title(block: object) -> Words:
    """Return the title of a block, or the first line of remarks without a title."""
    title: Words = getattr(block, "title", None) or getattr(block, "lines")[0]  # noqa: B009
    return title


def _fold_text(title: str, text: str) -> str:
    """Format a Markdown text as a folded section with a title."""
    return f"<details><summary>{title}</summary>\n\n{text}\n\n</details>"


@singledispatch
def _make_parts(_: object) -> list[str]:
    """Convert a block of a document to Markdown paragraphs; none for plots and 3-D views."""
    return []


@_make_parts.register
def _make_table_parts(table: Table) -> list[str]:
    """Convert a table to Markdown paragraphs: title, header with rows, and notes."""
    heads = [_format_header(column) for column in table.columns]
    rules = [":---" if column.left or not index else "---:" for index, column in
             enumerate(table.columns)]  # fmt: skip
    rows = [[_format_cell(cell) for cell in row] for row in table.rows]
    lines = [f"| {' | '.join(row)} |" for row in (heads, rules, *rows)]
    parts = [f"**{_escape_words(table.title)}**", "\n".join(lines)]
    if table.notes:
        parts.append("\n".join(f"- {_escape_words(note)}" for note in table.notes))
    return parts


def _format_header(column: Column) -> str:
    """Format the header of a table's column for Markdown, with the unit in brackets."""
    unit = f" ({_escape_markdown(column.unit)})" if column.unit not in ("", "1") else ""
    return f"{_escape_words(column.name)}{unit}" or " "


def _format_cell(cell: Cell) -> str:
    """Format a table cell for Markdown; cells marked bad, warn or best are bold."""
    text = _escape_markdown(cell.text) if isinstance(cell, Number) else _escape_words(cell)
    return f"**{text}**" if text and cell.mark in ("bad", "warn", "best") else text


@_make_parts.register
def _make_remark_parts(block: Lines) -> list[str]:
    """Convert remarks to Markdown paragraphs: the title, and the remarks as a list."""
    title = [] if block.title is None else [f"**{_escape_words(block.title)}**"]
    return [*title, "\n".join(f"- {_escape_words(line)}" for line in block.lines)]


@_make_parts.register
def _make_finding_parts(block: FileFinding) -> list[str]:
    """Convert a finding in a file to a nested Markdown list, with places and notes."""
    tag = "" if block.tag is None else f"{_escape_words(block.tag)} "
    lines = [f"- {tag}**{_escape_words(block.title)}**"]
    lines += [f"  - {_format_place(place)}" for place in block.columns]
    lines += [f"  - {_escape_words(note)}" for note in block.notes]
    return ["\n".join(lines)]


def _format_place(place: FilePlace) -> str:
    """Return the path of a place in a file, and the quoted line as code, as Markdown."""
    quoted = _format_code(get_english(place.line).replace("\n", " "))
    return f"{_escape_markdown(place.path) or _escape_words(place.place)}: {quoted}"


@_make_parts.register
def _make_listing_parts(block: Listing) -> list[str]:
    """Convert a listing to Markdown paragraphs: the title, and a fenced code block."""
    text = "\n".join(map(escape_control, block.text.rstrip("\n").split("\n")))
    fence = "`" * max(3, _measure_tick_run(text) + 1)
    return [f"**{_escape_words(block.title)}**", f"{fence}{block.language}\n{text}\n{fence}"]


def _format_code(text: str) -> str:
    """Format a text as inline code of Markdown."""
    shown = escape_control(text).replace("|", "¦")
    marks = "`" * (_measure_tick_run(shown) + 1)
    return f"{marks} {shown} {marks}" if shown.strip() else ""


def _measure_tick_run(text: str) -> int:
    """Return the length of the longest run of backticks in a text, to choose a longer fence."""
    return max(map(len, re.findall("`+", text)), default=0)


def _escape_words(words: Words) -> str:
    """Return the English text of words, escaped for Markdown."""
    return _escape_markdown(get_english(words))


def _escape_markdown(text: str) -> str:
    """Escape markup, mentions, references and links in a text for Markdown."""
    return _MARKUP_PATTERN.sub(
        _escape_match, _REFERENCE_PATTERN.sub(_WORD_JOINER, escape_control(text))
    )


def _escape_match(match: re.Match[str]) -> str:
    """Return a match of `_MARKUP_PATTERN` with a backslash before the markup character."""
    return f"\\{match[1]}" if match[1] else f"{match[2][:-1]}\\{match[2][-1]}"
