"""What moves a joint: servos, torque motors, servos that drive away; whatever their gears."""

from __future__ import annotations

import mujoco
import pytest

from pupper_analysis.models.transmission import Drive, drive_of


def drive(actuators: str) -> Drive:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="hinge"/><geom size="0.1"/></body></worldbody>'
        f"<actuator>{actuators}</actuator></mujoco>"
    )
    return drive_of(model, 0)


def position(kp: float, gear: float = 1.0) -> str:
    return f'<position joint="hinge" kp="{kp}" gear="{gear}"/>'


@pytest.mark.parametrize("gear", [1.0, 3.0, -3.0, 0.1])
def test_a_gear_makes_no_other_drive(gear: float) -> None:
    """Both the force and the length of an actuator are taken times the gear."""
    assert drive(position(10, gear)) is Drive.SERVO
    assert drive(position(-10, gear)) is Drive.WRONG_SIGN
    assert drive(position(0, gear)) is Drive.NO_STIFFNESS
    assert drive(f'<motor joint="hinge" gear="{gear}"/>') is Drive.MOTOR


def test_of_two_servos_the_stiffer_one_at_the_joint_says_where_it_goes() -> None:
    assert drive(position(10) + position(-10, 2)) is Drive.WRONG_SIGN  # 10 - 40 N m/rad
    assert drive(position(10, 2) + position(-10)) is Drive.SERVO


def test_what_an_actuator_makes_of_its_command_is_no_stiffness() -> None:
    away = '<general joint="hinge" gainprm="40" biastype="affine" biasprm="0 40 0"/>'
    assert drive(position(30) + away) is Drive.WRONG_SIGN  # 30 - 40 N m/rad
    assert drive(position(50) + away) is Drive.SERVO
