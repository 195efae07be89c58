"""Tables of documents as lines of a terminal, in the width that it has.

A table that is too wide has its sentences wrapped; if that is not enough, it is turned over, where
its rows are few; or else it is printed in parts, each with its first column. No name and no number
is ever cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

from rich.cells import cell_len
from rich.text import Text

from pupper_analysis.present.document import (
    Cell,
    Column,
    Name,
    Number,
    Table,
)
from pupper_analysis.present.formats import escape_control
from pupper_analysis.present.words import in_english

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
    if _wide(made) > width and len(rows) < len(columns) - 1:
        turned = _fitted(*_turned(columns, rows), width)
        if _wide(turned) <= width:
            return _lines(turned)
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
    head = _wrapped(escape_control(in_english(column.name)), max(wide, _HEADER))
    if column.unit not in ("", "1"):
        unit = f"({escape_control(column.unit)})"
        together = f"{head[-1]} {unit}" if head else unit
        head = [*head[:-1], together] if cell_len(together) <= wide else [*head, unit]
    shares = [cell.share if isinstance(cell, Number) else None for cell in cells]
    return _Column(
        head,
        texts,
        [STYLES.get(cell.mark, "") for cell in cells],
        column.left,
        shares if any(share is not None for share in shares) else [],
        max([wide, *map(cell_len, head)]),
    )


def _turned(
    columns: Sequence[Column], rows: Sequence[tuple[Cell, ...]]
) -> tuple[list[Column], list[tuple[Cell, ...]]]:
    """Returns a table with its rows as columns: a column's name and unit begin its row."""
    heads = [Column(Name(_shown(row[0]))) for row in rows]
    turned: list[tuple[Cell, ...]] = []
    for index, column in enumerate(columns[1:], start=1):
        unit = f" ({column.unit})" if column.unit not in ("", "1") else ""
        name = Name(f"{in_english(column.name)}{unit}")
        turned.append((name, *(row[index] for row in rows)))
    return [Column(columns[0].name, left=True), *heads], turned


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
    """Returns a text in lines of whole words."""
    lines: list[str] = []
    for word in text.split(" "):
        if lines and cell_len(lines[-1]) + 1 + cell_len(word) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines or [""]


def _shown(cell: Cell) -> str:
    return escape_control(cell.text if isinstance(cell, Number) else in_english(cell))


def _wide(columns: Sequence[_Column]) -> int:
    return sum(column.width for column in columns) + GAP * (len(columns) - 1)
