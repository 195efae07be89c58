"""Is a stand stable on its servos, by the spectrum of MuJoCo's step: without a simulation."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, model_with_servos
from pupper_analysis.robot.stability import SETTLE, Stability, step_stability
from pupper_analysis.robot.terrain import on_ground
from pupper_analysis.simulation.rollout import (
    STATE,
    begin_stand,
    check_standing,
    full_state,
    settled_activations,
)
from pupper_analysis.stance.sag.steady_state import SteadyState, steady_state
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]

MEETING = 0.05
"""s in which contacts meet their loads, where an equilibrium has been found already: the prediction
is of first order in friction's creep."""


@check_arguments
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
    With feed-forward the stand is judged; without, where servos let it rest (``steady_state``, feet
    pinned). It says nothing of harder pushes.

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
        NoEquilibriumError: If it comes to rest nowhere near without feed-forward.
    """
    check_standing(robot, stand)
    if not feedforward:
        pose = steady_state(robot, stand, kp=kp)
        return rest_stability(robot, stand, pose, kp=kp, kd=kd, integrator=integrator)
    held = begin_stand(robot, stand, kp=kp, kd=kd, integrator=integrator)
    return evaluate_stability(held.drive, held.start, held.ctrl)


def rest_stability(
    robot: Robot,
    stand: Stand,
    pose: SteadyState,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
) -> Stability:
    """Judges where the servos, commanded the stand alone, let a robot come to rest.

    Args:
        robot: The robot.
        stand: The stand that is commanded.
        pose: Where it comes to rest: ``steady_state``.
        kp: As for ``stand_stability``, like the next two.
        kd: Likewise.
        integrator: Likewise.

    Returns:
        The modes that grow there, and the margin.
    """
    robot = on_ground(robot, stand.task.ground, stand.rigid_targets)
    drive = model_with_servos(robot, kp, kd, integrator)
    ctrl = drive.command(robot, stand.joint_positions(robot))
    return evaluate_stability(drive, rest_state(robot, drive, pose, ctrl), ctrl, MEETING)


def rest_state(robot: Robot, drive: Servos, pose: SteadyState, ctrl: Array) -> Array:
    """Returns the state (mjSTATE_FULLPHYSICS) in which servos let a robot come to rest.

    Args:
        robot: The robot, on its ground.
        drive: Its servos.
        pose: Where it comes to rest.
        ctrl: (model.nu,) what they are commanded.
    """
    data = mujoco.MjData(drive.model)
    robot.mj_convention.set_state(data, pose.qpos)
    data.ctrl[:] = ctrl
    data.act[:] = settled_activations(drive.model, data.ctrl)
    return full_state(drive.model, data)


def evaluate_stability(
    drive: Servos, state: Array, ctrl: Array, settle: float = SETTLE
) -> Stability:
    """Judges a state (mjSTATE_FULLPHYSICS) under a command; see ``step_stability``."""
    data = mujoco.MjData(drive.model)
    mujoco.mj_setState(drive.model, data, state, STATE)
    data.ctrl[:] = ctrl
    return step_stability(drive.model, data, settle=settle)
