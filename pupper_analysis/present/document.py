"""What is said of a result, before it is shown anywhere: a verdict, key figures, tables, plots.

A document is made once, by the builder of its result's type (``documents``), and shown by each
renderer in its own way: on a terminal, on a page, in Markdown. Its words are the catalogue's, by
key, in English and Simplified Chinese. No text here is markup, whatever it holds: names in model
files are anybody's, and each renderer escapes all of it. A plot says which lines are over which
axes; how they are drawn is a renderer's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from pupper_analysis.base.diagnostics import Diagnostic
    from pupper_analysis.robot.robot import Robot
    from pupper_analysis.stance.stand import Stand
    from pupper_analysis.statics.equilibrium import GravityCompensation
from collections.abc import Iterable

from pupper_analysis.base.diagnostics import fill_template, format_number, is_term, phrase

Array = NDArray[np.float64]


def text(key: str, **values: object) -> Text:
    """Returns a text in both languages.

    Args:
        key: The catalogue's, of ``texts.toml`` or ``terms.toml``.
        **values: What stands in its braces; a ``Text`` in its own two languages.

    Its Chinese is made when it is asked for.

    Raises:
        KeyError: If the catalogue lacks it.
    """
    return Text(_filled(key, values, "en"), lambda: _filled(key, values, "zh"))


def word(name: str) -> Text | Name:
    """Returns a word of a result's in both languages, or as it is, where it is no term."""
    return text(name) if is_term(name) else Name(name)


def join_words(parts: Iterable[Words], comma: str = "comma") -> Text:
    """Returns words as a list, with each language's own comma (or what else is a text)."""
    listed = list(parts)
    between = text(comma)
    return Text(
        between.en.join(str(_in(part, "en")) for part in listed),
        lambda: between.zh.join(str(_in(part, "zh")) for part in listed),
    )


def get_english(words: Words) -> str:
    """Returns words in English."""
    return words.en if isinstance(words, Text) else words.text


def _filled(key: str, values: dict[str, object], language: str) -> str:
    template = phrase(key, language)
    said = {name: _in(value, language) for name, value in values.items()}
    return fill_template(template, said, language) if said else template


def _in(value: object, language: str) -> object:
    if isinstance(value, Text):
        return getattr(value, language)
    return value.text if isinstance(value, Name) else value


@dataclass(frozen=True)
class Axis:
    """What an axis measures.

    Attributes:
        name: The quantity.
        unit: Its unit.
        form: How its values are written.
    """

    name: Words
    unit: str
    form: str


@dataclass(frozen=True, eq=False)
class Series:
    """One line of a drawing.

    Attributes:
        name: Whose it is.
        x: (n,) along, in the axis's unit.
        y: (n,) up, in the axis's unit; what is not finite is left out.
        points: Whether every point is marked.
        note: What it comes to, in a word or a number, beside its name in the legend.
        marked_index: The number of the point that matters most; None for none.
        reference: Whether it is what the others are compared with.
    """

    name: Words
    x: ArrayLike
    y: ArrayLike
    points: bool = False
    note: Words | None = None
    marked_index: int | None = None
    reference: bool = False


@dataclass(frozen=True)
class Bar:
    """A bar of a bar plot.

    Attributes:
        name: Its name.
        value: Its length, in the axis's unit.
        marker: What is marked beside it by a tick; None for nothing.
        limit: How long it may be; None for no limit.
    """

    name: Words
    value: float
    marker: float | None = None
    limit: float | None = None


@dataclass(frozen=True, eq=False)
class Plot:
    """A drawing.

    Attributes:
        title: What it shows.
        detail: Whether a short view leaves it out.
    """

    kind: ClassVar[str] = "plot"
    detail: ClassVar[bool] = False
    title: Words


@dataclass(frozen=True, eq=False)
class LinePlot(Plot):
    """Lines over one another.

    Attributes:
        x: The axis along.
        y: The axis up.
        series: The lines, at least one with a finite value.
        note: What the notes beside the lines' names are; None where there are none.
    """

    x: Axis
    y: Axis
    series: Sequence[Series]
    note: Words | None = None


