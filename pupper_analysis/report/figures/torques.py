"""The figure of what every motor holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import NDArray

from pupper_analysis.report.figures import style

if TYPE_CHECKING:
    from pupper_analysis.analysis.robot import Analysis

Array = NDArray[np.float64]
_LEAST_UTILISATION = 0.1  # %, where the axis of the torques begins
_PREDICTED: dict[str, Any] = {
    "color": style.BLUE,
    "marker": "o",
    "ls": "",
    "mfc": "white",
    "mew": 1.6,
    "ms": 7,
}

_SIMULATED: dict[str, Any] = {"color": style.BLACK, "marker": "x", "ls": "", "mew": 1.3, "ms": 4.5}


def torque_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draws what every motor holds, in percent of its effort limit: one panel per robot.

    The axis is logarithmic, so that motors at 0.2 % and at 30 % can both be read.

    Args:
        analyses: The robots; ``statics``, ``verification`` and ``joints`` are drawn.
        path: The PNG to write.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    rows = max((len(analysis.joints) for analysis in analyses), default=0)
    figure, panels = style.panels_of(
        analyses,
        "Motor torques of the stand (at the left edge: up to 0.1 % of the limit)",
        0.16 * rows + 0.62,
    )
    for index, (axes, analysis) in enumerate(zip(panels, analyses, strict=True)):
        limits = np.array([joint.effort for joint in analysis.joints])
        names = [joint.name for joint in analysis.joints]
        places = np.arange(len(names))
        predicted = utilisation(analysis.statics.joint_torques, limits)
        simulated = utilisation(analysis.verification.joint_torques, limits)
        greatest = np.fmax(predicted, simulated)
        floor = _LEAST_UTILISATION
        axes.hlines(places, floor, greatest.clip(floor), color="#C9CED6", lw=1)
        axes.plot(predicted.clip(floor), places, **_PREDICTED, clip_on=False, zorder=3)
        axes.plot(simulated.clip(floor), places, **_SIMULATED, clip_on=False, zorder=4)
        axes.axvline(100, color=style.RED, lw=2)
        _mark_greatest(axes, analysis, greatest, floor)
        low, high = limits.min(), limits.max()
        style.title_panel(
            axes,
            f"{analysis.name}: limit {low:g}" + (f" to {high:g}" if high > low else "") + " N m",
        )
        axes.set_xscale("log")
        axes.set_xlim(floor, 200)
        axes.xaxis.set_major_locator(FixedLocator((0.1, 1, 10, 100)))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(style.plain_numbers)
        axes.grid(axis="x", color="#E3E6EB", lw=0.6)
        axes.set_axisbelow(True)
        axes.set_ylim(len(names) - 0.4, -0.6)
        before = (
            [joint.name for joint in analyses[index - 1].joints] if index % style.COLUMNS else None
        )
        axes.set_yticks(places, names if names != before else [""] * len(names), parse_math=False)
        if index + style.COLUMNS >= len(analyses):
            axes.set_xlabel("torque / limit (%)", size=style.FONT)
    style.put_legend(
        figure,
        [
            Line2D([], [], **_PREDICTED, label="predicted (Pinocchio)"),
            Line2D([], [], **_SIMULATED, label="simulated (MuJoCo, with feed-forward)"),
            Line2D([], [], color=style.RED, lw=2, label="limit"),
        ],
    )
    style.save(figure, path)


def utilisation(torques: Array, limits: Array) -> Array:
    """Returns |torque| / limit in percent; 0 where there is no limit."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((limits > 0) & np.isfinite(limits), 100 * np.abs(torques) / limits, 0.0)


def _mark_greatest(axes: Axes, analysis: Analysis, percents: Array, floor: float) -> None:
    """Writes the torque that is predicted of the motor that is used most beside its point."""
    most = int(np.argmax(percents > 0.999 * percents.max()))
    torque = abs(analysis.statics.joint_torques[most])
    left = percents[most] < 5
    axes.annotate(
        f"{torque:.3f} N m",
        (max(percents[most], floor), most),
        (7 if left else -7, 0),
        textcoords="offset points",
        size=style.FONT,
        ha="left" if left else "right",
        va="center",
        zorder=5,
        bbox={"fc": "white", "ec": "none", "pad": 0.5},
    )
