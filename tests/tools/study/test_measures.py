"""Metrics of a study equal the numbers of other commands."""

from __future__ import annotations

import pytest

import pupper_analysis as pa
from pupper_analysis.stance.sag.steady_state import steady_state
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.tools.study import measures
from tests.support.variants import load


def test_sag_of_a_study_equals_that_of_stand() -> None:
    """`stand` predicts the sag on the simulated ground; MuJoCo's v3 rests 7.4 mm lower."""
    robot = load("v3")
    stand = pa.solve_stand(robot)
    settled = steady_state(robot, solve_stand_as_simulated(robot, stand))
    design = measures.Design(robot, stand)
    assert (
        design.standing_equilibrium.height_loss
        == settled.height_loss
        == pytest.approx(7.4e-3, abs=1e-4)
    )
