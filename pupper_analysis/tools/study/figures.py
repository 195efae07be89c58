"""The figures of a study: what its page draws, as PNGs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.patches import Patch

from pupper_analysis.present.figures.drawing import write_plots
from pupper_analysis.tools.study.cells import spread_in, standing_designs
from pupper_analysis.tools.study.outcome import pareto_front
from pupper_analysis.tools.study.plots import MeansPlot, front_plot, study_plots

if TYPE_CHECKING:
    import pandas as pd


def draw_study(
    table: pd.DataFrame,
    variables: Sequence[str],
    folder: Path,
    objectives: Mapping[str, str] | None = None,
) -> list[Path]:
    """Draws what a study can show without being asked, as its page does: returns the files.

    Two variables of most values span the maps; the first metrics fill them. Two objectives, if
    there are two, have their front.

    Raises:
        OutputError: If a file cannot be written.
    """
    spread = spread_in(table, variables)
    shown = study_plots(table, variables, spread[:2] if len(spread) > 1 else ())
    if objectives is not None and len(objectives) == 2:
        up = standing_designs(table)
        if not up.dropna(subset=list(objectives)).empty:
            shown["front"] = [front_plot(up, pareto_front(up, objectives), objectives)]
    paths = []
    for name, plots in shown.items():
        paths.append(folder / f"{name}.png")
        partial = any(isinstance(one, MeansPlot) and one.found.partial.any() for one in plots)
        write_plots(plots, paths[-1], notes=[_crossed()] if partial else [])
    return paths


def _crossed() -> Patch:
    said = "crossed: some do not stand; the mean is of the others"
    return Patch(facecolor="none", edgecolor="black", hatch="///", label=said)
