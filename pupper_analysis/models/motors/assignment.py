"""Motors of joints: effort limits, and torques that a motor cannot exert."""

from __future__ import annotations

from collections.abc import Mapping

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.motors.motor import Motor


def describe_weak_motor(
    joint: str, motor: str, torque: float, largest: float, number: str
) -> Diagnostic:
    """Create the message that a motor at rest is too weak for a required torque.

    Args:
        joint: Joint.
        motor: Name of the motor.
        torque: Required torque at the output [N m].
        largest: Largest torque of the motor at rest [N m].
        number: Field of `Motor` that limits this torque, such as ``peak_torque``
            (`Motor.largest_torque`).
    """
    return diagnose(
        "motor-too-weak",
        joint=joint,
        motor=motor,
        torque=Quantity(abs(torque), "N m"),
        largest=Quantity(largest, "N m"),
        peak=number == "peak_torque",
        stall=number == "stall_torque",
        current=number == "current_limit",
        voltage=number == "supply_voltage",
    )


def list_motor_efforts(motors: Mapping[str, Motor]) -> dict[str, float]:
    """Return {joint: largest torque of its motor at rest [N m]}.

    Raises:
        ModelError: If the largest torque of a motor is unknown.
    """
    efforts = {}
    for joint, motor in motors.items():
        if motor.largest_torque is None:
            problem = diagnose("motor-numbers-unknown", numbers=["peak_torque"])
            raise ModelError(motor.name, problem)
        efforts[joint] = motor.largest_torque[0]
    return efforts


def describe_weak_motors(
    motors: Mapping[str, Motor], torques: Mapping[str, float]
) -> tuple[Diagnostic, ...]:
    """Return a message for each motor that at rest cannot exert its required torque, weakest first.

    The weakest motor has the largest ratio of required torque to largest torque. A motor whose
    largest torque is unknown has no message.

    Args:
        motors: {joint: motor}.
        torques: {joint: required torque at the output of the motor [N m]}; includes the joints of
            `motors`.
    """
    found: list[tuple[float, Diagnostic]] = []
    for joint, motor in motors.items():
        largest, torque = motor.largest_torque, abs(torques[joint])
        if largest is not None and torque > largest[0]:
            message = describe_weak_motor(joint, motor.name, torque, *largest)
            found.append((torque / largest[0], message))
    return tuple(message for _, message in sorted(found, key=lambda item: -item[0]))
