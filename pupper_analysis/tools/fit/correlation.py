"""Which parameters of a fit are off together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pupper_analysis.base.results import Result
from pupper_analysis.tools.fit.estimate import Posterior

_SHOWN = 0.5
"""Correlation from which on two are told of: below, one tells less than a quarter of the other's
variance."""


@dataclass(frozen=True)
class Correlation(Result):
    """Two parameters that are off together.

    Attributes:
        one: Name of a parameter.
        other: Name of another.
        correlation: Of what is not known of them: 1 if both are too large together, -1 if one is
            too large where the other is too small.
    """

    one: str
    other: str
    correlation: float


def find_correlations(posterior: Posterior) -> tuple[Correlation, ...]:
    """Returns the pairs of parameters that are off together, the strongest before."""
    std, names = posterior.std, [one.name for one in posterior.parameters]
    matrix = posterior.covariance / np.outer(std, std)
    rows, columns = np.triu_indices(len(names), 1)
    strength = np.abs(matrix[rows, columns])
    order = np.argsort(-strength, kind="stable")
    return tuple(
        Correlation(names[rows[at]], names[columns[at]], float(matrix[rows[at], columns[at]]))
        for at in order[: np.count_nonzero(strength >= _SHOWN)]
    )
