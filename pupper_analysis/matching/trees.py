"""A robot's two models as trees of parameters, with the same names."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.arrays import placement_of
from pupper_analysis.models import multibody
from pupper_analysis.models.conversion import pinocchio_from_mujoco
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.robot.robot import Robot


def kinematic_trees(robot: Robot) -> tuple[MultibodyTree, MultibodyTree]:
    """Returns the parameters of the URDF and of the MJCF; of a fixed base, in the world's frame."""
    frames = {**robot.description.feet, **robot.description.frames}
    urdf = multibody.from_pinocchio(
        robot.pin_model,
        robot.base,
        robot.joint_names,
        {name: pair[0] for name, pair in frames.items()},
    )
    mjcf = multibody.from_pinocchio(
        pinocchio_from_mujoco(robot.mj_model),
        robot.base,
        robot.joint_names,
        {name: pair[1] for name, pair in frames.items()},
    )
    return urdf, mjcf


def base_pose(robot: Robot) -> pin.SE3:
    """Returns where a fixed base stands in the world, by the MJCF."""
    data = mujoco.MjData(robot.mj_model)
    mujoco.mj_kinematics(robot.mj_model, data)
    body = robot.mj_model.body(robot.mj_base).id
    return placement_of(data.xquat[body], data.xpos[body])


Array = NDArray[np.float64]


def poses_at_zero(tree: multibody.MultibodyTree) -> dict[str, pin.SE3]:
    """Returns where each body's frame is at zero angles, in the base's."""
    poses = {tree.base: pin.SE3.Identity()}
    for name in tree.parents_first():
        joint = tree.joints[name]
        poses[name] = poses[joint.parent] * joint.placement
    return poses


def at_zero(tree: multibody.MultibodyTree) -> dict[str, tuple[Array, Array]]:
    """Returns where each joint is at zero, and its axis, both in the base's frame."""
    poses = poses_at_zero(tree)
    return {
        name: (np.array(poses[name].translation), poses[name].rotation @ joint.axis)
        for name, joint in tree.joints.items()
    }
