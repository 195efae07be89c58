"""The one convention of the public interface, and the way from it to each engine's own.

Public coordinates are MuJoCo's, with the joints in actuator order:

* ``qpos`` (nq,): base position in the world (m), base quaternion (w, x, y, z), joint positions;
* ``qvel`` (nv,): base linear velocity in the world frame (m/s), base angular velocity in the base
  frame (rad/s), joint velocities;
* generalised forces and Jacobian columns are dual to that ``qvel``.

A robot with a fixed base has the joints alone. Every joint has one coordinate.

With R the base's rotation, Pinocchio's velocity is v_pin = T qvel with T = diag(R^T, 1, P), P a
permutation, so that M = T^T M_pin T, J = J_pin T and g = T^T g_pin; because T changes with R, the
velocity-dependent forces are h = T^T (h_pin + M_pin dT/dt qvel).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.mjcf import free_joints
from pupper_analysis.models.transmission import is_at_one_joint

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


def normalise_quaternion(qpos: Array) -> None:
    """Normalises the quaternion of a free base, in place.

    Raises:
        ConfigurationError: If it is zero.
    """
    norm = math.hypot(*qpos[3:7].tolist())
    if norm < 1e-9:
        raise ConfigurationError("qpos", diagnose("quaternion-is-zero"))
    if norm != 1.0:
        qpos[3:7] /= norm


@dataclass(frozen=True, eq=False)
class PinocchioConvention:
    """Maps public coordinates to those of a Pinocchio model, whose joints are in another order.

    Attributes:
        floating: Whether the first joint is a free flyer.
        q_index: (n,) where each joint's coordinate starts in Pinocchio's q.
        v_index: (n,) where each joint's velocity is in Pinocchio's v.
        unbounded: (n,) whether the joint is ``continuous``, held as (cos, sin).
    """

    floating: bool
    nq: int
    nv: int
    q_index: IntArray
    v_index: IntArray
    unbounded: NDArray[np.bool_]

    @staticmethod
    def of(model: pin.Model, joint_names: Sequence[str]) -> PinocchioConvention:
        """Returns the maps between ``joint_names`` in their order and a model."""
        joints = [model.joints[model.getJointId(name)] for name in joint_names]
        return PinocchioConvention(
            floating=model.nv > sum(joint.nv for joint in joints),
            nq=model.nq,
            nv=model.nv,
            q_index=np.array([joint.idx_q for joint in joints], dtype=np.int64),
            v_index=np.array([joint.idx_v for joint in joints], dtype=np.int64),
            unbounded=np.array([joint.nq == 2 for joint in joints], dtype=np.bool_),
        )

    @property
    def base_nv(self) -> int:
        """6 for a floating base, 0 for a fixed one."""
        return 6 if self.floating else 0

    def q(self, qpos: Array) -> Array:
        """Returns Pinocchio's q (model.nq,) of a public qpos."""
        q = self.unit_q(qpos)
        if self.floating:
            q[3:7] /= math.hypot(*q[3:7].tolist())
        return q

    def unit_q(self, qpos: Array) -> Array:
        """Returns Pinocchio's q (model.nq,) of a public qpos whose quaternion is normalised."""
        if self._order is not None:
            q: Array = qpos.take(self._order)
            return q
        q = self.with_joints(np.empty(self.nq), qpos[7 if self.floating else 0 :])
        if self.floating:
            q[:7] = qpos[[0, 1, 2, 4, 5, 6, 3]]
        return q

    @cached_property
    def _order(self) -> IntArray | None:
        """Where each element of q is in qpos; None where one is a cosine."""
        if self.unbounded.any():
            return None
        base = [0, 1, 2, 4, 5, 6, 3] if self.floating else []
        order = np.empty(self.nq, dtype=np.int64)
        order[: len(base)] = base
        order[self.q_index] = len(base) + np.arange(len(self.q_index))
        return order

    @cached_property
    def _back(self) -> IntArray | None:
        """Where each element of qpos is in q; None where one is an angle of a cosine."""
        return None if self._order is None else np.argsort(self._order)

    def with_joints(self, q: Array, joints: Array) -> Array:
        """Returns Pinocchio's q (model.nq,) with other joint positions (n,), and the same base."""
        other = q.copy()
        turning = self.unbounded
        other[self.q_index[~turning]] = joints[~turning]
        other[self.q_index[turning]] = np.cos(joints[turning])
        other[self.q_index[turning] + 1] = np.sin(joints[turning])
        return other

    def qpos(self, q: Array) -> Array:
        """Returns the public qpos of Pinocchio's q; a continuous joint's is in (-pi, pi]."""
        if self._back is not None:
            there: Array = q.take(self._back)
            return there
        joints = q[self.q_index]
        turning = self.q_index[self.unbounded]
        joints[self.unbounded] = np.arctan2(q[turning + 1], q[turning])
        if not self.floating:
            return joints
        return np.concatenate([q[:3], q[[6, 3, 4, 5]], joints])


@dataclass(frozen=True, eq=False)
class MujocoConvention:
    """Maps public coordinates to those of a MuJoCo model.

    MuJoCo's are the public ones but for the order: ``data.qpos[qpos_index]`` is the public qpos,
    and likewise for velocities. A motor's first control is in ``data.ctrl`` at
    ``model.actuator_ctrladr[actuator_index]``.

    Attributes:
        actuator_index: (n,) the actuator of each joint, -1 where it has none.
    """

    qpos_index: IntArray
    qvel_index: IntArray
    actuator_index: IntArray

    @staticmethod
    def of(model: mujoco.MjModel, joint_names: Sequence[str]) -> MujocoConvention:
        """Returns the maps between ``joint_names`` in their order and a model."""
        qpos: list[int] = []
        qvel: list[int] = []
        free = free_joints(model)
        if free:
            qpos += range(model.jnt_qposadr[free[0]], model.jnt_qposadr[free[0]] + 7)
            qvel += range(model.jnt_dofadr[free[0]], model.jnt_dofadr[free[0]] + 6)
        drives = {
            model.joint(int(model.actuator_trnid[a, 0])).name: a
            for a in range(model.nactuator)
            if is_at_one_joint(model, a)
        }
        for name in joint_names:
            joint = model.joint(name).id
            qpos.append(int(model.jnt_qposadr[joint]))
            qvel.append(int(model.jnt_dofadr[joint]))
        return MujocoConvention(
            qpos_index=np.array(qpos, dtype=np.int64),
            qvel_index=np.array(qvel, dtype=np.int64),
            actuator_index=np.array([drives.get(name, -1) for name in joint_names], dtype=np.int64),
        )

    def set_state(self, data: mujoco.MjData, qpos: Array, qvel: Array | None = None) -> None:
        """Writes a public state into MuJoCo's data, and computes nothing."""
        data.qpos[self.qpos_index] = qpos
        data.qvel[self.qvel_index] = 0.0 if qvel is None else qvel
