"""The verdict of a posture that is held: what was simulated, and what its file does there."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.prepare.bare import Bare, Hold, place_held, self_controlled
from pupper_analysis.prepare.judge import remarks_of_files
from pupper_analysis.prepare.own_run import (
    NOTHING,
    as_loaded,
    hold_of_angles,
    is_limp,
    joint_places,
    raw_model,
    run_alone,
    states_ctrl,
)
from pupper_analysis.prepare.self_check import Predicted, compared_with_file, with_lines
from pupper_analysis.robot.alike import structure
from pupper_analysis.robot.as_published import OwnCommands, OwnRun, Published
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import servos_used
from pupper_analysis.simulation.verdict import Simulated, Verdict, beyond_limits, judge_stance
from pupper_analysis.stance.posture import Posture
from pupper_analysis.statics.equilibrium import GravityCompensation, gravity_compensation

Array = NDArray[np.float64]

_THERE = 1e-6
"""A posture that is so near to a keyframe's is its (rad, m)."""


def judge_held(
    robot: Robot,
    posture: Posture,
    fed: Simulated,
    alone: Simulated | None,
    statics: GravityCompensation,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> Verdict:
    """Weighs what was simulated of a posture of a robot whose base is held, as ``judge`` does.

    Args:
        robot: The robot, with what it carries.
        posture: Where it is commanded to be.
        fed: The simulation with feed-forward.
        alone: The simulation without.
        statics: What its motors hold.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping (N m s/rad), one or (nu,); the model's own by default.

    Raises:
        ModelError: If the robot has no position servos, and kp and kd are not both given.
    """
    servos, empty = servos_used(robot, kp, kd), as_loaded(robot)
    bare = gravity_compensation(Configuration(empty, posture.qpos), contacts=[])
    return judge_stance(
        fed,
        alone,
        servos,
        overloaded=beyond_limits(statics),
        own=own_run_held(robot, posture.qpos),
        published=as_published_held(robot, posture.qpos, bare.joint_torques),
        converted=robot.description.converted,
        remarks=(*structure(robot), *remarks_of_files(robot)),
    )


def own_run_held(robot: Robot, qpos: Array) -> OwnRun | None:
    """Returns what the file of a robot whose base is held does by itself in a posture.

    With a keyframe's ctrl where it is that keyframe's posture, and the XML states one; else with
    its servos told the posture.

    Args:
        robot: The robot.
        qpos: (nu,) joint positions.

    Returns:
        What it does; None where its base is free in the file, or commands of its own control it.
    """
    robot = as_loaded(robot)
    model = None if robot.floating else robot.once(raw_model)
    if model is None:
        return None
    bare = Bare.of(model, robot)
    if bare.floating or self_controlled(bare, robot):
        return None
    data, key = place_held(bare, robot, qpos), None
    places = joint_places(bare, robot)
    for number in range(model.nkey):
        there = np.abs(model.key_qpos[number, places] - qpos).max(initial=0.0) < _THERE
        if there and states_ctrl(robot, number):
            key = number
            mujoco.mj_resetDataKeyframe(model, data, number)
            break
    angles = hold_of_angles(bare, robot, data, qpos)
    if key is not None:
        angles = Hold(data.ctrl.copy(), data.act.copy(), NOTHING, {})
    run = run_alone(bare, robot, data, angles, standing=False)
    return replace(
        run,
        keyframe="" if key is None else model.key(key).name or f"keyframe {key + 1}",
        commands=OwnCommands.ANGLES if key is None else OwnCommands.STATED,
        limp=is_limp(bare),
    )


def as_published_held(robot: Robot, qpos: Array, torques: Array) -> Published | None:
    """Returns how the file of a robot whose base is held differs in a posture.

    Its servos are given the posture and the torques that hold it there: ctrl = q* + tau / kp.

    Args:
        robot: The robot; of one that was changed since it was loaded, how it was loaded.
        qpos: (nu,) joint positions.
        torques: (nu,) that hold it as it was loaded (N m, N).

    Returns:
        What comes of it; None where there is no file, or its base is free in it.
    """
    robot = as_loaded(robot)
    if robot.floating or robot.published is None or robot.published.as_prepared:
        return None
    model = robot.once(raw_model)
    if model is None:
        return None
    bare = Bare.of(model, robot)
    if bare.floating:
        return None
    found = compared_with_file(bare, robot, [Predicted(True, qpos, torques, qpos)])
    return replace(found, causes=with_lines(found.causes, robot))
