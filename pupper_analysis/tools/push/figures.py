"""The figure of how hard robots can be pushed: impulse over direction, seen from above."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.present.figures import style
from pupper_analysis.present.figures.drawing import draw_plot
from pupper_analysis.present.words import in_english
from pupper_analysis.tools.push.document import push_plot
from pupper_analysis.tools.push.recovery import PushRecovery


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
        raise ConfigurationError("results", diagnose("no-robot-to-draw"))
    if len(results) > len(style.LOOKS):
        raise ConfigurationError(
            "results", diagnose("too-many-to-tell-apart", most=len(style.LOOKS))
        )
    rigid = next(iter(results)) if tipping is None else tipping
    if rigid not in results:
        raise ConfigurationError("tipping", diagnose("none-of", value=rigid, known=results))
    plot = push_plot(results, rigid)
    title = "Largest horizontal push that the stand survives"
    figure = style.page_figure(title, 0.72 * style.WIDTH)
    handles = draw_plot(plot, figure.add_axes((0.06, 0.09, 0.58, 0.77), projection="polar"))
    for handle, one in zip(handles, plot.series, strict=True):
        if one.reference:  # beside the circle there is room for half a line
            handle.set_label(str(handle.get_label()).replace(": ", ":\n", 1))
    legend = figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0.68, 0.86),
        fontsize=style.FONT,
        frameon=False,
        title=None if plot.note is None else in_english(plot.note).replace(" (", "\n(", 1),
        title_fontsize=style.FONT,
        alignment="left",
        handlelength=3.2,
        labelspacing=0.9,
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
    style.save_figure(figure, path)
