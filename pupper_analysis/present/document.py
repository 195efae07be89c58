"""Documents: the content of a result as text, tables and plots, independent of the output format.

The builder of a result's type (``documents``) creates a ``Document``. The renderers (terminal, HTML
page, Markdown, PNG) render the document. Texts are stored in the catalogue by key, in English and
Simplified Chinese. No text contains markup. Names in model files may contain any characters, so
each renderer escapes all texts. A ``Plot`` contains axes and values; the renderer chooses the
style.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar

from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from pupper_analysis.base.diagnostics import Diagnostic
    from pupper_analysis.robot.robot import Robot
    from pupper_analysis.stance.stand import Stand
    from pupper_analysis.statics.equilibrium import GravityCompensation
from collections.abc import Iterable

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    CHINESE_SHORT_FORM,
    SHORT_FORM,
    fill_template,
    format_number,
    format_pair,
    is_term,
    phrase,
)
from pupper_analysis.base.diagnostics.diagnostic import Severity

MAX_ANSWER_WIDTH = 100
"""Maximum width [characters] of each line of messages in a short answer. A message that is too
wide is cut at the end of a clause; a message without such an end may be wider. Messages beyond the
width of the second line are only counted. Chosen, not tuned.
"""

SEVERITY_MARKS = {Severity.ERROR: "bad", Severity.WARNING: "warn", Severity.NOTE: ""}
"""{severity of a finding: emphasis of its text in a document}, values of ``Text.mark``."""


def text(key: str, **values: object) -> Text:
    """Create a text in English and Chinese from an entry of the text catalogue, with values.

    Args:
        key: Key in the catalogue (``texts.toml``, ``terms.toml`` or a table ``[texts]`` of a tool).
        **values: Values of the template's placeholders. A ``Text`` is inserted in the language of
            the result.

    Raises:
        KeyError: If the catalogue has no such key.
    """
    short, short_zh = phrase(key, SHORT_FORM), phrase(key, CHINESE_SHORT_FORM)
    return Text(
        _fill_phrase(key, values, "en"),
        lambda: _fill_phrase(key, values, "zh"),
        short=_fill_short(short, values, "en") if short else "",
        short_zh=_fill_short(short_zh, values, "zh") if short_zh else "",
    )


def word(name: str) -> Text | Name:
    """Translate a term of the catalogue ``terms.toml``; return other names, such as joints, as is.

    A string without an entry becomes a `Name`, which is shown untranslated.
    """
    return text(name) if is_term(name) else Name(name)


def join_words(parts: Iterable[Words], comma: str = "comma") -> Text:
    """Join texts and names into one text in both languages, with a short form if a part has one.

    ``comma`` is the catalogue key of the separator.
    """
    listed = list(parts)
    between = text(comma)
    return Text(
        between.en.join(str(_select_string(part, "en")) for part in listed),
        lambda: between.zh.join(str(_select_string(part, "zh")) for part in listed),
        short=_join_short_forms(listed, between.en, "en"),
        short_zh=_join_short_forms(listed, between.zh, "zh"),
    )


def _join_short_forms(parts: Sequence[Words], separator: str, language: str) -> str:
    """Join the short forms of texts and names in a language; empty if no part has a short form."""
    has_short = [isinstance(part, Text) and part.has_short_form(language) for part in parts]
    if not any(has_short):
        return ""
    return separator.join(translate(part, language, short=True) for part in parts)


def get_english(words: Words) -> str:
    """Return the English form of a translated text, or the string of an untranslated name."""
    return translate(words, "en")


def translate(words: Words, language: str, *, short: bool = False) -> str:
    """Return a text in a language ("en", "zh"), or an untranslated `Name` as it is.

    ``short`` selects the short form of a text that has one in the language.
    """
    if not isinstance(words, Text):
        return words.text
    if short and words.has_short_form(language):
        return words.short_zh if language == "zh" else words.short
    return words.zh if language == "zh" else words.en


def _fill_phrase(key: str, values: dict[str, object], language: str) -> str:
    """Format the catalogue entry ``key`` in a language ("en", "zh"), with ``values`` inserted."""
    template = phrase(key, language)
    translated = {name: _select_string(value, language) for name, value in values.items()}
    return fill_template(template, translated, language) if translated else template


def _fill_short(template: str, values: Mapping[str, object], language: str) -> str:
    """Format a short text in a language from a template; inserted texts have their short form."""
    translated = {
        name: _select_string(value, language, short=True) for name, value in values.items()
    }
    return fill_template(template, translated, language)


def _select_string(value: object, language: str, *, short: bool = False) -> object:
    """Return the string of a `Text` or `Name` in a language, or any other value unchanged.

    ``short`` selects the short form of a text that has one in the language.
    """
    return translate(value, language, short=short) if isinstance(value, Text | Name) else value


@dataclass(frozen=True)
class Axis:
    """Axis of a plot: name, unit and number format of a quantity.

    Attributes:
        name: Name of the quantity.
        unit: Unit of the values.
        form: Format specification of the values, such as ``".2f"``.
        low: Lower end of the axis of a line plot; None for the smallest value, with a margin.
        logarithmic: Whether the axis of a line plot is logarithmic. Values must be positive.
    """

    name: Words
    unit: str
    form: str
    low: float | None = None
    logarithmic: bool = False


@dataclass(frozen=True, eq=False)
class Series:
    """Line of a plot.

    Attributes:
        name: Name in the legend.
        x: Horizontal coordinates, shape (n,), in the unit of the axis.
        y: Vertical coordinates, shape (n,), in the unit of the axis. Points that are not finite are
            omitted.
        points: Whether to draw a marker at each point.
        note: Short result beside the name in the legend; None if absent.
        marked_index: Index, in ``x`` and ``y``, of the point with the larger marker; None if no
            point is marked. Without effect if ``points`` is False.
        reference: Whether the other lines are compared with this line, which is grey and dashed.
        shaded: Whether the series is an area, bounded by the polygon of the points, instead of a
            line. Areas are drawn below the lines.
    """

    name: Words
    x: ArrayLike
    y: ArrayLike
    points: bool = False
    note: Words | None = None
    marked_index: int | None = None
    reference: bool = False
    shaded: bool = False


@dataclass(frozen=True)
class PlotBar:
    """Bar of a bar plot.

    Attributes:
        name: Name beside the bar.
        value: Length, in the unit of the axis; NaN for no bar.
        marker: Value marked by a tick, in the unit of the axis; None if absent.
        limit: Largest allowed magnitude, in the unit of the axis; None if absent.
        unit: Unit that is printed after the value; "" for the unit of the axis.
        point: Value marked by a point, in the unit of the axis; None if absent.
        label: Text that is printed instead of value and unit; None for value and unit.
    """

    name: Words
    value: float
    marker: float | None = None
    limit: float | None = None
    unit: str = ""
    point: float | None = None
    label: Words | None = None


@dataclass(frozen=True, eq=False)
class Plot:
    """Base class of plots.

    Attributes:
        title: Title of the plot.
        detail: Always False. Terminals show no plots.
    """

    kind: ClassVar[str] = "plot"
    detail: ClassVar[bool] = False
    title: Words


@dataclass(frozen=True, eq=False)
class LinePlot(Plot):
    """Plot with one or more lines.

    Attributes:
        x: Horizontal axis.
        y: Vertical axis.
        series: Lines.
        note: Meaning of the notes in the legend, or a remark; None without notes.
        equal_scales: Whether a unit has the same length on both axes.
    """

    x: Axis
    y: Axis
    series: Sequence[Series]
    note: Words | None = None
    equal_scales: bool = False


@dataclass(frozen=True, eq=False)
class BarPlot(Plot):
    """Plot with horizontal bars that start at zero.

    Attributes:
        axis: Quantity, unit and format of the lengths.
        bars: Bars, from top to bottom.
        legend: Meaning of a bar's value, marker, limit and point, in this order. An element is None
            if no bar has this part; the last may be absent.
    """

    axis: Axis
    bars: Sequence[PlotBar]
    legend: tuple[Words | None, ...]


@dataclass(frozen=True)
class Text:
    """Text of a report in English and Chinese; ``text`` creates one from the catalogue.

    Attributes:
        en: English text.
        chinese: Simplified Chinese text, or a function that creates the text.
        mark: Emphasis: ``"good"``, ``"bad"``, ``"warn"``, ``"quiet"`` (less weight) or empty.
        short: Short English form, for the short answer on a terminal; empty if there is none.
        short_zh: Short Chinese form; empty if there is none.
    """

    en: str
    chinese: str | Callable[[], str] = field(compare=False)
    mark: str = ""
    short: str = ""
    short_zh: str = field(default="", compare=False)

    @property
    def zh(self) -> str:
        """Simplified Chinese form of this text."""
        return self.chinese if isinstance(self.chinese, str) else self.chinese()

    def with_mark(self, mark: str) -> Text:
        """Return a copy of this text with another emphasis: one of the values of ``Text.mark``."""
        return replace(self, mark=mark)

    def has_short_form(self, language: str) -> bool:
        """Return True if this text has a short form in a language ("en", "zh")."""
        return bool(self.short_zh if language == "zh" else self.short)

    def with_short_form(self, words: Text) -> Text:
        """Return a copy whose short forms are the short forms, or else the texts, of ``words``."""
        short, short_zh = (translate(words, language, short=True) for language in ("en", "zh"))
        return replace(self, short=short, short_zh=short_zh)


def diagnostic_text(diagnostic: Diagnostic, mark: str = "") -> Text:
    """Convert a diagnostic to a text in English and Chinese, with the emphasis ``mark``."""
    short, short_zh = (getattr(diagnostic, form, "") for form in (SHORT_FORM, CHINESE_SHORT_FORM))
    return Text(diagnostic.text("en"), lambda: diagnostic.text("zh"), mark, short, short_zh)


@dataclass(frozen=True)
class Name:
    """Name of a file, joint or option, which is not translated.

    Attributes:
        text: The name.
        mark: Emphasis, as in ``Text``.
    """

    text: str
    mark: str = ""


@dataclass(frozen=True)
class Number:
    """Number: displayed text, and value for sorting.

    Attributes:
        text: Formatted number.
        value: Number in the displayed unit; NaN if there is no number.
        mark: Emphasis: ``"good"``, ``"bad"``, ``"warn"``, ``"best"`` or empty.
        bar_fraction: Length of a bar in the cell, as a fraction of the full bar, 0 to 1; None for
            no bar.
    """

    text: str
    value: float
    mark: str = ""
    bar_fraction: float | None = None


Words = Text | Name
"""Content of a line: a translated text or an untranslated name."""

Cell = Text | Name | Number
"""Content of a table cell: a translated text, an untranslated name, or a number."""


@dataclass(frozen=True)
class Column:
    """Column of a table.

    Attributes:
        name: Header.
        unit: Unit of the numbers; ``"1"`` for dimensionless numbers, empty without a unit.
        left: True for left-aligned text.
        detail: True if the short terminal view omits the column.
    """

    name: Words
    unit: str = ""
    left: bool = False
    detail: bool = False


@dataclass(frozen=True)
class Table:
    """Table whose rows can be sorted.

    Attributes:
        title: Title of the table.
        columns: Columns. The first column contains the row headers.
        rows: Cells of each row, in the order of ``columns``.
        notes: Remarks below the table.
        source: Origin and verification of the numbers.
        detail: True if the short terminal view omits the table.
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
    """List of remarks; each remark is a line.

    Attributes:
        lines: Remarks.
        mark: ``"bad"`` for failures, ``"warn"`` for warnings, or empty.
        title: Title above the remarks; None if absent.
        detail: True if the short terminal view omits the remarks.
    """

    kind: ClassVar[str] = "lines"
    lines: tuple[Words, ...]
    mark: str = ""
    title: Words | None = None
    detail: bool = False


