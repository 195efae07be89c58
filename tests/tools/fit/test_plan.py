"""Which stands are chosen: those that tell most; and that servos too soft to stand hold none."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from pupper_analysis.base.errors import MeasurementError
from pupper_analysis.pupper.load import load_variant
from pupper_analysis.tools.fit.stands.plan import choose_stands, plan_stands


def test_the_chosen_make_the_determinant_largest() -> None:
    """Against all ways to choose: of 12 measurements 4."""
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(12, 2, 5)) * rng.uniform(0.2, 2, size=(12, 1, 5))
    each = [one.T @ one for one in rows]
    before = np.diag([1.0, 0.5, 2.0, 0.1, 1.0])

    def told(places: tuple[int, ...]) -> float:
        return float(np.linalg.slogdet(before + sum(each[place] for place in places))[1])

    best = max(combinations(range(12), 4), key=told)
    assert told(choose_stands(each, before, 4)) == pytest.approx(told(best), rel=0.02)
    assert len(set(choose_stands(each, before, 4))) == 4


def test_servos_that_are_too_soft_hold_no_stand() -> None:
    with pytest.raises(MeasurementError, match="only 0 of 3"):
        plan_stands(load_variant("v3"), 3, kp=0.3)
