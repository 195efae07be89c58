"""Torque-speed region of a motor: utilisation of a motion.

At a speed w in the direction of the torque, the motor exerts at most tau = min(I_max, (V - Ke w) /
R) K - T_f. Its peak and stall torque are further bounds. K is the torque at the output per current,
and T_f the friction of a driving motor (`Motor.compute_available_torques`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.array_types import Array
from pupper_analysis.models.motors.motor import Motor

_MIN_TORQUE = 1e-9
"""Magnitude of the torque [N m] up to which a motor counts as unloaded (rounding). Chosen, not
tuned."""


def compute_region_utilisation(motor: Motor, torques: ArrayLike, speeds: ArrayLike) -> Array:
    """Compute the utilisation |torque| / available torque of a motor; above 1 it is too weak.

    The available torque is the largest torque at this speed (`Motor.compute_available_torques`).

    Args:
        motor: Motor.
        torques: Torques at the output [N m], shape (n,).
        speeds: Speeds of the output [rad/s], shape (n,).

    Returns:
        Utilisation, shape (n,): 0 for |torque| up to `_MIN_TORQUE`, infinite for a larger |torque|
        if the motor has no torque at the speed.

    Raises:
        ModelError: If a required number of the motor is unknown.
    """
    values, rates = np.asarray(torques, dtype=float), np.asarray(speeds, dtype=float)
    sizes = np.abs(values)
    available = motor.compute_available_torques(np.where(values < 0, -rates, rates))
    with np.errstate(divide="ignore", invalid="ignore"):
        shares: Array = np.where(sizes <= _MIN_TORQUE, 0.0, sizes / available)
    return shares


def compute_motor_utilisation(
    motors: Mapping[str, Motor], joints: Sequence[str], torques: Array, speeds: Array
) -> Array:
    """Return the utilisation of the motors of joints: |torque| / available torque at the speed.

    Args:
        motors: {joint: motor}.
        joints: Names of nu joints.
        torques: Torques [N m], shape (n, nu).
        speeds: Speeds of the joints [rad/s], shape (n, nu).

    Returns:
        Shape (n, nu); NaN for a joint without motor. For special cases see
        `compute_region_utilisation`.

    Raises:
        ModelError: If a required number of a motor is unknown.
    """
    shares = np.full(torques.shape, np.nan)
    for index, joint in enumerate(joints):
        if joint in motors:
            columns = torques[:, index], speeds[:, index]
            shares[:, index] = compute_region_utilisation(motors[joint], *columns)
    return shares
