"""What is drawn of studies, as data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pupper_analysis.present.plots import Plot

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
        name: Which designs they are, if others have a front of their own.
    """

    table: pd.DataFrame
    front: pd.DataFrame
    axes: tuple[str, str]
    objectives: Sequence[str]
    name: Words | None = None
