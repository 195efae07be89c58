"""The figures of a study: what its page draws, as PNGs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Patch, Rectangle

from pupper_analysis.present.document import Plot
from pupper_analysis.present.figures import style
from pupper_analysis.present.html.plots import STYLES, Drawing, Mark, draw_svg
from pupper_analysis.present.words import in_english
from pupper_analysis.tools.study.cells import spread_in, standing_designs
from pupper_analysis.tools.study.pareto import pareto_front
from pupper_analysis.tools.study.plots import MeansPlot, front_plot, study_plots

if TYPE_CHECKING:
    import pandas as pd

_EMPTY = "0.93"
"""Grey of cells of which nothing is known."""

_SIDES = {"start": "left", "middle": "center", "end": "right"}


def draw_study(
    table: pd.DataFrame,
    variables: Sequence[str],
    folder: Path,
    objectives: Mapping[str, str] | None = None,
) -> list[Path]:
    """Draws what a study can show without being asked, as its page does: returns the files.

    Two variables of most values span the maps; the first metrics fill them. Two objectives, if
    there are two, have their front.

    Raises:
        OutputError: If a file cannot be written.
    """
    spread = spread_in(table, variables)
    shown = study_plots(table, variables, spread[:2] if len(spread) > 1 else ())
    if objectives is not None and len(objectives) == 2:
        up = standing_designs(table)
        if not up.dropna(subset=list(objectives)).empty:
            shown["front"] = [front_plot(up, pareto_front(up, objectives), objectives)]
    paths = []
    for name, plots in shown.items():
        paths.append(folder / f"{name}.png")
        write_plots(plots, paths[-1])
    return paths


def write_plots(plots: Sequence[Plot], path: Path) -> None:
    """Writes plots as panels of one figure, three in a row.

    Raises:
        OutputError: If the file cannot be written.
    """
    drawings = [draw_svg(plot) for plot in plots]
    columns = min(len(plots), 3)
    rows = -(-len(plots) // columns)
    width = style.WIDTH if len(plots) == 1 else max(style.WIDTH, 3.0 * columns)
    height = rows * width / columns * drawings[0].height / drawings[0].width + 0.6
    figure = style.page_figure(in_english(plots[0].title), height, width=width,
                               layout="constrained")  # fmt: skip
    named: dict[str, Patch] = {}
    for index, drawing in enumerate(drawings):
        axes = figure.add_subplot(rows, columns, 1 + index)
        _draw(drawing, axes, style.FONT if columns == 1 else style.FONT / 2)
        if len(plots) > 1:
            axes.set_title(in_english(drawing.title), size=style.FONT / 2, parse_math=False)
        for words, kind in drawing.legend:
            named[in_english(words)] = Patch(color=_colour(kind), label=in_english(words))
    if any(isinstance(one, MeansPlot) and one.found.partial.any() for one in plots):
        crossed = "crossed: some do not stand; the mean is of the others"
        named[crossed] = Patch(facecolor="none", edgecolor="black", hatch="///", label=crossed)
    if named:
        style.put_legend(figure, list(named.values()))
    style.save_figure(figure, path)


def _draw(drawing: Drawing, axes: Axes, size: float) -> None:
    """Draws a page's drawing into axes, whose unit is the page's."""
    axes.set(xlim=(0, drawing.width), ylim=(drawing.height, 0), aspect="equal")
    axes.axis("off")
    for mark in drawing.marks:
        kind = mark["class"].split()[-1]
        match mark["tag"]:
            case "rect":
                look: dict[str, Any] = {"color": mark.get("fill", _EMPTY), "linewidth": 0}
                corner, opacity = (mark["x"], mark["y"]), mark.get("opacity", 1.0)
                sides = mark["width"], mark["height"]
                axes.add_patch(Rectangle(corner, *sides, alpha=opacity, **look))
            case "line":
                ends = [mark["x1"], mark["x2"]], [mark["y1"], mark["y2"]]
                axes.plot(*ends, color=style.GRID if kind == "grid" else style.BLACK, lw=0.7)
            case "polyline" if kind != "unseen":
                colour = mark.get("stroke") or _colour(kind)
                axes.plot(*np.array(mark["points"]).T, color=colour, lw=0.9, alpha=0.8)
            case "circle":
                place = mark["cx"], mark["cy"]
                axes.add_patch(Circle(place, mark["r"], color=_colour(kind), linewidth=0))
            case "text":
                _write(mark, axes, size)


def _write(mark: Mark, axes: Axes, size: float) -> None:
    said = in_english(mark["words"]) + (f" ({mark['unit']})" if mark["unit"] else "")
    turned = 90.0 if "transform" in mark else 0.0
    axes.text(mark["x"], mark["y"], said, ha=_SIDES[mark["anchor"]], rotation=turned,
              size=size, parse_math=False)  # fmt: skip


def _colour(kind: str) -> str:
    """Returns the colour of a class of the page's style sheet, or of a legend's colour."""
    return kind if kind.startswith("#") else style.COLOURS[int(kind[1:]) % STYLES]
