"""Stand of a robot in the default pose of each source, with the gains of this source.

Inputs are the model files and the facts of the sources. For each source with enough default angles,
output is a `DefaultPoseStand`: base height, largest motor utilisation and, if gains are stated,
height loss and the result of a simulation without feed-forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.prepare.convert.load import load_robot
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verdict import Ending
from pupper_analysis.stance.sag.steady_state import steady_state
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import solve_stand, stand_statics
from pupper_analysis.tools.contract.findings import DefaultPoseStand
from pupper_analysis.tools.contract.orders import PlacedSource

_MIN_STATED_FRACTION = 0.5
"""Smallest fraction [1] of joints with a stated default angle. If a source states fewer default
angles, the stand in the default pose of this source is not computed. Chosen, not tuned.
"""


def stand_poses(
    models: Sequence[Path], placed: Sequence[PlacedSource], joints: tuple[str, ...]
) -> tuple[tuple[DefaultPoseStand, ...], list[Diagnostic]]:
    """Compute the stands of the robot in the default poses that sources state.

    If a source states all gains, the stand is also simulated in MuJoCo. A source is skipped if it
    states default angles of less than half of the joints. Joints without a default angle are at the
    start pose of the robot.

    Args:
        models: Files of the robot, at most one of a format.
        placed: Sources with the stated default angles [rad] and, optionally, gains.
        joints: Names of the robot's joints.

    Returns:
        Stands in the default poses, and notes. There are no stands for a robot with a fixed base,
        for example.
    """
    stated_angles = {
        placed_source: {
            joint: fact.number
            for (what, joint), fact in placed_source.facts.items()
            if what == "default angle" and fact.value is not None
        }
        for placed_source in placed
    }
    complete = {
        placed_source: angles
        for placed_source, angles in stated_angles.items()
        if len(angles) >= _MIN_STATED_FRACTION * len(joints)
    }
    if not complete:
        return (), []
    try:
        robot = load_robot(*models)
    except PupperAnalysisError as error:
        return (), [diagnose("contract-not-stood", why=error.diagnostic)]
    if not robot.floating or not robot.feet:
        return (), []
    limits = [
        efforts
        for placed_source in placed
        if (efforts := _get_stated_values(placed_source, "effort", robot))
    ]
    limits.append(robot.effort_limits.tolist())
    poses_by_key: dict[str, DefaultPoseStand] = {}
    poses = []
    for placed_source, angles in complete.items():
        kp, kd, efforts = (
            _get_stated_values(placed_source, what, robot) for what in ("kp", "kd", "effort")
        )
        arguments = (angles, kp, kd, efforts or limits[0])
        key = str(
            [sorted((joint, round(angle, 6)) for joint, angle in angles.items()), *arguments[1:]]
        )
        if key not in poses_by_key:
            poses_by_key[key] = _stand_in_pose(robot, placed_source.source.name, *arguments)
        poses.append(replace(poses_by_key[key], source=placed_source.source.name))
    return tuple(poses), []


def _get_stated_values(
    placed_source: PlacedSource, quantity: str, robot: Robot
) -> list[float] | None:
    """Return a source's values of a quantity in actuator order; None unless all are positive.

    The quantity is, for example, ``kp`` [N m/rad, N/m].
    """
    facts = [placed_source.facts.get((quantity, joint)) for joint in robot.joint_names]
    values = [None if fact is None else fact.value for fact in facts]
    positive = [value for value in values if value is not None and value > 0]
    return positive if len(positive) == len(values) else None


def _stand_in_pose(
    robot: Robot,
    name: str,
    angles: dict[str, float],
    kp: list[float] | None,
    kd: list[float] | None,
    efforts: list[float],
) -> DefaultPoseStand:
    """Compute the stand in a default pose, with height [m] and largest motor utilisation.

    ``angles`` is {joint: default angle [rad]}. With the gains ``kp`` [N m/rad, N/m] and ``kd`` [N m
    s/rad, N s/m], shape (nu,), the stand is also simulated. ``efforts`` are limits, shape (nu,) [N
    m, N]. An error of this package becomes the ``problem`` of the result.
    """
    home_angles = dict(zip(robot.joint_names, robot.home[-robot.nu :], strict=True))
    pose = np.array([angles.get(joint, home_angles[joint]) for joint in robot.joint_names])
    config = Configuration(robot, robot.make_qpos(pose))
    lowest = [
        min(
            float(config.foot_positions()[point][2]) - robot.contact_radius[point]
            for point in points
        )
        for points in robot.feet.values()
    ]
    height = float(robot.make_qpos(pose)[2]) - float(np.mean(lowest))
    home = np.concatenate([robot.home[:7], pose])
    posed = replace(robot, nominal=pose, home=home, stand_height=height)
    result = DefaultPoseStand(name, height, None, None, None, None)
    try:
        stand = solve_stand(posed)
        simulated_stand = solve_stand_as_simulated(posed, stand)
        torques = np.abs(stand_statics(posed, simulated_stand).joint_torques)
        # Infinite limits give the utilisation 0, which is reported as None.
        utilisation = float(np.max(torques / np.array(efforts))) or None
        result = replace(result, utilisation=utilisation)
        if kp is not None and kd is not None:  # gains of the model are not gains of this source
            verdict = judge_stand(posed, stand, kp=kp, kd=kd)
            result = replace(result, stays=verdict.commands_alone == Ending.HOLDS)
            result = replace(result, sag=steady_state(posed, simulated_stand, kp=kp).height_loss)
    except PupperAnalysisError as error:
        return replace(result, problem=error.diagnostic)
    return result
