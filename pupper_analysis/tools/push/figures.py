"""The figure of how hard robots can be pushed: impulse over direction, seen from above."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.present.figures.drawing import write_plots
from pupper_analysis.present.html.plots import STYLES
from pupper_analysis.tools.push.document import push_plot
from pupper_analysis.tools.push.recovery import PushRecovery


def push_figure(
    results: Mapping[str, PushRecovery], path: str | Path, *, tipping: str | None = None
) -> None:
    """Draws the largest push that each robot survives over its direction, forward drawn upwards.

    Args:
        results: Per robot, named as it shall be in the legend; five at most.
        path: The PNG to write.
        tipping: The robot whose tipping estimate is drawn too; the first by default.

    Raises:
        ConfigurationError: If there is no robot, or too many, or ``tipping`` is none of them.
        OutputError: If the file cannot be written.
    """
    if not results:
        raise ConfigurationError("results", diagnose("no-robot-to-draw"))
    if len(results) >= STYLES:  # one is of the estimate
        raise ConfigurationError("results", diagnose("too-many-to-tell-apart", most=STYLES - 1))
    rigid = next(iter(results)) if tipping is None else tipping
    if rigid not in results:
        raise ConfigurationError("tipping", diagnose("none-of", value=rigid, known=results))
    write_plots([push_plot(results, rigid)], path)
