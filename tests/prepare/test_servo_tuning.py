"""Gains of added servos: required sag, critical damping, and the stiffness that a time step can
follow.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.prepare.servo_tuning import (
    ServoRequirement,
    compute_joint_inertia,
    suggest_fixed_base_gains,
    suggest_standing_gains,
)
from tests.support.legged import quadruped_with_slides
from tests.support.variants import load

ROD = """<mujoco><option timestep="{step}"/><worldbody><body>
  <joint name="swing" axis="0 1 0" range="-180 180"/>
  <inertial pos="0 0 -.5" mass="2" diaginertia="1e-9 1e-9 1e-9"/></body></worldbody></mujoco>"""


def test_most_loaded_joint_deflects_by_the_requested_sag() -> None:
    """Closed form: |torque| / kp [rad], at most 0.02 rad; suggested gains are within 10 % below
    this stiffness.
    """
    robot = load("v3")
    stand = pa.solve_stand(robot)
    torques = pa.stance.stand_statics(robot, stand).joint_torques
    required = ServoRequirement.of_stand(robot, stand.qpos, torques)
    deflections = np.abs(torques) / required.stiffness(0.02)
    assert deflections.max() == pytest.approx(0.02, rel=1e-12)
    kp, kd = suggest_standing_gains(robot, stand, torques, 0.02)
    assert np.all((kp <= required.stiffness(0.02)) & (kp > 0.9 * required.stiffness(0.02)))
    np.testing.assert_allclose(kd, 0.05 * kp, rtol=0.1)


def test_slides_of_a_leg_are_as_stiff_at_the_foot_as_hinges(tmp_path: Path) -> None:
    """Closed form: kp of a slide = kp of a hinge / lever^2, with half of the stand height as lever.

    The stiffness of all joints is below the bound of the time step.
    """
    robot = pa.load_robot(quadruped_with_slides(tmp_path))
    lever = robot.stand_height / 2
    torques = np.ones(robot.nu)
    required = ServoRequirement.of_stand(robot, robot.home, torques)
    stiffness = dict(zip(robot.joint_names, required.stiffness(0.05), strict=True))
    assert 0.1 < lever < 1.0
    assert stiffness["FL_knee"] == pytest.approx(stiffness["FL_pitch"] / lever**2, rel=1e-9)
    assert stiffness["FL_knee"] < required.max_stiffness.max()


def test_no_joint_is_stiffer_than_a_step_can_follow() -> None:
    """Reference: `mj_solveM`, the acceleration due to a unit torque at one joint. Closed form: the
    natural frequency times the time step is 1.5.
    """
    robot = load("v3")
    qpos = pa.solve_stand(robot).qpos
    felt = compute_joint_inertia(robot, qpos)
    data = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_forward(robot.mj_model, data)
    column = np.zeros(robot.mj_model.nv)
    for joint, dof in enumerate(robot.mj_convention.qvel_index[6:].tolist()):
        unit = np.zeros(robot.mj_model.nv)
        unit[dof] = 1.0
        mujoco.mj_solveM(robot.mj_model, data, column[None], unit[None])
        assert felt[joint] == pytest.approx(1 / column[dof], rel=1e-6)
    step = float(robot.mj_model.opt.timestep)
    for parts in (1, 2):
        required = ServoRequirement.of_stand(robot, qpos, np.full(robot.nu, 1e6), parts=parts)
        frequency = np.sqrt(required.stiffness(0.02) / felt) * step / parts
        np.testing.assert_allclose(frequency, 1.5, rtol=1e-12)


@pytest.mark.parametrize("sag", [0.02, 0.05])
def test_tuned_servo_of_a_rod_is_critically_damped(sag: float) -> None:
    """A point mass on a rod: 2 kg, 0.5 m, so 9.81 N m at the most, and 0.5 kg m^2."""
    model = mujoco.MjModel.from_xml_string(ROD.format(step=0.001))
    kp, kd = suggest_fixed_base_gains(model, sag)
    assert kp[0] == pytest.approx(9.81 / sag, rel=0.01)
    assert kd[0] == pytest.approx(2 * np.sqrt(kp[0] * 0.5), rel=0.01)
    coarse = mujoco.MjModel.from_xml_string(ROD.format(step=0.05))
    assert suggest_fixed_base_gains(coarse, sag)[0][0] == pytest.approx(
        0.5 * (0.5 / 0.05) ** 2, rel=0.01
    )


def test_servo_without_gravity_is_tuned_for_its_inertia() -> None:
    """A rod of 0.25 kg m^2 about a vertical axis: natural frequency 2 Hz, critically damped."""
    rod = """<mujoco><worldbody><body><joint name="turn" axis="0 0 1"/>
      <inertial pos=".5 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body></worldbody></mujoco>"""
    kp, kd = suggest_fixed_base_gains(mujoco.MjModel.from_xml_string(rod))
    assert kp == pytest.approx([0.25 * (4 * np.pi) ** 2], rel=5e-3)
    assert kd == pytest.approx([2 * 0.25 * 4 * np.pi], rel=5e-3)
