"""A robot's two models as trees of parameters, with the same names."""

from __future__ import annotations

import mujoco
import pinocchio as pin

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
