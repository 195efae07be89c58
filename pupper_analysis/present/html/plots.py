"""Convert plots to inline SVG of an HTML page: lines and bars, with values at the mouse pointer.

A mark is a dictionary that the template writes as an SVG element. ``tag`` is the name of the
element, ``words`` a displayed text, ``points`` positions of shape (n, 2). ``labels`` contains a
text for each position.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array
from pupper_analysis.present.document import (
    Axis,
    BarPlot,
    LinePlot,
    Name,
    Plot,
    Series,
    Text,
    Words,
    number_cell,
    text,
)

Mark = Mapping[str, Any]
"""SVG element of a plot: {"tag": name of the element, attribute: value}."""

PLOT_WIDTH, PLOT_HEIGHT = 640.0, 300.0
"""Size of a line plot [CSS pixels]. A bar plot has the same width."""
LEFT_MARGIN, RIGHT_MARGIN, TOP_MARGIN, BOTTOM_MARGIN = 78.0, 14.0, 12.0, 44.0
"""Margins of a line plot for ticks and axis names [CSS pixels]. A bar plot has the same margins at
top and bottom."""

MAX_LINE_POINTS = 160
"""Largest number of points of a line, in addition to the marked point. This is one point per four
pixels of the plot's width. Chosen, not tuned.
"""

LETTER_WIDTH, MAX_BAR_NAME_LENGTH = 8.0, 28
"""Approximate width of a character on a phone [CSS pixels], and the largest number of characters of
the untranslated name (``Name``) of a bar. Chosen, not tuned."""

DOT_RADIUS, MARKED_DOT_RADIUS = 3.5, 6.0
"""Radius of a point [CSS pixels], and of the marked point of a series."""

NUM_SERIES_STYLES = 6
"""Number of series styles in the style sheet (``s0`` ...), with different colours and dashes.
Further series use the same styles again, from the first.
"""


AREA_CLASS, REFERENCE_CLASS = "area", "reference"
"""Classes of the style sheet of a shaded area, and of a line with which other lines are compared.
"""

DOT_OUTLINES: dict[str, tuple[tuple[float, float], ...]] = {
    "s1": ((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)),
    "s2": ((0.0, -1.1), (1.05, 0.85), (-1.05, 0.85)),
    "s3": ((0.0, -1.2), (1.0, 0.0), (0.0, 1.2), (-1.0, 0.0)),
    "s4": ((0.0, 1.1), (-1.05, -0.85), (1.05, -0.85)),
    "s5": ((-0.35, -1.1), (0.35, -1.1), (0.35, -0.35), (1.1, -0.35), (1.1, 0.35), (0.35, 0.35),
           (0.35, 1.1), (-0.35, 1.1), (-0.35, 0.35), (-1.1, 0.35), (-1.1, -0.35), (-0.35, -0.35)),
}  # fmt: skip
"""{class of the style sheet: corners of a point, divided by its radius, with y downwards}: square,
triangle, diamond, triangle that points down, and plus. Points of ``s0`` are circles."""


@dataclass(frozen=True)
class Drawing:
    """Plot that was converted to SVG elements (marks), in the user units of the SVG.

    Attributes:
        title: Title.
        width: Width [CSS pixels].
        height: Height [CSS pixels].
        marks: Lines, points and words, in drawing order.
        legend: (text of the entry, class of the style sheet) pairs. The class of a series that is a
            single point is ``dot`` and the style, such as ``dot s1``.
        note: Meaning of the notes in the legend; None if absent.
    """

    kind: ClassVar[str] = "plot"
    title: Words
    width: float
    height: float
    marks: tuple[Mark, ...]
    legend: tuple[tuple[Words, str], ...] = ()
    note: Words | None = None


@singledispatch
def draw_svg(plot: Plot) -> Drawing:
    """Convert a plot to lines, points and words of an SVG image.

    Raises:
        TypeError: If there is no implementation for this type of plot.
    """
    raise TypeError(f"no drawing of {type(plot).__name__}")


_MIN_HEIGHT_RATIO = 1e-3
"""Lower bound of the range of a line plot's vertical axis, divided by the larger magnitude of its
ends [1]. In a much smaller range, tick labels could be equal.
"""


def format_axis_value(axis: Axis, value: float) -> str:
    """Format a value on an axis of a plot, with the number format and the unit of the axis."""
    return f"{number_cell(value, axis.form).text} {axis.unit}"


_MIN_SPAN_OF_ANGLES = 60.0
"""Range of a horizontal axis [deg] above which its ticks are at multiples of 15, 30, 45 or 90 deg.
Chosen, not tuned.
"""


def round_ticks(low: float, high: float, count: int = 5, *, degrees: bool = False) -> list[float]:
    """Choose up to ``count`` + 1 round tick values of an axis from ``low`` to ``high``, ascending.

    The values are multiples of 1, 2 or 5 times a power of 10. If ``degrees`` is True and the range
    is large, the values are multiples of 15, 30, 45, or a multiple of 90.
    """
    span = max(high - low, 1e-12)
    power = 10.0 ** math.floor(math.log10(span / count))
    steps = (size * power for size in (1, 2, 5, 10))
    if degrees and span > _MIN_SPAN_OF_ANGLES:
        steps = (float(size) for size in (15, 30, 45, 90))
    turns = 90.0 * math.ceil(span / (90.0 * count))
    step = next((size for size in steps if size * count >= span), turns)
    first = math.ceil(low / step - 1e-9)
    return [round(index * step, 12) for index in range(first, math.floor(high / step + 1e-9) + 1)]


@draw_svg.register
def _draw_line_plot(plot: LinePlot) -> Drawing:
    """Convert a line plot to a drawing: grid, axes and lines, each line with labelled points.

    The size is `PLOT_WIDTH` by `PLOT_HEIGHT` [CSS pixels]; with equal scales, the height is larger
    if the data require this. Points that are not finite are omitted.
    """
    x, y, series = plot.x, plot.y, plot.series
    lines, marked = [], []
    for line_series in series:
        values = np.column_stack(
            [np.asarray(line_series.x, dtype=float), np.asarray(line_series.y, dtype=float)]
        )
        drawn = _select_drawn_points(values, line_series.marked_index)
        lines.append(values[drawn])
        marked.append(next(iter(np.flatnonzero(drawn == line_series.marked_index).tolist()), None))
    points = np.concatenate(lines) if any(map(len, lines)) else np.ones((1, 2))
    inside = any(line_series.points or bool(np.any(np.diff(line[:, 0]) < 0))
                 for line_series, line in zip(series, lines, strict=True))  # fmt: skip
    left, right = _compute_axis_range(x, points[:, 0], _X_MARGIN if inside else 0.0)
    low, high = _compute_axis_range(y, points[:, 1], _Y_MARGIN)
    flat = _MIN_HEIGHT_RATIO * max(abs(low), abs(high)) - (high - low)
    if flat > 0 and not y.logarithmic:
        low, high = low - flat / 2, high + flat / 2
    wide, tall = PLOT_WIDTH - LEFT_MARGIN - RIGHT_MARGIN, PLOT_HEIGHT - TOP_MARGIN - BOTTOM_MARGIN
    if plot.equal_scales:
        tall = min(max(tall, wide * (high - low) / (right - left)), _MAX_HEIGHT_RATIO * wide)
        size = max((right - left) / wide, (high - low) / tall)  # of a CSS pixel
        left, right = _widen_range(left, right, size * wide)
        low, high = _widen_range(low, high, size * tall)
    scale_x, scale_y = _select_scale(x), _select_scale(y)

    def place(values: Array) -> Array:
        """Convert data, shape (n, 2), to positions in the SVG, shape (n, 2) [CSS pixels]."""
        start, end = scale_x(np.array([left, right]))
        bottom, top = scale_y(np.array([low, high]))
        across = LEFT_MARGIN + wide * (scale_x(values[:, 0]) - start) / (end - start)
        up = TOP_MARGIN + tall * (top - scale_y(values[:, 1])) / (top - bottom)
        return np.column_stack([across, up])

    columns = {v: place(np.array([[v, points[0, 1]]]))[0, 0] for v in _list_ticks(x, left, right)}
    rows = {v: place(np.array([[points[0, 0], v]]))[0, 1] for v in _list_ticks(y, low, high)}
    marks = [
        *draw_grid(columns, rows, wide, tall),
        *draw_axes(x.name, y.name, wide, tall, (x.unit, y.unit)),
    ]
    styles = select_styles(series)
    drawn_series = sorted(
        enumerate(zip(series, lines, marked, strict=True)), key=lambda item: not item[1][0].shaded
    )
    for index, (line_series, line, mark) in drawn_series:
        labels = [
            f"{format_axis_value(x, across)}, {format_axis_value(y, up)}" for across, up in line
        ]
        style = styles[index]
        marks += draw_series(place(line), labels, replace(line_series, marked_index=mark), style)
    return Drawing(
        plot.title,
        PLOT_WIDTH,
        TOP_MARGIN + tall + BOTTOM_MARGIN,
        tuple(marks),
        draw_legend(series),
        plot.note,
    )


_Y_MARGIN = 0.06
"""Margin of the vertical axis [1], relative to the range of the values. Chosen, not tuned."""

_MAX_HEIGHT_RATIO = 0.6
"""Largest height of a plot with equal scales, divided by the width [1]. Chosen, not tuned."""


def _select_scale(axis: Axis) -> Callable[[Array], Array]:
    """Return the function that converts values, shape (n,), to positions along an axis [1]."""
    return np.log10 if axis.logarithmic else np.asarray


def _compute_axis_range(axis: Axis, values: Array, margin: float) -> tuple[float, float]:
    """Compute the ends of an axis, with a margin relative to the range of the values."""
    if axis.logarithmic:
        low, high = _compute_range(np.log10(values), margin)
        return float(10.0**low), float(10.0**high)
    if axis.low is None:
        return _compute_range(values, margin)
    _, high = _compute_range(np.append(values, axis.low), margin)
    return axis.low, high


def _widen_range(low: float, high: float, span: float) -> tuple[float, float]:
    """Widen a range to ``span``, with the same centre."""
    return (low + high - span) / 2, (low + high + span) / 2


def _list_ticks(axis: Axis, low: float, high: float) -> list[float]:
    """List the values of the ticks between the ends of an axis, ascending."""
    if axis.logarithmic:
        return round_log_ticks(low, high)
    return round_ticks(low, high, 6, degrees=axis.unit in ("°", "deg"))


_MAX_FINE_DECADES = 3.0
"""Largest range of a logarithmic axis [decades] with ticks at 1, 2 and 5 times each power of 10. A
larger range has a tick per power. Chosen, not tuned.
"""

_MIN_LOG_TICKS = 3
"""Smallest number of ticks of a logarithmic axis, if possible. Chosen, not tuned."""


def round_log_ticks(low: float, high: float) -> list[float]:
    """Choose round tick values of a logarithmic axis from ``low`` to ``high``, ascending.

    If fewer than `_MIN_LOG_TICKS` values at 1, 2 and 5 times a power of 10 are inside, there are
    further values; in a small range, the values are those of a linear axis.
    """
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    fine = math.log10(high / low) <= _MAX_FINE_DECADES
    for digits in (["1", "2", "5"] if fine else ["1"], ["1", "1.5", "2", "3", "5", "7"]):
        values = [float(f"{digit}e{power}") for power in powers for digit in digits]
        inside = [value for value in values if low <= value <= high]
        if len(inside) >= _MIN_LOG_TICKS:
            return inside
    return round_ticks(low, high)


_X_MARGIN = 0.03
"""Margin of the horizontal axis [1], relative to the range of the values, if the plot contains
points or a closed curve, for example. Without a margin, the axes would cover half of the outermost
points. Chosen, not tuned.
"""


_ROUNDING_RATIO = 1e-9
"""Upper bound [1] of the magnitude of a negative value, divided by the largest value or limit, that
counts as a rounding error. The bar plot then has no negative side. Chosen, not tuned.
"""


_BAR_POINT_CLASS, _BAR_POINT_RADIUS = "dot s1", 4.5
"""Classes of the style sheet, and radius [CSS pixels], of the point of a bar."""


@draw_svg.register
def _draw_bar_plot(plot: BarPlot) -> Drawing:
    """Convert a bar plot to a drawing: a row per bar, with name, value, limit and marker.

    The width is `PLOT_WIDTH` [CSS pixels]; the height depends on the number of bars.
    """
    axis, bars = plot.axis, plot.bars
    shown = [_shorten_name(bar.name) for bar in bars]
    numbers = [
        bar.label or Name(f"{number_cell(bar.value, axis.form).text} {bar.unit or axis.unit}")
        for bar in bars
    ]
    names = 24.0 + LETTER_WIDTH * max(map(_count_characters, shown))
    values, step = 24.0 + LETTER_WIDTH * max(map(_count_characters, numbers)), 22.0
    wide, tall = PLOT_WIDTH - names - values, step * len(bars)
    limits = [bar.limit for bar in bars if bar.limit is not None and math.isfinite(bar.limit)]
    ends = [value for bar in bars for value in (bar.value, bar.marker, bar.point)
            if value is not None and math.isfinite(value)]  # fmt: skip
    reach = max([*map(abs, ends), *limits, 1e-9])
    one_sided = all(end >= -_ROUNDING_RATIO * reach for end in ends)
    low = 0.0 if one_sided else -reach

    def at(value: float) -> float:
        """Return the x coordinate in the drawing [CSS pixels] of a value on the axis."""
        return names + wide * (value - low) / (reach - low)

    marks: list[Mark] = []
    for value in round_ticks(low, reach):
        marks.append(draw_line(at(value), TOP_MARGIN, at(value), TOP_MARGIN + tall, "grid"))
        marks.append(draw_words(at(value), TOP_MARGIN + tall + 16, Name(f"{value:g}"), "middle"))
    for index, (bar, name, number) in enumerate(zip(bars, shown, numbers, strict=True)):
        middle = TOP_MARGIN + step * (index + 0.5)
        if math.isfinite(bar.value):
            start, end = sorted((at(0.0), at(bar.value)))
            bounds = {"x": start, "y": middle - 6, "width": max(end - start, 0.5), "height": 12.0}
            marks.append({"tag": "rect", "class": "bar", **bounds})
        if bar.limit is not None and math.isfinite(bar.limit):
            for side in (1.0,) if one_sided else (1.0, -1.0):
                edge = at(side * bar.limit)
                marks.append(draw_line(edge, middle - 8, edge, middle + 8, "limit"))
        if bar.marker is not None and math.isfinite(bar.marker):
            edge = at(bar.marker)
            marks.append(draw_line(edge, middle - 8, edge, middle + 8, "other"))
        if bar.point is not None and math.isfinite(bar.point):
            place = {"cx": at(bar.point), "cy": middle, "r": _BAR_POINT_RADIUS}
            marks.append({"tag": "dot", "class": _BAR_POINT_CLASS, **place})
        marks.append(draw_words(names - 8, middle + 4, name, "end"))
        marks.append(draw_words(PLOT_WIDTH - 4, middle + 4, number, "end"))
    marks.append(draw_line(at(0.0), TOP_MARGIN, at(0.0), TOP_MARGIN + tall, "axis"))
    marks.append(
        draw_words(names + wide / 2, TOP_MARGIN + tall + 36, axis.name, "middle", axis.unit)
    )
    kinds = zip(plot.legend, ("bar", "other", "limit", _BAR_POINT_CLASS), strict=False)
    legend = tuple((words, kind) for words, kind in kinds if words is not None)
    return Drawing(plot.title, PLOT_WIDTH, TOP_MARGIN + tall + BOTTOM_MARGIN, tuple(marks), legend)


def draw_legend(series: Sequence[Series]) -> tuple[tuple[Words, str], ...]:
    """Create the legend of a line plot: (name, class of the style sheet) of each line.

    If a series has a note, the name contains the note.
    """
    return tuple(
        (
            line_series.name
            if line_series.note is None
            else text("name-note", name=line_series.name, note=line_series.note),
            _select_legend_class(line_series, style),
        )
        for line_series, style in zip(series, select_styles(series), strict=True)
    )


def select_styles(series: Sequence[Series]) -> list[str]:
    """Return a class of the style sheet for each series.

    Lines have ``s0``, ``s1`` ... in their order. References, such as the requested height, have
    `REFERENCE_CLASS`, so that the first line has the first colour in each plot. Areas have
    `AREA_CLASS`.
    """
    numbers = itertools.count()
    return [
        AREA_CLASS
        if line_series.shaded
        else REFERENCE_CLASS
        if line_series.reference
        else f"s{next(numbers) % NUM_SERIES_STYLES}"
        for line_series in series
    ]


def _select_legend_class(series: Series, style: str) -> str:
    """Return the class of a legend entry: an area, a point without a line, or a line."""
    return f"dot {style}" if series.points and np.size(series.x) == 1 else style


def _count_characters(words: Words) -> int:
    """Return the number of characters of a name, or of a text in its longer language."""
    return max(len(words.en), len(words.zh)) if isinstance(words, Text) else len(str(words.text))


def _shorten_name(words: Words) -> Words:
    """Cut the start of a `Name` that is too long for the space beside a bar; keep a `Text`."""
    if isinstance(words, Name) and len(words.text) > MAX_BAR_NAME_LENGTH:
        return Name(f"…{words.text[1 - MAX_BAR_NAME_LENGTH :]}")
    return words


def _select_drawn_points(points: Array, marked_index: int | None) -> NDArray[np.intp]:
    """Select the points of a line to draw; return their indices in ``points``, shape (n, 2).

    These are finite points, thinned to about `MAX_LINE_POINTS`.
    """
    finite = np.flatnonzero(np.isfinite(points).all(axis=1))
    if len(finite) <= MAX_LINE_POINTS:
        return finite
    kept = finite[np.linspace(0, len(finite) - 1, MAX_LINE_POINTS).round().astype(int)]
    return np.union1d(kept, np.intersect1d(finite, [-1 if marked_index is None else marked_index]))


def _compute_range(values: Array, margin: float) -> tuple[float, float]:
    """Compute the bounds of an axis: the range of the values, extended by a fraction ``margin``.

    If the values are equal, their magnitude, or 1 if they are 0, replaces the range.
    """
    low, high = float(values.min()), float(values.max())
    span = high - low or abs(high) or 1.0
    return low - margin * span, high + margin * span if high > low or margin else high + span


def draw_grid(
    across: Mapping[float, float], up: Mapping[float, float], wide: float, tall: float
) -> list[Mark]:
    """Create the SVG marks of vertical and horizontal grid lines, each with the value.

    ``across`` is {value: x coordinate of the vertical line}, ``up`` is {value: y coordinate of the
    horizontal line}; ``wide`` and ``tall`` are the size of the grid [CSS pixels]. y points down.
    """
    marks: list[Mark] = []
    for value, at in across.items():
        marks.append(draw_line(at, TOP_MARGIN, at, TOP_MARGIN + tall, "grid"))
        marks.append(draw_words(at, TOP_MARGIN + tall + 16, Name(f"{value:g}"), "middle"))
    for value, at in up.items():
        marks.append(draw_line(LEFT_MARGIN, at, LEFT_MARGIN + wide, at, "grid"))
        marks.append(draw_words(LEFT_MARGIN - 6, at + 4, Name(f"{value:g}"), "end"))
    return marks


def draw_axes(
    x: Words, y: Words, wide: float, tall: float, units: tuple[str, str] = ("", "")
) -> list[Mark]:
    """Create the SVG marks of the x and y axis, with names and units.

    ``wide`` and ``tall`` are the lengths of the axes [CSS pixels].
    """
    up = draw_words(14, TOP_MARGIN + tall / 2, y, "middle", units[1])
    return [
        draw_line(LEFT_MARGIN, TOP_MARGIN + tall, LEFT_MARGIN + wide, TOP_MARGIN + tall, "axis"),
        draw_line(LEFT_MARGIN, TOP_MARGIN, LEFT_MARGIN, TOP_MARGIN + tall, "axis"),
        draw_words(LEFT_MARGIN + wide / 2, TOP_MARGIN + tall + 36, x, "middle", units[0]),
        {**up, "transform": f"rotate(-90 14 {TOP_MARGIN + tall / 2:g})"},
    ]


def draw_series(places: Array, labels: Sequence[str], series: Series, style: str) -> list[Mark]:
    """Create the SVG marks of a series: a polyline, and dots if ``Series.points`` is true.

    Args:
        places: Points, shape (n, 2) [CSS pixels]; y points down.
        labels: Text of each point, shown at the mouse pointer.
        series: Series; ``marked_index`` refers to ``places``.
        style: Class of the style sheet (`select_styles`).
    """
    rounded = np.round(places, 1).tolist()
    if series.shaded:
        return [{"tag": "polygon", "class": style, "points": rounded}]
    marks: list[Mark] = [
        {
            "tag": "polyline",
            "class": f"series {style}",
            "points": rounded,
            "labels": list(labels),
            "name": series.name,
        }
    ]
    marks += [
        {"tag": "dot", "class": f"dot {style}", "cx": cx, "cy": cy,
         "r": MARKED_DOT_RADIUS if point == series.marked_index else DOT_RADIUS}
        for point, (cx, cy) in enumerate(rounded if series.points else [])
    ]  # fmt: skip
    return marks


def draw_line(x1: float, y1: float, x2: float, y2: float, style: str) -> Mark:
    """Create the SVG mark of a line from (x1, y1) to (x2, y2) [CSS pixels].

    ``style`` is a class of the style sheet.
    """
    return {"tag": "line", "class": style, "x1": x1, "y1": y1, "x2": x2, "y2": y2}


def draw_words(x: float, y: float, words: Words, anchor: str, unit: str = "") -> Mark:
    """Create the SVG mark of a text; its base line is at (x, y) [CSS pixels], with y downwards.

    ``anchor`` is the part of the text at ``x``: ``start``, ``middle`` or ``end``. ``unit`` follows
    the text in brackets.
    """
    return {
        "tag": "text",
        "class": "words",
        "x": x,
        "y": y,
        "words": words,
        "anchor": anchor,
        "unit": unit,
    }