@dataclass(frozen=True)
class FilePlace:
    """Place in a file.

    Attributes:
        place: File name and line number, or the statement that the file does not contain the
            element.
        line: Content of the line.
        path: Path and line number in the form that editors open; empty if the file does not contain
            the element.
    """

    place: Words
    line: Words
    path: str = ""


@dataclass(frozen=True)
class FileFinding:
    """Finding at one place of a file, or at one place of each of two files, shown side by side.

    Attributes:
        title: Description of the finding or difference.
        columns: Places in the files.
        notes: Effects and repairs of the finding.
        tag: Kind and severity; None if all findings are of one kind.
        detail: True if the short terminal view omits the finding.
    """

    kind: ClassVar[str] = "sides"
    title: Words
    columns: tuple[FilePlace, ...]
    notes: tuple[Words, ...] = ()
    tag: Words | None = None
    detail: bool = False


@dataclass(frozen=True)
class Listing:
    """Text that is shown verbatim, such as the changed lines of a file.

    Attributes:
        title: Title of the listing.
        text: The text.
        language: Language for syntax highlighting, as in Markdown, such as ``diff``.
        detail: True if the short terminal view omits the listing.
    """

    kind: ClassVar[str] = "listing"
    title: Words
    text: str
    language: str = ""
    detail: bool = False


