"""Figure of the largest pushes of robots: impulse over direction."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.present.document import Words, get_english
from pupper_analysis.present.figures.drawing import write_plots
from pupper_analysis.present.html.plots import NUM_SERIES_STYLES
from pupper_analysis.tools.push.document import push_plot
from pupper_analysis.tools.push.recovery import PushRecovery


def push_figure(
    results: Mapping[str, PushRecovery], path: str | Path, *, title: Words | None = None
) -> None:
    """Draw the largest push of each robot over the direction (0 forward, 90 deg left) as a PNG.

    The figure also shows the estimated tipping impulse of the first robot (``tipping_impulses``),
    if finite. ``results`` is {name in the legend: largest pushes}. By default, ``title`` is the
    title of the plot.

    Raises:
        ConfigurationError: If there is no robot, or there are more than six.
        OutputError: If the file cannot be written.
    """
    if not results:
        raise ConfigurationError("results", diagnose("no-robot-to-draw"))
    if len(results) > NUM_SERIES_STYLES:
        raise ConfigurationError(
            "results", diagnose("too-many-to-tell-apart", most=NUM_SERIES_STYLES)
        )
    plot = push_plot(results, next(iter(results)))
    names = [] if title is None else [get_english(plot.title)]
    write_plots([plot], path, title=title, names=names)
