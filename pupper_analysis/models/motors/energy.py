"""Electrical energy of motors in a simulated motion: work, copper loss and friction of the gears.

In a time step of length h, a motor exerts the torque tau at the output, with the mean speed w of
the start and the end of the step:

    work = tau w h,   copper loss = R i^2 h,   electrical energy = u i h
    motor drives (tau w >= 0):   i = |tau| / K,          u = R i + Ke |w|
    motor brakes (tau w < 0):    i = |tau| K / Ke^2,     u = R i - Ke |w|

K is the torque at the output per current, Ke the back-EMF constant at the output, and R the
resistance of the cold winding. The gear transmits the fraction K / Ke of the power in both
directions; the remainder is friction. Therefore the electrical energy equals work + copper loss +
friction, to rounding. With the mean speed, a semi-implicit step of MuJoCo changes the kinetic
energy by exactly the work of all forces, at a constant mass matrix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.results import Result
from pupper_analysis.models.motors.motor import Motor, list_unknown_numbers


@dataclass(frozen=True)
class MotorEnergy(Result):
    """Electrical energy of all assigned motors in a simulated motion, and its balance.

    All energies are None if a required number of a motor is unknown.

    Attributes:
        duration: Simulated time (s).
        electrical: Energy that the motors draw (J); energy that braking motors return counts as
            negative.
        work: Mechanical work at the joints (J).
        copper: Copper loss of the cold windings (J).
        friction: Friction of the gears (J).
        residual: |electrical - work - copper - friction|, relative to the sum of the absolute
            values of the electrical energies of all steps and motors; 0 without energy.
        unknown: Names of the missing motor numbers.
    """

    duration: float = field(metadata={"unit": "s"})
    electrical: float | None = field(metadata={"unit": "J"})
    work: float | None = field(metadata={"unit": "J"})
    copper: float | None = field(metadata={"unit": "J"})
    friction: float | None = field(metadata={"unit": "J"})
    residual: float | None = field(metadata={"unit": "1"})
    unknown: tuple[str, ...] = ()

    @property
    def power(self) -> float | None:
        """Mean electrical power [W]; None if the energy is unknown, or for a motion of 0 s."""
        if self.electrical is None or not self.duration:
            return None
        return self.electrical / self.duration


def compute_motor_energy(
    motors: Mapping[str, Motor],
    joints: Sequence[str],
    torques: Array,
    speeds: Array,
    period: float,
) -> MotorEnergy:
    """Compute the electrical energy that motors draw in n time steps of a simulation.

    Args:
        motors: {joint: motor}; joints without a motor are ignored.
        joints: Names of nu joints.
        torques: Torques at the joints in each step, shape (n, nu) [N m].
        speeds: Speeds of the joints at the start of each step, and at the end of the last step,
            shape (n + 1, nu) [rad/s].
        period: Time step [s].
    """
    constants, unknown = {}, dict[str, None]()
    for joint in joints:
        if joint in motors:
            try:
                constants[joint] = _find_constants(motors[joint])
            except ModelError as error:
                unknown |= dict.fromkeys(list_unknown_numbers(error))
    duration = period * len(torques)
    if unknown:
        return MotorEnergy(duration, None, None, None, None, None, tuple(unknown))
    electrical = work = copper = friction = throughput = 0.0
    for column, joint in enumerate(joints):
        if joint not in constants:
            continue
        per_ampere, back_emf, ohms = constants[joint]
        torque, speed = torques[:, column], (speeds[:-1, column] + speeds[1:, column]) / 2
        drives = torque * speed >= 0
        current = np.abs(torque) * np.where(drives, 1 / per_ampere, per_ampere / back_emf**2)
        voltage = ohms * current + np.where(drives, 1.0, -1.0) * back_emf * np.abs(speed)
        power = torque * speed
        lost = np.where(drives, back_emf / per_ampere - 1, per_ampere / back_emf - 1) * power
        electrical += period * float((voltage * current).sum())
        throughput += period * float(np.abs(voltage * current).sum())
        work += period * float(power.sum())
        copper += period * float((ohms * current**2).sum())
        friction += period * float(lost.sum())
    difference = abs(electrical - work - copper - friction)
    residual = difference / throughput if throughput else 0.0
    return MotorEnergy(duration, electrical, work, copper, friction, residual)


def _find_constants(motor: Motor) -> tuple[float, float, float]:
    """Return torque per current [N m/A], back-EMF constant [V s/rad] and resistance [ohm].

    The first two are at the output. The back-EMF constant is at least the torque per current, since
    no gear creates energy.
    """
    per_ampere, ohms = motor.output_torque_per_ampere, motor.winding_ohms
    if motor.torque_constant is not None and motor.gear_ratio is not None:
        back_emf = motor.torque_constant * motor.gear_ratio
    else:
        back_emf = motor.get("supply_voltage") / motor.get("no_load_speed")
    return per_ampere, max(back_emf, per_ampere), ohms