@dataclass(frozen=True, eq=False)
class Motion:
    """Sequence of configurations for the 3-D view.

    Attributes:
        name: Name of the motion.
        time: Times, shape (n,) [s].
        qpos: Configurations, shape (n, nq), with the joints in actuator order.
    """

    name: Text
    time: Array
    qpos: Array


@dataclass(frozen=True, eq=False)
class StandScene:
    """Robot in a stand, with the acting forces, for the 3-D view.

    Attributes:
        robot: Robot.
        stand: Stand.
        statics: Static equilibrium; None to omit forces, torques and the centre of mass.
        motions: Motions that the view can play, in addition to the stand.
    """

    robot: Robot
    stand: Stand
    statics: GravityCompensation | None = None
    motions: Sequence[Motion] = ()


@dataclass(frozen=True, eq=False)
class MotionScene:
    """Moving robot on level ground at height 0, for the 3-D view.

    Attributes:
        robot: Robot.
        motions: Motions that the view can play. The first configuration of the first motion is the
            initial configuration.
    """

    robot: Robot
    motions: Sequence[Motion]


@dataclass(frozen=True)
class SceneView:
    """Interactive 3-D view, for renderers that support 3-D.

    Attributes:
        title: Title of the view.
        scene: Content; None if the robot is not available.
        note: Remark on the content; None if absent.
        detail: True if the short terminal view omits the block.
    """

    kind: ClassVar[str] = "view"
    title: Words
    scene: StandScene | MotionScene | None
    note: Words | None = None
    detail: bool = False


