"""Electrical energy of motors in single steps.

Integration rule: the torque with which MuJoCo integrates a step, times the mean speed of the step.
With this rule, electrical energy = work + copper loss + friction. The runs of commands are tested
in the folders of ``path``, ``push``, ``walk`` and ``heat``.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from pupper_analysis.models.motors.dcmotor import list_dcmotors, make_dcmotor_element
from pupper_analysis.models.motors.energy import compute_motor_energy
from pupper_analysis.models.motors.reading import find_motor
from tests.support.motor_energy import MOTOR, check_balance


def test_energy_agrees_with_the_voltage_and_current_of_a_dcmotor() -> None:
    """Reference: MuJoCo's ``dcmotor`` (no gear losses) at random torques and speeds.

    The voltage R i + Ke w, applied to the element at the mean speed, exerts the torque; the drawn
    power is this voltage times the current, force / Kt.
    """
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>
        <geom size=".05" mass="1" pos=".2 0 0"/></body></worldbody>
        <actuator>{make_dcmotor_element(MOTOR, "hinge")}</actuator></mujoco>"""
    )
    (motor,) = list_dcmotors(model, "bench").values()
    random = np.random.default_rng(75)
    torques, speeds = random.normal(0, 5, (200, 1)), random.normal(0, 8, (201, 1))
    energy = check_balance(compute_motor_energy({"hinge": motor}, ["hinge"], torques, speeds, 0.01))
    data, drawn = mujoco.MjData(model), 0.0
    for torque, before, after in zip(torques[:, 0], speeds[:-1, 0], speeds[1:, 0], strict=True):
        data.qvel[0] = (before + after) / 2
        data.ctrl[0] = 0.5 * torque / 0.6 + 0.6 * data.qvel[0]
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator[0] == pytest.approx(torque, rel=1e-9)
        drawn += 0.01 * data.ctrl[0] * data.actuator_force[0] / 0.1
    assert energy.electrical == pytest.approx(drawn, rel=1e-9)
    assert energy.work == pytest.approx(0.01 * (torques * (speeds[:-1] + speeds[1:]) / 2).sum())
    assert energy.friction == pytest.approx(0.0, abs=1e-9)


def test_mean_power_of_a_motion_without_steps_is_none() -> None:
    energy = compute_motor_energy({"a": MOTOR}, ["a"], np.zeros((0, 1)), np.zeros((1, 1)), 0.1)
    assert (energy.duration, energy.electrical, energy.power) == (0.0, 0.0, None)


def test_gear_with_losses_takes_energy_in_both_directions() -> None:
    """Reference: by hand. 80 % of the rotor's power reach the load, and 80 % of the load's power
    reach the rotor of a motor that brakes. 1 s at 3 N m and 2 rad/s: 6 J of work."""
    motor = replace(MOTOR, gear_efficiency=0.8)
    torques, speeds = np.full((10, 1), 3.0), np.full((11, 1), 2.0)
    drives = check_balance(compute_motor_energy({"a": motor}, ["a"], torques, speeds, 0.1))
    assert (drives.work, drives.friction) == (pytest.approx(6.0), pytest.approx(6 / 0.8 - 6))
    assert drives.copper == pytest.approx((3 / 0.48) ** 2 * 0.5)
    brakes = check_balance(compute_motor_energy({"a": motor}, ["a"], torques, -speeds, 0.1))
    assert (brakes.work, brakes.friction) == (pytest.approx(-6.0), pytest.approx(6 * 0.2))
    assert brakes.copper == pytest.approx((3 * 0.8 / 0.6) ** 2 * 0.5)
    both = (drives.power, drives.duration)
    assert both == (pytest.approx(7.5 + (3 / 0.48) ** 2 * 0.5), pytest.approx(1.0))


def test_gear_never_creates_energy_and_unknown_numbers_are_named() -> None:
    """Of a published motor, the torque per current at the output exceeds Kt N (0.45 > 0.42)."""
    torques, speeds = np.full((5, 2), 3.0), np.full((6, 2), 2.0)
    motors = {"a": find_motor("mit-mini-cheetah")}
    assert check_balance(compute_motor_energy(motors, "ab", torques, speeds, 0.1)).friction == 0.0
    motors["b"] = find_motor("unitree-go-m8010-6")
    energy = compute_motor_energy(motors, "ab", torques, speeds, 0.1)
    assert energy.unknown == ("resistance", "stall_current")
    assert (energy.electrical, energy.work, energy.residual, energy.power) == (None,) * 4
