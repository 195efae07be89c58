"""How sure is a stand of numbers that are not exact?"""

from __future__ import annotations

import math
import reprlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

_Z = 1.959963984540054
"""Of a 95 % confidence interval: the 97.5 % quantile of the normal distribution."""


@dataclass(frozen=True)
class Chance(Result):
    """A probability, estimated from designs.

    Attributes:
        probability: The share of designs.
        low: The least that it may be, with 95 % confidence.
        high: The greatest.
        designs: How many there are.
    """

    probability: float
    low: float
    high: float
    designs: int


def probability_interval(there: int, designs: int) -> Chance:
    """Returns a probability and its confidence interval.

    Source: Wilson, "Probable inference", 1927: good where the share is near to 0 or 1 too.

    Args:
        there: How many designs are as wanted.
        designs: Of how many.
    """
    if designs < 1:
        raise ConfigurationError("table", diagnose("table-without-designs"))
    share, z = there / designs, _Z**2 / designs
    middle = (share + z / 2) / (1 + z)
    half = math.sqrt(share * (1 - share) * z + z**2 / 4) / (1 + z)
    return Chance(share, max(0.0, middle - half), min(1.0, middle + half), designs)


@dataclass(frozen=True)
class Certainty(Result):
    """How sure a stand is.

    Attributes:
        stands: That it stays up on its servos; a design that fails does not.
        motors: {joint: that its motor is under its limit in the stand}.
        all_motors: That all are.
        both: That it stays up, and all motors are under their limits.
    """

    stands: Chance
    motors: dict[str, Chance]
    all_motors: Chance
    both: Chance


NEEDED = ("stands", "utilisation")
"""Measures that ``certainty`` looks at."""


def certainty(table: pd.DataFrame) -> Certainty:
    """Tells from a study's table how sure its stands are.

    Args:
        table: Of a study with the metrics ``stands`` and ``utilisation``, and with samples.

    Raises:
        ConfigurationError: If a metric is missing, or there are no designs.
    """
    if not hasattr(table, "columns"):
        raise ConfigurationError("table", diagnose("no-table", given=reprlib.repr(table)))
    joints = [str(name) for name in table.columns if str(name).startswith("utilisation.")]
    if "stands" not in table or not joints:
        raise ConfigurationError("table", diagnose("table-lacks-metrics", needed=NEEDED))
    count = len(table)
    up = table["stands"].fillna(0.0).to_numpy(float) > 0
    under = table[joints].to_numpy(float) < 1  # not of a design that has no stand
    return Certainty(
        stands=probability_interval(int(up.sum()), count),
        motors={
            name.partition(".")[2]: probability_interval(int(held.sum()), count)
            for name, held in zip(joints, under.T, strict=True)
        },
        all_motors=probability_interval(int(under.all(axis=1).sum()), count),
        both=probability_interval(int((up & under.all(axis=1)).sum()), count),
    )
