"""The figures of a study: heat maps, parallel coordinates, Pareto fronts, regions of failure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.present.document import Name
from pupper_analysis.present.figures import style
from pupper_analysis.present.figures.drawing import draw_plot, plot_figure
from pupper_analysis.present.plots import Plot
from pupper_analysis.present.words import in_english
from pupper_analysis.tools.study import document_plots as study_plots
from pupper_analysis.tools.study.cells import check_columns, spread_in, standing_designs
from pupper_analysis.tools.study.figures_maps import ALL_MEASURED, put_scale
from pupper_analysis.tools.study.pareto import pareto_front
from pupper_analysis.tools.study.plots import EndsPlot, MeansPlot

if TYPE_CHECKING:
    import pandas as pd


def heat_map(
    table: pd.DataFrame,
    x: str,
    y: str,
    metric: str,
    path: str | Path,
    *,
    others: Sequence[str] = (),
) -> None:
    """Draws a metric over two variables.

    Each combination of the other variables' values has a panel, where these are few; else a cell is
    a mean over them. Cells without any value are grey. Hatched are those in whose mean designs are
    missing, as they do not stand.

    Args:
        table: Of a study.
        x: The variable along the figure.
        y: The variable upwards.
        metric: The column that is drawn.
        path: The PNG to write.
        others: The other variables.

    Raises:
        ConfigurationError: If a column is not there.
        OutputError: If the file cannot be written.
    """
    _write(study_plots.mean_plots(table, x, y, metric, others), path)


def failure_map(
    table: pd.DataFrame, x: str, y: str, path: str | Path, *, others: Sequence[str] = ()
) -> None:
    """Draws what most designs of a cell come to, over two variables: their reason, or none.

    Args:
        table: Of a study.
        x: The variable along the figure.
        y: The variable upwards.
        path: The PNG to write.
        others: The other variables: each combination of their values has a panel, where these are
            few.

    Raises:
        ConfigurationError: If a column is not there.
        OutputError: If the file cannot be written.
    """
    _write(study_plots.end_plots(table, x, y, others), path)


def parallel_coordinates(
    table: pd.DataFrame, columns: Sequence[str], colour: str, path: str | Path
) -> None:
    """Draws each design as a line over several columns; failed ones end in grey.

    Args:
        table: Of a study.
        columns: From left to right.
        colour: The column that colours the lines.
        path: The PNG to write.

    Raises:
        ConfigurationError: If a column is not there.
        OutputError: If the file cannot be written.
    """
    plot_figure(study_plots.parallel_plot(table, columns, colour), path)


def pareto_figure(
    table: pd.DataFrame,
    objectives: Mapping[str, str],
    path: str | Path,
    *,
    by: str | None = None,
    title: str | None = None,
    labels: Mapping[str, str] | None = None,
) -> None:
    """Draws all designs over two objectives, and the front of those that no other beats.

    Args:
        table: Of a study.
        objectives: {column: ``"min"`` or ``"max"``}, two of them.
        path: The PNG to write.
        by: A column; each of its values has a front of its own.
        title: Over the figure.
        labels: {column: what the axis says}.

    Raises:
        ConfigurationError: If there are not two objectives, or a column is not there.
        OutputError: If the file cannot be written.
    """
    if len(objectives) != 2:
        raise ConfigurationError(
            "objectives", diagnose("objectives-not-two", count=len(objectives))
        )
    check_columns(table, *((by,) if by else ()))
    groups: list[tuple[Name | None, pd.DataFrame]] = [(None, table)]
    if by is not None:
        said = (labels or {}).get(by, by)
        values = sorted(table[by].dropna().unique())
        groups = [(Name(f"{said} {value:g}"), table[table[by] == value]) for value in values]
    x, y = objectives
    shown = Name(title or f"Pareto front: {x} against {y}")
    plots = [
        study_plots.front_plot(
            part, pareto_front(part, objectives), objectives, title=shown, labels=labels, name=name
        )
        for name, part in groups
    ]
    figure = style.page_figure(in_english(shown), 3.4, layout="constrained")
    axes = figure.add_subplot()
    handles = [handle for plot in plots for handle in draw_plot(plot, axes)]
    style.title_panel(axes, "")
    style.put_legend(figure, handles)
    style.save_figure(figure, path)


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
    axes = spread[:2] if len(spread) > 1 else ()
    paths = []
    for name, plots in study_plots.study_plots(table, variables, axes).items():
        paths.append(folder / f"{name}.png")
        _write(plots, paths[-1])
    if objectives is not None and len(objectives) == 2:
        up = standing_designs(table)
        if not up.dropna(subset=list(objectives)).empty:
            paths.append(folder / "front.png")
            pareto_figure(up, objectives, paths[-1])
    return paths


def _write(plots: Sequence[Plot], path: str | Path) -> None:
    """Writes the maps of one metric as panels of one figure, or any other plot alone."""
    first = plots[0]
    if not isinstance(first, MeansPlot | EndsPlot):
        plot_figure(first, path)
        return
    figure, panels = _panels(in_english(first.title), len(plots))
    named = {
        handle.get_label(): handle
        for axes, plot in zip(panels, plots, strict=True)
        for handle in draw_plot(plot, axes)
    }
    if isinstance(first, MeansPlot):
        put_scale(panels, first.ends, first.metric)
    else:
        named = _counted(named, [plot for plot in plots if isinstance(plot, EndsPlot)])
    if named:
        style.put_legend(figure, list(named.values()))
    style.save_figure(figure, path)


def _counted(named: Mapping[object, Artist], plots: Sequence[EndsPlot]) -> dict[object, Artist]:
    """Returns what kinds of ends look like, with how many there are on all panels."""
    found: dict[object, Artist] = {}
    for kind in plots[0].kinds:
        counts = (one.found.counts[one.found.kinds.index(kind)].sum()
                  for one in plots if kind in one.found.kinds)  # fmt: skip
        if total := int(sum(counts)):
            name = kind or ALL_MEASURED
            found[name] = named[name]
            found[name].set_label(f"{name} ({total})")
    return found


def _panels(title: str, count: int) -> tuple[Figure, list[Axes]]:
    """Returns a figure with panels beside each other, three in a row."""
    columns = min(count, 3)
    rows = -(-count // columns)
    width = style.WIDTH if count == 1 else max(style.WIDTH, 3.0 * columns + 1.2)
    figure = style.page_figure(title, 3.4 if rows == 1 else 2.9 * rows, width=width,
                               layout="constrained")  # fmt: skip
    return figure, [figure.add_subplot(rows, columns, 1 + index) for index in range(count)]
