"""Plots drawn as inline SVG: lines, bars and directions, with values that show under the pointer.

A mark is a dictionary that the template writes as one element: ``tag`` names it, ``words`` is a
text that it shows, ``points`` are places (n, 2) with one of ``labels`` each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import singledispatch
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

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

Array = NDArray[np.float64]
Mark = Mapping[str, Any]

WIDTH, HEIGHT = 640.0, 300.0
LEFT, RIGHT, TOP, BOTTOM = 78.0, 14.0, 12.0, 44.0
"""Of a drawing (CSS pixels): itself, and what its axes' words need around it."""

MOST_POINTS = 160
"""Points of a line: one per four pixels of its width, which is as near as a pointer can be put."""

LETTER, LONGEST = 7.0, 28
"""Width of a letter (CSS pixels), and letters of a name for which there is room beside a bar."""

DOT, MARKED = 3.5, 6.0
"""Radius of a point (CSS pixels), and of the one that matters most."""

STYLES = 6
"""Styles of series in the style sheet (``s0`` ...), each of its own colour, dashes and marker."""


@dataclass(frozen=True)
class Drawing:
    """A drawing, with its marks in the user's units of an SVG.

    Attributes:
        title: What it shows.
        width: Of the drawing.
        height: Of the drawing.
        marks: Its lines, points and words, in the order in which they are drawn.
        legend: (words, class) of each series.
        note: What is beside the names in it; None for nothing.
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
    """Draws a plot.

    Raises:
        TypeError: If nobody has said how such a plot is drawn.
    """
    raise TypeError(f"no drawing of {type(plot).__name__}")


_FLAT = 1e-3
"""Least height of a drawing, in parts of its values: less than that is level, and would have the
same six digits at all of its lines."""


def draw_label(axis: Axis, value: float) -> str:
    """Writes a value with its unit."""
    return f"{number_cell(value, axis.form).text} {axis.unit}"


def round_ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Returns round values between two, about as many as asked for."""
    span = max(high - low, 1e-12)
    power = 10.0 ** math.floor(math.log10(span / count))
    step = next(size * power for size in (1, 2, 5, 10) if size * power * count >= span)
    first = math.ceil(low / step - 1e-9)
    return [round(index * step, 12) for index in range(first, math.floor(high / step + 1e-9) + 1)]


@draw_svg.register
def _lines(plot: LinePlot) -> Drawing:
    x, y, series = plot.x, plot.y, plot.series
    lines = []
    for one in series:
        across, up = (np.asarray(values, dtype=float) for values in (one.x, one.y))
        good = np.isfinite(across) & np.isfinite(up)
        lines.append(_thinned(np.column_stack([across[good], up[good]])))
    points = np.concatenate(lines) if any(map(len, lines)) else np.ones((1, 2))
    left, right = _range(points[:, 0], 0.0)
    low, high = _range(points[:, 1], 0.06)
    flat = _FLAT * max(abs(low), abs(high)) - (high - low)
    if flat > 0:
        low, high = low - flat / 2, high + flat / 2
    wide, tall = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def place(values: Array) -> Array:
        across = LEFT + wide * (values[:, 0] - left) / (right - left)
        up = TOP + tall * (high - values[:, 1]) / (high - low)
        return np.column_stack([across, up])

    columns = {v: place(np.array([[v, points[0, 1]]]))[0, 0]
              for v in round_ticks(left, right, 6)}  # fmt: skip
    rows = {v: place(np.array([[points[0, 0], v]]))[0, 1]
          for v in round_ticks(low, high, 6)}  # fmt: skip
    marks = [
        *draw_grid(columns, rows, wide, tall),
        *draw_axes(x.name, y.name, wide, tall, (x.unit, y.unit)),
    ]
    for index, (one, line) in enumerate(zip(series, lines, strict=True)):
        labels = [f"{draw_label(x, across)}, {draw_label(y, up)}" for across, up in line]
        marks += draw_series(place(line), labels, one, index)
    return Drawing(plot.title, WIDTH, HEIGHT, tuple(marks), draw_legend(series), plot.note)


_ROUNDED = 1e-9
"""Of what is drawn: less below zero is rounding, and draws no second side."""


