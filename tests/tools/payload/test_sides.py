"""Nudges cover all sides: whichever way the first one points, the answer is the same."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

import pupper_analysis as pa
from pupper_analysis.simulation import trial
from pupper_analysis.tools.payload.limit import simulate_payload
from tests.support.random_legged import irregular_biped, written

ABOVE = (0.0, 0.0, 0.1)
MOST_SEEN, LESS = 9.19, 8.4
"""kg: with the first it falls when it is pushed to some sides between the eight that had been
tried, and stood; with the second to none."""


@pytest.fixture(scope="module")
def biped(tmp_path_factory: pytest.TempPathFactory) -> pa.Robot:
    """A biped whose soles tip soon to some sides."""
    return pa.load_robot(*written(irregular_biped(3), tmp_path_factory.mktemp("biped")))


@pytest.mark.parametrize(("mass", "stands"), [(MOST_SEEN, False), (LESS, True)])
def test_who_stands_the_nudges_stands_those_between_them(
    mass: float, stands: bool, biped: pa.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    nudges = trial.nudge_velocities

    def turned(by: float, size: float) -> Callable[..., NDArray[np.float64]]:
        def turn(robot: pa.Robot, stand: pa.Stand, first: float) -> NDArray[np.float64]:
            speeds = nudges(robot, stand, first + by)
            speeds[:, :2] *= size
            return speeds

        return turn

    held, falls = [], 0
    for by in math.pi / 16 * np.arange(2):
        monkeypatch.setattr(trial, "nudge_velocities", turned(by, 1.0))
        held.append(simulate_payload(biped, pa.StandTask(), mass, ABOVE).held)
        # As fast as is said, no faster: the same circle for every turn.
        monkeypatch.setattr(trial, "nudge_velocities", turned(by, math.cos(math.pi / 8)))
        falls += simulate_payload(biped, pa.StandTask(), mass, ABOVE).fell
    assert held == [stands] * 2
    assert (falls == 0) is stands
