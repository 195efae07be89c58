"""What is drawn of studies, as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pupper_analysis.present import plots
from pupper_analysis.present.document import Name, Text
from pupper_analysis.present.plots import Plot
from pupper_analysis.present.words import text
from pupper_analysis.tools.study.cells import (
    Panel,
    check_columns,
    column_label,
    end_map,
    mean_map,
    metrics_in,
    split_panels,
    spread_in,
)

if TYPE_CHECKING:
    import pandas as pd

    from pupper_analysis.present.document import Words
    from pupper_analysis.tools.study.cells import EndMap, MeanMap


@dataclass(frozen=True, eq=False)
class MeansPlot(Plot):
    """Means of a metric over two variables; cells in whose mean designs are missing are crossed.

    Attributes:
        found: The means.
        x: The variable along.
        y: The variable upwards.
        metric: The metric.
        ends: The least and the greatest value that colours tell.
        part: Of which designs it is, if others have a map of their own, or what is averaged.
    """

    found: MeanMap
    x: str
    y: str
    metric: str
    ends: tuple[float, float]
    part: Words | None = None


@dataclass(frozen=True, eq=False)
class EndsPlot(Plot):
    """What most designs of each cell come to; paler where they come to different ends.

    Attributes:
        found: What becomes of the designs.
        x: The variable along.
        y: The variable upwards.
        kinds: Of the whole study, whose colours are the same in all its maps.
        part: As of a ``MeansPlot``.
    """

    found: EndMap
    x: str
    y: str
    kinds: Sequence[str]
    part: Words | None = None


@dataclass(frozen=True, eq=False)
class ParallelPlot(Plot):
    """Each design as a line over several columns, coloured by one of them.

    Attributes:
        table: Of a study.
        columns: From left to right.
        shade: The column that colours the lines; grey are designs that have none.
    """

    table: pd.DataFrame
    columns: Sequence[str]
    shade: str


@dataclass(frozen=True, eq=False)
class FrontPlot(Plot):
    """Designs over two metrics, and the front of those that no other beats.

    Attributes:
        table: Of a study.
        front: The front of it.
        axes: What is said along, and upwards: the objectives' columns, with their units.
        objectives: Their columns: along, and upwards.
    """

    table: pd.DataFrame
    front: pd.DataFrame
    axes: tuple[str, str]
    objectives: Sequence[str]


# What is drawn of a study, on its page and as figures: maps, designs as lines, fronts.

MAPS = 3
"""Measures that have a map each."""

LINES = 4
"""Measures beside the variables in parallel coordinates."""


def study_plots(
    table: pd.DataFrame, variables: Sequence[str], axes: Sequence[str]
) -> dict[str, list[plots.Plot]]:
    """Returns what a study can show without being asked, each drawing with a name for its file.

    Args:
        table: Of the study.
        variables: What varies in it.
        axes: The two variables that span the maps; empty if there are no two.
    """
    metrics, spread = metrics_in(table, variables), spread_in(table, variables)
    shown: dict[str, list[plots.Plot]] = {}
    if axes:
        x, y = axes
        shown["failures"] = [*end_plots(table, x, y, variables)]
        for metric in metrics[:MAPS]:
            shown[f"map_{metric}"] = [*mean_plots(table, x, y, metric, variables)]
    if spread and metrics:
        columns = [*(name for name in variables if name in spread), *metrics[:LINES]]
        shown["parallel"] = [parallel_plot(table, columns, metrics[0])]
    return shown


def end_plots(table: pd.DataFrame, x: str, y: str, variables: Sequence[str] = ()) -> list[EndsPlot]:
    """Returns what becomes of designs: a map, or one for each combination of other variables.

    Args:
        table: Of a study.
        x: The variable along.
        y: The variable upwards.
        variables: What varies in it.

    Raises:
        ConfigurationError: If a column is not there, or the table is empty.
    """
    kinds = end_map(table, x, y).kinds
    title = text("what-becomes-of-designs-over", x=Name(x), y=Name(y))
    return [
        EndsPlot(title, end_map(one.table, x, y), x, y, kinds, _part(one))
        for one in split_panels(table, variables, x, y)
    ]


def mean_plots(
    table: pd.DataFrame, x: str, y: str, metric: str, variables: Sequence[str] = ()
) -> list[MeansPlot]:
    """Returns a metric's maps, in the same colours; see ``end_plots``.

    Raises:
        ConfigurationError: If a column is not there, or the table is empty.
    """
    check_columns(table, x, y, metric)
    maps = [
        (panel, mean_map(panel.table, x, y, metric))
        for panel in split_panels(table, variables, x, y)
    ]
    known = np.concatenate([one.means[np.isfinite(one.means)] for _, one in maps])
    ends = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    named = Name(column_label(metric))
    title = text("metric-over-x-and-y", metric=named, x=Name(x), y=Name(y))
    return [MeansPlot(title, found, x, y, metric, ends, _part(panel)) for panel, found in maps]


def _part(panel: Panel) -> Text | Name | None:
    """Returns what a map's designs have in common, or what is averaged."""
    if panel.averaged:
        return text("mean-over", names=", ".join(panel.averaged))
    return Name(panel.values()) if panel.fixed else None


def parallel_plot(table: pd.DataFrame, columns: Sequence[str], shade: str) -> ParallelPlot:
    """Returns designs as lines over columns, coloured by one.

    Raises:
        ConfigurationError: If a column is not there, or the table is empty.
    """
    check_columns(table, *columns, shade)
    title = text("designs-as-lines-coloured", metric=Name(shade))
    return ParallelPlot(title, table, columns, shade)


def front_plot(
    table: pd.DataFrame, front: pd.DataFrame, objectives: Mapping[str, str]
) -> FrontPlot:
    """Returns designs over two objectives, with their front.

    Args:
        table: The designs.
        front: Those that no other beats.
        objectives: {column: ``"min"`` or ``"max"``}, two of them.
    """
    along, up = (f"{column_label(one)}, {sense}" for one, sense in objectives.items())
    title = text("designs-worth-building-the-front")
    return FrontPlot(title, table, front, (along, up), list(objectives))