@draw_svg.register
def _bars(plot: BarPlot) -> Drawing:
    axis, bars = plot.axis, plot.bars
    shown = [_shortened(bar.name) for bar in bars]
    names, values, step = 24.0 + LETTER * max(map(_letters, shown)), 84.0, 22.0
    wide, tall = WIDTH - names - values, step * len(bars)
    limits = [bar.limit for bar in bars if bar.limit is not None and math.isfinite(bar.limit)]
    reach = max([abs(bar.value) for bar in bars] + limits + [1e-9])
    one_sided = all(bar.value >= -_ROUNDED * reach for bar in bars)
    low = 0.0 if one_sided else -reach

    def at(value: float) -> float:
        return names + wide * (value - low) / (reach - low)

    marks: list[Mark] = []
    for value in round_ticks(low, reach):
        marks.append(draw_line(at(value), TOP, at(value), TOP + tall, "grid"))
        marks.append(word_at(at(value), TOP + tall + 16, Name(f"{value:g}"), "middle"))
    for index, (bar, name) in enumerate(zip(bars, shown, strict=True)):
        middle = TOP + step * (index + 0.5)
        start, end = sorted((at(0.0), at(bar.value)))
        bounds = {"x": start, "y": middle - 6, "width": max(end - start, 0.5), "height": 12.0}
        marks.append({"tag": "rect", "class": "bar", **bounds})
        if bar.limit is not None and math.isfinite(bar.limit):
            for side in (1.0,) if one_sided else (1.0, -1.0):
                edge = at(side * bar.limit)
                marks.append(draw_line(edge, middle - 8, edge, middle + 8, "limit"))
        if bar.other is not None and math.isfinite(bar.other):
            edge = at(bar.other)
            marks.append(draw_line(edge, middle - 8, edge, middle + 8, "other"))
        marks.append(word_at(names - 8, middle + 4, name, "end"))
        marks.append(word_at(WIDTH - 4, middle + 4, Name(draw_label(axis, bar.value)), "end"))
    marks.append(draw_line(at(0.0), TOP, at(0.0), TOP + tall, "axis"))
    marks.append(word_at(names + wide / 2, TOP + tall + 36, axis.name, "middle", axis.unit))
    kinds = zip(plot.legend, ("bar", "other", "limit"), strict=True)
    legend = tuple((words, kind) for words, kind in kinds if words is not None)
    return Drawing(plot.title, WIDTH, TOP + tall + BOTTOM, tuple(marks), legend)


def draw_legend(series: Sequence[Series]) -> tuple[tuple[Words, str], ...]:
    """Returns each line's name, with what it comes to, and its style."""
    return tuple(
        (
            one.name if one.note is None else text("name-note", name=one.name, note=one.note),
            f"s{index % STYLES}",
        )
        for index, one in enumerate(series)
    )


def _letters(words: Words) -> int:
    return max(len(words.en), len(words.zh)) if isinstance(words, Text) else len(str(words.text))


def _shortened(words: Words) -> Words:
    """Returns a name that fits beside its bar: its end, where names differ."""
    if isinstance(words, Name) and len(words.text) > LONGEST:
        return Name(f"…{words.text[1 - LONGEST :]}")
    return words


def _thinned(points: Array) -> Array:
    """Returns at most ``MOST_POINTS`` of them, the first and the last included."""
    if len(points) <= MOST_POINTS:
        return points
    kept: Array = points[
        np.unique(np.linspace(0, len(points) - 1, MOST_POINTS).round().astype(int))
    ]
    return kept


def _range(values: Array, room: float) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    span = high - low or abs(high) or 1.0
    return low - room * span, high + room * span if high > low or room else high + span


def draw_grid(
    across: Mapping[float, float], up: Mapping[float, float], wide: float, tall: float
) -> list[Mark]:
    """Returns lines at values of both axes, {value: where}, with the values beside them."""
    marks: list[Mark] = []
    for value, at in across.items():
        marks.append(draw_line(at, TOP, at, TOP + tall, "grid"))
        marks.append(word_at(at, TOP + tall + 16, Name(f"{value:g}"), "middle"))
    for value, at in up.items():
        marks.append(draw_line(LEFT, at, LEFT + wide, at, "grid"))
        marks.append(word_at(LEFT - 6, at + 4, Name(f"{value:g}"), "end"))
    return marks


def draw_axes(
    x: Words, y: Words, wide: float, tall: float, units: tuple[str, str] = ("", "")
) -> list[Mark]:
    """Returns both axes, with what they say."""
    up = word_at(14, TOP + tall / 2, y, "middle", units[1])
    return [
        draw_line(LEFT, TOP + tall, LEFT + wide, TOP + tall, "axis"),
        draw_line(LEFT, TOP, LEFT, TOP + tall, "axis"),
        word_at(LEFT + wide / 2, TOP + tall + 36, x, "middle", units[0]),
        {**up, "transform": f"rotate(-90 14 {TOP + tall / 2:g})"},
    ]


def draw_series(places: Array, labels: Sequence[str], one: Series, index: int) -> list[Mark]:
    """Returns a line through places (n, 2), which have labels, and its points."""
    rounded = np.round(places, 1).tolist()
    style = f"s{index % STYLES}"
    marks: list[Mark] = [
        {
            "tag": "polyline",
            "class": f"series {style}",
            "points": rounded,
            "labels": list(labels),
            "name": one.name,
        }
    ]
    marks += [
        {"tag": "circle", "class": f"dot {style}", "cx": cx, "cy": cy,
         "r": MARKED if number_cell == one.marked else DOT}
        for number_cell, (cx, cy) in enumerate(rounded if one.points else [])
    ]  # fmt: skip
    return marks


def draw_line(x1: float, y1: float, x2: float, y2: float, style: str) -> Mark:
    """Returns a straight line."""
    return {"tag": "line", "class": style, "x1": x1, "y1": y1, "x2": x2, "y2": y2}


def word_at(x: float, y: float, words: Words, anchor: str, unit: str = "") -> Mark:
    """Returns words at a place; their ``anchor`` is ``start``, ``middle`` or ``end``."""
    return {
        "tag": "text",
        "class": "words",
        "x": x,
        "y": y,
        "words": words,
        "anchor": anchor,
        "unit": unit,
    }
