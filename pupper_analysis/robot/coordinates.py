"""Generalised coordinates of this package, and maps to Pinocchio's and MuJoCo's coordinates.

The coordinates of this package ("public" coordinates) are MuJoCo's, with the joints in actuator
order:

* ``qpos`` (nq,): base position [m] in the world, base quaternion (w, x, y, z), joint positions;
* ``qvel`` (nv,): base linear velocity [m/s] in the world frame, base angular velocity [rad/s] in
  the base frame, joint velocities;
* generalised forces and Jacobian columns are dual to ``qvel``.

A robot with a fixed base has the joint coordinates only. Each joint has a single coordinate.

With R the rotation of the base, Pinocchio's velocity is v_pin = T qvel with T = diag(R^T, 1, P), P
a permutation. Therefore M = T^T M_pin T, J = J_pin T and g = T^T g_pin. Because T changes with R,
the velocity-dependent forces are h = T^T (h_pin + M_pin dT/dt qvel).
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

from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import ReadOnlyFields
from pupper_analysis.models.mjcf import list_free_joints
from pupper_analysis.models.transmission import is_at_one_joint


def normalise_quaternion(qpos: Array) -> None:
    """Normalise the quaternion qpos[3:7] of a free base, in place.

    Raises:
        ConfigurationError: If the quaternion is zero (norm below 1e-9).
    """
    norm = math.hypot(*qpos[3:7].tolist())
    if math.isinf(norm):  # the norm of finite components overflows
        qpos[3:7] /= np.abs(qpos[3:7]).max()
        norm = math.hypot(*qpos[3:7].tolist())
    if norm < 1e-9:
        raise ConfigurationError("qpos", diagnose("quaternion-is-zero"))
    if norm != 1.0:
        qpos[3:7] /= norm


@dataclass(frozen=True, eq=False)
class PinocchioConvention(ReadOnlyFields):
    """Maps between public coordinates and the coordinates of a Pinocchio model.

    Public coordinates are MuJoCo's, with the joints in actuator order.

    Attributes:
        floating: Whether the base is free.
        nq: Size of Pinocchio's q.
        nv: Size of Pinocchio's v.
        q_index: Index in Pinocchio's q of each of the n joints in actuator order, shape (n,).
        v_index: Index in Pinocchio's v of each joint, shape (n,).
        unbounded: Mask, shape (n,): True for a ``continuous`` joint, whose q is (cos, sin).
    """

    floating: bool
    nq: int
    nv: int
    q_index: IntArray
    v_index: IntArray
    unbounded: NDArray[np.bool_]

    @staticmethod
    def from_model(model: pin.Model, joint_names: Sequence[str]) -> PinocchioConvention:
        """Derive the maps between public coordinates and the q and v of a Pinocchio model.

        Args:
            model: Pinocchio model.
            joint_names: Joints in actuator order.
        """
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
        """Number of degrees of freedom of the base, 6 if floating, 0 if fixed."""
        return 6 if self.floating else 0

    def q(self, qpos: Array) -> Array:
        """Convert qpos to Pinocchio's q, shape (model.nq,), with normalised quaternion.

        Args:
            qpos: Configuration, shape (nq,): quaternion (w, x, y, z), joints in actuator order.
        """
        q = self.unit_q(qpos)
        if self.floating:
            q[3:7] /= math.hypot(*q[3:7].tolist())
        return q

    def unit_q(self, qpos: Array) -> Array:
        """Convert a qpos whose quaternion is already normalised to Pinocchio's q.

        Args:
            qpos: Configuration, shape (nq,): quaternion (w, x, y, z), joints in actuator order.

        Returns:
            Shape (model.nq,); a continuous joint has the entries cos and sin.
        """
        if self._qpos_address_of_q is not None:
            q: Array = qpos.take(self._qpos_address_of_q)
            return q
        q = self.with_joints(np.empty(self.nq), qpos[7 if self.floating else 0 :])
        if self.floating:
            q[:7] = qpos[[0, 1, 2, 4, 5, 6, 3]]
        return q

    @cached_property
    def _qpos_address_of_q(self) -> IntArray | None:
        """Index in qpos of each element of Pinocchio's q; None if a joint is continuous."""
        if self.unbounded.any():
            return None
        base = [0, 1, 2, 4, 5, 6, 3] if self.floating else []
        order = np.empty(self.nq, dtype=np.int64)
        order[: len(base)] = base
        order[self.q_index] = len(base) + np.arange(len(self.q_index))
        return order

    @cached_property
    def _q_address_of_qpos(self) -> IntArray | None:
        """Index in Pinocchio's q of each element of qpos; None if a joint is continuous."""
        return None if self._qpos_address_of_q is None else np.argsort(self._qpos_address_of_q)

    def with_joints(self, q: Array, joints: Array) -> Array:
        """Return a copy of Pinocchio's q with other joint positions; the base pose is kept.

        Args:
            q: Pinocchio's configuration, shape (model.nq,).
            joints: Joint positions in actuator order, shape (n,) or (k, n) [rad, m].
        """
        result = np.tile(q, (*joints.shape[:-1], 1)) if joints.ndim > 1 else q.copy()
        unbounded = self.unbounded
        result[..., self.q_index[~unbounded]] = joints[..., ~unbounded]
        result[..., self.q_index[unbounded]] = np.cos(joints[..., unbounded])
        result[..., self.q_index[unbounded] + 1] = np.sin(joints[..., unbounded])
        return result

    def qpos(self, q: Array) -> Array:
        """Convert Pinocchio's q to qpos, shape (nq,): quaternion (w, x, y, z), actuator order.

        Positions of continuous joints are between -pi and pi.

        Args:
            q: Pinocchio's configuration, shape (model.nq,).
        """
        if self._q_address_of_qpos is not None:
            qpos: Array = q.take(self._q_address_of_qpos)
            return qpos
        joints = q[self.q_index]
        cosine_address = self.q_index[self.unbounded]
        joints[self.unbounded] = np.arctan2(q[cosine_address + 1], q[cosine_address])
        if not self.floating:
            return joints
        return np.concatenate([q[:3], q[[6, 3, 4, 5]], joints])

    def velocity_map(self, qpos: Array) -> Array:
        """Return the matrix T, shape (model.nv, nv), that maps qvel to Pinocchio's v = T qvel.

        T is orthogonal.

        Args:
            qpos: Configuration, shape (nq,): quaternion (w, x, y, z), not zero, joints in actuator
                order.
        """
        base, count = self.base_nv, len(self.v_index)
        result = np.zeros((self.nv, base + count))
        if self.floating:
            rotation = rotation_from_quaternion(qpos[3:7] / math.hypot(*qpos[3:7].tolist()))
            result[:3, :3], result[3:6, 3:6] = rotation.T, np.eye(3)
        result[self.v_index, base + np.arange(count)] = 1.0
        return result

    def acceleration_offset(self, qpos: Array, qvel: Array) -> Array:
        """Return the term dT/dt qvel, shape (model.nv,), of Pinocchio's a = T qacc + dT/dt qvel.

        T is the `velocity_map`. The term is zero for a fixed base.

        Args:
            qpos: Configuration, shape (nq,): quaternion (w, x, y, z), not zero, joints in actuator
                order.
            qvel: Velocity, shape (nv,), joints in actuator order.
        """
        result = np.zeros(self.nv)
        if self.floating:
            rotation = rotation_from_quaternion(qpos[3:7] / math.hypot(*qpos[3:7].tolist()))
            result[:3] = -np.cross(qvel[3:6], rotation.T @ qvel[:3])
        return result


