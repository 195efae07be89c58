"""What motors bear if their legs share a load: on six feet more than where the ground shares it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.payload import with_payload
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.stance.context import Context
from pupper_analysis.stance.payload.sharing import share_load
from pupper_analysis.stance.problem import make_goal
from pupper_analysis.stance.soft_ground import solve_loaded_stand
from pupper_analysis.stance.stand import solve_goal
from tests.support.random_legged import ring, written

POINT = (0.03, 0.02, 0.05)


def loaded(folder: Path, seed: int, legs: int) -> pa.Robot:
    pair = written(ring(seed, legs), folder)
    return pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)


def lowest(robot: pa.Robot, stand: pa.Stand, share: float) -> float:
    """By how much MuJoCo's base sinks in 4 s with a share of the load that is shared (m)."""
    sharing = share_load(robot, stand, POINT)
    assert sharing is not None
    laden = with_payload(robot, share * sharing.mass, POINT)
    depths = {
        foot: GroundLaw.of(laden, foot).depth(force)
        for foot, force in sharing.normal_forces.items()
    }
    task = solve_loaded_stand(laden, stand).task
    sunk = solve_goal(Context(laden), make_goal(laden, task, depths), explain=False)
    drive = model_with_servos(laden)
    data = mujoco.MjData(drive.model)
    speed = np.zeros(laden.nv)
    speed[2] = -0.01
    laden.mj_convention.set_state(data, sunk.qpos, speed)
    data.ctrl[:] = drive.command(laden, sunk.joint_positions(laden), sharing.joint_torques)
    while data.time < 4.0:
        mujoco.mj_step(drive.model, data)
    return float(sunk.qpos[2] - data.qpos[2])


def test_three_feet_share_a_load_in_one_way(tmp_path: Path) -> None:
    robot = loaded(tmp_path, 0, 3)
    found = pa.payload_limit(robot, pa.solve_stand(robot), POINT)
    assert found.shared is not None
    assert found.shared.mass == pytest.approx(found.motors.mass, rel=1e-9)


@pytest.mark.longest
@pytest.mark.parametrize(("seed", "legs"), [(0, 6), (2, 6), (2, 5), (2, 4)])
def test_mujoco_bears_what_legs_share(seed: int, legs: int, tmp_path: Path) -> None:
    """Commanded so it stays, to 1e-4 of its height; with 5 % more it goes down."""
    robot = loaded(tmp_path, seed, legs)
    stand = pa.solve_stand(robot)
    found = pa.payload_limit(robot, stand, POINT)
    assert found.shared is not None
    assert found.shared.mass > 1.01 * found.motors.mass
    torques = np.abs(found.shared.joint_torques) / robot.effort_limits
    assert torques.max() == pytest.approx(1.0)
    assert abs(lowest(robot, stand, 1.0)) < 1e-4 * stand.qpos[2]
    assert lowest(robot, stand, 1.05) > 0.03 * stand.qpos[2]


@pytest.mark.longest
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("legs", [3, 5, 6])
def test_any_number_of_legs_bears_what_is_stated_and_no_more(
    legs: int, seed: int, tmp_path: Path
) -> None:
    """Nudged, with the shares that the ground gives the legs; it was 5 to 15 % low."""
    robot = loaded(tmp_path, seed, legs)
    stand = pa.solve_stand(robot)
    limit = pa.payload_limit(robot, stand, POINT)
    assert limit.binding == "motors"
    trials = [
        pa.simulation.simulate_payload(robot, stand, share * limit.mass, POINT)
        for share in (0.95, 1.03)
    ]
    assert [trial.held for trial in trials] == [True, False]
