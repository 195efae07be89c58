"""What ground and IMU are not as was said is told by all signs of it together."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.parameters import Parameter, ParameterTable
from pupper_analysis.tools.fit.stands.doubts import doubt_surroundings

Array = NDArray[np.float64]

WIDTH = math.radians(0.2)


def measured(parameters: tuple[Parameter, ...], values: Array, noise: float) -> Posterior:
    """Returns what is known once each was measured, with noise in parts of the prior's width."""
    table = ParameterTable(parameters)
    n, told = len(parameters), 1 / noise**2
    share = 1 / (1 + told)
    width = table.width
    return Posterior(
        parameters=table.parameters,
        mean=table.stated + (1 - share) * (values - table.stated),
        covariance=share * np.diag(width**2),
        information=told * np.eye(n),
        precision=table.precision,
        chi2=0.0,
        moved=(1 - share) * (values - table.stated) / width,
        rows=n,
        steps=1,
    )


SLOPE = tuple(Parameter("slope", "floor", axis, 0.0, WIDTH) for axis in "xy")
FEET = tuple(Parameter("softness", foot, "", 1.0, 0.5) for foot in ("FL", "FR", "RL", "RR"))


def test_two_weak_signs_of_a_slope_are_one() -> None:
    """2.6 sigma along each axis: neither alone is beyond 3.1, of which 0.002 are by chance."""
    noise = 0.5
    sigma = WIDTH * math.hypot(1, noise)
    one = measured(SLOPE, np.array([2.6, 0.0]) * sigma, noise)
    both = measured(SLOPE, np.array([2.6, -2.7]) * sigma, noise)
    assert not list(doubt_surroundings(one))
    (told,) = doubt_surroundings(both)
    assert told.code == "ground-slopes"
    assert told.values["axis"] == "y"
    # As measured: not drawn to the level by what was known before.
    assert told.values["slope"].value == pytest.approx(math.hypot(2.6, 2.7) * sigma)


def test_soles_that_are_all_a_little_softer_are_softer() -> None:
    noise = 1.0
    sigma = 0.5 * math.hypot(1, noise)
    alike = measured(FEET, 1 + np.array([2.1, 2.2, 2.3, 1.9]) * sigma, noise)
    told = list(doubt_surroundings(alike))
    assert [one.subject.name for one in told if one.subject] == ["FL", "FR", "RL"]
    assert told[0].values["times"] == pytest.approx(1 + 2.1 * sigma)
    assert not list(doubt_surroundings(measured(FEET, 1 + np.eye(4)[0] * 2.5 * sigma, noise)))


def test_false_alarms_are_as_rare_as_is_said() -> None:
    rng, noise = np.random.default_rng(0), 0.7
    alarms = 0
    for _ in range(4000):
        true = WIDTH * rng.normal(size=2)
        found = measured(SLOPE, true + noise * WIDTH * rng.normal(size=2), noise)
        alarms += bool(list(doubt_surroundings(found)))
    assert 1 <= alarms <= 20  # 8 on average


def test_what_is_not_told_is_not_doubted() -> None:
    assert not list(doubt_surroundings(measured(SLOPE, np.array([9.0, 9.0]) * WIDTH, 30.0)))