Block = Table | Lines | FileFinding | Listing | Plot | SceneView
"""Part of a document: table, remarks, finding in a file, listing, plot, or 3-D view."""


@dataclass(frozen=True)
class NextStep:
    """Proposed next command after a result, without the argument for the robot.

    Attributes:
        command: Name of the command.
        words: Further arguments and options, such as ``("--kp", "10")``.
        robot_typed: True if the next command gets the robot argument that the user typed. False if
            ``words`` contain the files of the robot.
        omitted: Options that the user typed and the next command does not get, such as
            ``"--command"``; ``"*"`` for all options.
        stance_found: True if the next command is for a stance that the running command has found.
            The next command reads the stance from the file of ``--json``. If the user typed no
            such file, the next command gets ``stance_words``; without these, the running command
            with ``--json`` is proposed first.
        stance_words: Options of the stance that was found, such as ``("--height", "10cm")``.
        of_mjcf: True if the next command gets only the MJCF of two typed files, for example because
            the MJCF contains the cause of a failure.
    """

    command: str
    words: tuple[str, ...] = ()
    robot_typed: bool = True
    omitted: tuple[str, ...] = ()
    stance_found: bool = False
    stance_words: tuple[str, ...] = ()
    of_mjcf: bool = False


@dataclass(frozen=True)
class Document:
    """Content of a result to show: verdict, findings, tables, plots and notes.

    The answer of the short view is up to three lines:

    - Line 1 is the verdict with the first failure or finding.
    - Line 2 contains further failures or findings, such as the limit or the cause.
    - Line 3 is the next command.

    Attributes:
        kind: Kind of result, such as an analysis or a stance.
        title: Name of the robot or of the files.
        blocks: Tables, plots and remarks, the most important first.
        passed: True if the verdict is good; None without a verdict.
        verdict: Verdict in one or two words; None without a verdict.
        warned: True if the mark of the verdict is a warning instead of good or bad.
        failures: Reasons of a bad verdict.
        findings: Requested number, limit or cause, and warnings.
        details: Further statements; a terminal prints these statements with -v only.
        brief: True if verdict and key figures are the answer. A terminal then prints tables and
            notes with -v only.
        notes: Assumptions, findings and omissions.
        next_step: Command to run next; None if the result suggests none.
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
    next_step: NextStep | None = None

    @property
    def mark(self) -> str:
        """Emphasis of the verdict, ``"good"``, ``"bad"`` or ``"warn"``; empty without a verdict."""
        if self.passed is None:
            return ""
        return "warn" if self.warned else "good" if self.passed else "bad"


@dataclass(frozen=True)
class Report:
    """Documents of several results, with an overview that compares the results.

    Attributes:
        title: Title of the report.
        documents: A document per result.
        overview: Blocks that compare the results.
    """

    title: Words
    documents: tuple[Document, ...]
    overview: tuple[Block, ...] = ()


def number_cell(value: float | None, form: str, mark: str = "", scale: float = 1.0) -> Number:
    """Create a table cell with a number, converted from SI units to the displayed unit.

    Args:
        value: Number in SI units. None is shown as a dash.
        form: Format specification, such as ``".3f"`` or ``".1%"``.
        mark: Emphasis, as in ``Number``.
        scale: Factor from SI units to the displayed unit.
    """
    if value is None:
        return Number("-", math.nan, mark)
    shown = scale * float(value)
    text = format_number(shown, form)
    if not float(text.rstrip("%") or "nan"):
        text = format_number(0.0, form)  # no minus before a zero
    return Number(text, shown, mark)


def widen_format(form: str, values: Iterable[float]) -> str:
    """Return a fixed-point format with at least two significant digits for the largest magnitude.

    The format has the decimals of ``form``, such as ``"+.4f"``, or more, up to nine
    (`_MAX_DECIMALS`).
    """
    start, decimals = form[:-1].split(".")
    largest = max((abs(value) for value in values if math.isfinite(value)), default=0.0)
    needed = 1 - math.floor(math.log10(largest)) if largest > 0 else 0
    return f"{start}.{min(max(int(decimals), needed), _MAX_DECIMALS)}f"


def fits_first_line(word: Text, name: str, message: Text) -> bool:
    """Return True if the short form of a verdict with a robot's name and a message fits on a line.

    Otherwise the end of the message would be cut (`MAX_ANSWER_WIDTH`).
    """
    line = f"{word.short or word.en} {name}: {message.short or message.en}"
    return len(line) <= MAX_ANSWER_WIDTH


def format_widened(value: float, form: str) -> str:
    """Format a number by a fixed-point format with at least two significant digits.

    ``form`` is a format such as ``".2f"`` (`widen_format`): the mass of a robot of 0.00317 kg is
    not printed as 0.00.
    """
    return format(value, widen_format(form, [value]))


_MAX_DECIMALS = 9
"""Largest number of decimals of a fixed-point format with more digits for small values [1]. Chosen,
not tuned."""


def pair_cells(first: float, second: float, form: str) -> tuple[Number, Number]:
    """Create two table cells with numbers to compare, with enough digits to show the difference.

    The numbers are in the displayed unit. ``form`` is a format such as ``".4g"``.
    """
    texts = format_pair(float(first) + 0.0, float(second) + 0.0, form)
    return Number(texts[0], float(first)), Number(texts[1], float(second))


def vector_cell(values: Sequence[float] | Array, form: str) -> Name:
    """Create a table cell with the numbers of a vector, shape (n,), separated by spaces.

    ``form`` is the format of each number, such as ``"+.3f"``.
    """
    return Name(" ".join(number_cell(value, form).text for value in values))