@dataclass(frozen=True, eq=False)
class MujocoConvention(ReadOnlyFields):
    """Index maps between public coordinates and the coordinates of a MuJoCo model.

    Public coordinates are MuJoCo's, with the joints in actuator order. ``data.qpos[qpos_index]`` is
    the public qpos, ``data.qvel[qvel_index]`` the public qvel. The first control of an actuator is
    ``data.ctrl[model.actuator_ctrladr[actuator_index]]``.

    Attributes:
        qpos_index: Index in MuJoCo's qpos of each public coordinate, shape (nq,).
        qvel_index: Index in MuJoCo's qvel of each public velocity, shape (nv,).
        actuator_index: Id of the actuator that acts directly on each joint, shape (n,); -1 if there
            is none. If several actuators act directly on a joint, the id of the last.
    """

    qpos_index: IntArray
    qvel_index: IntArray
    actuator_index: IntArray

    @staticmethod
    def from_model(model: mujoco.MjModel, joint_names: Sequence[str]) -> MujocoConvention:
        """Derive the index maps from public coordinates to qpos and qvel of a MuJoCo model.

        Args:
            model: MuJoCo model. The first free joint, if any, belongs to the base.
            joint_names: Joints in actuator order.
        """
        qpos: list[int] = []
        qvel: list[int] = []
        free = list_free_joints(model)
        if free:
            qpos += range(model.jnt_qposadr[free[0]], model.jnt_qposadr[free[0]] + 7)
            qvel += range(model.jnt_dofadr[free[0]], model.jnt_dofadr[free[0]] + 6)
        actuator_by_joint = {
            model.joint(int(model.actuator_trnid[actuator, 0])).name: actuator
            for actuator in range(model.nactuator)
            if is_at_one_joint(model, actuator)
        }
        for name in joint_names:
            joint = model.joint(name).id
            qpos.append(int(model.jnt_qposadr[joint]))
            qvel.append(int(model.jnt_dofadr[joint]))
        return MujocoConvention(
            qpos_index=np.array(qpos, dtype=np.int64),
            qvel_index=np.array(qvel, dtype=np.int64),
            actuator_index=np.array(
                [actuator_by_joint.get(name, -1) for name in joint_names], dtype=np.int64
            ),
        )

    def set_state(self, data: mujoco.MjData, qpos: Array, qvel: Array | None = None) -> None:
        """Write qpos and qvel to MuJoCo's data, without computing anything.

        Args:
            data: MuJoCo data; modified.
            qpos: Configuration, shape (nq,), joints in actuator order.
            qvel: Velocity, shape (nv,), joints in actuator order. Default: zero.
        """
        data.qpos[self.qpos_index] = qpos
        data.qvel[self.qvel_index] = 0.0 if qvel is None else qvel

    def read_state(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Read qpos and qvel from MuJoCo's data, with the joints in actuator order.

        Returns:
            qpos, shape (nq,); qvel, shape (nv,). The linear base velocity is in the world frame,
            the angular base velocity in the base frame.
        """
        return data.qpos[self.qpos_index], data.qvel[self.qvel_index]
