"""Servos behind a gear: at the joint they are what the files' numbers say, times the gear."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.stance.sag.equilibrium import SagEquilibrium
from tests.support.engines import changed, mujoco_at
from tests.support.variants import load, stand_of

GEARS = np.array([2.0, -1.5, 0.4] * 4)
"""Of each leg's joints; one turns the other way."""


def geared(name: str, *, force: float | None = None) -> pa.Robot:
    """The robot with gears, the actuators' own numbers left as they are."""
    robot = load(name)
    actuators = robot.mj_convention.actuator_index

    def change(model: mujoco.MjModel) -> None:
        model.actuator_gear[actuators, 0] = GEARS
        if force is not None:
            model.actuator_forcelimited[:] = 1
            model.actuator_forcerange[:] = -force, force

    return changed(robot, change)


@pytest.mark.parametrize("gains", [{}, {"kp": 7.0, "kd": 0.3}])
def test_the_law_at_the_joint_is_mujocos(gains: dict[str, float]) -> None:
    """tau = kp (q* - q) + feed-forward - kd dq/dt, with the gains that are said."""
    robot, name = geared("v3"), "v3"
    drive = model_with_servos(robot, **gains)
    actuators = robot.mj_convention.actuator_index
    own = (load(name).mj_model.actuator_gainprm[actuators, 0] * GEARS**2, 0.1 * GEARS**2)
    for found, given, file in ((drive.kp, "kp", own[0]), (drive.kd, "kd", own[1])):
        np.testing.assert_allclose(found, gains.get(given, file), rtol=1e-12)
    random = np.random.default_rng(2)
    rates, wanted, torque = (random.uniform(-size, size, 12) for size in (0.5, 0.1, 0.05))
    qpos = stand_of(name).qpos
    data = mujoco_at(robot, qpos, np.r_[np.zeros(6), rates], drive.model)
    model = drive.model
    model.actuator_forcelimited[:] = 0
    model.actuator_ctrllimited[:] = 0
    data.ctrl[:] = drive.command(robot, qpos[7:] + wanted, torque)
    mujoco.mj_forward(model, data)
    joints = np.array([model.joint(name).dofadr[0] for name in robot.joint_names])
    np.testing.assert_allclose(
        data.qfrc_actuator[joints], drive.kp * wanted + torque - drive.kd * rates, atol=1e-12
    )


def test_a_geared_robot_stands_as_it_did_with_the_same_gains_at_the_joints() -> None:
    stand = stand_of("v3")
    plain, other = (
        pa.verify_stand(robot, stand, kp=8.0, kd=0.2, feedforward=False, duration=2.0)
        for robot in (load("v3"), geared("v3"))
    )
    np.testing.assert_allclose(other.joint_torques, plain.joint_torques, atol=1e-7)
    assert other.base_height == pytest.approx(plain.base_height, abs=1e-8)
    sag = [pa.steady_state(robot, stand, kp=8.0) for robot in (load("v3"), geared("v3"))]
    np.testing.assert_allclose(sag[1].qpos, sag[0].qpos, atol=1e-10)


def test_a_force_range_counts_times_the_gear() -> None:
    robot = geared("v3", force=0.9)
    most = np.minimum(0.9 * np.abs(GEARS), load("v3").effort_limits)
    np.testing.assert_allclose(robot.effort_limits, most, rtol=1e-12)


def test_a_servo_saturates_at_its_force_range_times_the_gear() -> None:
    """What MuJoCo clips and what the prediction clips, far from the commanded pose."""
    robot = geared("v3", force=0.9)
    drive, stand = model_with_servos(robot, kp=50.0, kd=0.0), stand_of("v3")
    data = mujoco_at(robot, stand.qpos, model=drive.model)
    drive.model.actuator_ctrllimited[:] = 0
    for sign in (1, -1):
        data.ctrl[:] = drive.command(robot, stand.qpos[7:] + sign * 1.0)
        mujoco.mj_forward(drive.model, data)
        joints = np.array([drive.model.joint(name).dofadr[0] for name in robot.joint_names])
        np.testing.assert_allclose(data.qfrc_actuator[joints], sign * 0.9 * np.abs(GEARS))
        system = SagEquilibrium(robot, stand, 50.0, "pinned")
        away = np.r_[stand.qpos[:7], system.target - sign * 1.0]
        np.testing.assert_allclose(system.torques(away), sign * 0.9 * np.abs(GEARS), rtol=1e-12)
