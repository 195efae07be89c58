"""A payload's trial: how it is nudged, and that dry friction does not hold up what it tries."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.servos import with_options
from pupper_analysis.simulation import trial as payload
from pupper_analysis.tools.payload.limit import simulate_payload
from tests.support.variants import load, stand_of


def test_each_nudge_is_simulated_from_the_stand_that_is_judged() -> None:
    robot, stand, seen = load("v3"), stand_of("v3"), []

    def watched(model: object, workers: object, starts: np.ndarray, control: np.ndarray) -> object:
        seen.append(starts)
        return roll_out(model, workers, starts, control)  # type: ignore[arg-type]

    roll_out = payload.roll_out
    with mock.patch.object(payload, "roll_out", watched):
        trial = simulate_payload(robot, stand, 2.0, (0.05, 0.0, 0.05), duration=2)
    assert trial.nudges == len(seen[0]) == 12
    loaded = pa.robot.with_payload(robot, 2.0, (0.05, 0.0, 0.05))
    held = pa.stance.solve_stand_as_simulated(loaded, pa.StandTask())
    places = 1 + robot.mj_convention.qpos_index
    np.testing.assert_allclose(seen[0][:, places], np.tile(held.qpos, (12, 1)), atol=1e-6)
    assert held.qpos[0] < stand.qpos[0] - 0.01  # the base moved from under the load


@pytest.mark.slow
def test_unstable_load_is_refused_despite_dry_friction() -> None:
    """With 7 kg v3 stays up for 6 s of nudges, but a deviation doubles within 12 s in MuJoCo."""
    assert simulate_payload(load("v3"), stand_of("v3"), 7.0, duration=6).held
    loaded = pa.robot.with_payload(load("v3"), 7.0, (0.0, 0.0, 0.0))
    verdict = pa.judge_stand(loaded, pa.stance.solve_stand_as_simulated(loaded))
    assert "mode-buckles" in {failure.code for failure in verdict.failures}


@pytest.mark.slow
@pytest.mark.parametrize(("impratio", "failure"), [(30.0, None), (1.0, payload.Failure.SLIDING)])
def test_creep_is_no_slide(impratio: float, failure: payload.Failure | None) -> None:
    """With a quarter of their friction feet creep by 7 mm, as MuJoCo's is viscous; or by 0.2 m."""
    robot = with_options(load("v3"), cone="elliptic", impratio=impratio)
    task = pa.StandTask(ground=pa.Ground(np.radians(15.0)))
    trial = simulate_payload(robot, task, 1.0, (0.0, 0.0, 0.05), duration=9)
    assert trial.failure is failure
