"""The figures that put analyses beside each other: torques, heights and gains, a panel each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import in_english, text
from pupper_analysis.present.documents.loads import torque_plot
from pupper_analysis.present.documents.standing import height_plot
from pupper_analysis.present.figures import drawing
from pupper_analysis.present.figures.drawing import write_plots
from pupper_analysis.tools.analyze.document import deviation_table

if TYPE_CHECKING:
    from pupper_analysis.tools.analyze.analysis import Analysis

_COLUMNS = 3
"""Panels beside each other."""

_ROOMY = 12
"""Columns of cells across a page in which five digits stand apart at the usual size."""


def torque_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draws what every motor holds, beside its effort limit: one panel per robot.

    Args:
        analyses: The robots; ``statics``, ``verification`` and ``joints`` are drawn.
        path: The PNG to write.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    plots, names = [], []
    for one in analyses:
        limits = [joint.effort for joint in one.joints]
        simulated = one.verification.joint_torques.tolist()
        plots.append(torque_plot(one.statics, simulated, limits))
        low, high = min(limits), max(limits)
        names.append(f"{one.name}: limit {low:g}{f' to {high:g}' if high > low else ''} N m")
    write_plots(plots, path, title=text("motor-torques-against-their-limits"), names=names)


def height_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draws the base's height over the simulated time, with and without feed-forward.

    Args:
        analyses: The robots; ``stand``, ``verification`` and ``sagging`` are drawn.
        path: The PNG to write.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    plots = [
        height_plot((one.verification, one.sagging), float(one.stand.qpos[2])) for one in analyses
    ]
    write_plots(plots, path, names=[one.name for one in analyses])


def gain_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draws the gain sweeps as heat maps: how much the height deviates, for each kp and kd.

    Args:
        analyses: The robots; ``sweep`` is drawn.
        path: The PNG to write.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    rows = max((len(analysis.sweep.kp) for analysis in analyses), default=0)
    title = "Gain sweep: standard deviation of the height in the last second"
    figure, panels = _panels(analyses, title, 0.26 * rows + 0.65)
    tables = [deviation_table(analysis.sweep) for analysis in analyses]
    shown = [_values(table) for table in tables]
    known = np.concatenate([values[values > 0] for values in shown])
    low, high = (known.min(), known.max()) if len(known) else (0.1, 1.0)
    norm = LogNorm(low, max(high, 1.01 * low))
    for index, (axes, analysis) in enumerate(zip(panels, analyses, strict=True)):
        image = axes.imshow(
            shown[index].clip(low), norm=norm, cmap="cividis", aspect="auto", origin="lower"
        )
        sweep = analysis.sweep
        columns = len(sweep.kd) * min(_COLUMNS, len(analyses))
        _write_cells(axes, tables[index], norm, drawing.FONT * min(1.0, _ROOMY / columns))
        drawing.title_panel(axes, analysis.name)
        axes.set_xticks(range(len(sweep.kd)), [f"{value:g}" for value in sweep.kd])
        axes.set_yticks(range(len(sweep.kp)), [f"{value:g}" for value in sweep.kp])
        axes.tick_params(length=0)
        axes.set_xlabel("kd (N m s/rad)", size=drawing.FONT)
        axes.set_ylabel("kp (N m/rad)", size=drawing.FONT)
        _label_outside(axes, index, len(analyses))
    colours = figure.colorbar(
        image, ax=panels, shrink=0.9, pad=0.015, aspect=20 * -(-len(panels) // _COLUMNS)
    )
    colours.set_label("deviation (mm)", size=drawing.FONT)
    colours.ax.tick_params(labelsize=drawing.FONT, which="both")
    colours.ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    colours.ax.yaxis.set_minor_locator(NullLocator())
    colours.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    disturbance = f"vertical disturbance of {sweep.amplitude:g} N at {sweep.frequency:g} Hz"
    named = [
        Patch(fill=False, edgecolor=drawing.RED, lw=2, label="no stable rest"),
        Patch(facecolor="#F1F1F1", edgecolor=drawing.GREY, hatch="////", label="fell"),
        Line2D([], [], ls="", label=disturbance),
    ]
    drawing.put_legend(figure, named)
    drawing.save_figure(figure, path)


def _panels(analyses: Sequence[object], title: str, row_height: float) -> tuple[Figure, list[Axes]]:
    """Returns a figure with one panel (of ``row_height`` inches) per robot, in rows of three."""
    if not analyses:
        raise ConfigurationError("analyses", diagnose("no-robot-to-draw"))
    columns = min(_COLUMNS, len(analyses))
    rows = -(-len(analyses) // columns)
    figure = drawing.page_figure(title, rows * row_height + 0.75, layout="constrained")
    grid = figure.add_gridspec(rows, columns)
    panels = [figure.add_subplot(grid[divmod(index, columns)]) for index in range(len(analyses))]
    return figure, panels


def _label_outside(axes: Axes, index: int, count: int) -> None:
    """Takes off what axes say that those below say too, or those on the left."""
    if index + _COLUMNS < count:
        axes.set_xlabel("")
    if index % _COLUMNS:
        axes.set_ylabel("")


def _values(table: doc.Table) -> doc.Array:
    """Returns the numbers of a table's cells but for the first column's; nan where one has none."""
    return np.array(
        [
            [cell.value if isinstance(cell, doc.Number) else np.nan for cell in row[1:]]
            for row in table.rows
        ]
    )


def _write_cells(axes: Axes, table: doc.Table, norm: LogNorm, size: float) -> None:
    """Writes the numbers of a table into its cells, or what is there; frames those marked."""
    for row, cells in enumerate(table.rows):
        for column, cell in enumerate(cells[1:]):
            # What is inside its cell makes no room for itself: it need not be measured for that.
            at: dict[str, Any] = {"size": size, "ha": "center", "va": "center", "in_layout": False}
            if not isinstance(cell, doc.Number):
                place = (column - 0.5, row - 0.5)
                look: dict[str, Any] = {
                    "fc": "#F1F1F1",
                    "ec": drawing.GREY,
                    "hatch": "////",
                    "lw": 0,
                }
                axes.add_patch(Rectangle(place, 1, 1, **look))
                box = {"fc": "white", "ec": "none", "pad": 1.0}
                axes.text(column, row, in_english(cell), bbox=box, **at)
                continue
            said = f"{cell.value:.3f}" if cell.value < 10 else f"{cell.value:.0f}"
            shade = "white" if norm(cell.value) < 0.5 else drawing.BLACK
            axes.text(column, row, said, color=shade, **at)
            if cell.mark:
                place = (column - 0.46, row - 0.46)
                axes.add_patch(Rectangle(place, 0.92, 0.92, fill=False, ec=drawing.RED, lw=2.2))
