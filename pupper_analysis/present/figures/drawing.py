"""Plots drawn by matplotlib: of each description what belongs into one pair of axes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import FixedLocator, MaxNLocator, NullFormatter, NullLocator
from numpy.typing import NDArray

from pupper_analysis.present.document import (
    Axis,
    BarPlot,
    DirectionPlot,
    LinePlot,
    Plot,
    Series,
)
from pupper_analysis.present.figures import style
from pupper_analysis.present.words import in_english

Array = NDArray[np.float64]

LEAST_SHARE = 0.1
"""Percent of a limit, where the axis of bars with limits begins."""

_FAILS: dict[str, Any] = {
    "color": style.BLACK,
    "marker": "X",
    "ms": 9,
    "mec": "white",
    "ls": "",
    "zorder": 5,
    "clip_on": False,
}
_VALUE: dict[str, Any] = {
    "color": style.BLUE,
    "marker": "o",
    "ls": "",
    "mfc": "white",
    "mew": 1.6,
    "ms": 7,
}
_OUTLIER_STYLE: dict[str, Any] = {
    "color": style.BLACK,
    "marker": "x",
    "ls": "",
    "mew": 1.3,
    "ms": 4.5,
}
_REFERENCE: dict[str, Any] = {"color": style.BLACK, "ls": ":", "lw": 1.4, "zorder": 3}
_DIRECTIONS = {0: "0°\nforward", 90: "90°\nleft", 180: "180°\nback", 270: "270°\nright"}


@singledispatch
def draw_plot(plot: Plot, _: Axes) -> list[Artist]:
    """Draws a plot.

    Args:
        plot: What is drawn.
        _: The axes to draw in; those of directions are polar.

    Returns:
        What a legend shows of it.

    Raises:
        TypeError: If nobody has said how such a plot is drawn.
    """
    raise TypeError(f"no drawing of {type(plot).__name__}")


def plot_figure(plot: Plot, path: str | Path) -> None:
    """Draws one plot as a figure of its own.

    Args:
        plot: What is drawn.
        path: The PNG to write.

    Raises:
        OutputError: If the file cannot be written.
    """
    figure = style.page_figure(in_english(plot.title), 3.4, layout="constrained")
    polar = isinstance(plot, DirectionPlot)
    axes = figure.add_subplot(projection="polar" if polar else None)
    handles = draw_plot(plot, axes)
    if not polar:
        style.title_panel(axes, "")
    if handles:
        style.put_legend(figure, handles)
    style.save_figure(figure, path)


def axis_label(axis: Axis) -> str:
    """Returns what an axis says: the quantity and its unit."""
    return f"{in_english(axis.name)} ({axis.unit})" if axis.unit else in_english(axis.name)


def looks_of(series: Sequence[Series]) -> list[dict[str, Any]]:
    """Returns how each line looks: what others are compared with is dotted, all others differ."""
    found: list[dict[str, Any]] = []
    count = 0
    for one in series:
        found.append(_REFERENCE if one.reference else style.LOOKS[count % len(style.LOOKS)])
        count += not one.reference
    return found


@draw_plot.register
def _lines(plot: LinePlot, axes: Axes) -> list[Artist]:
    handles: list[Artist] = []
    looks = looks_of(plot.series)
    for one, look in zip(plot.series, looks, strict=True):
        x, y = (np.asarray(values, dtype=float) for values in (one.x, one.y))
        every = None if one.points or one.reference else (0.1, 0.2)
        axes.plot(x, y, **look, markevery=every)
        if one.fails:
            end = np.flatnonzero(np.isfinite(x) & np.isfinite(y))[-1]
            axes.plot(x[end], y[end], **_FAILS)
        handles.append(Line2D([], [], **look, label=in_english(one.name)))
    if plot.x.log:
        axes.set_xscale("log")
    if plot.y.log:
        axes.set_yscale("log")
    axes.grid(color=style.GRID, lw=0.6)
    axes.set_xlabel(axis_label(plot.x), size=style.FONT, parse_math=False)
    axes.set_ylabel(axis_label(plot.y), size=style.FONT, parse_math=False)
    if any(one.fails for one in plot.series):
        handles.append(Line2D([], [], **_FAILS, label="fails"))
    if plot.note is not None:
        handles.append(Line2D([], [], ls="", label=in_english(plot.note)))
    return handles


def shares_of(plot: BarPlot) -> tuple[Array, Array]:
    """Returns the bars' values and what is marked beside them, in percent of the limits.

    0 where there is no limit.
    """
    limits = np.array([math.nan if bar.limit is None else bar.limit for bar in plot.bars])
    values = np.array([[bar.value, bar.other or 0.0] for bar in plot.bars], dtype=float).T
    known = (limits > 0) & np.isfinite(limits)
    shares = np.where(known, 100 * np.abs(values) / np.where(known, limits, 1.0), 0.0)
    return shares[0], shares[1]


@draw_plot.register
def _bars(plot: BarPlot, axes: Axes) -> list[Artist]:
    """Draws values in percent of their limits, along a logarithm: 0.2 % and 30 % can be read."""
    places = np.arange(len(plot.bars))
    value, other = shares_of(plot)
    greatest = np.fmax(value, other)
    axes.hlines(places, LEAST_SHARE, greatest.clip(LEAST_SHARE), color="#C9CED6", lw=1)
    axes.plot(value.clip(LEAST_SHARE), places, **_VALUE, clip_on=False, zorder=3)
    axes.plot(other.clip(LEAST_SHARE), places, **_OUTLIER_STYLE, clip_on=False, zorder=4)
    axes.axvline(100, color=style.RED, lw=2)
    _mark_greatest(axes, plot, greatest)
    axes.set_xscale("log")
    axes.set_xlim(LEAST_SHARE, 200)
    axes.xaxis.set_major_locator(FixedLocator((0.1, 1, 10, 100)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(style.plain_numbers)
    axes.grid(axis="x", color=style.GRID, lw=0.6)
    axes.set_axisbelow(True)
    axes.set_ylim(len(places) - 0.4, -0.6)
    axes.set_yticks(places, [in_english(bar.name) for bar in plot.bars], parse_math=False)
    said = ["" if words is None else in_english(words) for words in plot.legend]
    name, limit = in_english(plot.axis.name), said[2]
    axes.set_xlabel(f"{name} / {limit} (%)", size=style.FONT, parse_math=False)
    return [
        Line2D([], [], **_VALUE, label=said[0]),
        Line2D([], [], **_OUTLIER_STYLE, label=said[1]),
        Line2D([], [], color=style.RED, lw=2, label=said[2]),
    ]


def _mark_greatest(axes: Axes, plot: BarPlot, percents: Array) -> None:
    """Writes the value of the bar that is nearest to its limit beside its point."""
    most = int(np.argmax(percents > 0.999 * percents.max()))
    left = percents[most] < 5
    axes.annotate(
        f"{abs(plot.bars[most].value):.3f} {plot.axis.unit}",
        (max(percents[most], LEAST_SHARE), most),
        (7 if left else -7, 0),
        textcoords="offset points",
        size=style.FONT,
        ha="left" if left else "right",
        va="center",
        zorder=5,
        bbox={"fc": "white", "ec": "none", "pad": 0.5},
    )


@draw_plot.register
def _directions(plot: DirectionPlot, axes: Axes) -> list[Artist]:
    assert isinstance(axes, PolarAxes)
    axes.set_theta_zero_location("N")  # forward is up; angles grow to the left, as about z
    handles: list[Artist] = []
    for one, look in zip(plot.series, looks_of(plot.series), strict=True):
        angles, values = (np.asarray(numbers, dtype=float) for numbers in (one.x, one.y))
        around = [np.append(numbers, numbers[0]) for numbers in (angles, values)]
        axes.plot(*around, **look)
        if one.marked is not None:
            filled = {**look, "mfc": look["color"], "ms": 6.5, "zorder": 4}
            axes.plot(angles[one.marked], values[one.marked], **filled)
        note = "" if one.note is None else f": {in_english(one.note)}"
        handles.append(Line2D([], [], label=f"{in_english(one.name)}{note}", **look))
    shown = range(0, 360, 30)
    names = [_DIRECTIONS.get(angle, f"{angle}°") for angle in shown]
    axes.set_xticks(np.radians(list(shown)), names)
    axes.tick_params(axis="x", labelsize=style.FONT, pad=3)
    axes.set_ylim(0, None)
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=(1, 2, 5, 10)))
    axes.yaxis.set_major_formatter(NullFormatter())
    for value in axes.get_yticks():
        if 0 < value < 0.98 * axes.get_ylim()[1]:
            place = (np.radians(-15), value)
            box = {"fc": "white", "ec": "none", "pad": 0.6}
            said = f"{value:g} {plot.axis.unit}"
            axes.text(*place, said, size=style.FONT, ha="center", zorder=5, bbox=box)
    axes.grid(color="#D5D9DF", lw=0.6)
    return handles
