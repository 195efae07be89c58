"""The figure of the base's height over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D

from pupper_analysis.report.figures import style

if TYPE_CHECKING:
    from pupper_analysis.analysis.robot import Analysis

_WITH: dict[str, Any] = {"color": style.BLUE, "lw": 1.5, "marker": "o", "ms": 4, "mfc": "white"}
_FAILS: dict[str, Any] = {
    "color": style.BLACK,
    "marker": "X",
    "ms": 9,
    "mec": "white",
    "ls": "",
    "zorder": 5,
    "clip_on": False,
}
_WITHOUT: dict[str, Any] = {
    "color": style.RED,
    "lw": 1.5,
    "ls": (0, (5, 1.5)),
    "marker": "s",
    "ms": 4,
}


def height_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draws the base's height over the simulated time, with and without feed-forward.

    Args:
        analyses: The robots; ``stand``, ``verification`` and ``sagging`` are drawn.
        path: The PNG to write.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    figure, panels = style.panels_of(analyses, "Height of the simulated base", 1.75)
    for index, (axes, analysis) in enumerate(zip(panels, analyses, strict=True)):
        task = 1e3 * analysis.stand.qpos[2]
        axes.axhline(task, color=style.BLACK, lw=1.2, ls=":")
        low = high = task
        for run, look in ((analysis.verification, _WITH), (analysis.sagging, _WITHOUT)):
            label = f"{round(1e3 * run.height_loss, 2) + 0.0:.2f} mm"  # no -0.00
            if run.failures:
                label += ", fails"
                end = np.flatnonzero(np.isfinite(run.height))[-1]
                axes.plot(run.time[end], 1e3 * run.height[end], **_FAILS)
            axes.plot(run.time, 1e3 * run.height, **look, markevery=(0.1, 0.2), label=label)
            low = min(low, float(np.nanmin(1e3 * run.height)))
            high = max(high, float(np.nanmax(1e3 * run.height)))
        span = max(high - low, 1.0)
        axes.set_ylim(high - 1.3 * span, high + 0.1 * span)
        axes.legend(
            loc="lower right",
            ncols=2,
            fontsize=style.FONT,
            handlelength=0.8,  # wider, the two stick out of one of three panels
            handletextpad=0.3,
            columnspacing=0.4,
            borderaxespad=0.1,
            frameon=False,
            borderpad=0.1,
        )
        style.title_panel(axes, f"{analysis.name}: task {task:.1f} mm")
        axes.set_xlim(0, max(analysis.verification.time[-1], analysis.sagging.time[-1]))
        axes.grid(color="#E3E6EB", lw=0.6)
        if index + style.COLUMNS >= len(analyses):
            axes.set_xlabel("time (s)", size=style.FONT)
        if index % style.COLUMNS == 0:
            axes.set_ylabel("base height (mm)", size=style.FONT)
    style.put_legend(
        figure,
        [
            Line2D([], [], color=style.BLACK, lw=1.2, ls=":", label="task"),
            Line2D([], [], **_WITH, label="with feed-forward"),
            Line2D([], [], **_WITHOUT, label="without"),
            Line2D([], [], **_FAILS, label="fails"),
            Line2D([], [], ls="", label="in the panels: height lost, mean of the last second"),
        ],
    )
    style.save(figure, path)
