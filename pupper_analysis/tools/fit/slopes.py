"""Derivatives that cost much: made when they are needed, and used as long as they do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MOST = 6
"""Times: fits that end make them one to four times with the same noise."""


class Slopes:
    """Derivatives that are made when they are needed, and how good they are.

    Args:
        renew: Makes those that ``linearise`` uses, at parameters. None: it makes its own each time.

    Attributes:
        outdated: Whether they are to be made anew.
        made: How often they were.
    """

    def __init__(self, renew: Callable[[Array], None] | None = None) -> None:
        self._renew = renew
        self._at: Array | None = None
        self.outdated, self.made = True, 0

    def prepare(self, x: Array) -> None:
        """Makes them at some parameters, if those that there are have misled."""
        if self._renew is not None and self.outdated:
            self._renew(x)
            self._at = x.copy()
            self.made += 1
        self.outdated = False

    def spent(self, before: int) -> bool:
        """Says whether they were made so often since then that it leads nowhere."""
        return self.made - before >= _MOST

    def are_at(self, x: Array) -> bool:
        """Says whether they were made at some parameters."""
        return self._renew is None or (self._at is not None and np.array_equal(self._at, x))

    def are_near(self, x: Array, curvature: Array, most: float) -> bool:
        """Says whether they were made near by.

        Args:
            x: (n,) the parameters.
            curvature: (n, n) of the cost.
            most: By what the cost may rise from here to there.
        """
        if self._renew is None or self._at is None:
            return True
        off = x - self._at
        return float(off @ curvature @ off) < most
