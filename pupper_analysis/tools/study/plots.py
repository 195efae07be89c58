"""What is drawn of studies, as data."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.present.document import Name, Plot, Text, Words, text
from pupper_analysis.present.html.plots import (
    BOTTOM,
    LEFT,
    TOP,
    WIDTH,
    Drawing,
    Mark,
    draw_axes,
    draw_grid,
    draw_line,
    draw_svg,
    round_ticks,
    word_at,
)
from pupper_analysis.tools.study.outcome import (
    Cells,
    MeanMap,
    Panel,
    check_columns,
    column_label,
    mean_map,
    metrics_in,
    split_panels,
    value_span,
)

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]


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


# What is drawn of a study on its page: maps, designs as lines, fronts.

MAPS = 3
"""Measures that have a map each."""

LINES = 4
"""Measures beside the objectives in a table of the front."""


def study_plots(
    table: pd.DataFrame, variables: Sequence[str], axes: Sequence[str]
) -> dict[str, list[Plot]]:
    """Returns what a study can show without being asked, each drawing with a name for its file.

    Args:
        table: Of the study.
        variables: What varies in it.
        axes: The two variables that span the maps; empty if there are no two.
    """
    metrics = metrics_in(table, variables)
    shown: dict[str, list[Plot]] = {}
    if axes:
        x, y = axes
        for metric in metrics[:MAPS]:
            shown[f"map_{metric}"] = [*mean_plots(table, x, y, metric, variables)]
    return shown


def mean_plots(
    table: pd.DataFrame, x: str, y: str, metric: str, variables: Sequence[str] = ()
) -> list[MeansPlot]:
    """Returns a metric's maps: one, or one for each combination of other variables.

    Args:
        table: Of a study.
        x: The variable along.
        y: The variable upwards.
        metric: What is shown; all maps have the same colours.
        variables: What varies in it.

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


# Drawings of many designs: maps over two numbers, lines over several, clouds with their front.


MAP_HEIGHT = 380.0
"""Of a map (CSS pixels)."""

BAR_ROOM = 92.0
"""At the right of a map (CSS pixels): a bar of its colours, with words."""

MOST_DOTS = 1500
"""Designs of a cloud, evenly drawn of more."""

FEW_LABELS = 10
"""Values that are written along one side of a map."""

_VIRIDIS = ("#440154", "#482878", "#3e4989", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58",
            "#b5de2b", "#fde725")  # fmt: skip
"""Matplotlib's, which is even to the eye, in grey too, and to those who see few colours."""


