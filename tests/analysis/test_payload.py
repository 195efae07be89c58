"""What a stance is said to carry: what bears the trial's nudges."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from pupper_analysis.analysis.payload import FINE, _bisected


@pytest.mark.parametrize("high", [9.0, 3.3])
def test_where_the_trial_falls_what_it_bears_is_bisected(high: float) -> None:
    seen: list[float] = []

    def tried(mass: float) -> Any:
        seen.append(mass)
        return SimpleNamespace(tried=mass, held=mass <= 3.0)

    mass, trial = _bisected(tried, tried(high), high)
    assert 3.0 - FINE * high <= mass <= 3.0
    assert trial.held
    assert trial.tried == mass
    assert len(seen) < 8


def test_a_robot_that_bears_nothing_is_said_to_fall() -> None:
    def tried(mass: float) -> Any:
        return SimpleNamespace(held=False)

    mass, trial = _bisected(tried, tried(2.0), 2.0)
    assert mass == 0.0
    assert not trial.held
