"""A robot's two models as trees of parameters, with the same names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import placement_of
from pupper_analysis.models import multibody
from pupper_analysis.models.conversion import pinocchio_from_mujoco
from pupper_analysis.models.mjcf import free_joints
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.robot.coordinates import MujocoConvention
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


def kinematic_trees(robot: Robot) -> tuple[MultibodyTree, MultibodyTree]:
    """Returns the parameters of the URDF and of the MJCF; of a fixed base, in the world's frame."""
    frames = {**robot.description.contact_points, **robot.description.frames}
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


@dataclass(frozen=True, eq=False)
class Reference:
    """A compiled MJCF, and the names by which its elements are called.

    Attributes:
        model: What MuJoCo makes of the file, as it is; it may hold more than the robot.
        names: The same, in which every body and joint has a name.
        joint_names: The robot's joints, by those names.
        base: Its base, likewise.
    """

    model: mujoco.MjModel
    names: mujoco.MjModel
    joint_names: Sequence[str]
    base: str

    def joints(self) -> list[int]:
        """Returns the ids of the robot's joints, and of the free one of its base."""
        base = self.names.body(self.base).id
        free = free_joints(self.model)
        loose = [joint for joint in free if self.model.jnt_bodyid[joint] == base]
        return [*loose, *(self.names.joint(name).id for name in self.joint_names)]

    def convention(self) -> MujocoConvention:
        """Returns where the public coordinates are; other objects of a scene may float as well."""
        model, joints = self.model, self.joints()
        free = len(joints) - len(self.joint_names)
        starts = zip(model.jnt_qposadr[joints], model.jnt_dofadr[joints], strict=True)
        qpos: list[int] = []
        qvel: list[int] = []
        for number, (position, velocity) in enumerate(starts):
            qpos += range(position, position + (7 if number < free else 1))
            qvel += range(velocity, velocity + (6 if number < free else 1))
        return MujocoConvention(
            qpos_index=np.array(qpos, dtype=np.int64),
            qvel_index=np.array(qvel, dtype=np.int64),
            actuator_index=np.full(len(self.joint_names), -1),
        )

    def bodies(self) -> set[int]:
        """Returns the ids of the robot's bodies: all on the trees of its base and its joints."""
        model = self.model
        found = {self.names.body(self.base).id}
        found |= {int(model.jnt_bodyid[joint]) for joint in self.joints()}
        roots = {int(model.body_rootid[body]) for body in found} - {0}
        return {body for body in range(model.nbody) if int(model.body_rootid[body]) in roots}