def colour_of_share(share: float) -> str:
    """Returns the colour of a share from 0 to 1."""
    place = min(max(share, 0.0), 1.0) * (len(_VIRIDIS) - 1)
    first = min(int(place), len(_VIRIDIS) - 2)
    pair = [[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in _VIRIDIS[first : first + 2]]
    mixed = [round(a + (b - a) * (place - first)) for a, b in zip(*pair, strict=True)]
    return "#{:02x}{:02x}{:02x}".format(*mixed)


@draw_svg.register
def _means(plot: MeansPlot) -> Drawing:
    """Draws means, which show under the pointer."""
    found, x, y = plot.found, plot.x, plot.y
    low, high = plot.ends
    wide = value_span(low, high)

    def filled(row: int, column: int) -> tuple[str, float]:
        mean = float(found.means[row, column])
        if not math.isfinite(mean):
            return "", 1.0
        return colour_of_share((mean - low) / wide if wide else 0.5), 1.0

    def label(row: int, column: int) -> str:
        mean = float(found.means[row, column])
        if not math.isfinite(mean):
            return "-"
        several = found.designs[row, column] > 1
        of = f" ({found.counts[row, column]:.0f} / {found.designs[row, column]:.0f})"
        return f"{mean:.4g}{of if several else ''}"

    cells = _Grid(found.x, found.y)
    marks = [*cells.cells(filled), *cells.crossed(found.partial), *cells.axes(x, y)]
    marks += _bar(low, high)
    marks.append(cells.labels(Name(column_label(plot.metric)), x, y, label))
    return Drawing(_titled(plot), WIDTH, MAP_HEIGHT, tuple(marks))


def _titled(plot: MeansPlot) -> Words:
    """Returns a map's title, and of which designs it is."""
    return plot.title if plot.part is None else text("name-note", name=plot.title, note=plot.part)


@draw_svg.register
def _front(plot: FrontPlot) -> Drawing:
    table, front = plot.table, plot.front
    x, y = plot.objectives
    known = table.dropna(subset=[x, y])
    low = [float(known[name].min()) for name in (x, y)]
    high = [float(known[name].max()) for name in (x, y)]
    room = [0.04 * ((b - a) or abs(b) or 1.0) for a, b in zip(low, high, strict=True)]
    wide, tall = WIDTH - LEFT - 14.0, MAP_HEIGHT - TOP - BOTTOM

    def place(values: Array) -> Array:
        share = (values - np.array(low) + room) / (np.array(high) - low + 2 * np.array(room))
        points = np.array([LEFT, TOP + tall]) + share * np.array([wide, -tall])
        return np.asarray(np.round(points, 1))

    across, up = (
        {value: place(np.array([value, value]))[axis] for value in round_ticks(least, most, 6)}
        for axis, (least, most) in enumerate(zip(low, high, strict=True))
    )
    marks = [
        *draw_grid(across, up, wide, tall),
        *draw_axes(Name(plot.axes[0]), Name(plot.axes[1]), wide, tall),
    ]
    cloud = _evenly(known, MOST_DOTS)
    for part, style, name in (
        (cloud, "s0", text("designs")),
        (front, "s1", text("no-other-design-beats-these")),
    ):
        numbers = part[[x, y]].to_numpy(float)
        points = place(numbers)
        labels = [_plain(f"{x} {a:.4g}, {y} {b:.4g}") for a, b in numbers]
        kind = f"series {style}" if style == "s1" else "unseen"
        marks.append({"tag": "polyline", "class": kind, "points": points.tolist(),
                      "labels": labels, "name": name})  # fmt: skip
        size = 3.5 if style == "s1" else 2.0
        marks += [{"tag": "circle", "class": f"dot {style}", "cx": cx, "cy": cy, "r": size}
                  for cx, cy in points.tolist()]  # fmt: skip
    legend = ((text("designs"), "s0"), (text("no-other-design-beats-these"), "s1"))
    return Drawing(plot.title, WIDTH, MAP_HEIGHT, tuple(marks), legend)


class _Grid:
    """Cells of one size, whatever values they stand for: each can be pointed at."""

    def __init__(self, x: Cells, y: Cells) -> None:
        self.x, self.y = x, y
        self.wide, self.tall = WIDTH - LEFT - BAR_ROOM, MAP_HEIGHT - TOP - BOTTOM
        self.across, self.up = self.wide / len(x.centres), self.tall / len(y.centres)

    def cells(self, filled: Callable[[int, int], tuple[str, float]]) -> list[Mark]:
        """Returns the cells, by (row, column) coloured; without a colour they are empty."""
        marks: list[Mark] = []
        for row, column in np.ndindex(len(self.y.centres), len(self.x.centres)):
            fill, opacity = filled(row, column)
            bounds = {
                "x": LEFT + column * self.across,
                "y": TOP + (len(self.y.centres) - 1 - row) * self.up,
                "width": self.across,
                "height": self.up,
            }
            style = {"fill": fill, "opacity": opacity} if fill else {}
            kind = "cell" if fill else "cell empty"
            marks.append({"tag": "rect", "class": kind, **bounds, **style})
        return marks

    def crossed(self, chosen: NDArray[np.bool_]) -> list[Mark]:
        """Returns lines across some cells."""
        marks = []
        for row, column in np.argwhere(chosen):
            left, foot = LEFT + column * self.across, TOP + self.tall - row * self.up
            for x0, y0, x1, y1 in (
                (0.0, 0.5, 0.5, 1.0),
                (0.0, 0.0, 1.0, 1.0),
                (0.5, 0.0, 1.0, 0.5),
            ):
                begin = left + x0 * self.across, foot - y0 * self.up
                marks.append(
                    draw_line(*begin, left + x1 * self.across, foot - y1 * self.up, "axis")
                )
        return marks

    def labels(
        self,
        name: Words,
        x: str,
        y: str,
        label: Callable[[int, int], str],
    ) -> Mark:
        """Returns what cells say when pointed at: an unseen line through their middles."""
        points, labels = [], []
        for row, column in np.ndindex(len(self.y.centres), len(self.x.centres)):
            middle = LEFT + (column + 0.5) * self.across
            points.append([round(middle, 1), round(TOP + self.tall - (row + 0.5) * self.up, 1)])
            at = f"{x} {self.x.centres[column]:.4g}, {y} {self.y.centres[row]:.4g}"
            labels.append(_plain(f"{at}: {label(row, column)}"))
        reach = math.hypot(self.across, self.up) / 2
        return {"tag": "polyline", "class": "unseen", "points": points, "labels": labels,
                "name": name, "reach": reach}  # fmt: skip

    def axes(self, x: str, y: str) -> list[Mark]:
        """Returns the axes, with the values of some cells."""
        marks = draw_axes(Name(column_label(x)), Name(column_label(y)), self.wide, self.tall)
        for index in _some(len(self.x.centres)):
            at = LEFT + (index + 0.5) * self.across
            words = Name(f"{self.x.centres[index]:.4g}")
            marks.append(word_at(at, TOP + self.tall + 16, words, "middle"))
        for index in _some(len(self.y.centres)):
            at = TOP + self.tall - (index + 0.5) * self.up
            marks.append(word_at(LEFT - 6, at + 4, Name(f"{self.y.centres[index]:.4g}"), "end"))
        return marks


def _some(count: int) -> range:
    """Returns which of some cells have their value written beside them."""
    return range(0, count, -(-count // FEW_LABELS))


def _bar(low: float, high: float) -> list[Mark]:
    """Returns the bar that tells which colour is which value."""
    steps, tall = 40, MAP_HEIGHT - TOP - BOTTOM
    left, height = WIDTH - BAR_ROOM + 16.0, tall / 40
    marks: list[Mark] = [
        {"tag": "rect", "class": "cell", "x": left, "y": TOP + tall - (step + 1) * height,
         "width": 14.0, "height": height + 0.5, "fill": colour_of_share((step + 0.5) / steps),
         "opacity": 1.0}
        for step in range(steps)
    ]  # fmt: skip
    for share in (0.0, 0.5, 1.0):
        value = low + share * (high - low)
        at = TOP + tall - share * tall + (4 if share else 0)
        marks.append(
            word_at(left + 18, at + (6 if share == 1 else 0), Name(f"{value:.3g}"), "start")
        )
    return marks


def _evenly(table: pd.DataFrame, most: int) -> pd.DataFrame:
    """Returns at most so many rows, evenly drawn."""
    if len(table) <= most:
        return table
    return table.iloc[np.linspace(0, len(table) - 1, most).astype(int)]


def _plain(label: str) -> str:
    """Returns a label without what parts labels from each other in the page."""
    return label.replace("|", "¦")
