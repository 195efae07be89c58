"""Gives a robot its start pose, and keeps it in its description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.prepare import start, touching
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


def find_start_pose(
    robot: Robot, known: Mapping[str, Mapping[str, float]]
) -> tuple[Robot, list[Diagnostic]]:
    """Gives a robot a start pose: a keyframe's in which it stands, or one that is found.

    What is on its feet's bodies beside the feet is not in the way: see ``touching``.

    Args:
        robot: The robot with feet.
        known: {keyframe: {joint: position}}, those to be tried first.

    Returns:
        The robot, and which pose it is.
    """
    whole, robot = robot, touching.with_bare_feet(robot)
    standing = {name: pose for name, pose in known.items() if start.stands_at(robot, pose)}
    for name, pose in standing.items():
        home = np.array([pose.get(joint, 0.0) for joint in robot.joint_names])
        at_home = _at(robot, home)
        for nominal in (np.zeros(robot.nu), home):
            tried = replace(at_home, nominal=nominal)
            if start.first_stand(tried) is not None:
                notes = [diagnose("start-pose-is-keyframe", subject=("keyframe", name))]
                if nominal is home:
                    notes.append(diagnose("feet-placed-by-start-pose"))
                return _kept(whole, tried), notes
    poses = [
        *(start.clip_to_limits(robot, pose) for pose in known.values()),
        start.clip_to_limits(robot),
    ]
    bounded = np.isfinite(robot.lower_limits) & np.isfinite(robot.upper_limits)
    low, high = (np.where(bounded, x, 0.0) for x in (robot.lower_limits, robot.upper_limits))
    middle = (low + high) / 2
    found = start.found_start(robot, [*poses, middle])
    if found is None:
        return whole, [diagnose("no-start-pose")]
    height = Quantity(found.stand_height, "m")
    return _kept(whole, found), [diagnose("start-pose-found", height=height, keyframes=bool(known))]


def _at(robot: Robot, joints: Array) -> Robot:
    """Returns the robot with a start pose whose lowest foot touches the ground."""
    qpos = robot.posed(joints)
    places = Configuration(robot, qpos).foot_positions()
    height = max(robot.foot_radius[foot] - float(place[2]) for foot, place in places.items())
    return replace(robot, home=qpos, stand_height=height)


def _kept(whole: Robot, posed: Robot) -> Robot:
    """Returns a robot with the start pose of one that is posed, also in its description."""
    spec = whole.description.mjcf.copy()
    data = mujoco.MjData(whole.mj_model)
    home = posed.home.copy()
    home[:7] = (0.0, 0.0, posed.stand_height, 1.0, 0.0, 0.0, 0.0)
    whole.mj_convention.set_state(data, home)
    SpecTree(spec).set_home(data.qpos)
    nominal = dict(zip(posed.joint_names, posed.nominal.tolist(), strict=True))
    return replace(
        whole,
        description=replace(whole.description, mjcf=spec, nominal=nominal),
        home=home,
        nominal=posed.nominal,
        stand_height=posed.stand_height,
    )
