"""Electrical energy of the motors of a walking robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pupper_analysis.models.motors.reading import find_motor
from pupper_analysis.tools.walk.gait import simulate_walk
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import prepare_stage, simulate_cases
from tests.support.motor_energy import check_balance, compute_bare_work
from tests.support.variants import load
from tests.tools.walk import made


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "v3-heavy"])
def test_energy_of_a_walk_is_balanced(name: str, tmp_path: Path) -> None:
    """Reference: the change of momentum in bare MuJoCo, step by step, after the warm-up."""
    policy = Policy.load(made.write_standing_policy(tmp_path / "still.json"))
    robot = load(name)
    motors = dict.fromkeys(robot.joint_names, find_motor("lk-tech-mg4010-10"))
    walk = simulate_walk(robot, policy, (0, 0, 0), seconds=3.0, warm_up=1.0, motors=motors)
    energy = check_balance(walk.gaits[0].energy)
    stage = prepare_stage(robot, policy)
    (run,) = simulate_cases(stage, [stage.make_case(np.zeros(3), 0)], 3.0, 1.0, None)
    first = round(1.0 / stage.timestep)
    bare = compute_bare_work(stage.model, run.states[first:], run.targets[first + 1 :])
    assert energy.work == pytest.approx(bare, rel=1e-6, abs=1e-6 * energy.copper)
