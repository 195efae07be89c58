"""Ranking of the sampled stances of a search, and derivatives of their constraints."""

from __future__ import annotations

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.tools.best.search import EvaluatedStance, Objective, StanceSearch
from tests.support.variants import load, stand_of


def test_violated_constraints_worsen_a_stance_in_proportion_to_their_sum() -> None:
    """Reference: the exact penalty function of Nocedal and Wright (2006), equation 17.22.

    The first row contains the scaled objective, so that it is no constraint of the ranking.
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("objective", "task", "scale"),
    [
        ("utilisation", pa.StandTask(), 0.0),
        ("utilisation", pa.StandTask(), 0.1),
        ("utilisation", pa.StandTask(swing={"FR": 0.02}, com="inside", joint_margin=0.05), 0.1),
        ("margin", pa.StandTask(ground=pa.Ground(slope=0.1, uphill=0.4)), 0.1),
    ],
)
def test_closed_form_derivatives_equal_differences_of_solved_stances(
    objective: Objective, task: pa.StandTask, scale: float
) -> None:
    """Reference: central differences of stances that are solved again, with a step of 1e-5.

    In the initial stance (``scale`` 0) two rear feet have the same x, so that a step of one foot
    changes which corner of the support polygon has the smallest x.
    """
    search = StanceSearch(load("v3"), Objective(objective), task)
    space, random = search.space, np.random.default_rng(0)
    offset = scale * random.uniform(-1, 1, len(space.start))
    coordinates = space.start + offset * (space.high - space.low)
    stance = search.evaluate(coordinates)
    assert stance is not None
    exact, step = search.differentiate_rows(stance), 1e-5
    assert exact is not None
    for index in range(len(coordinates)):
        moved = step * np.eye(len(coordinates))[index]
        ahead, behind = (search.evaluate(coordinates + sign * moved) for sign in (1, -1))
        assert ahead is not None
        assert behind is not None
        difference = (ahead.rows - behind.rows) / (2 * step)
        np.testing.assert_allclose(exact[:, index], difference[:, 0], atol=2e-6)
        assert not difference[:, 1].any()  # b is constant


def test_derivatives_have_no_closed_form_if_balance_does_not_determine_the_forces() -> None:
    """On a slope the weights of the contact forces depend on the forces (contact viscosities)."""
    slope = pa.StandTask(ground=pa.Ground(slope=0.1))
    search = StanceSearch(load("v3"), Objective.UTILISATION, slope)
    assert search.differentiate_rows(search.nominal) is None
