"""Is a stand stable on its servos, by the spectrum of MuJoCo's step: without a simulation."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.arguments import checked
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, servos
from pupper_analysis.robot.stability import SETTLE, Stability, step_stability
from pupper_analysis.robot.terrain import on_ground
from pupper_analysis.simulation.rollout import STATE, check_standing, place_on_ground
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.statics.equilibrium import ForceDistribution

Array = NDArray[np.float64]


@checked
def stand_stability(
    robot: Robot,
    stand: Stand,
    *,
    feedforward: bool = True,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
) -> Stability:
    """Judges whether a stand is stable, by the eigenvalues of one of MuJoCo's steps.

    It takes milliseconds, where ``verify_stand`` simulates seconds, and finds what no seconds show.
    It says nothing of where the robot comes to rest, nor of harder pushes.

    Args:
        robot: The robot.
        stand: How it stands.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        integrator: MuJoCo's integrator; the model's own by default.

    Returns:
        The modes that grow, with their doubling times, and the margin.

    Raises:
        ConfigurationError: If an argument is out of its range, or the base is fixed.
        ModelError: If the model has no servos and no gains are given.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    check_standing(robot, stand)
    robot = on_ground(robot, stand.task.ground, stand.foot_targets)
    torques = stand_statics(
        robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL
    ).joint_torques
    drive = servos(robot, kp, kd, integrator)
    start = place_on_ground(robot, drive, stand, torques)
    fed = torques if feedforward else None
    return judged_at(drive, start, drive.command(robot, stand.joint_positions(robot), fed))


def judged_at(drive: Servos, state: Array, ctrl: Array, settle: float = SETTLE) -> Stability:
    """Judges a state (mjSTATE_FULLPHYSICS) under a command; see ``step_stability``."""
    data = mujoco.MjData(drive.model)
    mujoco.mj_setState(drive.model, data, state, STATE)
    data.ctrl[:] = ctrl
    return step_stability(drive.model, data, settle=settle)
