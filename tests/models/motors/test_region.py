"""Torque-speed region of motors, against MuJoCo's ``dcmotor`` and closed forms."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.motors.assignment import describe_weak_motors, list_motor_efforts
from pupper_analysis.models.motors.dcmotor import make_dcmotor_element
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.motors.region import (
    compute_motor_utilisation,
    compute_region_utilisation,
)

MOTOR = Motor(
    *("test", "bench"),
    torque_constant=0.1,
    gear_ratio=6.0,
    gear_efficiency=1.0,
    resistance=0.5,
    supply_voltage=24.0,
    current_limit=30.0,
)


@pytest.mark.parametrize("voltage", [24.0, -24.0])
def test_region_agrees_with_mujocos_motor_at_full_voltage(voltage: float) -> None:
    """Reference: the force of MuJoCo's ``dcmotor`` with the supply voltage, at 41 speeds.

    The element limits the torque by ``saturation``, as the current limit does. A motor that its
    voltage accelerates against the speed brakes; beyond the speed without load it can only brake.
    """
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>
        <geom size=".05" mass="1" pos=".2 0 0"/></body></worldbody>
        <actuator>{make_dcmotor_element(MOTOR, "hinge")}</actuator></mujoco>"""
    )
    data = mujoco.MjData(model)
    data.ctrl[0] = voltage
    sign = np.sign(voltage)
    for speed in np.linspace(-60, 60, 41):
        data.qvel[0] = speed
        mujoco.mj_forward(model, data)
        torque = sign * data.qfrc_actuator[0]
        available = MOTOR.compute_available_torque(sign * speed)
        assert available == pytest.approx(max(torque, 0.0), rel=1e-12, abs=1e-12)
        if torque > 0:
            (share,) = compute_region_utilisation(MOTOR, [sign * torque], [speed])
            assert share == pytest.approx(1.0, rel=1e-12)


def test_utilisation_beyond_the_speed_without_load_is_infinite() -> None:
    """Reference: no torque in the direction of the motion at 24 V / 0.6 N m/A = 40 rad/s."""
    shares = compute_region_utilisation(MOTOR, [1.0, 0.0, -1.0, 9.0], [41.0, 41.0, 41.0, 20.0])
    assert np.isnan(compute_region_utilisation(MOTOR, [np.nan], [np.nan])).all()
    assert shares[0] == np.inf
    assert shares[1] == 0.0
    assert shares[2] == pytest.approx(1 / 18.0)  # braking: 30 A
    assert shares[3] == pytest.approx(9 / (0.6 * 12 / 0.5))


def test_stated_speed_without_load_limits_the_region() -> None:
    """Reference: the line through V Kt N / R at rest and zero at the stated speed."""
    slow = replace(MOTOR, current_limit=None, no_load_speed=20.0)
    assert slow.compute_available_torque(10.0) == pytest.approx(0.5 * 24 / 0.5 * 0.6)
    assert slow.compute_available_torque(20.0) == 0.0
    assert replace(slow, stall_torque=20.0).compute_available_torque(1.0) == 20.0


def test_friction_of_a_driving_motor_reduces_its_torque() -> None:
    """Reference: MuJoCo's ``dcmotor`` at a joint with dry and viscous friction, at full voltage.

    The acceleration times the inertia is the torque that remains for a load. At rest and while the
    motor brakes, friction supports the motor, and is not counted.
    """
    rough = replace(MOTOR, coulomb_friction=2.0, viscous_friction=0.1)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option gravity="0 0 0"><flag eulerdamp="disable"/></option><worldbody><body>
        <joint name="hinge" axis="0 1 0" damping="0.1" frictionloss="2" solreffriction="0.002 1"/>
        <geom size=".05" mass="1" pos=".2 0 0"/></body></worldbody>
        <actuator>{make_dcmotor_element(MOTOR, "hinge")}</actuator></mujoco>"""
    )
    data, mass = mujoco.MjData(model), np.zeros((1, 1))
    data.ctrl[0] = 24.0
    for speed in (1.0, 10.0, 20.0, 30.0):
        data.qvel[0] = speed
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        remaining = mass[0, 0] * data.qacc[0]
        assert rough.compute_available_torque(speed) == pytest.approx(max(remaining, 0.0), abs=1e-6)
    assert rough.compute_available_torque(0.0) == MOTOR.compute_available_torque(0.0)
    assert rough.compute_available_torque(-5.0) == MOTOR.compute_available_torque(-5.0)
    stuck = replace(MOTOR, coulomb_friction=17.0)
    (share,) = compute_region_utilisation(stuck, [1.0], [38.0])
    assert share == np.inf
    # The speed of a data sheet is measured with friction: 24 V / 40 rad/s.
    stated = replace(rough, torque_constant=None, gear_ratio=None, no_load_speed=40.0)
    stated = replace(stated, output_torque_constant=0.6)
    expected = pytest.approx(MOTOR.compute_available_torque(10.0), rel=1e-12)
    assert stated.compute_available_torque(10.0) == expected


def test_joints_without_motor_have_no_utilisation() -> None:
    torques, speeds = np.array([[1.0, 2.0], [3.0, 4.0]]), np.zeros((2, 2))
    shares = compute_motor_utilisation({"b": MOTOR}, ("a", "b"), torques, speeds)
    assert np.isnan(shares[:, 0]).all()
    np.testing.assert_allclose(shares[:, 1], [2 / 18, 4 / 18])
    with pytest.raises(ModelError, match="supply_voltage"):
        compute_region_utilisation(replace(MOTOR, supply_voltage=None), [1.0], [0.0])


def test_efforts_are_the_largest_torques() -> None:
    """Reference: current limit x Kt N."""
    assert list_motor_efforts({"a": MOTOR}) == {"a": pytest.approx(18.0)}
    with pytest.raises(ModelError, match="peak_torque"):
        list_motor_efforts({"a": Motor("bare", "bench")})
    first, second = describe_weak_motors(
        {"a": MOTOR, "b": MOTOR, "c": MOTOR}, {"a": -19.0, "b": 36.0, "c": 17.0}
    )
    assert str(first).startswith("b must exert 36 N m; test exerts at most 18 N m (current limit)")
    assert "a must exert 19 N m" in str(second)
