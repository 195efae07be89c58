"""The figure of how hard robots can be pushed: impulse over direction, seen from above."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator, NullFormatter
from numpy.typing import NDArray

from pupper_analysis.errors import ConfigurationError
from pupper_analysis.report.figures import style
from pupper_analysis.simulation.push import PushRecovery

Array = NDArray[np.float64]

_NAMES = {0: "0°\nforward", 90: "90°\nleft", 180: "180°\nback", 270: "270°\nright"}

# Told apart by marker and line as well, in black and white too.
_STYLES = tuple(
    zip(
        (style.BLUE, style.RED, style.GREEN, style.BLACK, style.ORANGE, style.SKY, style.GREY),
        ("o", "s", "^", "D", "v", "P", "X"),
        ("-", (0, (5, 1.5)), (0, (3, 1, 1, 1)), "-", (0, (5, 1.5)), (0, (3, 1, 1, 1)), "-"),
        strict=True,
    )
)


def push_figure(
    results: Mapping[str, PushRecovery], path: str | Path, *, tipping: str | None = None
) -> None:
    """Draws the largest push that each robot survives over its direction, forward drawn upwards.

    Args:
        results: Per robot, named as it shall be in the legend; seven at most.
        path: The PNG to write.
        tipping: The robot whose tipping estimate is drawn too; the first by default.

    Raises:
        ConfigurationError: If there is no robot, or too many, or ``tipping`` is none of them.
        OutputError: If the file cannot be written.
    """
    if not results:
        raise ConfigurationError("results", "there is no robot to draw")
    if len(results) > len(_STYLES):
        raise ConfigurationError("results", f"more than {len(_STYLES)} robots cannot be told apart")
    estimated = next(iter(results)) if tipping is None else tipping
    if estimated not in results:
        raise ConfigurationError("tipping", f"{estimated!r} is not one of: {', '.join(results)}")
    figure = style.page_figure(
        "Largest horizontal push that the stand survives", 0.72 * style.WIDTH
    )
    axes = figure.add_axes((0.06, 0.09, 0.58, 0.77), projection="polar")
    assert isinstance(axes, PolarAxes)
    axes.set_theta_zero_location("N")  # forward is up; angles grow to the left, as about z
    handles = []
    for (name, result), (colour, marker, line) in zip(results.items(), _STYLES, strict=False):
        look: dict[str, Any] = {
            "color": colour,
            "ls": line,
            "lw": 1.4,
            "marker": marker,
            "ms": 4.5,
        }
        axes.plot(*_closed(result.directions, result.impulses), mfc="white", **look)
        weakest = (result.weakest_direction, result.weakest_impulse)
        axes.plot(*weakest, **{**look, "ms": 6.5, "zorder": 4})
        label = f"{name}: {result.weakest_impulse:.2f} N s"
        handles.append(Line2D([], [], mfc="white", label=label, **look))
    tips = results[estimated]
    if np.isfinite(tips.tipping_estimate).all():
        around = _closed(tips.directions, tips.tipping_estimate)
        axes.plot(*around, color=style.BLACK, ls=":", lw=1.6, zorder=3)
        label = f"{estimated}, were it rigid:\ntipping estimate"
        handles.append(Line2D([], [], color=style.BLACK, ls=":", lw=1.6, label=label))
    angles = range(0, 360, 30)
    axes.set_xticks(np.radians(list(angles)), [_NAMES.get(angle, f"{angle}°") for angle in angles])
    axes.tick_params(axis="x", labelsize=style.FONT, pad=3)
    axes.set_ylim(0, None)
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=(1, 2, 5, 10)))
    axes.yaxis.set_major_formatter(NullFormatter())
    for impulse in axes.get_yticks():
        if 0 < impulse < 0.98 * axes.get_ylim()[1]:
            place = (np.radians(-15), impulse)
            box = {"fc": "white", "ec": "none", "pad": 0.6}
            axes.text(*place, f"{impulse:g} N s", size=style.FONT, ha="center", zorder=5, bbox=box)
    axes.grid(color="#D5D9DF", lw=0.6)
    legend = figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0.68, 0.86),
        fontsize=style.FONT,
        frameon=False,
        title="impulse in the weakest direction\n(filled marker)",
        title_fontsize=style.FONT,
        alignment="left",
        handlelength=3.2,
        labelspacing=0.9,
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
    style.save(figure, path)


def _closed(angles: Array, values: Array) -> tuple[Array, Array]:
    """Returns a line that ends where it began."""
    return np.append(angles, angles[0]), np.append(values, values[0])
