"""Derivatives that cost much: made when they are needed, and used as long as they do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Slopes:
    """Derivatives that are made when they are needed, and how good they are.

    Args:
        renew: Makes those that ``linearise`` uses, at parameters; better ones, of twice the price,
            if asked for. None: it makes its own each time.

    Attributes:
        outdated: Whether they are to be made anew.
    """

    def __init__(self, renew: Callable[[Array, bool], None] | None = None) -> None:
        self._renew, self._both = renew, False
        self._made: Array | None = None
        self.outdated = True

    def prepare(self, x: Array) -> None:
        """Makes them at some parameters, if those that there are have misled."""
        if self._renew is not None and self.outdated:
            self._renew(x, self._both)
            self._made = x.copy()
        self.outdated = False

    def improve(self, x: Array) -> bool:
        """Makes better ones at some parameters; says no if it has them."""
        if self._renew is None or self._both:
            return False
        self._renew(x, True)
        self._made, self._both = x.copy(), True
        return True

    def are_at(self, x: Array) -> bool:
        """Says whether they were made at some parameters."""
        return self._renew is None or (self._made is not None and np.array_equal(self._made, x))

    def are_near(self, x: Array, curvature: Array, most: float) -> bool:
        """Says whether they were made near by.

        Args:
            x: (n,) the parameters.
            curvature: (n, n) of the cost.
            most: By what the cost may rise from here to there.
        """
        if self._renew is None or self._made is None:
            return True
        off = x - self._made
        return float(off @ curvature @ off) < most
