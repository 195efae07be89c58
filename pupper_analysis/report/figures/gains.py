"""The figure of the gain sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import LogLocator, NullLocator

from pupper_analysis.report.figures import style

if TYPE_CHECKING:
    from pupper_analysis.analysis.robot import Analysis
    from pupper_analysis.simulation.gain_sweep import GainSweep


_ROOMY = 12
"""Columns of cells across a page in which five digits stand apart at the usual size."""


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
    figure, panels = style.panels_of(
        analyses,
        "Gain sweep: standard deviation of the height in the last second",
        0.26 * rows + 0.65,
    )
    finite = np.concatenate(
        [1e3 * a.sweep.height_deviation[np.isfinite(a.sweep.height_deviation)] for a in analyses]
    )
    positive = finite[finite > 0]
    low, high = (positive.min(), positive.max()) if len(positive) else (0.1, 1.0)
    norm = LogNorm(low, max(high, 1.01 * low))
    for index, (axes, analysis) in enumerate(zip(panels, analyses, strict=True)):
        sweep = analysis.sweep
        image = axes.imshow(
            np.where(sweep.fell, np.nan, 1e3 * sweep.height_deviation).clip(low),
            norm=norm,
            cmap="cividis",
            aspect="auto",
            origin="lower",
        )
        columns = len(sweep.kd) * min(style.COLUMNS, len(analyses))
        _write_values(axes, sweep, norm, style.FONT * min(1.0, _ROOMY / columns))
        style.title_panel(axes, analysis.name)
        axes.set_xticks(range(len(sweep.kd)), [f"{value:g}" for value in sweep.kd])
        axes.set_yticks(range(len(sweep.kp)), [f"{value:g}" for value in sweep.kp])
        axes.tick_params(length=0)
        if index + style.COLUMNS >= len(analyses):
            axes.set_xlabel("kd (N m s/rad)", size=style.FONT)
        if index % style.COLUMNS == 0:
            axes.set_ylabel("kp (N m/rad)", size=style.FONT)
    colours = figure.colorbar(
        image, ax=panels, shrink=0.9, pad=0.015, aspect=20 * -(-len(panels) // style.COLUMNS)
    )
    colours.set_label("deviation (mm)", size=style.FONT)
    colours.ax.tick_params(labelsize=style.FONT, which="both")
    colours.ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    colours.ax.yaxis.set_minor_locator(NullLocator())
    colours.ax.yaxis.set_major_formatter(style.plain_numbers)
    style.put_legend(
        figure,
        [
            Patch(fill=False, edgecolor=style.RED, lw=2, label="no stable rest"),
            Patch(facecolor="#F1F1F1", edgecolor=style.GREY, hatch="////", label="fell"),
            Line2D(
                [],
                [],
                ls="",
                label=f"vertical disturbance of {sweep.amplitude:g} N at {sweep.frequency:g} Hz",
            ),
        ],
    )
    style.save(figure, path)


def _write_values(axes: Axes, sweep: GainSweep, norm: LogNorm, size: float) -> None:
    """Writes the deviation (mm) into each cell, or that it fell; frames what is not stable."""
    for row, column in np.ndindex(sweep.height_deviation.shape):
        if sweep.fell[row, column]:
            axes.add_patch(
                Rectangle(
                    (column - 0.5, row - 0.5), 1, 1, fc="#F1F1F1", ec=style.GREY, hatch="////", lw=0
                )
            )
            axes.text(
                column,
                row,
                "fell",
                size=size,
                ha="center",
                va="center",
                bbox={"fc": "white", "ec": "none", "pad": 1.0},
            )
            continue
        value = 1e3 * sweep.height_deviation[row, column]
        axes.text(
            column,
            row,
            f"{value:.3f}" if value < 10 else f"{value:.0f}",
            size=size,
            ha="center",
            va="center",
            color="white" if norm(value) < 0.5 else style.BLACK,
        )
        if not sweep.lasts[row, column]:
            axes.add_patch(
                Rectangle((column - 0.46, row - 0.46), 0.92, 0.92, fill=False, ec=style.RED, lw=2.2)
            )
