"""Bounds of the servo gains of a stand."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.tool import find_place, with_payload
from pupper_analysis.simulation.controlled_stand import ControlledStand
from pupper_analysis.simulation.rollout import make_stand_start
from pupper_analysis.simulation.servo_bounds import (
    bound_explicit_damping,
    bound_servo_gains,
    find_soft_servos,
)
from pupper_analysis.stance.sag.stiffness import estimate_minimum_stiffness, minimum_stiffness
from pupper_analysis.stance.stand import stand_statics
from tests.support.variants import load


@pytest.mark.slow
def test_bounds_contain_the_gains_of_v3() -> None:
    """References: `minimum_stiffness`; the modes of the controlled stand on both sides of the
    bound. Bare MuJoCo stands from 2.25 to 2.38 N m/rad."""
    robot = load("v3")
    stand = pa.solve_stand_as_simulated(robot)
    bounds = bound_servo_gains(robot, stand)
    least = minimum_stiffness(robot, stand)
    assert bounds.uniform
    assert bound_explicit_damping(robot, stand) == bounds.largest_kd_factor
    assert bounds.holding_kp_factor is None
    assert [joint_class.name for joint_class in bounds.classes] == ["leg_*_1", "leg_*_2", "leg_*_3"]
    assert all(
        joint_class.least_kp == pytest.approx(least, rel=0.01) for joint_class in bounds.classes
    )
    most = bounds.classes[0].largest_kd
    assert most is not None
    assert 2.5 < most < 3.0
    loop = ControlledStand(make_stand_start(robot, stand))
    kp = np.full(12, 5.0)
    assert loop.is_stable(kp, np.full(12, 0.97 * most))
    assert not loop.is_stable(kp, np.full(12, 1.03 * most))


@pytest.mark.slow
def test_servos_that_are_too_soft_get_a_stiffness_that_stands() -> None:
    """Reference: a simulation with the stated stiffness, without feed-forward; another with the
    given stiffness."""
    robot = load("v3")
    stand = pa.solve_stand_as_simulated(robot)
    bounds = bound_servo_gains(robot, stand, kp=2.0, stands=False)
    least, holding = bounds.least_kp_factor, bounds.holding_kp_factor
    assert least is not None
    assert holding is not None
    assert 1 < least < holding
    assert pa.verify_stand(robot, stand, kp=2.0 * holding, feedforward=False).stays
    assert not pa.verify_stand(robot, stand, kp=2.0, feedforward=False).stays


def test_servos_without_damping_have_no_largest_damping() -> None:
    robot = load("v3")
    stand = pa.solve_stand_as_simulated(robot)
    bounds = bound_servo_gains(robot, stand, kp=5.0, kd=0.0)
    assert bounds.largest_kd_factor is None
    assert all(joint_class.largest_kd is None for joint_class in bounds.classes)


def simulate_in_bare_mujoco(robot: pa.Robot, stand: pa.Stand, kp: np.ndarray) -> float:
    """Return the distance [m] that the base moves in 30 s with feed-forward and servos."""
    torques = stand_statics(robot, stand).joint_torques
    model, joints = copy.copy(robot.mj_model), stand.joint_positions(robot)
    servos = robot.mj_convention.actuator_index
    model.actuator_gainprm[servos, 0], model.actuator_biasprm[servos, 1] = kp, -kp
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, stand.qpos)
    data.ctrl[servos] = joints + torques / kp
    start = data.qpos[:3].copy()
    data.qvel[:2] = 0.02
    mujoco.mj_step(model, data, nstep=round(30.0 / model.opt.timestep))
    return float(np.linalg.norm(data.qpos[:3] - start))


@pytest.mark.slow
def test_class_of_servos_that_alone_is_too_soft_is_found() -> None:
    """Reference: bare MuJoCo with these servos, once as given and once with the found factor."""
    robot = load("v3")
    stand = pa.solve_stand_as_simulated(robot)
    joints = [index for index, name in enumerate(robot.joint_names) if name.endswith("_1")]
    kp = np.full(12, 5.0)
    kp[joints] = 0.2
    run = pa.verify_stand(robot, stand, kp=kp)
    assert not run.stays
    soft = find_soft_servos(robot, stand, run, kp=kp)
    assert soft is not None
    assert (soft.name, soft.kp) == ("leg_*_1", 0.2)
    assert {robot.joint_names[index] for index in joints} == set(soft.joints)
    assert simulate_in_bare_mujoco(robot, stand, kp) > 0.03
    kp[joints] *= soft.factor
    assert simulate_in_bare_mujoco(robot, stand, kp) < 1e-3
    assert find_soft_servos(robot, stand, pa.verify_stand(robot, stand, kp=kp), kp=kp) is None


def test_least_stiffness_is_at_most_a_stiffness_that_stands() -> None:
    """Reference: `verify_stand` with kp 5 N m/rad, without feed-forward, stays for 12 s.

    The estimate for v3 with 3.2 kg is 5.2 N m/rad; a simulation stands with 5 and not with 4.95.
    """
    robot = with_payload(load("v3"), 3.2, find_place(load("v3"), (0.0, 0.0, 0.0)))
    stand = pa.solve_stand_as_simulated(robot)
    assert pa.verify_stand(robot, stand, feedforward=False).stays
    bounds = bound_servo_gains(robot, stand)
    assert estimate_minimum_stiffness(robot, stand) > 5.0
    assert bounds.least_kp_factor == 1.0
    assert bounds.classes[0].least_kp == bounds.classes[0].kp == 5.0
