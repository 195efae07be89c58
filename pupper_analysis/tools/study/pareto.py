"""Which designs are worth building: those that no other one beats in all that counts."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_type, real_array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError

if TYPE_CHECKING:
    import pandas as pd

SENSES = {"min": 1.0, "max": -1.0}


def pareto_front(table: pd.DataFrame, objectives: Mapping[str, str]) -> pd.DataFrame:
    """Returns the designs that no other beats: none is as good in all objectives, better in one.

    Args:
        table: Of a study. Designs without a value of an objective count as beaten.
        objectives: {column: ``"min"`` or ``"max"``}.

    Returns:
        Their rows, sorted by the first objective, the best first.

    Raises:
        ConfigurationError: If a column is not there, or a sense is neither.
    """
    if not hasattr(table, "columns"):
        raise ConfigurationError("table", diagnose("no-table", given=reprlib.repr(table)))
    check_type("objectives", objectives, Mapping[str, str])
    for name, sense in objectives.items():
        if name not in table or sense not in SENSES:
            known = map(str, table.columns)
            problem = diagnose("no-column-to-optimise", column=name, sense=sense, known=known)
            raise ConfigurationError("objectives", problem)
    if not objectives:
        raise ConfigurationError("objectives", diagnose("no-objectives"))
    whole = table.dropna(subset=list(objectives))
    columns = []
    for name, sense in objectives.items():
        columns.append(SENSES[sense] * real_array(f"column {name!r}", whole[name].to_numpy()))
    costs = np.column_stack(columns)
    best = whole[_unbeaten(costs)]
    first, sense = next(iter(objectives.items()))
    front: pd.DataFrame = best.sort_values(first, ascending=sense == "min", kind="stable")
    return front.reset_index(drop=True)


def _unbeaten(costs: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tells which rows of costs (n, m) no other row beats.

    Rows are looked at in the order of their first cost: only an earlier one can beat a later one,
    and only one that is unbeaten itself need be looked at.
    """
    order = np.lexsort(costs.T[::-1])
    front: list[int] = []
    for index in order:
        held = costs[front]
        beats = (held <= costs[index]).all(axis=1) & (held < costs[index]).any(axis=1)
        if not beats.any():
            front.append(int(index))
    found = np.zeros(len(costs), bool)
    found[front] = True
    return found
