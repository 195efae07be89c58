"""What is drawn, as data: which lines over which axes. How it is drawn is a renderer's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from numpy.typing import ArrayLike

if TYPE_CHECKING:
    import pandas as pd

    from pupper_analysis.report.document import Words
    from pupper_analysis.study.cells import EndMap, MeanMap


@dataclass(frozen=True)
class Axis:
    """What an axis measures.

    Attributes:
        name: The quantity.
        unit: Its unit.
        form: How its values are written.
        log: Whether it is logarithmic.
    """

    name: Words
    unit: str
    form: str
    log: bool = False


@dataclass(frozen=True, eq=False)
class Series:
    """One line of a drawing.

    Attributes:
        name: Whose it is.
        x: (n,) along, in the axis's unit.
        y: (n,) up, in the axis's unit; what is not finite is left out.
        points: Whether every point is marked.
        note: What it comes to, in a word or a number, beside its name in the legend.
        marked: The number of the point that matters most; None for none.
        fails: Whether its last point is where it fails, and is crossed.
        reference: Whether it is what the others are compared with.
    """

    name: Words
    x: ArrayLike
    y: ArrayLike
    points: bool = False
    note: Words | None = None
    marked: int | None = None
    fails: bool = False
    reference: bool = False


@dataclass(frozen=True)
class Bar:
    """A bar of a bar plot.

    Attributes:
        name: Its name.
        value: Its length, in the axis's unit.
        other: What is marked beside it by a tick; None for nothing.
        limit: How long it may be; None for no limit.
    """

    name: Words
    value: float
    other: float | None = None
    limit: float | None = None


@dataclass(frozen=True, eq=False)
class Plot:
    """A drawing.

    Attributes:
        title: What it shows.
        detail: Whether a short view leaves it out.
    """

    kind: ClassVar[str] = "plot"
    detail: ClassVar[bool] = False
    title: Words


@dataclass(frozen=True, eq=False)
class LinePlot(Plot):
    """Lines over one another.

    Attributes:
        x: The axis along.
        y: The axis up.
        series: The lines, at least one with a finite value.
        note: What the notes beside the lines' names are; None where there are none.
    """

    x: Axis
    y: Axis
    series: Sequence[Series]
    note: Words | None = None


@dataclass(frozen=True, eq=False)
class BarPlot(Plot):
    """Bars from zero to both sides, each with its limit and with another value beside it.

    Attributes:
        axis: What they measure.
        bars: The bars, from above.
        legend: What a bar's value, the other value and the limit are; None of what no bar has.
    """

    axis: Axis
    bars: Sequence[Bar]
    legend: tuple[Words, Words | None, Words | None]


@dataclass(frozen=True, eq=False)
class DirectionPlot(Plot):
    """Values by direction, as seen from above: forward is up, left is left.

    Attributes:
        axis: What their distances from the middle measure.
        series: Per robot, ``x`` are the directions (rad) and ``y`` the values.
        note: What the notes beside the lines' names are; None where there are none.
    """

    axis: Axis
    series: Sequence[Series]
    note: Words | None = None


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
