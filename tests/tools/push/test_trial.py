"""One push against the search for the largest: the same bench, and MuJoCo stepped by hand."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from tests.support.variants import load, stand_of


def test_what_survives_and_what_does_not_is_as_the_search_says() -> None:
    robot, stand = load("original"), stand_of("original")
    found = pa.push_recovery(robot, stand, directions=3, duration=2.0, resolution=0.1)
    for direction, impulse in zip(found.directions, found.impulses, strict=True):
        good = pa.simulation.simulate_push(
            robot, stand, float(impulse), float(direction), duration=2.0
        )
        bad = pa.simulation.simulate_push(
            robot, stand, float(impulse) + 0.1, float(direction), duration=2.0
        )
        assert good.recovered
        assert good.failure is None
        assert not bad.recovered
        assert bad.failure
    assert good.velocity_step == pytest.approx(good.impulse / robot.total_mass)


def test_the_motion_is_that_of_a_force_on_the_base() -> None:
    """Stepped by hand: 0.3 N s in 20 ms to the left of a base that is yawed."""
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(yaw=0.3))
    trial = pa.simulation.simulate_push(robot, stand, 0.3, math.pi / 2, duration=2.0)
    model = robot.mj_model
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, trial.motion[0])
    mujoco.mj_kinematics(model, data)
    body = model.body(robot.mj_base).id
    moved = trial.motion[3, :2] - trial.motion[0, :2]
    left = np.array([-math.sin(0.3), math.cos(0.3)])
    assert moved @ left > 5 * abs(moved @ [left[1], -left[0]])
    # The com of the base's body, where the first sample has it after one step.
    assert data.xipos[body] == pytest.approx(trial.point, abs=6e-3)
    assert trial.pulse == pytest.approx(0.02)
    assert np.diff(trial.motion_time) == pytest.approx(np.full(len(trial.motion) - 1, 0.034))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"impulse": -1.0}, "impulse: -1 N s is not from 0"),
        ({"impulse": math.nan}, "impulse: nan is not finite"),
        (
            {"impulse": 1.0, "direction": 7.0},
            "direction: 401.07 deg is not between -360 and 360 deg",
        ),
        ({"impulse": 1.0, "duration": 1.0}, "duration"),
    ],
)
def test_what_is_no_push_is_refused(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(pa.ConfigurationError, match=message):
        pa.simulation.simulate_push(load("v3"), stand_of("v3"), **arguments)
