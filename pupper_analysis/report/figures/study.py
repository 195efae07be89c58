"""The figures of a study: heat maps, parallel coordinates, Pareto fronts, regions of failure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from pupper_analysis.errors import ConfigurationError
from pupper_analysis.report.figures import style
from pupper_analysis.study.cells import (
    Cells,
    EndMap,
    Panel,
    check_columns,
    end_map,
    labelled,
    mean_map,
    measures_in,
    panels,
    spread_in,
)
from pupper_analysis.study.pareto import pareto_front

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

MOST_LINES = 2000
"""In parallel coordinates: evenly drawn of more designs."""

_FAILED = (style.RED, style.ORANGE, style.GREY, style.BLACK, style.SKY, "#CC79A7", "#F0E442")
_FRONTS = (style.BLUE, style.RED, style.GREEN, style.ORANGE, style.SKY, style.BLACK)
_OUT = "0.93"  # grey of what is not known
_HATCHED: dict[str, Any] = {"facecolor": "none", "edgecolor": "white", "linewidth": 0}

FEW_LABELS = 10
"""Values that are written along one side of a map."""


def figure_of(title: str, width: float = style.WIDTH, height: float = 3.4) -> tuple[Figure, Axes]:
    """Returns a figure with one panel."""
    figure = style.page_figure(title, height, width=width, layout="constrained")
    return figure, figure.add_subplot()


def heat_map(
    table: pd.DataFrame,
    x: str,
    y: str,
    measure: str,
    path: str | Path,
    *,
    others: Sequence[str] = (),
) -> None:
    """Draws a measure over two variables.

    Each combination of the other variables' values has a panel, where these are few; else a cell is
    a mean over them. Cells without any value are grey. Hatched are those in whose mean designs are
    missing, as they do not stand.

    Args:
        table: Of a study.
        x: The variable along the figure.
        y: The variable upwards.
        measure: The column that is drawn.
        path: The PNG to write.
        others: The other variables.

    Raises:
        ConfigurationError: If a column is not there.
        OutputError: If the file cannot be written.
    """
    check_columns(table, x, y, measure)
    shown = panels(table, others, x, y)
    maps = [mean_map(panel.table, x, y, measure) for panel in shown]
    known = np.concatenate([one.means[np.isfinite(one.means)] for one in maps])
    scale = Normalize(*((known.min(), known.max()) if len(known) else (0.0, 1.0)))
    figure, grid = _panels(f"{measure} over {x} and {y}", len(shown))
    for axes, panel, found in zip(grid, shown, maps, strict=True):
        axes.set_facecolor(_OUT)
        axes.pcolormesh(found.x.edges, found.y.edges, found.means, cmap="viridis", norm=scale)
        for row, column in np.argwhere(found.partial):
            x0, x1 = found.x.edges[column : column + 2]
            y0, y1 = found.y.edges[row : row + 2]
            axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, hatch="///", **_HATCHED))
        _label(axes, x, y, _told(panel))
        _ticks(axes, found.x, found.y)
    bar = figure.colorbar(ScalarMappable(scale, colormaps["viridis"]), ax=grid)
    bar.set_label(labelled(measure), size=style.FONT)
    bar.ax.tick_params(labelsize=style.FONT)
    named = [
        *([Patch(color=_OUT, label="not measured")] * any((m.counts == 0).any() for m in maps)),
        *([Patch(hatch="///", label="some do not stand: the mean is of the others", **_HATCHED)]
          * any(m.partial.any() for m in maps)),
    ]  # fmt: skip
    if named:
        style.put_legend(figure, named)
    style.save(figure, path)


def failure_map(
    table: pd.DataFrame, x: str, y: str, path: str | Path, *, others: Sequence[str] = ()
) -> None:
    """Draws what most designs of a cell come to, over two variables: their reason, or none.

    Args:
        table: Of a study.
        x: The variable along the figure.
        y: The variable upwards.
        path: The PNG to write.
        others: The other variables: each combination of their values has a panel, where these are
            few.

    Raises:
        ConfigurationError: If a column is not there.
        OutputError: If the file cannot be written.
    """
    whole = end_map(table, x, y)
    shades = [_FAILED[index % len(_FAILED)] for index in range(len(whole.kinds) - 1)]
    colours = dict(zip(whole.kinds, [style.GREEN, *shades], strict=True))
    shown = panels(table, others, x, y)
    figure, grid = _panels(f"What becomes of designs over {x} and {y}", len(shown))
    for axes, panel in zip(grid, shown, strict=True):
        found = end_map(panel.table, x, y)
        axes.pcolormesh(found.x.edges, found.y.edges, _ends(found, colours))
        _label(axes, x, y, _told(panel))
        _ticks(axes, found.x, found.y)
    named = [
        Patch(color=colours[kind], label=f"{kind or 'all measured'} ({int(count.sum())})")
        for kind, count in zip(whole.kinds, whole.counts, strict=True)
        if count.any()
    ]
    style.put_legend(figure, named)
    style.save(figure, path)


def _ends(found: EndMap, colours: Mapping[str, str]) -> Array:
    """Returns the colours of cells; paler where the designs of one come to different ends."""
    image = np.ones((*found.counts.shape[1:], 4))
    total, most = found.counts.sum(axis=0), found.counts.argmax(axis=0)
    for place in np.ndindex(*total.shape):
        image[place] = to_rgba(_OUT)
        if total[place]:
            share = found.counts[(most[place], *place)] / total[place]
            image[place] = to_rgba(colours[found.kinds[most[place]]], alpha=0.25 + 0.75 * share)
    return image


def parallel_coordinates(
    table: pd.DataFrame, columns: Sequence[str], colour: str, path: str | Path
) -> None:
    """Draws each design as a line over several columns; failed ones end in grey.

    Args:
        table: Of a study.
        columns: From left to right.
        colour: The column that colours the lines.
        path: The PNG to write.

    Raises:
        ConfigurationError: If a column is not there.
        OutputError: If the file cannot be written.
    """
    check_columns(table, *columns, colour)
    if len(table) > MOST_LINES:
        table = table.iloc[np.linspace(0, len(table) - 1, MOST_LINES).astype(int)]
    table = table.sort_values(colour, na_position="first")
    data = table[list(columns)].to_numpy(float)
    low, high = np.nanmin(data, axis=0), np.nanmax(data, axis=0)
    unit = np.where(high > low, (data - low) / np.where(high > low, high - low, 1.0), 0.5)
    shade = table[colour].to_numpy(float)
    figure, axes = figure_of(f"Designs as lines, coloured by {colour}")
    scale = Normalize(np.nanmin(shade), np.nanmax(shade))
    palette = colormaps["viridis"]
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
    axes.set_xticks(range(len(columns)), [_wrapped(labelled(name)) for name in columns])
    style.title_panel(axes, "")
    axes.spines["left"].set_visible(False)
    for place, (least, most) in enumerate(zip(low, high, strict=True)):
        axes.axvline(place, color=style.BLACK, linewidth=0.7)
        for value, at, side in ((least, -0.02, "top"), (most, 1.02, "bottom")):
            axes.text(place, at, f"{value:.4g}", ha="center", va=side, size=style.FONT - 1)
    bar = figure.colorbar(ScalarMappable(scale, palette), ax=axes, pad=0.04)
    bar.set_label(labelled(colour), size=style.FONT)
    bar.ax.tick_params(labelsize=style.FONT)
    style.save(figure, path)


def pareto_figure(
    table: pd.DataFrame,
    objectives: Mapping[str, str],
    path: str | Path,
    *,
    by: str | None = None,
    title: str | None = None,
    labels: Mapping[str, str] | None = None,
) -> None:
    """Draws all designs over two objectives, and the front of those that no other beats.

    Args:
        table: Of a study.
        objectives: {column: ``"min"`` or ``"max"``}, two of them.
        path: The PNG to write.
        by: A column; each of its values has a front of its own.
        title: Over the figure.
        labels: {column: what the axis says}.

    Raises:
        ConfigurationError: If there are not two objectives, or a column is not there.
        OutputError: If the file cannot be written.
    """
    if len(objectives) != 2:
        raise ConfigurationError("objectives", f"{len(objectives)} of them; a figure shows two")
    check_columns(table, *((by,) if by else ()))
    x, y = objectives
    labels = {name: f"{labelled(name)}, {sense}" for name, sense in objectives.items()} | dict(
        labels or {}
    )
    figure, axes = figure_of(title or f"Designs worth building: {x} against {y}")
    handles = []
    groups: list[tuple[str, pd.DataFrame]] = [("", table)]
    if by is not None:
        values = sorted(table[by].dropna().unique())
        groups = [(f"{labels.get(by, by)} {v:g}: ", table[table[by] == v]) for v in values]
    for index, (said, part) in enumerate(groups):
        colour, front = _FRONTS[index % len(_FRONTS)], pareto_front(part, objectives)
        axes.scatter(part[x], part[y], s=4, color=colour, alpha=0.35, linewidths=0)
        axes.plot(front[x], front[y], "o-", color=colour, markersize=3.5, linewidth=1.2)
        label = f"{said}no other design beats these"
        handles.append(Line2D([], [], color=colour, marker="o", markersize=3.5, label=label))
    style.title_panel(axes, "")
    axes.set_xlabel(labels[x], size=style.FONT)
    axes.set_ylabel(labels[y], size=style.FONT)
    style.put_legend(figure, handles)
    style.save(figure, path)


def draw_study(
    table: pd.DataFrame,
    variables: Sequence[str],
    folder: Path,
    objectives: Mapping[str, str] | None = None,
) -> list[Path]:
    """Draws what a study can show without being asked: returns the files.

    Two variables of most values span the maps; the first measures fill them. Two objectives, if
    there are two, have their front.

    Raises:
        OutputError: If a file cannot be written.
    """
    measures, spread = measures_in(table, variables), spread_in(table, variables)
    paths = []
    if len(spread) >= 2:
        x, y = spread[:2]
        for measure in measures[:3]:
            paths.append(folder / f"map_{measure}.png")
            heat_map(table, x, y, measure, paths[-1], others=spread)
        paths.append(folder / "failures.png")
        failure_map(table, x, y, paths[-1], others=spread)
    if spread and measures:
        paths.append(folder / "parallel.png")
        shown = [*(n for n in variables if n in spread), *measures[:4]]
        parallel_coordinates(table, shown, measures[0], paths[-1])
    if objectives is not None and len(objectives) == 2:
        up = table[table["stands"] == 1] if "stands" in table else table
        if not up.dropna(subset=list(objectives)).empty:
            paths.append(folder / "front.png")
            pareto_figure(up, objectives, paths[-1])
    return paths


def _told(panel: Panel) -> str:
    """Returns what else there is to know of a panel's cells than their place."""
    return f"mean over {', '.join(panel.averaged)}" if panel.averaged else panel.values()


def _panels(title: str, count: int) -> tuple[Figure, list[Axes]]:
    """Returns a figure with panels beside each other, three in a row."""
    columns = min(count, 3)
    rows = -(-count // columns)
    width = style.WIDTH if count == 1 else max(style.WIDTH, 3.0 * columns + 1.2)
    figure = style.page_figure(title, 3.4 if rows == 1 else 2.9 * rows, width=width,
                               layout="constrained")  # fmt: skip
    return figure, [figure.add_subplot(rows, columns, 1 + index) for index in range(count)]


def _label(axes: Axes, x: str, y: str, title: str = "") -> None:
    style.title_panel(axes, title)
    axes.set_xlabel(labelled(x), size=style.FONT)
    axes.set_ylabel(labelled(y), size=style.FONT)


def _ticks(axes: Axes, x: Cells, y: Cells) -> None:
    """Puts ticks at the values, where each cell has one and they are few enough to be read."""
    for cells, put in ((x, axes.set_xticks), (y, axes.set_yticks)):
        if cells.levels and len(cells.centres) <= FEW_LABELS:
            put(cells.centres, [f"{value:.4g}" for value in cells.centres])


def _wrapped(name: str) -> str:
    return name.replace("_", "\n", 1) if len(name) > 12 else name
