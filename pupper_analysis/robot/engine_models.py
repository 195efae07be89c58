"""Models of a robot for other programs, and conversions between the conventions of both engines.

`EngineModels` is a base class of ``Robot``. Public coordinates are MuJoCo's, with the joints in
actuator order (``robot.coordinates``). Pinocchio's coordinates are the coordinates of
``robot.pin_model``.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, overload

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_vector, real_array
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import embed_meshes
from pupper_analysis.robot.coordinates import (
    MujocoConvention,
    PinocchioConvention,
    normalise_quaternion,
)
from pupper_analysis.robot.engine_types import (
    MujocoModel,
    MujocoSpec,
    PinocchioData,
    PinocchioGeometryModel,
    PinocchioModel,
)
from pupper_analysis.robot.mujoco_spec import make_mujoco_spec
from pupper_analysis.robot.shapes import CarriedShape, may_touch


class EngineModels:
    """Base class of ``Robot``: models for other programs, and conversions between both engines."""

    if TYPE_CHECKING:
        description: Description
        pin_model: PinocchioModel
        mj_model: MujocoModel
        floating: bool
        pin_convention: PinocchioConvention
        mj_convention: MujocoConvention

        @property
        def nq(self) -> int:
            """Size of qpos, 7 for a free base plus 1 per joint."""

        @property
        def nv(self) -> int:
            """Size of qvel, 6 for a free base plus 1 per joint."""

        @property
        def shapes(self) -> tuple[CarriedShape, ...]:
            """Collision shapes of the robot's MuJoCo model, including feet and a fixed base."""

    def pin_data(self) -> PinocchioData:
        """Return new Pinocchio data of ``pin_model``."""
        return self.pin_model.createData()

    def mj_spec(self) -> MujocoSpec:
        """Return a new MuJoCo spec of the robot, with its additions such as floor and servos.

        The caller may change the spec, or attach it to another spec. Mesh files are referenced by
        their paths, unless meshes are in memory.

        Raises:
            InputError: If a mesh file cannot be read.
            OutputError: If this run of the command line also writes a mesh file.
        """
        spec: MujocoSpec
        spec, _, _ = make_mujoco_spec(self.description, fixed_base=not self.floating)
        for joint in spec.joints:  # as in `mj_model`: gravity compensation is a passive force
            joint.actgravcomp = 0
        embed_meshes(spec)
        return spec

    @cached_property
    def collision_model(self) -> PinocchioGeometryModel:
        """Pinocchio's geometry model with the collision shapes of ``mj_model``; cached.

        The shapes are primitives, and convex hulls of meshes, without the ground. Each shape is
        attached to a joint of ``pin_model``. The collision pairs are the pairs of geoms that MuJoCo
        checks, if its contacts are enabled. Change only a copy (``.copy()``), because all callers
        share the cached object.

        Raises:
            ModelError: If Pinocchio's collision library does not support a geom.
        """
        model = self.pin_model
        result: PinocchioGeometryModel = pin.GeometryModel()
        for shape in self.shapes:
            frame = model.getFrameId(shape.link, pin.FrameType.BODY)
            owner = model.frames[frame]
            name = f"{self.mj_model.geom(shape.geom).name or 'geom'}_{shape.geom}"
            pose = owner.placement * shape.form.pose.placement
            result.addGeometryObject(
                pin.GeometryObject(name, owner.parentJoint, frame, pose, shape.form.collision)
            )
        for second, shape in enumerate(self.shapes):
            for first in range(second):
                if _are_checked(self.mj_model, self.shapes[first], shape):
                    result.addCollisionPair(pin.CollisionPair(first, second))
        return result

    @overload
    def to_pinocchio(self, qpos: ArrayLike, qvel: None = None) -> Array: ...

    @overload
    def to_pinocchio(self, qpos: ArrayLike, qvel: ArrayLike) -> tuple[Array, Array]: ...

    def to_pinocchio(
        self, qpos: ArrayLike, qvel: ArrayLike | None = None
    ) -> Array | tuple[Array, Array]:
        """Convert qpos and qvel (MuJoCo's convention) to Pinocchio's q and v.

        Args:
            qpos: Configuration, shape (nq,): quaternion (w, x, y, z), which is normalised; joints
                in actuator order.
            qvel: Velocity, shape (nv,); the base linear velocity is in the world frame.

        Returns:
            q, shape (pin_model.nq,): quaternion (x, y, z, w), continuous joints as (cos, sin). With
            ``qvel`` also v, shape (pin_model.nv,); the base linear velocity is in the base frame.

        Raises:
            ConfigurationError: If a vector has a wrong length or no real numbers, a value is not
                finite, or the quaternion is zero.
        """
        position = self._check_qpos(qpos)
        q = self.pin_convention.unit_q(position)
        if qvel is None:
            return q
        velocity = check_vector("qvel", qvel, self.nv)
        return q, self.pin_convention.velocity_map(position) @ velocity

    @overload
    def to_mujoco(self, q: ArrayLike, v: None = None) -> Array: ...

    @overload
    def to_mujoco(self, q: ArrayLike, v: ArrayLike) -> tuple[Array, Array]: ...

    def to_mujoco(self, q: ArrayLike, v: ArrayLike | None = None) -> Array | tuple[Array, Array]:
        """Convert Pinocchio's q and v to qpos and qvel (MuJoCo's convention).

        Args:
            q: Pinocchio's configuration, shape (pin_model.nq,).
            v: Pinocchio's velocity, shape (pin_model.nv,).

        Returns:
            qpos, shape (nq,), with continuous joints between -pi and pi; with ``v`` also qvel,
            shape (nv,). The joints are in actuator order; `MujocoConvention.set_state` writes the
            state to MjData.

        Raises:
            ConfigurationError: If a vector has a wrong length or no real numbers, a value is not
                finite, or the quaternion is zero.
        """
        qpos = self.pin_convention.qpos(check_vector("q", q, self.pin_convention.nq))
        if self.floating:
            normalise_quaternion(qpos)
        if v is None:
            return qpos
        velocity = check_vector("v", v, self.pin_convention.nv)
        return qpos, self.pin_convention.velocity_map(qpos).T @ velocity

    def velocity_map(self, qpos: ArrayLike) -> Array:
        """Return the matrix T, shape (pin_model.nv, nv), that maps qvel to Pinocchio's v = T qvel.

        T is orthogonal. It also converts forces (tau_pin = T tau), Jacobians (J = J_pin T), and
        mass matrices (M = T^T M_pin T).

        Args:
            qpos: Configuration, shape (nq,).

        Raises:
            ConfigurationError: If ``qpos`` has not the shape (nq,), a value is not finite, or the
                quaternion is zero.
        """
        return self.pin_convention.velocity_map(self._check_qpos(qpos))

    def forces_to_pinocchio(self, qpos: ArrayLike, forces: ArrayLike) -> Array:
        """Convert generalised forces, dual to qvel, to Pinocchio's tau, shape (pin_model.nv,).

        The base force is in the world frame in MuJoCo, and in the base frame in Pinocchio. The base
        torque is in the base frame in both. Bias forces that depend on the velocity (``qfrc_bias``)
        need a further term: see `accelerations_to_pinocchio`.

        Args:
            qpos: Configuration, shape (nq,).
            forces: Generalised forces, shape (nv,) [N, N m].

        Raises:
            ConfigurationError: If a vector has a wrong length or no real numbers, a value is not
                finite, or the quaternion is zero.
        """
        return self.velocity_map(qpos) @ check_vector("forces", forces, self.nv)

    def forces_to_mujoco(self, qpos: ArrayLike, tau: ArrayLike) -> Array:
        """Convert Pinocchio's generalised forces to forces dual to qvel, shape (nv,) [N, N m].

        The result has the order and the axes of qvel: T^T tau, with T of `velocity_map`.

        Args:
            qpos: Configuration, shape (nq,): base position [m], quaternion (w, x, y, z), joints.
            tau: Pinocchio's generalised forces (pin_model.nv,) [N, N m].

        Raises:
            ConfigurationError: If a vector has a wrong length or no real numbers, a value is not
                finite, or the quaternion is zero.
        """
        return self.velocity_map(qpos).T @ check_vector("tau", tau, self.pin_convention.nv)

    def accelerations_to_pinocchio(
        self, qpos: ArrayLike, qvel: ArrayLike, qacc: ArrayLike
    ) -> Array:
        """Convert qacc to Pinocchio's acceleration a = T qacc + dT/dt qvel, shape (pin_model.nv,).

        T is the `velocity_map`. Inverse dynamics then agree: rnea(q, v, a) = T (M qacc + bias).

        Args:
            qpos: Configuration, shape (nq,).
            qvel: Velocity, shape (nv,).
            qacc: Acceleration, shape (nv,) [m/s^2, rad/s^2].

        Raises:
            ConfigurationError: If a vector has a wrong length or no real numbers, a value is not
                finite, or the quaternion is zero.
        """
        velocity = check_vector("qvel", qvel, self.nv)
        acceleration = check_vector("qacc", qacc, self.nv)
        offset = self.pin_convention.acceleration_offset(self._check_qpos(qpos), velocity)
        return self.velocity_map(qpos) @ acceleration + offset

    def accelerations_to_mujoco(self, qpos: ArrayLike, qvel: ArrayLike, a: ArrayLike) -> Array:
        """Convert Pinocchio's acceleration a to qacc = T^T (a - dT/dt qvel), shape (nv,).

        T is the `velocity_map`.

        Args:
            qpos: Configuration, shape (nq,): quaternion (w, x, y, z), joints in actuator order.
            qvel: Velocity, shape (nv,), joints in actuator order.
            a: Pinocchio's acceleration, shape (pin_model.nv,) [m/s^2, rad/s^2].

        Raises:
            ConfigurationError: If a vector has a wrong length or no real numbers, a value is not
                finite, or the quaternion is zero.
        """
        velocity = check_vector("qvel", qvel, self.nv)
        acceleration = check_vector("a", a, self.pin_convention.nv)
        offset = self.pin_convention.acceleration_offset(self._check_qpos(qpos), velocity)
        return self.velocity_map(qpos).T @ (acceleration - offset)

    def jacobian_to_pinocchio(self, qpos: ArrayLike, jacobian: ArrayLike) -> Array:
        """Convert a Jacobian J whose columns are dual to qvel to Pinocchio's J_pin = J T^T.

        T is the `velocity_map`.

        Args:
            qpos: Configuration, shape (nq,).
            jacobian: Jacobian J, shape (n, nv).

        Returns:
            Pinocchio's Jacobian, shape (n, pin_model.nv).

        Raises:
            ConfigurationError: If an array is not valid.
        """
        return _check_columns("jacobian", jacobian, self.nv) @ self.velocity_map(qpos).T

    def jacobian_to_mujoco(self, qpos: ArrayLike, jacobian: ArrayLike) -> Array:
        """Convert Pinocchio's Jacobian J_pin to J = J_pin T, whose columns are dual to qvel.

        T is the `velocity_map`.

        Args:
            qpos: Configuration, shape (nq,): quaternion (w, x, y, z), joints in actuator order.
            jacobian: Pinocchio's Jacobian J_pin, shape (n, pin_model.nv).

        Returns:
            J, shape (n, nv).

        Raises:
            ConfigurationError: If an array is not valid.
        """
        columns = _check_columns("jacobian", jacobian, self.pin_convention.nv)
        return columns @ self.velocity_map(qpos)

    def _check_qpos(self, qpos: ArrayLike) -> Array:
        """Check a qpos (nq,), and return a copy with normalised quaternion."""
        result = check_vector("qpos", qpos, self.nq)
        if self.floating:
            normalise_quaternion(result)
        return result


