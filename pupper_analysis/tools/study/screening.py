"""Which numbers enter which metric: designs that differ in one number alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.tools.study.study import DesignStudy

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

ENDS = (0.001, 0.999)
"""Shares of a distribution that stand for its ends, as a normal one has none."""

EFFECT = 1e-6
"""Relative to the metric's size: what changes by less, from end to end, is rounding of solvers."""


def screen_variables(
    study: DesignStudy,
    points: Array,
    columns: Sequence[str],
    run: Callable[[DesignStudy], pd.DataFrame],
) -> dict[str, tuple[str, ...]]:
    """Returns which of a study's variables change which columns of its table.

    Each variable alone goes to either end of its range, from several designs, as an effect may
    be there in some of them only. A value that is lost, or found, has changed.

    Source: Morris, "Factorial sampling plans for preliminary computational experiments", 1991: its
    elementary effects, over the whole range.

    Args:
        study: The study.
        points: (n, variables) the designs from which they go.
        columns: Of its table; those with several values, ``NAME.KEY``, count together.
        run: Measures the designs of a study, and returns their table.

    Returns:
        {column: the variables that change it, in the study's order}.
    """
    names = list(study.variables)
    varied = [at for at, one in enumerate(study.variables.values()) if _span(one)[1] > 0]
    designs = [np.array(points)]
    for at in varied:
        for end in _span(list(study.variables.values())[at])[0]:
            moved = np.array(points)
            moved[:, at] = end
            designs.append(moved)
    chosen = study.at(np.concatenate(designs))
    table = run(chosen)
    place = {name: index for index, name in enumerate(table["design"])}
    order = [place[name] for block, _ in chosen.designs() for name in block]
    found = {}
    for column in columns:
        own = [n for n in table if n == column or str(n).startswith(f"{column}.")]
        values = table[own].to_numpy(float)[order].reshape(len(designs), len(points), -1)
        size = EFFECT * np.nanmax(np.abs(values), initial=0.0)
        lost = np.isnan(values) != np.isnan(values[:1])
        changed = (lost | (np.abs(values - values[:1]) > size)).any(axis=(1, 2))
        pairs = changed[1:].reshape(-1, 2).any(axis=1)
        found[column] = tuple(names[at] for at, one in zip(varied, pairs, strict=True) if one)
    return found


def _span(variable: Any) -> tuple[Array, float]:
    """Returns a variable's ends (2,), and how far apart they are."""
    ends: Array = np.array(variable.range if variable.levels else variable.at(np.array(ENDS)))
    return ends, float(np.ptp(ends))
