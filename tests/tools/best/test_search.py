"""Ranking of the sampled stances of a search."""

from __future__ import annotations

import numpy as np
import pytest

from pupper_analysis.tools.best.search import EvaluatedStance, StanceSearch
from tests.support.variants import stand_of


def test_violated_constraints_worsen_a_stance_in_proportion_to_their_sum() -> None:
    """Reference: the exact penalty function of Nocedal and Wright (2006), equation 17.22.

    The first row contains the level, so that it is no constraint of the ranking.
    """
    search = object.__new__(StanceSearch)

    def merit(*slacks: float) -> float:
        rows = np.array([(-5.0, 1.0), *((slack, 0.0) for slack in slacks)])
        allowed = min(slacks) >= 0
        return search.merit(EvaluatedStance(np.zeros(1), stand_of("v3"), 0.5, rows, allowed))

    assert merit(0.3, 0.0) == 0.5
    single, double = (merit(0.3, -violation, -0.01) - 0.5 for violation in (0.01, 0.03))
    assert single > 0
    assert double == pytest.approx(2 * single)
    assert search.merit(None) == np.inf
