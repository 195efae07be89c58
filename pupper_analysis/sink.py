"""Stands on MuJoCo's soft ground: the feet sink by what they carry, and the base stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.configuration import Configuration
from pupper_analysis.errors import NotSettlingError
from pupper_analysis.ground import GroundLaw
from pupper_analysis.path import StancePath
from pupper_analysis.robot import Robot
from pupper_analysis.stand import Stand, solve_stand, stand_statics
from pupper_analysis.statics import LoadSharing
from pupper_analysis.task import StandTask

Array = NDArray[np.float64]

DEPTH_TOLERANCE = 1e-9
"""Change of the feet's depths between iterations that counts as none (m)."""

_MAX_ITERATIONS = 50
_STEPS = 3  # of Newton's iteration, for legs that get longer by millimetres


def sunk_stand(robot: Robot, task: StandTask | None = None, *, explain: bool = True) -> Stand:
    """Finds the stand that satisfies a task on ground as soft as MuJoCo's.

    On rigid ground only the feet's places count. MuJoCo's ground gives way by millimetres, in
    proportion to what a foot carries: a robot that is commanded the joints of ``solve_stand`` sinks
    and, where its feet bear unequal loads, tilts, by which the loads change too. Here the legs are
    longer by what their feet sink in, so that base and com are where the task has them, and the
    forces are those of ``LoadSharing.EVEN``. The depths and forces determine each other; repeated
    substitution finds them in 1 to 3 rounds.

    Args:
        robot: A robot with a floating base and a ground.
        task: How to stand; the nominal stand by default.
        explain: Where the stance is out of reach, find out why.

    Returns:
        The stand; its ``depths`` are those of MuJoCo's contacts under its forces.

    Raises:
        ConfigurationError: As ``solve_stand``.
        StanceUnreachableError: If it is out of reach, at least with its feet sunk.
        StaticsInfeasibleError: If no contact forces balance it.
        NotSettlingError: If the depths do not settle.
    """
    task = task or StandTask()
    stand = solve_stand(robot, task, explain=explain)
    asked = stand.task
    if task.com == "inside":
        x, y, _ = Configuration(robot, stand.qpos).center_of_mass()
        task = replace(task, com=(float(x), float(y)), com_margin=0.0)
    laws = {foot: GroundLaw.of(robot, foot) for foot in stand.carrying}
    for _ in range(_MAX_ITERATIONS):
        forces = stand_statics(robot, stand, sharing=LoadSharing.EVEN).contact_forces
        depths = {
            foot: law.depth(max(0.0, float(forces[foot] @ stand.normals[foot])))
            for foot, law in laws.items()
        }
        change = max(abs(depths[foot] - stand.depths[foot]) for foot in depths)
        if change < DEPTH_TOLERANCE:
            return replace(stand, task=asked)
        posture = tuple(stand.joint_positions(robot).tolist())
        stand = solve_stand(robot, replace(task, posture=posture), depths=depths, explain=explain)
    raise NotSettlingError(change, f"the feet's depths do not settle, by {1e3 * change:.3g} mm")


def sunk_path(robot: Robot, path: StancePath) -> Array:
    """Returns a path's qpos (n, nq) with each leg longer by what its foot sinks into soft ground.

    The base stays. (The com moves with the legs, by a hundredth of the depths.)

    Args:
        robot: The robot.
        path: Its path, which is for rigid ground.
    """
    ground = path.stances[0].task.ground
    normal, laws = ground.normal(), {foot: GroundLaw.of(robot, foot) for foot in path.feet}
    rows = []
    for qpos, loads in zip(path.qpos, path.loads, strict=True):
        feet = Configuration(robot, qpos).foot_positions()
        targets = {
            foot: feet[foot] - laws[foot].depth(max(0.0, load * normal[2])) * normal
            for foot, load in zip(path.feet, loads, strict=True)
        }
        sunk = qpos.copy()
        for _ in range(_STEPS):
            config = Configuration(robot, sunk)
            positions, jacobians = config.foot_positions(), config.foot_jacobians()
            missing = np.concatenate([targets[foot] - positions[foot] for foot in path.feet])
            jacobian = np.concatenate([jacobians[foot][:, 6:] for foot in path.feet])
            sunk[7:] += np.linalg.lstsq(jacobian, missing, rcond=1e-6)[0]
        rows.append(sunk)
    return np.array(rows)
