"""Figure of stable gains: largest damping over stiffness."""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.present.document import get_english
from pupper_analysis.present.figures.drawing import write_plots
from pupper_analysis.present.plots import make_figure_title
from pupper_analysis.tools.gains.document import gain_plot, gains_document
from pupper_analysis.tools.gains.gains import GainStudy


def gain_figure(study: GainStudy, path: str | Path) -> None:
    """Draw the largest stable damping over the stiffness as a PNG file, with marked gains.

    The reference gains and the recommended gains are marked.

    Raises:
        OutputError: If the file cannot be written.
    """
    plot, title = gain_plot(study), make_figure_title(gains_document(study))
    write_plots([plot], path, title=title, names=[get_english(plot.title)])
