"""Figure of heat: temperatures of the windings over time."""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.present.document import get_english
from pupper_analysis.present.figures.drawing import write_plots
from pupper_analysis.present.plots import make_figure_title
from pupper_analysis.tools.heat.document import heat_document, heat_plots
from pupper_analysis.tools.heat.heat import HeatStudy


def heat_figure(study: HeatStudy, path: str | Path) -> None:
    """Draw the temperatures of the hottest windings over time as a PNG file.

    Raises:
        ConfigurationError: If no temperature of a loaded motor is known, for example.
        OutputError: If the file cannot be written.
    """
    plots = heat_plots(study)
    title = make_figure_title(heat_document(study))
    write_plots(plots, path, title=title, names=[get_english(plot.title) for plot in plots])
