"""The figure of how hard robots can be pushed: impulse over direction, seen from above."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.present.figures.drawing import write_plots
from pupper_analysis.present.html.plots import NUM_SERIES_STYLES
from pupper_analysis.tools.push.document import push_plot
from pupper_analysis.tools.push.recovery import PushRecovery


def push_figure(results: Mapping[str, PushRecovery], path: str | Path) -> None:
    """Draws the largest push that each robot survives over its direction, forward drawn upwards.

    Args:
        results: Per robot, named as it shall be in the legend, with the first one's tipping
            estimate; five at most.
        path: The PNG to write.

    Raises:
        ConfigurationError: If there are too many robots.
        OutputError: If the file cannot be written.
    """
    if len(results) >= NUM_SERIES_STYLES:  # one is of the estimate
        raise ConfigurationError(
            "results", diagnose("too-many-to-tell-apart", most=NUM_SERIES_STYLES - 1)
        )
    write_plots([push_plot(results, next(iter(results)))], path)
