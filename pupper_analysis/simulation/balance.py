"""Does a stand balance by MuJoCo, too: by its kinematics and dynamics of the MJCF."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.contact import contact_offset
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation import monitor
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation

Array = NDArray[np.float64]


def load_by_mujoco(robot: Robot, qpos: Array) -> Array:
    """Returns what motors and contacts hold at rest (nv,), by MuJoCo's dynamics of the MJCF.

    It is ``Configuration.load`` of the other engine, from the other file.
    """
    data = _at(robot, qpos)
    load: Array = (data.qfrc_bias - data.qfrc_passive)[robot.mj_convention.qvel_index]
    return load


def _at(robot: Robot, qpos: Array) -> mujoco.MjData:
    data = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_fwdPosition(robot.mj_model, data)
    mujoco.mj_fwdVelocity(robot.mj_model, data)
    return data


def balance_by_mujoco(
    robot: Robot, stand: Stand, prediction: GravityCompensation
) -> tuple[float, float]:
    """Checks stand and statics with MuJoCo's kinematics and dynamics of the MJCF."""
    model = robot.mj_model
    data = _at(robot, stand.qpos)
    remainder = data.qfrc_bias - data.qfrc_passive
    foot_error = 0.0
    jacobian = np.zeros((3, model.nv))
    for foot, centre in monitor.foot_centres(robot, data).items():
        foot_error = max(foot_error, float(np.linalg.norm(centre - stand.foot_targets[foot])))
        if foot in stand.stance_feet:
            radius, depth = robot.contact_radius[foot], stand.depths[foot]
            point = centre + contact_offset(radius, stand.normals[foot], depth)
            mujoco.mj_jac(model, data, jacobian, None, point, robot.contact_places[foot][0])
            remainder -= jacobian.T @ prediction.contact_forces[foot]
    joints = robot.mj_convention.qvel_index[6:]
    if robot.closure is not None:
        remainder[joints] -= robot.closure.push(stand.qpos) @ remainder[joints]
    remainder[joints] -= prediction.joint_torques
    return foot_error, float(np.abs(remainder).max())
