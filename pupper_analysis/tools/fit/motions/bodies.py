"""The moving bodies of a MuJoCo model: their inertials as parameters, and which feel each other."""

from __future__ import annotations

import copy
from collections.abc import Iterator

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.links import AXES, link_of
from pupper_analysis.tools.fit.moments import LEAST_MASS
from pupper_analysis.tools.fit.parameters import ParameterTable

Array = NDArray[np.float64]

_DEEP = 1e-3
"""m: shapes that are in each other by less may be rounded otherwise."""


class MovingBodies:
    """The bodies that a robot's joints move, each with those that are fixed to it.

    Masses and coms are those of all that a joint moves up to the next joint; they are named by
    the joint's link of the URDF, and coms are in its frame, that of Pinocchio's joint. With a mass
    its rotational inertia about the com is in proportion; a com that moves leaves it.

    Args:
        robot: A robot whose base is held.
        model: Its MuJoCo model.

    Attributes:
        model: A copy of the model, in which each body's inertial is that of all fixed to it.
        links: (nu,) the link of each joint.
        mass: (nu,) kg.
        com: (nu, 3) in the link's frame (m).
    """

    def __init__(self, robot: Robot, model: mujoco.MjModel) -> None:
        self.model = copy.copy(model)
        self._joints = [self.model.joint(name).id for name in robot.joint_names]
        self._bodies = self.model.jnt_bodyid[self._joints]
        self._names = robot.joint_names
        for body in dict.fromkeys(self._bodies.tolist()):
            self._gather(body)
            # Coms that move are nowhere that MuJoCo could take them for their body's origin.
            self.model.body_sameframe[body] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE.value
            self.model.body_simple[body] = 0
        self.model.dof_simplenum[:] = 0
        self._to_link = list(_link_frames(robot, self.model, self._bodies))
        self.links = tuple(
            link_of(robot.pin_model, robot.pin_model.getJointId(name)) for name in robot.joint_names
        )
        self.mass = self.model.body_mass[self._bodies].copy()
        self._inertia = self.model.body_inertia[self._bodies].copy()
        self.com = np.array(
            [
                to_link.act(self.model.body_ipos[body])
                for to_link, body in zip(self._to_link, self._bodies, strict=True)
            ]
        )

    def _gather(self, body: int) -> None:
        """Gives a body the inertial of all that is fixed to it."""
        model = self.model
        fixed = np.flatnonzero(model.body_weldid == body)
        if len(fixed) == 1:
            return
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        whole = pin.Inertia.Zero()
        for other in fixed:
            turned = data.ximat[other].reshape(3, 3)
            place = pin.SE3(turned, data.xipos[other])
            own = pin.Inertia(
                float(model.body_mass[other]), np.zeros(3), np.diag(model.body_inertia[other])
            )
            whole += place.act(own)
        own = pin.SE3(data.xmat[body].reshape(3, 3), data.xpos[body]).actInv(whole)
        values, axes = np.linalg.eigh(own.inertia)
        axes[:, 2] *= np.linalg.det(axes)
        model.body_mass[fixed], model.body_inertia[fixed] = 0.0, 0.0
        model.body_mass[body], model.body_ipos[body] = own.mass, own.lever
        model.body_inertia[body] = values
        mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())

    def put(self, model: mujoco.MjModel, table: ParameterTable, vector: Array) -> None:
        """Writes masses and coms of a vector of parameters into a copy of ``model``."""
        for number, (link, body) in enumerate(zip(self.links, self._bodies, strict=True)):
            if self.mass[number] <= 0:
                continue
            least = LEAST_MASS * self.mass[number]
            mass = max(table.value(vector, "mass", link, "", self.mass[number]), least)
            com = [
                table.value(vector, "com", link, axis, own)
                for axis, own in zip(AXES, self.com[number], strict=True)
            ]
            model.body_mass[body] = mass
            model.body_inertia[body] = self._inertia[number] * mass / self.mass[number]
            model.body_ipos[body] = self._to_link[number].actInv(np.array(com))

    def touching(self, positions: Array) -> tuple[tuple[str, str], ...]:
        """Returns the pairs of moving bodies that are in each other at joint positions (n, nu)."""
        model, data = self.model, mujoco.MjData(self.model)
        enabled = copy.copy(model)
        enabled.opt.disableflags &= ~mujoco.mjtDisableBit.mjDSBL_CONTACT.value
        found: dict[tuple[str, str], None] = {}
        for joints in positions:
            data.qpos[model.jnt_qposadr[self._joints]] = joints
            mujoco.mj_kinematics(enabled, data)
            mujoco.mj_comPos(enabled, data)
            mujoco.mj_collision(enabled, data)
            for contact in data.contact:
                bodies = model.geom_bodyid[contact.geom]
                # With the world: a floor is not where a robot hangs.
                if contact.dist < -_DEEP and model.body_weldid[bodies].all():
                    one, other = sorted(model.body(int(body)).name for body in bodies)
                    found[one, other] = None
        return tuple(found)

    def groups(self, table: ParameterTable) -> list[tuple[list[int], list[int]]]:
        """Returns groups of joints that do not feel each other, with the parameters of each.

        The base is held, so those are one that have a moving body in common; all are where loops,
        couplings or tendons are.
        """
        model = self.model
        roots = [_root(model, int(body)) for body in self._bodies]
        if model.neq or model.ntendon:
            roots = [0] * len(roots)
        found = []
        for root in dict.fromkeys(roots):
            joints = [number for number, own in enumerate(roots) if own == root]
            subjects = {name for at in joints for name in (self._names[at], self.links[at])}
            columns = [place for place, one in enumerate(table) if one.subject in subjects]
            found.append((joints, columns))
        return found

    def shared(self, table: ParameterTable) -> list[int]:
        """Returns the parameters of no joint or link: those that act on all."""
        own = {*self._names, *self.links}
        return [place for place, one in enumerate(table) if one.subject not in own]


def _root(model: mujoco.MjModel, body: int) -> int:
    """Returns the first moving body on the way from the world to a body."""
    while model.body_weldid[model.body_parentid[body]] != 0:
        body = int(model.body_parentid[body])
    return int(model.body_weldid[body])


def _link_frames(
    robot: Robot, model: mujoco.MjModel, bodies: NDArray[np.int64]
) -> Iterator[pin.SE3]:
    """Yields how each joint's body frame of MuJoCo is placed in Pinocchio's frame of the joint."""
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, robot.home)
    mujoco.mj_kinematics(model, data)
    by_pin = robot.pin_model.createData()
    pin.forwardKinematics(robot.pin_model, by_pin, robot.pin_convention.q(robot.home))
    base = _base_offset(robot, data, by_pin)
    for name, body in zip(robot.joint_names, bodies.tolist(), strict=True):
        there = pin.SE3(data.xmat[body].reshape(3, 3), data.xpos[body])
        yield (base * by_pin.oMi[robot.pin_model.getJointId(name)]).actInv(there)


def _base_offset(robot: Robot, data: mujoco.MjData, by_pin: pin.Data) -> pin.SE3:
    """Returns where Pinocchio's world is in MuJoCo's: the base is fixed where the MJCF has it."""
    model = robot.pin_model
    frame = model.frames[model.getFrameId(robot.base, pin.FrameType.BODY)]
    there = by_pin.oMi[frame.parentJoint] * frame.placement
    base = data.body(robot.mj_base)
    return pin.SE3(base.xmat.reshape(3, 3), base.xpos.copy()) * there.inverse()
