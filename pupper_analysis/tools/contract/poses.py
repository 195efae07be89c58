"""How a robot stands in each source's default pose, with that source's gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
from pupper_analysis.tools.contract.findings import Pose
from pupper_analysis.tools.contract.orders import PlacedSource

Array = NDArray[np.float64]

_PART = 0.5
"""Least share of a robot's joints whose default angles a source states, to be stood in them."""


def stand_poses(
    models: Sequence[Path], placed: Sequence[PlacedSource], joints: tuple[str, ...]
) -> tuple[tuple[Pose, ...], list[Diagnostic]]:
    """Returns how the robot stands in each source's default pose, each once; and notes.

    Args:
        models: The robot's files.
        placed: The sources.
        joints: The joints by which they are ordered.
    """
    stating = {
        one: {
            joint: said.number
            for (what, joint), said in one.facts.items()
            if what == "default angle" and said.value is not None
        }
        for one in placed
    }
    whole = {one: angles for one, angles in stating.items() if len(angles) >= _PART * len(joints)}
    if not whole:
        return (), []
    kinds = {path.suffix.lower() == ".urdf": path for path in models}
    try:
        robot = load_robot(*kinds.values())
    except PupperAnalysisError as error:
        return (), [diagnose("contract-not-stood", why=error.diagnostic)]
    if not robot.floating or not robot.feet:
        return (), []
    limits = [each for one in placed if (each := _stated(one, "effort", robot))]
    limits.append(robot.effort_limits.tolist())
    found: dict[str, Pose] = {}
    poses = []
    for one, angles in whole.items():
        kp, kd, efforts = (_stated(one, what, robot) for what in ("kp", "kd", "effort"))
        asked = (angles, kp, kd, efforts or limits[0])
        key = str([sorted((joint, round(angle, 6)) for joint, angle in angles.items()), *asked[1:]])
        if key not in found:
            found[key] = _stood(robot, one.source.name, *asked)
        poses.append(replace(found[key], source=one.source.name))
    return tuple(poses), []


def _stated(one: PlacedSource, quantity: str, robot: Robot) -> list[float] | None:
    """Returns a source's gains or limits (nu,), if it states them of all joints."""
    stated = [one.facts.get((quantity, joint)) for joint in robot.joint_names]
    values = [None if said is None else said.value for said in stated]
    known = [value for value in values if value is not None and value > 0]
    return known if len(known) == len(values) else None


def _stood(
    robot: Robot,
    name: str,
    angles: dict[str, float],
    kp: list[float] | None,
    kd: list[float] | None,
    efforts: list[float],
) -> Pose:
    mine = dict(zip(robot.joint_names, robot.home[-robot.nu :], strict=True))
    pose = np.array([angles.get(joint, mine[joint]) for joint in robot.joint_names])
    there = Configuration(robot, robot.posed(pose))
    lowest = [
        min(
            float(there.foot_positions()[point][2]) - robot.contact_radius[point]
            for point in points
        )
        for points in robot.feet.values()
    ]
    height = float(robot.posed(pose)[2]) - float(np.mean(lowest))
    home = np.concatenate([robot.home[:7], pose])
    posed = replace(robot, nominal=pose, home=home, stand_height=height)
    found = Pose(name, height, None, None, None, None)
    try:
        stand = solve_stand(posed)
        held = solve_stand_as_simulated(posed, stand)
        torques = np.abs(stand_statics(posed, held).joint_torques)
        use = float(np.max(torques / np.array(efforts))) or None  # without limits, nothing
        found = replace(found, utilisation=use)
        if kp is not None and kd is not None:  # those of the model are none of this source
            verdict = judge_stand(posed, stand, kp=kp, kd=kd)
            found = replace(found, stays=verdict.commands_alone == Ending.HOLDS)
            found = replace(found, sag=steady_state(posed, held, kp=kp).height_loss)
    except PupperAnalysisError as error:
        return replace(found, problem=error.diagnostic)
    return found
