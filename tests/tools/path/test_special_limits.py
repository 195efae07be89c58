"""Utilisation of limits that are zero or unknown."""

from __future__ import annotations

import numpy as np

from pupper_analysis.tools.path.plan import divide_by_limits


def test_shares_of_zero_and_unknown_limits_are_infinite_and_unknown() -> None:
    """Infinite beyond a limit of zero, 0 for rounding errors, NaN without a limit."""
    limits = np.array([2.0, 0.0, 0.0, np.inf])
    shares = divide_by_limits(np.array([[1.0, -0.5, 1e-15, 3.0]]), limits)
    np.testing.assert_array_equal(shares, [[0.5, np.inf, 0.0, np.nan]])
