"""A study's designs in cells over two of its numbers: what a map of them shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.stance.fields import FIELDS
from pupper_analysis.tools.study.design import ENDS, NUMBERS, UNBOUNDED
from pupper_analysis.tools.study.measures import METRICS
from pupper_analysis.tools.study.parameters import AXES, OF_JOINTS

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

BINS, FEWEST = 24, 4
"""Cells along one side of a map, of a variable that has more than ``BINS`` values."""

PANELS = 6
"""Maps beside each other, one for each combination of the other variables: more are no picture."""

EACH = 3
"""Designs that a cell then has, on average: fewer cells of more designs, than a map of holes."""

SAME = 1e-9
"""Relative: what differs by less differs by rounding."""


class Cells:
    """Values in cells: one per value where they are few, evenly wide ones where they are many.

    Attributes:
        levels: Whether each cell has one value.
        edges: (n + 1,) between which the cells are.
        centres: (n,) their values, or their middles.
        index: (designs,) in which cell each design is.
    """

    def __init__(self, values: Array) -> None:
        levels = np.unique(values)
        self.levels = len(levels) <= BINS
        if self.levels:
            middle = (levels[1:] + levels[:-1]) / 2
            first, last = levels[0], levels[-1]
            half = (middle[0] - first, last - middle[-1]) if len(middle) else (0.5, 0.5)
            self.edges = np.concatenate([[first - half[0]], middle, [last + half[1]]])
            self.index = np.searchsorted(levels, values)
            self.centres = levels
            return
        count = int(np.clip(np.sqrt(len(values) / EACH), FEWEST, BINS))
        self.edges = np.linspace(levels[0], levels[-1], count + 1)
        self.index = np.clip(np.searchsorted(self.edges, values, "right") - 1, 0, count - 1)
        self.centres = (self.edges[1:] + self.edges[:-1]) / 2


@dataclass(frozen=True, eq=False)
class MeanMap:
    """Means of a metric over two variables.

    Attributes:
        x: The cells along.
        y: The cells upwards.
        means: (ny, nx); not a number where nothing was measured.
        counts: (ny, nx) how many designs each is the mean of.
        designs: (ny, nx) how many are there: where they are more, those of which there is nothing
            to measure, as they do not stand, are missing in the mean.
    """

    x: Cells
    y: Cells
    means: Array
    counts: Array
    designs: Array

    @property
    def partial(self) -> NDArray[np.bool_]:
        """(ny, nx) whether some designs of a cell are missing in its mean."""
        found: NDArray[np.bool_] = (self.counts > 0) & (self.counts < self.designs)
        return found


@dataclass(frozen=True, eq=False)
class Panel:
    """Designs of one map.

    Attributes:
        fixed: {variable: the value that all of them have}.
        averaged: The other variables, over which a cell's mean goes.
        table: Their rows.
    """

    fixed: dict[str, float]
    averaged: tuple[str, ...]
    table: pd.DataFrame

    def values(self) -> str:
        """Returns the fixed values with their units."""
        finding = [f"{name} = {value:g} {unit_of(name)}" for name, value in self.fixed.items()]
        return ", ".join(one.rstrip() for one in finding)


@dataclass(frozen=True, eq=False)
class EndMap:
    """What becomes of designs over two variables.

    Attributes:
        x: The cells along.
        y: The cells upwards.
        kinds: ``""`` for those of which all was measured, then kinds of failure, the most frequent
            first.
        counts: (kinds, ny, nx) designs.
    """

    x: Cells
    y: Cells
    kinds: tuple[str, ...]
    counts: Array


def mean_map(table: pd.DataFrame, x: str, y: str, metric: str) -> MeanMap:
    """Returns the mean of a metric over two variables.

    Raises:
        ConfigurationError: If a column is not there, or the table is empty.
    """
    check_columns(table, x, y, metric)
    columns, rows = (Cells(table[name].to_numpy(float)) for name in (x, y))
    values = table[metric].to_numpy(float)
    sums, counts, there = (np.zeros((len(rows.centres), len(columns.centres))) for _ in range(3))
    known = np.isfinite(values)
    np.add.at(there, (rows.index, columns.index), 1.0)
    at = (rows.index[known], columns.index[known])
    np.add.at(sums, at, values[known])
    np.add.at(counts, at, 1.0)
    with np.errstate(invalid="ignore"):
        return MeanMap(columns, rows, sums / counts, counts, there)


def split_panels(table: pd.DataFrame, variables: Sequence[str], x: str, y: str) -> list[Panel]:
    """Returns the designs of a map for each, so that no more is averaged than must be.

    Each combination of the other variables' values has a map of its own where these are few, and
    each cell of it one design; else a cell is a mean over them.
    """
    others = [name for name in spread_in(table, variables) if name not in (x, y)]
    several = math.prod(table[name].nunique() for name in others)
    if not others or several > PANELS:
        return [Panel({}, tuple(others), table)]
    parts = [part for _, part in table.groupby(others, sort=True)]
    return [Panel({n: float(part[n].iloc[0]) for n in others}, (), part) for part in parts]


def unit_of(column: str) -> str:
    """Returns the unit of a metric or of a number that varies; empty of ratios and factors."""
    if column.partition(":")[0] in AXES:
        return UNBOUNDED.unit
    if column.partition(":")[0] in OF_JOINTS:
        return FIELDS[column.partition(":")[0]].unit
    metric = METRICS.get(column.partition(".")[0])
    unit = metric.unit if metric else NUMBERS[column].unit if column in NUMBERS else ""
    return "" if unit in ("1", "-") else unit


def column_label(column: str) -> str:
    """Returns the name of a metric or of a number that varies, with its unit."""
    unit = unit_of(column)
    return f"{column} ({unit})" if unit else column


def end_map(table: pd.DataFrame, x: str, y: str) -> EndMap:
    """Returns what becomes of designs over two variables.

    Raises:
        ConfigurationError: If a column is not there, or the table is empty.
    """
    check_columns(table, x, y, "failure")
    columns, rows = (Cells(table[name].to_numpy(float)) for name in (x, y))
    reasons = table["failure"].fillna("").astype(str).to_numpy()
    kinds = ("", *(str(kind) for kind in table["failure"].dropna().value_counts().index))
    counts = np.zeros((len(kinds), len(rows.centres), len(columns.centres)))
    kind_at = np.array([kinds.index(reason) for reason in reasons])
    np.add.at(counts, (kind_at, rows.index, columns.index), 1.0)
    return EndMap(columns, rows, kinds, counts)


def value_span(low: float, high: float) -> float:
    """Returns how far apart two values are; 0 if they are the same but for rounding."""
    return high - low if high - low > SAME * max(abs(low), abs(high)) else 0.0


def metrics_in(table: pd.DataFrame, variables: Sequence[str]) -> list[str]:
    """Returns the columns of a study's table with metrics, of which something was measured."""
    given = (*variables, "design", *ENDS)
    return [str(name) for name in table.columns if name not in given and table[name].notna().any()]


def spread_in(table: pd.DataFrame, variables: Sequence[str]) -> list[str]:
    """Returns the variables with several values in a table, those of most values first."""
    several = [name for name in variables if name in table and table[name].nunique() > 1]
    return sorted(several, key=lambda name: -table[name].nunique())


def standing_designs(table: pd.DataFrame) -> pd.DataFrame:
    """Returns the designs that stay up, or all where that was not measured."""
    return table[table["stands"] == 1] if "stands" in table else table


def check_columns(table: pd.DataFrame, *columns: str) -> None:
    """Checks that a table has columns, and rows.

    Raises:
        ConfigurationError: If not; says which columns there are.
    """
    for name in columns:
        if name not in table:
            finding = diagnose("column-unknown", column=name, known=map(str, table.columns))
            raise ConfigurationError("column", finding)
    if table.empty:
        raise ConfigurationError("table", diagnose("nothing-to-draw"))