def _check_columns(name: str, values: ArrayLike, count: int) -> Array:
    """Return a matrix (n, count), also from a vector (count,); ConfigurationError if not valid."""
    matrix = np.atleast_2d(real_array(name, values))
    if matrix.ndim != 2 or matrix.shape[1] != count:
        problem = diagnose(
            "array-of-another-shape", size=count, shape=str(np.shape(values)), rows=True
        )
        raise ConfigurationError(name, problem)
    if not np.isfinite(matrix).all():
        index = int(np.flatnonzero(~np.isfinite(matrix))[0])
        problem = diagnose("element-not-finite", index=index, value=matrix.flat[index])
        raise ConfigurationError(name, problem)
    return matrix


def _are_checked(model: mujoco.MjModel, one: CarriedShape, other: CarriedShape) -> bool:
    """Return True if MuJoCo, with contacts enabled, checks two geoms of the robot for contact."""
    for pair in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True):
        if set(pair) == {one.geom, other.geom}:
            return True
    first, second = int(model.body_weldid[one.body]), int(model.body_weldid[other.body])
    if first == second or not may_touch(model, one.geom, other.geom):
        return False
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT.value:
        return True
    parents = [int(model.body_weldid[model.body_parentid[body]]) for body in (first, second)]
    is_child = (parents[0] == second and second) or (parents[1] == first and first)
    return not is_child
