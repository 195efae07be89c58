"""Plots of many designs, drawn by matplotlib: maps, designs as lines, clouds with their front."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from pupper_analysis.present.figures import style
from pupper_analysis.present.figures.drawing import draw_plot
from pupper_analysis.present.words import in_english
from pupper_analysis.tools.study.cells import Cells, EndMap, column_label
from pupper_analysis.tools.study.plots import (
    EndsPlot,
    FrontPlot,
    MeansPlot,
    ParallelPlot,
)

Array = NDArray[np.float64]

MOST_LINES = 2000
"""In parallel coordinates: evenly drawn of more designs."""

FEW_LABELS = 10
"""Values that are written along one side of a map."""

ALL_MEASURED = "all measured"
"""What designs come to that have not failed."""

_FAILED = (style.RED, style.ORANGE, style.GREY, style.BLACK, style.SKY, "#CC79A7", "#F0E442")
_OUT = "0.93"  # grey of what is not known
_HATCHED: dict[str, Any] = {"facecolor": "none", "edgecolor": "white", "linewidth": 0}
_PALETTE = "viridis"


@draw_plot.register
def _means(plot: MeansPlot, axes: Axes) -> list[Artist]:
    """Draws means; hatched are those in which designs are missing, grey are those of none."""
    found = plot.found
    axes.set_facecolor(_OUT)
    axes.pcolormesh(
        found.x.edges, found.y.edges, found.means, cmap=_PALETTE, norm=Normalize(*plot.ends)
    )
    for row, column in np.argwhere(found.partial):
        x0, x1 = found.x.edges[column : column + 2]
        y0, y1 = found.y.edges[row : row + 2]
        axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, hatch="///", **_HATCHED))
    _frame(axes, plot)
    named: list[Artist] = []
    if (found.counts == 0).any():
        named.append(Patch(color=_OUT, label="not measured"))
    if found.partial.any():
        missing = "some do not stand: the mean is of the others"
        named.append(Patch(hatch="///", label=missing, **_HATCHED))
    return named


@draw_plot.register
def _ends(plot: EndsPlot, axes: Axes) -> list[Artist]:
    found = plot.found
    shades = [_FAILED[index % len(_FAILED)] for index in range(len(plot.kinds) - 1)]
    colours = dict(zip(plot.kinds, [style.GREEN, *shades], strict=True))
    axes.pcolormesh(found.x.edges, found.y.edges, _paled(found, colours))
    _frame(axes, plot)
    return [
        Patch(color=colours[kind], label=kind or ALL_MEASURED)
        for kind, count in zip(found.kinds, found.counts, strict=True)
        if count.any()
    ]


def _paled(found: EndMap, colours: Mapping[str, str]) -> Array:
    """Returns the colours of cells; paler where the designs of one come to different ends."""
    image = np.ones((*found.counts.shape[1:], 4))
    total, most = found.counts.sum(axis=0), found.counts.argmax(axis=0)
    for place in np.ndindex(*total.shape):
        image[place] = to_rgba(_OUT)
        if total[place]:
            share = found.counts[(most[place], *place)] / total[place]
            image[place] = to_rgba(colours[found.kinds[most[place]]], alpha=0.25 + 0.75 * share)
    return image


@draw_plot.register
def _parallel(plot: ParallelPlot, axes: Axes) -> list[Artist]:
    """Draws each design as a line over several columns; failed ones end in grey."""
    table, columns = plot.table, plot.columns
    if len(table) > MOST_LINES:
        table = table.iloc[np.linspace(0, len(table) - 1, MOST_LINES).astype(int)]
    table = table.sort_values(plot.shade, na_position="first")
    data = table[list(columns)].to_numpy(float)
    low, high = np.nanmin(data, axis=0), np.nanmax(data, axis=0)
    unit = np.where(high > low, (data - low) / np.where(high > low, high - low, 1.0), 0.5)
    shade = table[plot.shade].to_numpy(float)
    scale = Normalize(np.nanmin(shade), np.nanmax(shade))
    palette = colormaps[_PALETTE]
    colours = [palette(scale(v)) if np.isfinite(v) else to_rgba(style.GREY) for v in shade]
    known = np.isfinite(unit)
    lines = [
        np.column_stack([np.flatnonzero(there), row[there]])
        for row, there in zip(unit, known, strict=True)
    ]
    width = float(np.clip(60 / len(table), 0.25, 1.2))
    axes.add_collection(LineCollection(lines, colors=colours, linewidths=width, alpha=0.7))
    axes.set_xlim(0, len(columns) - 1)
    axes.set_ylim(-0.08, 1.08)
    axes.set_yticks([])
    axes.set_xticks(range(len(columns)), [_wrapped(column_label(name)) for name in columns])
    axes.spines["left"].set_visible(False)
    for place, (least, most) in enumerate(zip(low, high, strict=True)):
        axes.axvline(place, color=style.BLACK, linewidth=0.7)
        for value, at, side in ((least, -0.02, "top"), (most, 1.02, "bottom")):
            box = {"fc": "white", "ec": "none", "pad": 0.6}
            said = f"{value:.4g}"
            axes.text(place, at, said, ha="center", va=side, size=style.FONT - 1, bbox=box)
    put_scale(axes, (scale.vmin or 0.0, scale.vmax or 0.0), plot.shade, pad=0.04)
    return []


@draw_plot.register
def _front(plot: FrontPlot, axes: Axes) -> list[Artist]:
    """Draws a cloud with its front, in the next colour of the axes'."""
    x, y = plot.objectives
    colour = style.COLOURS[len(axes.lines) % len(style.COLOURS)]
    axes.scatter(plot.table[x], plot.table[y], s=4, color=colour, alpha=0.35, linewidths=0)
    look: dict[str, Any] = {"color": colour, "marker": "o", "markersize": 3.5}
    axes.plot(plot.front[x], plot.front[y], linewidth=1.2, **look)
    axes.set_xlabel(plot.axes[0], size=style.FONT, parse_math=False)
    axes.set_ylabel(plot.axes[1], size=style.FONT, parse_math=False)
    said = "" if plot.name is None else f"{in_english(plot.name)}: "
    return [Line2D([], [], label=f"{said}no other design beats these", **look)]


def put_scale(
    axes: Axes | list[Axes], ends: tuple[float, float], column: str, **place: Any
) -> None:
    """Puts a bar beside axes that tells which colour is which value of a column."""
    first = axes[0] if isinstance(axes, list) else axes
    mappable = ScalarMappable(Normalize(*ends), colormaps[_PALETTE])
    bar = first.figure.colorbar(mappable, ax=axes, **place)
    bar.set_label(column_label(column), size=style.FONT)
    bar.ax.tick_params(labelsize=style.FONT)


def _frame(axes: Axes, plot: MeansPlot | EndsPlot) -> None:
    """Gives a map its axes' names, ticks and title."""
    style.title_panel(axes, "" if plot.part is None else in_english(plot.part))
    axes.set_xlabel(column_label(plot.x), size=style.FONT)
    axes.set_ylabel(column_label(plot.y), size=style.FONT)
    _ticks(axes, plot.found.x, plot.found.y)


def _ticks(axes: Axes, x: Cells, y: Cells) -> None:
    """Puts ticks at the values, where each cell has one and they are few enough to be read."""
    for cells, put in ((x, axes.set_xticks), (y, axes.set_yticks)):
        if cells.levels and len(cells.centres) <= FEW_LABELS:
            put(cells.centres, [f"{value:.4g}" for value in cells.centres])


def _wrapped(name: str) -> str:
    return name.replace("_", "\n", 1) if len(name) > 12 else name