@dataclass(frozen=True, eq=False)
class BarPlot(Plot):
    """Bars from zero to both sides, each with its limit and with another value beside it.

    Attributes:
        axis: What they measure.
        bars: The bars, from above.
        legend: What a bar's value, the other value and the limit are; None of what no bar has.
    """

    axis: Axis
    bars: Sequence[Bar]
    legend: tuple[Words, Words | None, Words | None]


@dataclass(frozen=True)
class Text:
    """A text of the report itself, in both languages; see ``words``.

    Attributes:
        en: In English.
        chinese: In Simplified Chinese, or what makes it: who reads English does not wait for it.
        mark: ``"good"``, ``"bad"``, ``"warn"``, ``"quiet"`` (of less weight) or nothing.
    """

    en: str
    chinese: str | Callable[[], str] = field(compare=False)
    mark: str = ""

    @property
    def zh(self) -> str:
        """In Simplified Chinese."""
        return self.chinese if isinstance(self.chinese, str) else self.chinese()

    def with_mark(self, mark: str) -> Text:
        """Returns the text with an emphasis."""
        return Text(self.en, self.chinese, mark)


def diagnostic_text(diagnostic: Diagnostic, mark: str = "") -> Text:
    """Returns what a diagnostic says, in both languages.

    Args:
        diagnostic: What was found.
        mark: As of a ``Text``.
    """
    return Text(diagnostic.text("en"), lambda: diagnostic.text("zh"), mark)


@dataclass(frozen=True)
class Name:
    """A name, of a file, a joint, an option: no word of a language, and never translated.

    Attributes:
        text: The name.
        mark: As of a ``Text``.
    """

    text: str
    mark: str = ""


@dataclass(frozen=True)
class Number:
    """A number, as it is shown and as it is sorted.

    Attributes:
        text: Its digits.
        value: The number, in the unit that is shown; not a number where there is none.
        mark: ``"good"``, ``"bad"``, ``"warn"``, ``"best"`` or nothing.
        bar_fraction: Of a whole, from 0 to 1, to be drawn as a bar; None for no bar.
    """

    text: str
    value: float
    mark: str = ""
    bar_fraction: float | None = None


Words = Text | Name
"""What may stand in a line."""

