"""Requirements on the designs of a study: ``stands = true``, ``continuous_utilisation = "< 1"``."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.tools.study.store import number_truth_values

if TYPE_CHECKING:
    import pandas as pd

_COMPARISONS: Mapping[str, Callable[[Any, float], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "=": operator.eq,
}
"""{comparison in the text of a requirement: function}."""

_REQUIREMENT = re.compile(r"\s*(<=|>=|<|>|=)\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*\Z")
"""Pattern of the text of a requirement, such as ``< 1.5``: comparison, then number."""


@dataclass(frozen=True)
class Requirement:
    """Requirement on the designs of a study: a bound on a column of the table.

    Attributes:
        column: Metric or variable.
        comparison: A key of `_COMPARISONS`.
        limit: Limit, in the unit of the column.
    """

    column: str
    comparison: str
    limit: float

    @classmethod
    def parse(cls, column: str, text: object) -> Requirement:
        """Create a requirement from a value in a study file.

        Args:
            column: Metric or variable, a column of the study's table.
            text: True, False, a number, or a text of comparison and number, such as ``"< 1"``. A
                number requires exactly this value. True requires 1, and False requires 0.

        Raises:
            ConfigurationError: If the value has another form, or the number is not finite.
        """
        match = _REQUIREMENT.match(text) if isinstance(text, str) else None
        try:
            if isinstance(text, bool | int | float):
                found = cls(column, "=", float(text))
            else:
                found = cls(column, match[1], float(match[2]))  # type: ignore[index]
        except (TypeError, ValueError, OverflowError):
            found = None
        if found is None or not math.isfinite(found.limit):
            problem = diagnose("requirement-not-valid", given=repr(text))
            raise ConfigurationError(f"require[{column!r}]", problem)
        return found

    @property
    def text(self) -> str:
        """The requirement as text: column, comparison and limit, for example ``mass < 5``."""
        return f"{self.column} {self.comparison} {self.limit:g}"

    def is_met(self, table: pd.DataFrame) -> NDArray[np.bool_]:
        """Return a mask of the rows of a study's table that meet the requirement, shape (rows,).

        A row with a missing value does not meet the requirement.
        """
        if self.column not in table:
            return np.zeros(len(table), bool)
        values = number_truth_values(table[[self.column]])[self.column].to_numpy(dtype=float)
        met: NDArray[np.bool_] = ~np.isnan(values) & _COMPARISONS[self.comparison](
            values, self.limit
        )
        return met


def select_designs(table: pd.DataFrame, requirements: tuple[Requirement, ...]) -> pd.DataFrame:
    """Return the rows of a study's table that meet all requirements (`Requirement.is_met`)."""
    met = np.ones(len(table), bool)
    for requirement in requirements:
        met &= requirement.is_met(table)
    return table[met]
