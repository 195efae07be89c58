"""Documents as Markdown, for a comment on a pull request: GitHub's dialect, which GitLab reads too.

What a short view leaves out is folded. Names are anybody's: none of them becomes markup, a mention
or a reference.

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
"""Before a verdict."""

MAX_COMMENT_LENGTH = 60_000
"""Of a comment, which may have 65,536, with room for what is put around it."""

_ACTS = re.compile(r"([\\`*_\[\]<>#|~&$])|^(\s*(?:[-+]|\d+[.)])(?=\s))")
"""What may begin or end markup, within words too; and what makes an item of a list of a line."""

_REFERS = re.compile(
    r"(?<=[@#])(?=\w)|(?<=GH-)(?=\d)|(?<=:)(?=//)|(?<=www)(?=\.)|(?<=:)(?=[\w+-]+:)"
)
"""Where a mention, a reference, a link or an emoji begins that needs no markup."""

_JOINER = "\u2060"
"""Takes no room, and keeps letters from being read as one word."""


def write_markdown(report: Report) -> str:
    """Returns documents as Markdown.

    Args:
        report: The documents.
    """
    parts = [part for block in report.overview for part in _folded(block)]
    for document in report.documents:
        parts += _document(document, whole=not report.overview)
    text = "\n\n".join(parts) + "\n"
    if len(text) <= MAX_COMMENT_LENGTH:
        return text
    short = "\n\n".join(
        [part for document in report.documents for part in _document(document, whole=False)]
    )
    message = "*Its tables are longer than a comment may be: `--json` has all numbers.*"
    return f"{short[:MAX_COMMENT_LENGTH]}\n\n{message}\n"


def fold_lines(title: str, lines: Iterable[str]) -> str:
    """Returns lines as they are, folded under a title."""
    said = "\n".join(html.escape(line) for line in lines)
    return f"<details><summary>{html.escape(title)}</summary><pre>{said}</pre></details>\n"


def _document(document: Document, *, whole: bool) -> list[str]:
    sign = VERDICT_SIGNS.get(document.mark, "")
    verdict = "" if document.verdict is None else f"{_escaped(document.verdict)} "
    title = f"### {f'{sign} ' if sign else ''}{verdict}{_escaped(document.title)}"
    messages = [f"- **{_escaped(one)}**" for one in document.failures]
    messages += [f"- {_escaped(one)}" for one in (*document.findings, *document.details)]
    parts = [title, "\n".join(messages)] if messages else [title]
    if whole:
        for block in document.blocks:
            parts += _folded(block)
    if document.notes:
        notes = "\n".join(f"- {_escaped(note)}" for note in document.notes)
        parts.append(_fold(f"{len(document.notes)} notes", notes))
    return parts


def _folded(block: object) -> list[str]:
    """Returns a block; one that a short view leaves out is shown when it is asked for."""
    parts = _block(block)
    if parts and getattr(block, "detail", False):
        return [_fold(_escaped(_title(block)), "\n\n".join(parts))]
    return parts


def _title(block: object) -> Words:
    title: Words = getattr(block, "title", None) or getattr(block, "lines")[0]  # noqa: B009
    return title


def _fold(title: str, text: str) -> str:
    return f"<details><summary>{title}</summary>\n\n{text}\n\n</details>"


@singledispatch
def _block(_: object) -> list[str]:
    return []


@_block.register
def _table(table: Table) -> list[str]:
    heads = [_header(column) for column in table.columns]
    rules = [":---" if column.left or not index else "---:" for index, column in
             enumerate(table.columns)]  # fmt: skip
    rows = [[_cell(cell) for cell in row] for row in table.rows]
    lines = [f"| {' | '.join(row)} |" for row in (heads, rules, *rows)]
    parts = [f"**{_escaped(table.title)}**", "\n".join(lines)]
    if table.notes:
        parts.append("\n".join(f"- {_escaped(note)}" for note in table.notes))
    return parts


def _header(column: Column) -> str:
    unit = f" ({_escape(column.unit)})" if column.unit not in ("", "1") else ""
    return f"{_escaped(column.name)}{unit}" or " "


def _cell(cell: Cell) -> str:
    text = _escape(cell.text) if isinstance(cell, Number) else _escaped(cell)
    return f"**{text}**" if text and cell.mark in ("bad", "warn", "best") else text


@_block.register
def _lines(block: Lines) -> list[str]:
    title = [] if block.title is None else [f"**{_escaped(block.title)}**"]
    return [*title, "\n".join(f"- {_escaped(line)}" for line in block.lines)]


@_block.register
def _sides(block: FileFinding) -> list[str]:
    tag = "" if block.tag is None else f"{_escaped(block.tag)} "
    lines = [f"- {tag}**{_escaped(block.title)}**"]
    lines += [f"  - {_place(one)}" for one in block.columns]
    lines += [f"  - {_escaped(note)}" for note in block.notes]
    return ["\n".join(lines)]


def _place(place: FilePlace) -> str:
    quoted = _code(get_english(place.line).replace("\n", " "))
    return f"{_escape(place.path) or _escaped(place.place)}: {quoted}"


@_block.register
def _listing(block: Listing) -> list[str]:
    text = "\n".join(map(escape_control, block.text.rstrip("\n").split("\n")))
    fence = "`" * max(3, _longest(text) + 1)
    return [f"**{_escaped(block.title)}**", f"{fence}{block.language}\n{text}\n{fence}"]


def _code(text: str) -> str:
    """Returns a text in which nothing is markup, letter by letter."""
    shown = escape_control(text).replace("|", "¦")
    marks = "`" * (_longest(shown) + 1)
    return f"{marks} {shown} {marks}" if shown.strip() else ""


def _longest(text: str) -> int:
    """Returns of how many ticks the longest row of them has."""
    return max(map(len, re.findall("`+", text)), default=0)


def _escaped(words: Words) -> str:
    return _escape(get_english(words))


def _escape(text: str) -> str:
    """Returns a text in which nothing acts: no markup, no mention, no reference, no link."""
    return _ACTS.sub(_tamed, _REFERS.sub(_JOINER, escape_control(text)))


def _tamed(found: re.Match[str]) -> str:
    return f"\\{found[1]}" if found[1] else f"{found[2][:-1]}\\{found[2][-1]}"