Cell = Text | Name | Number


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: Its header.
        unit: Of its numbers; ``"1"`` where they have no dimension, nothing where it has none.
        left: Whether it is text, and stands on the left.
        detail: Whether a short view leaves it out.
    """

    name: Words
    unit: str = ""
    left: bool = False
    detail: bool = False


@dataclass(frozen=True)
class Table:
    """A table that can be sorted.

    Attributes:
        title: What it shows.
        columns: Its columns; the first is each row's header.
        rows: Per row, its cells.
        notes: Remarks on it.
        source: Where its numbers come from, and how they are verified.
        detail: Whether a short view leaves it out.
    """

    kind: ClassVar[str] = "table"
    title: Words
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[Words, ...] = ()
    source: tuple[Words, ...] = ()
    detail: bool = False


@dataclass(frozen=True)
class Lines:
    """Remarks, one below the other.

    Attributes:
        lines: The remarks.
        mark: ``"bad"`` for failures, ``"warn"`` for what to look at, or nothing.
        title: Over them; None for no title.
        detail: Whether a short view leaves it out.
    """

    kind: ClassVar[str] = "lines"
    lines: tuple[Words, ...]
    mark: str = ""
    title: Words | None = None
    detail: bool = False


@dataclass(frozen=True)
class FilePlace:
    """A line of a file.

    Attributes:
        place: The file's name and the number of its line; or that it is not in the file.
        line: What stands there.
        path: The file and its line as one opens them; empty if it is nowhere.
    """

    place: Words
    line: Words
    path: str = ""


@dataclass(frozen=True)
class FileFinding:
    """What is found at one place of a file, or at two of two files side by side.

    Attributes:
        title: What is found, or what differs.
        columns: Where.
        notes: What it does.
        tag: Of which kind it is, and how bad; None where all are alike.
        detail: Whether a short view leaves it out.
    """

    kind: ClassVar[str] = "sides"
    title: Words
    columns: tuple[FilePlace, ...]
    notes: tuple[Words, ...] = ()
    tag: Words | None = None
    detail: bool = False


@dataclass(frozen=True)
class Listing:
    """A text that is shown letter by letter, such as the changes of a file.

    Attributes:
        title: What it is.
        text: The text.
        language: What it is written in, as Markdown names it: ``diff``.
        detail: Whether a short view leaves it out.
    """

    kind: ClassVar[str] = "listing"
    title: Words
    text: str
    language: str = ""
    detail: bool = False


@dataclass(frozen=True, eq=False)
class Motion:
    """What a view can step through.

    Attributes:
        name: What moves.
        time: (n,) when (s).
        qpos: (n, nq) how the robot is then.
    """

    name: Text
    time: Array
    qpos: Array


@dataclass(frozen=True, eq=False)
class StandScene:
    """A robot as it stands, and what acts on it.

    Attributes:
        robot: The robot.
        stand: How it stands.
        statics: What holds it there, if forces, torques and the com are to be shown.
        motions: What can be stepped through, beside the stand itself.
    """

    robot: Robot
    stand: Stand
    statics: GravityCompensation | None = None
    motions: Sequence[Motion] = ()


@dataclass(frozen=True, eq=False)
class MotionScene:
    """A robot that moves, on level ground at height 0.

    Attributes:
        robot: The robot.
        motions: What can be stepped through; the first is how it begins.
    """

    robot: Robot
    motions: Sequence[Motion]


@dataclass(frozen=True)
class View:
    """A robot that one can turn, where there are three dimensions.

    Attributes:
        title: What it shows.
        scene: What is in it; None where the robot is not at hand.
        note: What it is made of.
        detail: Whether a short view leaves it out.
    """

    kind: ClassVar[str] = "view"
    title: Words
    scene: StandScene | MotionScene | None
    note: Words | None = None
    detail: bool = False


Block = Table | Lines | FileFinding | Listing | Plot | View


@dataclass(frozen=True)
class Document:
    """What is shown of one result.

    Attributes:
        kind: What is shown: an analysis, a stance.
        title: What of: a robot, a file, two files.
        blocks: What is shown, what matters most first.
        passed: The verdict; None where there is none.
        verdict: The verdict in a word or two; None where there is none.
        warned: Whether it is between the two: it has passed, but has something to look at, or has
            not, but for a convention.
        failures: Why the verdict is not better.
        findings: The key figures, and what the verdict rests on.
        details: What else it rests on: after ``findings``, on a terminal with -v.
        brief: Whether its head is the answer: a terminal shows its tables with -v.
        notes: What was assumed, found or left out on the way.
    """

    kind: Words
    title: Words
    blocks: tuple[Block, ...]
    passed: bool | None = None
    verdict: Words | None = None
    warned: bool = False
    failures: tuple[Words, ...] = ()
    findings: tuple[Words, ...] = ()
    notes: tuple[Words, ...] = ()
    details: tuple[Words, ...] = ()
    brief: bool = False

    @property
    def mark(self) -> str:
        """The verdict's emphasis: ``"good"``, ``"bad"``, ``"warn"`` or nothing."""
        if self.passed is None:
            return ""
        return "warn" if self.warned else "good" if self.passed else "bad"


@dataclass(frozen=True)
class Report:
    """What is shown of several results together.

    Attributes:
        title: What they are, and what of.
        documents: One for each.
        overview: What compares them.
    """

    title: Words
    documents: tuple[Document, ...]
    overview: tuple[Block, ...] = ()


def number_cell(value: float | None, form: str, mark: str = "", scale: float = 1.0) -> Number:
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
    text = format_number(shown, form)
    if not float(text.rstrip("%") or "nan"):
        text = format(0.0, form)  # no minus before a zero
    return Number(text, shown, mark)


def vector_cell(values: Sequence[float] | Array, form: str) -> Name:
    """Returns a vector as a cell."""
    return Name(" ".join(number_cell(value, form).text for value in values))
