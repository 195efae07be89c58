"""Trials of a payload: nudges, and instability that dry friction hides."""

from __future__ import annotations

from typing import Any
from unittest import mock

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.servos import with_options
from pupper_analysis.simulation import trial as payload
from pupper_analysis.tools.payload.limit import simulate_payload
from tests.support.variants import load, stand_of


def test_each_nudge_is_simulated_from_the_stand_that_is_judged() -> None:
    """Reference: qpos of the loaded stand, for all twelve nudges."""
    robot, stand, all_starts = load("v3"), stand_of("v3"), []

    def watched(model: object, workers: object, starts: np.ndarray, control: np.ndarray) -> object:
        all_starts.append(starts)
        return roll_out(model, workers, starts, control)  # type: ignore[arg-type]

    roll_out = payload.roll_out
    with mock.patch.object(payload, "roll_out", watched):
        trial = simulate_payload(robot, stand, 2.0, (0.05, 0.0, 0.05), duration=2)
    assert trial.nudges == len(all_starts[0]) == 12
    loaded = pa.robot.with_payload(robot, 2.0, (0.05, 0.0, 0.05))
    held = pa.stance.solve_stand_as_simulated(loaded, pa.StandTask())
    places = 1 + robot.mj_convention.qpos_index
    np.testing.assert_allclose(all_starts[0][:, places], np.tile(held.qpos, (12, 1)), atol=1e-6)
    assert held.qpos[0] < stand.qpos[0] - 0.01  # the base moved from under the load


@pytest.mark.slow
def test_unstable_load_is_refused_despite_dry_friction() -> None:
    """With 7 kg v3 stays up for 6 s of nudges, but a deviation doubles within 12 s in MuJoCo."""
    assert simulate_payload(load("v3"), stand_of("v3"), 7.0, duration=6).survived
    loaded = pa.robot.with_payload(load("v3"), 7.0, (0.0, 0.0, 0.0))
    verdict = pa.judge_stand(loaded, pa.stance.solve_stand_as_simulated(loaded))
    assert "mode-buckles" in {failure.code for failure in verdict.failures}


@pytest.mark.slow
@pytest.mark.parametrize(("impratio", "failure"), [(30.0, None), (1.0, payload.Failure.SLIDING)])
def test_creep_is_no_slide(impratio: float, failure: payload.Failure | None) -> None:
    """On a slope of 15 deg the feet creep by 7 mm with an impratio of 30, and by 0.2 m with 1."""
    robot = with_options(load("v3"), cone="elliptic", impratio=impratio)
    task = pa.StandTask(ground=pa.Ground(np.radians(15.0)))
    trial = simulate_payload(robot, task, 1.0, (0.0, 0.0, 0.05), duration=9)
    assert trial.failure is failure


@pytest.mark.slow
@pytest.mark.parametrize("mass", [2.0, 6.4])
def test_nudges_end_early_without_motion_in_the_remaining_time(
    mass: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With 6.4 kg modes of v3 double in 12 to 15 s. Reference: the nudges simulated for 12 s."""
    ends: list[np.ndarray] = []

    def watched(*arguments: Any) -> np.ndarray:
        states = roll_out(*arguments)
        ends.extend(states[:, -1])
        return states

    roll_out = payload.roll_out
    monkeypatch.setattr(payload, "roll_out", watched)
    robot = load("v3")
    early = simulate_payload(robot, stand_of("v3"), mass)
    decided, places = ends[-1], 1 + robot.mj_convention.qpos_index
    monkeypatch.setattr(payload, "_MAX_REMAINING_MOTION", -1.0)
    full = simulate_payload(robot, stand_of("v3"), mass)
    assert full.simulated == pytest.approx(12 * 12.0)
    assert early.simulated < full.simulated / 3
    assert (early.survived, early.failed_nudges, early.duration) == (
        full.survived,
        full.failed_nudges,
        12.0,
    )
    assert full.survived
    nearest = min(np.abs(end - decided)[places].max() for end in ends[-12:])
    assert nearest < 1e-3


@pytest.mark.slow
def test_first_failure_is_equal_if_simulations_end_at_it() -> None:
    """Reference: all twelve nudges simulated until each has failed or rests."""
    robot, stand = load("v3"), stand_of("v3")
    short, full = (
        simulate_payload(robot, stand, 9.0, (0.0, 0.0, 0.3), until_failure=only)
        for only in (True, False)
    )
    assert not full.survived
    assert (short.failure, short.failing_parts, short.time) == (
        full.failure,
        full.failing_parts,
        full.time,
    )
    assert short.simulated <= full.simulated
    assert short.failed_nudges <= full.failed_nudges


def test_payload_out_of_reach_or_at_no_point_is_not_simulated() -> None:
    with pytest.raises(pa.StanceUnreachableError):
        simulate_payload(load("v3"), stand_of("v3"), 50.0, (0.4, 0.0, 0.0))
    with pytest.raises(pa.ConfigurationError, match="point"):
        simulate_payload(load("v3"), stand_of("v3"), 1.0, "top")  # type: ignore[arg-type]
