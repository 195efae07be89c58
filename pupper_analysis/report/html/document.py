"""What a page is made of, before it is markup: sections, tables, plots, views, and texts.

No text here is markup, whatever it holds: names in model files are anybody's. The templates escape
all of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Text:
    """A text of the report itself, in both languages; see ``words``.

    Attributes:
        en: In English.
        zh: In Simplified Chinese.
    """

    en: str
    zh: str


@dataclass(frozen=True)
class Said:
    """A sentence that a result says, which is in English alone.

    Attributes:
        text: The sentence.
    """

    text: str


@dataclass(frozen=True)
class Name:
    """A name, of a file, a joint, an option: no word of a language, and never translated.

    Attributes:
        text: The name.
    """

    text: str


@dataclass(frozen=True)
class Number:
    """A number, as it is shown and as it is sorted.

    Attributes:
        text: Its digits.
        value: The number, in the unit that is shown; not a number where there is none.
        mark: ``"good"``, ``"bad"``, ``"best"`` or nothing.
        share: Of a whole, from 0 to 1, to be drawn as a bar; None for no bar.
    """

    text: str
    value: float
    mark: str = ""
    share: float | None = None


Words = Text | Said | Name
"""What may stand in a line."""

Cell = Text | Said | Name | Number


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: Its header.
        unit: Of its numbers; ``"1"`` where they have no dimension, nothing where it has none.
        left: Whether it is text, and stands on the left.
    """

    name: Words
    unit: str = ""
    left: bool = False


@dataclass(frozen=True)
class Table:
    """A table that can be sorted.

    Attributes:
        title: What it shows.
        columns: Its columns; the first is each row's header.
        rows: Per row, its cells.
        notes: Remarks on it.
        source: Where its numbers come from, and how they are verified.
        units: Whether each row has its own unit, in the column of that name.
    """

    kind: ClassVar[str] = "table"
    title: Words
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[Words, ...] = ()
    source: tuple[Words, ...] = ()


@dataclass(frozen=True)
class Lines:
    """Remarks, one below the other.

    Attributes:
        lines: The remarks.
        mark: ``"bad"`` for failures, ``"warn"`` for what to look at, or nothing.
        title: Over them; None for no title.
    """

    kind: ClassVar[str] = "lines"
    lines: tuple[Words, ...]
    mark: str = ""
    title: Words | None = None


@dataclass(frozen=True)
class Sides:
    """Two places of two files, side by side.

    Attributes:
        title: What differs.
        columns: (name of the file and its line, that line) of each.
        notes: What it does.
    """

    kind: ClassVar[str] = "sides"
    title: Words
    columns: tuple[tuple[Words, Words], ...]
    notes: tuple[Words, ...] = ()


@dataclass(frozen=True)
class Plot:
    """A drawing, with its marks in the user's units of an SVG; see ``plots``.

    Attributes:
        title: What it shows.
        width: Of the drawing.
        height: Of the drawing.
        marks: Its lines, points and words, in the order in which they are drawn.
        legend: (words, class) of each series.
        source: Where its numbers come from.
    """

    kind: ClassVar[str] = "plot"
    title: Words
    width: float
    height: float
    marks: tuple[Mapping[str, Any], ...]
    legend: tuple[tuple[Words, str], ...] = ()
    source: tuple[Words, ...] = ()


@dataclass(frozen=True)
class View:
    """A robot that one can turn; see ``scene``.

    Attributes:
        title: What it shows.
        scene: All that is drawn, as plain lists and numbers.
        note: What is left out, if something is.
    """

    kind: ClassVar[str] = "view"
    title: Words
    scene: Mapping[str, Any]
    note: Words | None = None


Block = Table | Lines | Sides | Plot | View


@dataclass(frozen=True)
class Section:
    """A part of a page.

    Attributes:
        title: Its heading.
        blocks: What it shows.
        passed: The verdict; None where there is none.
        verdict: The verdict in a word or two; None where there is none.
        told: What the summary says of it, beside the verdict.
        warned: Whether it has passed, but has something to look at.
    """

    title: Words
    blocks: tuple[Block, ...]
    passed: bool | None = None
    verdict: Words | None = None
    told: tuple[Words, ...] = ()
    warned: bool = False


def number(value: float | None, form: str, mark: str = "", scale: float = 1.0) -> Number:
    """Returns a number as a cell.

    Args:
        value: The number, in SI units; None is shown as a dash.
        form: How it is formatted, such as ``".3f"`` or ``".1%"``.
        mark: See ``Number``.
        scale: What it is multiplied by to be in the unit that is shown.
    """
    if value is None:
        return Number("-", math.nan, mark)
    shown = scale * float(value)
    text = format(shown, form)
    if not float(text.rstrip("%") or "nan"):
        text = format(0.0, form)  # no minus before a zero
    return Number(text, shown, mark)


def vector(values: Sequence[float] | Array, form: str) -> Name:
    """Returns a vector as a cell."""
    return Name(" ".join(number(value, form).text for value in values))
