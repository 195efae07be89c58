"""Least stiffness without feed-forward, against the path on which feed-forward is removed."""

from __future__ import annotations

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ConfigurationError, NoStiffnessError
from pupper_analysis.stance.sag import equilibrium, stiffness
from pupper_analysis.stance.sag.equilibrium import EquilibriumScales
from pupper_analysis.stance.sag.steady_state import find_sag_failure
from pupper_analysis.stance.sag.stiffness import (
    _StiffnessSearch,
    estimate_minimum_stiffness,
    minimum_stiffness,
)
from tests.support.variants import load


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "original"])
def test_least_stiffness_is_the_end_of_the_stiffnesses_that_stand(name: str) -> None:
    """Reference: `find_sag_failure`, which removes the feed-forward for each kp, without
    continuation from another kp."""
    robot = load(name)
    stand = pa.solve_stand_as_simulated(robot)
    least = minimum_stiffness(robot, stand)
    assert find_sag_failure(robot, stand, kp=least) is None
    assert find_sag_failure(robot, stand, kp=0.99 * least) is not None
    assert estimate_minimum_stiffness(robot, stand) == pytest.approx(least, rel=0.01)


@pytest.mark.slow
def test_ratios_scale_the_stiffness_of_each_joint() -> None:
    """Reference: the same ratios times a constant; `find_sag_failure` with the scaled kp."""
    robot = load("v3")
    stand = pa.solve_stand_as_simulated(robot)
    ratios = np.tile([1.0, 1.0, 2.0], 4)
    least = minimum_stiffness(robot, stand, ratios=ratios)
    assert minimum_stiffness(robot, stand, ratios=4 * ratios) == pytest.approx(least / 4, rel=0.01)
    assert find_sag_failure(robot, stand, kp=least * ratios) is None
    assert find_sag_failure(robot, stand, kp=0.98 * least * ratios) is not None
    assert least < minimum_stiffness(robot, stand)


@pytest.mark.parametrize("ratios", [np.ones(3), -np.ones(12), np.zeros(12), np.full(12, np.nan)])
def test_invalid_ratios_are_refused(ratios: np.ndarray) -> None:
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask())
    with pytest.raises(ConfigurationError, match="12 finite ratios"):
        minimum_stiffness(robot, stand, ratios=ratios)


@pytest.mark.slow
def test_creep_that_ends_each_equilibrium_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """No kp holds the stand; the search ends at the documented bound of 2500 times the unit."""
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask())
    monkeypatch.setattr(stiffness, "simulate_creep", lambda *_: 5.0)
    with pytest.raises(NoStiffnessError, match="creep") as caught:
        minimum_stiffness(robot, stand)
    unit = EquilibriumScales.from_stand(robot, stand).stiffness
    assert 1250 * unit < caught.value.kp <= 2500 * unit


@pytest.mark.slow
def test_a_small_tolerance_needs_few_tested_values() -> None:
    """Reference: the end of the stiffnesses that stand. A bracket of 1e-9 has 2^30 cells."""
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask())
    least = minimum_stiffness(robot, stand, tolerance=1e-9)
    assert minimum_stiffness(robot, stand) == pytest.approx(least, rel=0.01)
    assert find_sag_failure(robot, stand, kp=least) is None
    assert find_sag_failure(robot, stand, kp=(1 - 1e-6) * least) is not None


@pytest.mark.slow
def test_equilibria_that_continuation_misses_are_found_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A continuation that fails below 6 N m/rad, once. Reference: the result without failure.

    The soles of Booster's T1 need this: continuation ends 5 % above the least stiffness.
    """
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask())
    least = minimum_stiffness(robot, stand)
    continued, followed = _StiffnessSearch.stands_at_first, _StiffnessSearch.follow
    found: list[float] = []

    def fail_once(search: _StiffnessSearch, value: float) -> bool:
        if search._path is None or found[1:] or value > 6:
            return continued(search, value)
        search.lost.add(value)
        return False

    def follow(search: _StiffnessSearch, value: float) -> bool:
        if followed(search, value):
            found.append(value)
        return found[-1:] == [value]

    monkeypatch.setattr(_StiffnessSearch, "stands_at_first", fail_once)
    monkeypatch.setattr(_StiffnessSearch, "follow", follow)
    assert minimum_stiffness(robot, stand) == pytest.approx(least, rel=0.01)
    assert len(found) == 2  # at the start, and below the lost values


@pytest.mark.slow
def test_distant_prediction_is_replaced_by_the_bisection(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reference: `minimum_stiffness`. Aliengo: the prediction from 0.6 s was 30 % too large."""
    robot = load("v3")
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    least = minimum_stiffness(robot, stand)
    predict, tried = stiffness._predict_stiffness, []

    def predict_far(start: float, kp: float, lasts: float) -> float:
        """Return 1.5 times the first kp, as for a robot whose creep ends at once."""
        tried.append(kp)
        return 1.5 * kp if len(tried) == 1 else predict(start, kp, lasts)

    monkeypatch.setattr(stiffness, "_predict_stiffness", predict_far)
    assert estimate_minimum_stiffness(robot, stand) == pytest.approx(least, rel=0.01)
    assert len(tried) > 1


@pytest.mark.slow
def test_solves_that_end_at_alternating_contacts_do_not_change_the_stiffness(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Reference: solves that end after the largest number of iterations."""
    robot = load("original")
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    counts: list[int] = []
    alternates = equilibrium._is_alternating

    def count(residuals: list[float]) -> bool:
        counts.append(len(residuals))
        return alternates(residuals)

    monkeypatch.setattr(equilibrium, "_is_alternating", count)
    found = estimate_minimum_stiffness(robot, stand)
    assert max(counts) < equilibrium._MAX_ITERATIONS
    monkeypatch.setattr(equilibrium, "_is_alternating", lambda _: False)
    assert estimate_minimum_stiffness(robot, stand) == found


@pytest.mark.parametrize(
    ("residuals", "expected"),
    [
        ([2.0, 3.0, 2.0], False),
        ([9.0, 2.0, 3.0, 2.0, 3.0 + 1e-7], True),
        ([2.0, 3.0, 2.0, 3.1], False),
        ([2.0, 2e-2, 2e-6, 2e-7], False),
    ],
)
def test_residuals_alternate_if_two_of_them_repeat(residuals: list[float], expected: bool) -> None:
    assert equilibrium._is_alternating(residuals) is expected
