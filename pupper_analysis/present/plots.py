"""What is drawn, as data: which lines over which axes. How it is drawn is a renderer's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from pupper_analysis.present.document import Words


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
