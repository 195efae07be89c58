"""A compiled MJCF, its names, and where the robot is in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from pupper_analysis.models.joint_kinds import free_joints
from pupper_analysis.robot.coordinates import MujocoConvention


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
