"""Where position servos let a posture come to rest under gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import NoEquilibriumError
from pupper_analysis.base.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import servo_gains
from pupper_analysis.robot.tendons import tendon_ranges
from pupper_analysis.robot.tool import Tool
from pupper_analysis.stance.posture import (
    Posture,
    check_held,
    joint_ranges,
    joint_units,
    with_give,
)

Array = NDArray[np.float64]

_BALANCED = 1e-10
"""What is left of the balance, in parts of the greatest torque."""

_MOST_STEPS = 60

_LONGEST = 0.3
"""A longer Newton step is shortened (rad, m): gravity turns by a radian."""

_MOVED = 1e-12
"""A shorter step is rounding (rad, m)."""

_REACHED = 1e-6
"""What is nearer to a limit is at it (rad, m): MuJoCo's limits, and couplings, give way by more."""


@dataclass(frozen=True, eq=False)
class SaggedPosture(Result):
    """Where position servos let a posture come to rest, commanded the posture alone.

    Attributes:
        qpos: (nu,) where the joints are then (rad, m).
        joint_sag: (nu,) by how much these are from the posture (rad, m).
        joint_torques: (nu,) of the motors there (N m, N).
        tool_sag: (3,) how far the tool is from where the posture has it, in world axes (m).
        softest: The least eigenvalue of servos' stiffness and gravity's together, in parts of the
            least stiffness of a servo; at 0 the robot buckles.
    """

    qpos: Array
    joint_sag: Array
    joint_torques: Array
    tool_sag: Array
    softest: float


@check_arguments
def sag_posture(
    robot: Robot, posture: Posture, tool: Tool, *, kp: ArrayLike | None = None
) -> SaggedPosture:
    """Finds where position servos, commanded a posture, let it come to rest.

    There kp (q* - q) = tau(q), the torques that gravity and the MJCF's springs leave to the motors:
    in the velocities W that couplings of joints allow, W^T (l(q) + kp (q - q*)) = 0. It is solved
    by Newton's method from the posture on.

    Args:
        robot: A robot whose base is held.
        posture: What is commanded.
        tool: Whose sag is computed.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.

    Raises:
        ConfigurationError: If the base is free, or kp is no stiffness.
        ModelError: If the model has no position servos and no kp is given.
        NoEquilibriumError: If it comes to rest nowhere near: the motors are too weak or the servos
            too soft, or a joint comes to its limit.
    """
    check_held(robot)
    # A damping is asked for with a stiffness where motors are no servos; here none moves.
    gains = servo_gains(robot, kp, None if kp is None else 0.0).kp
    commanded = posture.qpos
    qpos = commanded.copy()
    config = Configuration(robot, qpos)
    for _ in range(_MOST_STEPS):
        left, rates, basis = _balance(config, commanded, gains)
        step = basis @ np.linalg.lstsq(rates, -left, rcond=None)[0]
        longest = float(np.abs(step).max(initial=0.0))
        if longest < _MOVED or np.abs(left).max() <= _BALANCED * np.abs(config.load()).max():
            break
        qpos = qpos + step * min(1.0, _LONGEST / longest)
        if robot.closure is not None:
            closed = robot.closure.closed(qpos, np.ones(robot.nu))
            if closed is None:
                raise NoEquilibriumError(None, diagnose("sag-not-found"))
            qpos = closed
        config = Configuration(robot, qpos)
    else:
        raise NoEquilibriumError(None, diagnose("sag-not-found"))
    _, rates, _ = _balance(config, commanded, gains)
    softest = float(np.linalg.eigvalsh((rates + rates.T) / 2)[0] / gains[gains > 0].min())
    if softest <= 0:
        raise NoEquilibriumError(None, diagnose("held-posture-buckles"))
    torques = gains * (commanded - qpos)
    qpos = with_give(robot, qpos)
    config = Configuration(robot, qpos)
    if problem := _beyond(robot, qpos, torques):
        raise NoEquilibriumError(None, problem)
    start = tool.position(Configuration(robot, commanded))
    return SaggedPosture(qpos, qpos - commanded, torques, tool.position(config) - start, softest)


def _balance(config: Configuration, commanded: Array, kp: Array) -> tuple[Array, Array, Array]:
    """Returns what is left of the balance (n,), its derivative (n, n), and the ways (nu, n)."""
    closure = config.robot.closure
    basis = np.eye(len(kp)) if closure is None else closure.null_space(config.qpos)
    left = config.load() + kp * (config.qpos - commanded)
    rates = config.static_rates({}) + np.diag(kp)
    return basis.T @ left, basis.T @ rates @ basis, basis


def _beyond(robot: Robot, qpos: Array, torques: Array) -> Diagnostic | None:
    """Says so if a motor would have to give more than it can, or a limit keeps a joint."""
    weakest, strongest = robot.effort_ranges.T
    for joint in np.flatnonzero((torques < weakest) | (torques > strongest)).tolist():
        return diagnose(
            "motor-too-weak",
            subject=("joint", robot.joint_names[joint]),
            torque=Quantity(torques[joint], "N m"),
            limit=Quantity(strongest[joint] if torques[joint] > 0 else weakest[joint], "N m"),
        )
    low, high = joint_ranges(robot).T
    for joint in np.flatnonzero((qpos < low - _REACHED) | (qpos > high + _REACHED)).tolist():
        unit = joint_units(robot)[joint]
        name = robot.joint_names[joint]
        beyond = Quantity(max(low[joint] - qpos[joint], qpos[joint] - high[joint]), unit)
        return diagnose("sags-to-joint-limit", subject=("joint", name), beyond=beyond)
    return next(tendon_ranges(robot).at_ends(qpos, -_REACHED), None)
