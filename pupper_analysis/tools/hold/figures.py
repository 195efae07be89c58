"""Figure of a posture of a robot with a fixed base: torques, reach, and forces on the tool."""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.present.document import Name, get_english
from pupper_analysis.present.figures.drawing import write_plots
from pupper_analysis.present.plots import make_figure_title
from pupper_analysis.tools.hold.document import (
    force_plots,
    hold_document,
    hold_torque_plot,
    reach_plot,
)
from pupper_analysis.tools.hold.hold import Hold


def hold_figure(hold: Hold, path: str | Path) -> None:
    """Draw motor utilisation, utilisation over the reach, and forces on the tool as a PNG file.

    The panels are below each other, because letters of panels side by side would be too small.

    Raises:
        OutputError: If the file cannot be written.
    """
    plots = [hold_torque_plot(hold), reach_plot(hold.reach), *force_plots(hold.force)]
    title = Name(f"{get_english(make_figure_title(hold_document(hold)))}, tool {hold.tool.name}")
    write_plots(plots, path, title=title, max_columns=1)
