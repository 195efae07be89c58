"""``Configuration``: kinematics and dynamics of a robot at a state.

Coordinates are MuJoCo's, with the joints in actuator order (``robot.coordinates``).

Pinocchio computes the results from the URDF. MuJoCo computes the passive forces (springs, gravity
compensation, wind ...), because a URDF does not contain such forces.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, TypeAlias

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_names, check_type, check_vector, real_array
from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.base.arrays import cross_matrices, rotation_from_quaternion
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.base.results import Pictured
from pupper_analysis.robot.robot import Robot, borrow
from pupper_analysis.robot.structure import Workspace

Reference: TypeAlias = Literal["local", "world", "local_world_aligned"] | pin.ReferenceFrame
"""Reference frame of a Jacobian: Pinocchio's constant such as ``pin.LOCAL``, or its name in lower
case."""

_REFERENCE_FRAMES = {
    "local": pin.LOCAL,
    "world": pin.WORLD,
    "local_world_aligned": pin.LOCAL_WORLD_ALIGNED,
}
"""{name of a reference frame: Pinocchio's constant}."""

_MOTION_ROWS = {"linear": slice(0, 3), "angular": slice(3, 6), "both": slice(0, 6)}
"""{kind of motion: rows of a Jacobian (6, nv)}."""

UP = np.array([0.0, 0.0, 1.0])
"""Unit vector of the world's z axis."""


class Configuration(Pictured):
    """Robot at a state (qpos, qvel): kinematics and dynamics. Construction runs the kinematics.

    The coordinates are MuJoCo's, with the joints in actuator order. The base quaternion
    (w, x, y, z) is normalised.

    Attributes:
        robot: The robot.
        qpos: Configuration, shape (nq,), read-only.
        qvel: Velocity, shape (nv,), read-only.
    """

    def __init__(self, robot: Robot, qpos: ArrayLike, qvel: ArrayLike | None = None) -> None:
        """Run the forward kinematics of a state.

        Args:
            robot: The robot.
            qpos: Configuration, shape (nq,).
            qvel: Velocity, shape (nv,); zero by default.

        Raises:
            ConfigurationError: If ``robot`` has another type, a vector has a wrong length, a value
                is not a finite number, or the quaternion is zero.
        """
        if type(robot) is not Robot:
            check_type("robot", robot, Robot)
        self._structure = structure = robot.structure
        self.robot = robot
        self.qpos = own = structure.normalise_qpos(qpos)
        self.qvel = structure.rest
        if qvel is not None:
            self.qvel = check_vector("qvel", qvel, structure.nv)
            self.qvel.flags.writeable = False
        own.flags.writeable = False

        self._model = structure.model
        # The workspace is owned by this configuration alone; a copy acquires its own.
        self._workspace = structure.acquire_workspace()
        self._data = self._workspace.data
        self._q = structure.convention.unit_q(own)
        pin.computeJointJacobians(self._model, self._data, self._q)
        pin.updateFramePlacements(self._model, self._data)

    def __reduce__(self) -> tuple[type[Configuration], tuple[Robot, Array, Array]]:
        """Pickle robot, qpos and qvel: Pinocchio cannot load all models and data that it saves."""
        return type(self), (self.robot, self.qpos, self.qvel)

    def __repr__(self) -> str:
        moving = "moving" if np.any(self.qvel) else "at rest"
        base = "fixed base"
        if self.robot.floating:
            x, y, z = np.round(self.qpos[:3], 6) + 0.0  # without a negative zero
            base = f"base at ({x:.4g}, {y:.4g}, {z:.4g}) m"
        return f"<Configuration of {self.robot.name!r}: {base}, {self.robot.nu} joints, {moving}>"

    def _repr_html_(self) -> str:
        """Return an HTML table of base, joints, centre of mass and velocity, for notebooks."""
        from pupper_analysis.base.notebook import format_value, render_table

        robot = self.robot
        joints = dict(zip(robot.joint_names, self.qpos[-robot.nu :].tolist(), strict=True))
        rows = []
        if robot.floating:
            rows += [
                ("base position", format_value(self.qpos[:3]), "m"),
                ("base quaternion (w, x, y, z)", format_value(self.qpos[3:7]), ""),
            ]
        rows += [
            ("joint positions", format_value(joints), "rad or m"),
            ("center_of_mass()", format_value(self.center_of_mass()), "m"),
            ("qvel", format_value(self.qvel), "m/s, rad/s"),
        ]
        return render_table(f"Configuration of {robot.name}", rows)

    def frame_position(self, name: str) -> Array:
        """Return the position (3,) [m] of the origin of a link, in the world frame.

        Raises:
            UnknownNameError: If the URDF has no such link.
        """
        return np.array(self._data.oMf[self._frame_index(name)].translation)

    def frame_rotation(self, name: str) -> Array:
        """Return the rotation (3, 3) from the axes of a link to the world axes.

        Raises:
            UnknownNameError: If the URDF has no such link.
        """
        return np.array(self._data.oMf[self._frame_index(name)].rotation)

    def frame_jacobian(
        self,
        name: str,
        offset: ArrayLike | None = None,
        *,
        reference: Reference = "local_world_aligned",
    ) -> Array:
        """Return the Jacobian J (6, nv) of a point that moves with a link.

        J qvel = (linear velocity [m/s], angular velocity [rad/s]), as in ``pin.getFrameJacobian``.

        Args:
            name: Name of the link.
            offset: Vector (3,) [m] from the origin of the link to the point, in world axes; zero by
                default.
            reference: Velocity that J qvel returns. "local_world_aligned": velocity of the point,
                in world axes. "local": velocity of the point, in the axes of the link. "world":
                velocity of the material point of the link at the world origin, in world axes;
                ``offset`` then has no effect, and is not checked. Pinocchio's constants, such as
                ``pin.LOCAL``, are accepted as well.

        Raises:
            UnknownNameError: If the URDF has no such link.
            ConfigurationError: If ``reference`` is unknown, or ``offset`` is no vector of three
                finite numbers.
        """
        frame = self._frame_index(name)
        reference, frame_type = _check_reference(reference)
        if reference == "local_world_aligned":
            jacobian = self._compute_frame_jacobian(frame)
            if offset is not None:
                jacobian[:3] -= pin.skew(check_vector("offset", offset, 3)) @ jacobian[3:]
            return jacobian
        columns = pin.getFrameJacobian(self._model, self._data, frame, frame_type)
        jacobian = self._structure.sort_columns(columns)
        if offset is not None and reference == "local":
            lever = self._data.oMf[frame].rotation.T @ check_vector("offset", offset, 3)
            jacobian[:3] -= pin.skew(lever) @ jacobian[3:]
        return jacobian

    def frame_jacobian_time_variation(
        self,
        name: str,
        offset: ArrayLike | None = None,
        *,
        reference: Reference = "local_world_aligned",
    ) -> Array:
        """Return the time derivative dJ/dt, shape (6, nv), of ``frame_jacobian`` at ``qvel``.

        With ``reference`` "local_world_aligned", the acceleration of the point is J qacc + dJ/dt
        qvel.

        Args:
            name: Name of the link.
            offset: Vector (3,) [m] from the origin of the link to the point, in world axes at this
                state. The point moves with the link. Zero by default.
            reference: As in ``frame_jacobian``. With "world", ``offset`` has no effect, and is not
                checked.

        Raises:
            UnknownNameError: If the URDF has no such link.
            ConfigurationError: If ``reference`` is unknown, or ``offset`` is no vector of three
                finite numbers.
        """
        frame = self._frame_index(name)
        reference, frame_type = _check_reference(reference)
        workspace = self._structure.acquire_workspace()
        data = workspace.data
        pin.computeJointJacobiansTimeVariation(self._model, data, self._q, self._v)
        pin.updateFramePlacements(self._model, data)
        columns = pin.getFrameJacobianTimeVariation(self._model, data, frame, frame_type)
        variation = self._structure.sort_columns(columns)
        if offset is not None and reference != "world":
            lever = check_vector("offset", offset, 3)
            if reference == "local":  # the lever is constant in the axes of the link
                lever = data.oMf[frame].rotation.T @ lever
            else:
                turning = self._compute_frame_jacobian(frame)[3:]
                variation[:3] -= pin.skew(np.cross(turning @ self.qvel, lever)) @ turning
            variation[:3] -= pin.skew(lever) @ variation[3:]
        return variation

    def manipulability(
        self,
        name: str,
        offset: ArrayLike | None = None,
        *,
        motion: Literal["linear", "angular", "both"] = "linear",
    ) -> float:
        """Return Yoshikawa's manipulability of a point on a link: sqrt(det(J J^T)).

        J contains only the columns of the joints, as if the base were fixed. The result is the
        product of the singular values of J. It is 0 at a singular configuration, or if J has fewer
        columns than rows. Source: Yoshikawa 1985, "Manipulability of robotic mechanisms".

        Args:
            name: Name of the link.
            offset: Vector (3,) [m] from the origin of the link to the point, in world axes. Zero by
                default.
            motion: Rows of J: "linear" (three rows), "angular" (three rows), or "both" (six rows).
                If all joints are hinges, the unit of the result is m^3/rad^3 for "linear", and 1
                for "angular".

        Raises:
            UnknownNameError: If the URDF has no such link.
            ConfigurationError: If ``motion`` is unknown, or ``offset`` is no vector of three finite
                numbers.
        """
        rows = _MOTION_ROWS.get(motion) if isinstance(motion, str) else None
        if rows is None:
            problem = diagnose("not-one-of", given=str(motion), known=list(_MOTION_ROWS))
            raise ConfigurationError("motion", problem)
        jacobian = self.frame_jacobian(name, offset)[rows, self.robot.nv - self.robot.nu :]
        if jacobian.shape[1] < jacobian.shape[0]:
            return 0.0  # fewer joints than rows: J J^T is singular
        return float(np.prod(np.linalg.svd(jacobian, compute_uv=False)))

    def point_jacobian(self, name: str, point: Array) -> Array:
        """Return the Jacobian J (3, nv) of a point that moves with a link.

        J qvel is the velocity of the point [m/s], in world axes.

        Args:
            name: Name of the link.
            point: Position (3,) [m] of the point in the world.

        Raises:
            UnknownNameError: If the URDF has no such link.
            ConfigurationError: If the point is no vector of three finite numbers.
        """
        frame = self._frame_index(name)
        jacobian = self._compute_frame_jacobian(frame)
        offset = check_vector("point", point, 3) - self._data.oMf[frame].translation
        result: Array = jacobian[:3] - pin.skew(offset) @ jacobian[3:]
        return result

    def _frame_index(self, name: str) -> int:
        """Return the index of a link's frame in Pinocchio.

        Raises:
            UnknownNameError: If the URDF has no such link. For a foot, the message lists the frames
                of its contact points first.
        """
        index = self._structure.links.get(name) if isinstance(name, str) else None
        if index is None:
            robot = self.robot
            links = [frame.name for frame in self._model.frames if frame.type == pin.FrameType.BODY]
            points = robot.feet.get(name, (name,)) if isinstance(name, str) else ()
            frames = [
                robot.contact_frames[point] for point in points if point in robot.contact_frames
            ]
            raise UnknownNameError(
                robot.name, "link", name, links, base=robot.base, first=[*dict.fromkeys(frames)]
            )
        return index

    def _compute_frame_jacobian(self, frame: int) -> Array:
        """Return the Jacobian (6, nv) of a frame's origin in world axes; linear rows come first."""
        jacobian = pin.getFrameJacobian(self._model, self._data, frame, pin.LOCAL_WORLD_ALIGNED)
        return self._structure.sort_columns(jacobian)

    def _foot_frames(self, feet: Iterable[str]) -> list[int]:
        """Return the Pinocchio frame index of each contact point; UnknownNameError if unknown."""
        frames, names = self._structure.feet, check_names("feet", feet)
        try:
            return [frames[name] for name in names]
        except (KeyError, TypeError):  # TypeError: a value without hash
            for name in names:
                self.robot.check_foot(name)
            raise

    def _compute_point_jacobians(self, feet: Iterable[str]) -> Array:
        """Return the Jacobians (n, 6, nv) of n contact points in world axes; linear rows first."""
        jacobians = np.array(
            [self._compute_frame_jacobian(frame) for frame in self._foot_frames(feet)]
        )
        return jacobians.reshape(-1, 6, self._structure.nv)

    def joint_position(self, name: str) -> Array:
        """Return the position (3,) [m] of the frame of a joint, in the world frame.

        Raises:
            UnknownNameError: If the robot has no such joint.
        """
        return np.array(self._data.oMi[self._joint_index(name)].translation)

    def joint_axis(self, name: str) -> Array:
        """Return the unit axis (3,) of a hinge or slide, in the world frame.

        Raises:
            UnknownNameError: If the robot has no such joint.
        """
        joint = self._joint_index(name)
        column = self._data.J.reshape(6, -1)[:, self._model.joints[joint].idx_v]
        rotation, translation = column[3:], column[:3]
        axis: Array = rotation if np.linalg.norm(rotation) > 0.5 else translation
        return np.array(axis / np.linalg.norm(axis))

    def _joint_index(self, name: str) -> int:
        """Return the Pinocchio index of a joint; UnknownNameError if there is none."""
        index = self._structure.joints.get(name) if isinstance(name, str) else None
        if index is None:
            raise UnknownNameError(self.robot.name, "joint", name, self.robot.joint_names)
        return index

    def foot_positions(self) -> dict[str, Array]:
        """Return the sphere centres of all contact points in the world frame.

        Returns:
            {contact point: position (3,) [m]}.
        """
        placements, frames = self._data.oMf, self._structure.feet
        return {foot: np.array(placements[frame].translation) for foot, frame in frames.items()}

    def foot_centres(self, feet: Iterable[str]) -> Array:
        """Return the sphere centres of n contact points in the world frame, shape (n, 3) [m].

        Args:
            feet: Names of the contact points.

        Raises:
            ConfigurationError: If ``feet`` is a text, bytes or no iterable.
            UnknownNameError: If there is no such contact point.
        """
        placements = self._data.oMf
        positions = [placements[frame].translation for frame in self._foot_frames(feet)]
        return np.array(positions, dtype=float).reshape(-1, 3)

    def foot_jacobians(self) -> dict[str, Array]:
        """Return {contact point: Jacobian J (3, nv) of its sphere centre}.

        J qvel is the velocity of the sphere centre [m/s], in world axes.
        """
        return {
            foot: self._compute_frame_jacobian(frame)[:3]
            for foot, frame in self._structure.feet.items()
        }

    def foot_rotations(self, feet: Iterable[str]) -> Array:
        """Return the rotations (n, 3, 3) from the frames of n contact points to the world axes.

        Args:
            feet: Names of the contact points.

        Raises:
            ConfigurationError: If ``feet`` is a text, bytes or no iterable.
            UnknownNameError: If there is no such contact point.
        """
        placements = self._data.oMf
        rotations = [placements[frame].rotation for frame in self._foot_frames(feet)]
        return np.array(rotations).reshape(-1, 3, 3)

    def foot_twist_jacobians(self, feet: Sequence[str]) -> Array:
        """Return the Jacobians J, shape (n, 6, nv), of the sphere centres of n contact points.

        J qvel = (linear velocity of the centre [m/s], angular velocity [rad/s]), in world axes.

        Args:
            feet: Names of the contact points.

        Raises:
            ConfigurationError: If ``feet`` is a text, bytes or no iterable.
            UnknownNameError: If there is no such contact point.
        """
        return self._compute_point_jacobians(feet)

    def contact_points(self, feet: Iterable[str] | None = None) -> dict[str, Array]:
        """Return the lowest point of the sphere of each contact point, in the world frame.

        Args:
            feet: Names of the contact points; all by default.

        Returns:
            {contact point: sphere centre minus radius times the world's z axis, shape (3,) [m]}.

        Raises:
            ConfigurationError: If ``feet`` is a text, bytes or no iterable.
            UnknownNameError: If there is no such contact point.
        """
        names = self.robot.contact_points if feet is None else check_names("feet", feet)
        positions = self.foot_positions()
        return {
            self.robot.check_foot(foot): positions[foot] - self.robot.contact_radius[foot] * UP
            for foot in names
        }

    def point_jacobians(self, feet: Sequence[str], offsets: Array) -> Array:
        """Return the Jacobians (n, 3, nv) of n points that move with feet, in world axes.

        Args:
            feet: Name of a contact point for each point. The point moves with the link of this
                contact point.
            offsets: Vectors from the sphere centres of the contact points to the points, in world
                axes, shape (n, 3) [m].

        Raises:
            ConfigurationError: If ``feet`` is a text, bytes or no iterable.
            UnknownNameError: If there is no such contact point.
        """
        jacobians = self._compute_point_jacobians(feet)
        result: Array = jacobians[:, :3] - cross_matrices(offsets) @ jacobians[:, 3:]
        return result

    def center_of_mass(self) -> Array:
        """Return the position of the CoM in the world frame, shape (3,) [m]."""
        # Without q, Pinocchio reuses the joint placements.
        moving = pin.centerOfMass(self._model, self._data, pin.KinematicLevel.POSITION, False)
        return np.array(self._structure.total_com(moving))

    def com_jacobian(self) -> Array:
        """Return the Jacobian J (3, nv) of the CoM: J qvel is its velocity [m/s], in world axes."""
        if self._structure.fixed == 1:  # the moving links have no mass
            return np.zeros((3, self._structure.nv))
        moving = pin.jacobianCenterOfMass(self._model, self._data, self._q)
        jacobian: Array = (1 - self._structure.fixed) * self._structure.sort_columns(moving)
        return jacobian

    def centroidal_map(self) -> Array:
        """Return the centroidal momentum matrix A (6, nv).

        A qvel = (linear momentum [kg m/s], angular momentum about the CoM [kg m^2/s]), in world
        axes, as in ``pin.computeCentroidalMap``. Armature is not included. Source: Orin and Goswami
        2008, "Centroidal momentum matrix of a humanoid robot".
        """
        if self._structure.fixed == 1:
            return self._massless_centroidal_map()
        workspace = self._structure.acquire_workspace()
        moving = pin.computeCentroidalMap(self._model, workspace.data, self._q)
        momentum = np.array(self._structure.sort_columns(moving))
        if self._structure.fixed:  # Pinocchio's CoM does not include fixed mass
            momentum[3:] += pin.skew(self._compute_moving_com_offset()) @ momentum[:3]
        return momentum

    def centroidal_map_time_variation(self) -> Array:
        """Return the time derivative dA/dt, shape (6, nv), of ``centroidal_map`` at ``qvel``.

        The rate of the centroidal momentum is A qacc + dA/dt qvel.

        The angular rows differ from ``pin.computeCentroidalMapTimeVariation`` (Pinocchio's issue
        2093), which differentiates about a fixed point at the present CoM. This method subtracts
        the missing term: the cross product of the CoM velocity and the linear rows of
        ``centroidal_map``.
        """
        if self._structure.fixed == 1:
            return self._massless_centroidal_map_variation()
        # Pinocchio's function reads data.vcom[0], which must be zero, as in new data.
        data = self._model.createData()
        moving = pin.computeCentroidalMapTimeVariation(self._model, data, self._q, self._v)
        variation = np.array(self._structure.sort_columns(moving))
        momentum = self._structure.sort_columns(np.array(data.Ag))
        variation[3:] -= pin.skew(self.com_jacobian() @ self.qvel) @ momentum[:3]
        if self._structure.fixed:
            variation[3:] += pin.skew(self._compute_moving_com_offset()) @ variation[:3]
        return variation

    def _massless_centroidal_map(self) -> Array:
        """Compute ``centroidal_map`` if the moving links have no mass: Pinocchio returns NaN."""
        momentum = np.zeros((6, self._structure.nv))
        for joint in range(1, self._model.njoints):
            turning = pin.getJointJacobian(self._model, self._data, joint, pin.LOCAL_WORLD_ALIGNED)
            angular = self._structure.sort_columns(turning)[3:]
            momentum[3:] += self._compute_world_inertia(joint) @ angular
        return momentum

    def _massless_centroidal_map_variation(self) -> Array:
        """Compute ``centroidal_map_time_variation`` if the moving links have no mass.

        Per link: d(I J)/dt = (S I - I S) J + I dJ/dt, with the inertia I, the angular Jacobian J,
        and the cross-product matrix S of the angular velocity.
        """
        workspace = self._structure.acquire_workspace()
        data, frame = workspace.data, pin.LOCAL_WORLD_ALIGNED
        pin.computeJointJacobiansTimeVariation(self._model, data, self._q, self._v)
        variation = np.zeros((6, self._structure.nv))
        for joint in range(1, self._model.njoints):
            matrices = (
                pin.getJointJacobian(self._model, data, joint, frame),
                pin.getJointJacobianTimeVariation(self._model, data, joint, frame),
            )
            angular, change = (self._structure.sort_columns(matrix)[3:] for matrix in matrices)
            inertia, spin = self._compute_world_inertia(joint), pin.skew(angular @ self.qvel)
            variation[3:] += (spin @ inertia - inertia @ spin) @ angular + inertia @ change
        return variation

    def _compute_world_inertia(self, joint: int) -> Array:
        """Return the inertia (3, 3) [kg m^2] of a joint's body about its CoM, in world axes."""
        rotation = self._data.oMi[joint].rotation
        inertia: Array = rotation @ self._model.inertias[joint].inertia @ rotation.T
        return inertia

    def _compute_moving_com_offset(self) -> Array:
        """Return the vector (3,) [m] from the CoM to the CoM without a fixed base, in the world."""
        fixed, lever = self._structure.fixed, self._structure.lever
        offset: Array = fixed / (1 - fixed) * (self.center_of_mass() - lever)
        return offset

    def mass_matrix(self) -> Array:
        """Return the joint-space inertia matrix M, shape (nv, nv) [kg, kg m, kg m^2].

        Computed by ``pin.crba``, including armature.
        """
        return self._structure.fill_symmetric(
            pin.crba(self._structure.update_armature(), self._data, self._q)
        )

    def bias_forces(self) -> Array:
        """Return the bias h (nv,) [N, N m]: Coriolis, centrifugal and gravity forces.

        The equation of motion is M qacc + h = tau. tau contains all other generalised forces, such
        as forces of motors, contacts, springs, damping and closed loops. Computed by
        ``pin.nonLinearEffects``; in the order of qvel.
        """
        forces = pin.nonLinearEffects(self._model, self._data, self._q, self._v)
        return self._structure.to_qvel_order(forces)

    def gravity(self) -> Array:
        """Return the gravity vector g, shape (nv,) [N, N m]: the bias forces at rest.

        Computed by ``pin.computeGeneralizedGravity``; in the order of qvel. With a free base, g[:3]
        = -m a [N], expressed in the world frame, with the robot's mass m [kg] and the gravitational
        acceleration a [m/s^2]. The joint part contains the motor torques that hold the joints of a
        robot whose base is held, without contacts, passive forces, closed loops and couplings. For
        the motor torques of a standing robot use ``gravity_compensation``.
        """
        forces = pin.computeGeneralizedGravity(self._model, self._data, self._q)
        return self._structure.to_qvel_order(forces)

    def passive_forces(self) -> Array:
        """Return the passive generalised forces of the MJCF at zero velocity, shape (nv,) [N, N m].

        The forces are MuJoCo's ``qfrc_passive`` at this configuration, for example of springs and
        gravity compensation. A URDF does not contain such forces.
        """
        if not self.robot.acts_at_rest:
            return np.zeros(self.robot.nv)
        with borrow(self.robot, AtRest) as springs:
            return springs.forces(self.qpos)

    def static_load(self) -> Array:
        """Return the generalised force required to hold the robot at rest, shape (nv,) [N, N m].

        The force is the gravity vector minus the passive forces of the MJCF. Motors, contacts and
        constraints must exert it together.
        """
        return self.gravity() - self.passive_forces() if self.robot.acts_at_rest else self.gravity()

    def transfer_to_motors(self, forces: Array) -> Array:
        """Transfer loads of dependent joints to the motors of loops and couplings.

        The rows of dependent joints become zero (`Closure.load_transfer`). The first nv - nu rows
        (the base) are unchanged.

        Args:
            forces: Generalised forces that motors and constraints must exert together, shape (nv,)
                or, for n loads, (nv, n) [N, N m].

        Returns:
            Generalised forces that the motors must exert, same shape.

        Raises:
            ConfigurationError: If ``forces`` has another shape or is no array of numbers, or if a
                closed loop is singular.
        """
        forces = real_array("forces", forces)
        if forces.ndim not in (1, 2) or len(forces) != self.robot.nv:
            message = diagnose(
                "array-of-another-shape", size=self.robot.nv, shape=str(forces.shape), rows=""
            )
            raise ConfigurationError("forces", message)
        closure = self.robot.closure
        if closure is None:
            return forces
        result, first = forces.copy(), self.robot.nv - self.robot.nu
        result[first:] -= closure.load_transfer(self.qpos) @ forces[first:]
        return result

    def static_load_derivative(self, wrenches: Mapping[str, Array]) -> Array:
        """Return the derivative of the static load minus constant wrenches on the feet.

        The differentiated force is l - sum J^T w. l is the `static_load` (gravity minus passive
        forces), w a wrench, and J the Jacobian (6, nv) of the sphere centre of a contact point.

        Args:
            wrenches: {contact point: wrench (6,)}: force [N] and moment about the sphere centre [N
                m], constant in world axes.

        Returns:
            Shape (nv, nv). Column i: derivative with respect to a displacement along qvel[i].

        Raises:
            ConfigurationError: If ``wrenches`` is no mapping with names as keys, or a wrench is no
                vector of six finite numbers.
            UnknownNameError: If there is no such contact point.
        """
        check_type("wrenches", wrenches, Mapping[str, object])
        rows = [check_vector(f"wrenches[{point}]", row, 6) for point, row in wrenches.items()]
        pushes = np.array(rows).reshape(-1, 6)
        return self.loaded_points_derivative(self._compute_point_jacobians(wrenches), pushes)

    def loaded_points_derivative(self, jacobians: Array, wrenches: Array) -> Array:
        """Return the derivative of the static load minus constant wrenches on points of links.

        The differentiated force is l - sum J^T w. l is the `static_load` (gravity minus passive
        forces), w a wrench, and J the Jacobian of its point.

        Args:
            jacobians: Jacobians J of n points that move with links, shape (n, 6, nv): linear
                velocity, then angular velocity, in world axes.
            wrenches: Force [N] and moment about the point [N m], shape (n, 6), constant in world
                axes.

        Returns:
            Shape (nv, nv). Column i: derivative with respect to a displacement along qvel[i].
        """
        structure = self._structure
        workspace = structure.acquire_workspace()
        rates = pin.computeGeneralizedGravityDerivatives(self._model, workspace.data, self._q)
        changed = structure.sort_matrix(np.atleast_2d(rates))
        changed -= self.wrenches_derivative(jacobians, wrenches)
        if self.robot.acts_at_rest:
            with borrow(self.robot, AtRest) as springs:
                changed -= springs.force_derivative(self.qpos)
        return changed

    def wrenches_derivative(self, jacobians: Array, wrenches: Array) -> Array:
        """Return the derivative of sum J^T w, the generalised force of constant wrenches on points.

        Args:
            jacobians: Jacobians J of n points that move with links, shape (n, 6, nv): linear
                velocity, then angular velocity, in world axes.
            wrenches: Force [N] and moment about the point [N m], shape (n, 6), constant in world
                axes.

        Returns:
            Shape (nv, nv). Column i: derivative with respect to a displacement along qvel[i].
        """
        structure, n = self._structure, self._structure.nv
        turned = cross_matrices(wrenches.reshape(-1, 3)).reshape(-1, 6, 3) @ jacobians[:, 3:]
        pushed = jacobians[:, :3].reshape(-1, n).T @ turned[:, :3].reshape(-1, n)
        combined = jacobians.reshape(-1, n).T @ turned.reshape(-1, n)
        # Derivative of the columns of J: a joint nearer the base rotates the column, and a joint
        # farther from the base moves the point.
        result: Array = np.where(structure.carried, combined, pushed.T)
        return result

    def forward_dynamics(self, force: ArrayLike) -> Array:
        """Return the acceleration qacc, shape (nv,) [m/s^2, rad/s^2], under a generalised force.

        The result is qacc = M^-1 (force - h), with the mass matrix M and the bias h. Contacts,
        closed loops and couplings are not solved.

        Args:
            force: Sum of all generalised forces except the bias h, shape (nv,) [N, N m]: forces of
                motors, contacts, springs, damping and constraints.

        Raises:
            ConfigurationError: If the vector has a wrong length, or a value is not a finite number.
        """
        model_force = self._structure.to_model_order(check_vector("force", force, self.robot.nv))
        acceleration = pin.aba(
            self._structure.update_armature(), self._data, self._q, self._v, model_force
        )
        return self._structure.to_qvel_order(acceleration)

    def joint_torque_regressor(self, qacc: ArrayLike) -> Array:
        """Return the regressor Y (nv, 10 n) of the inverse dynamics of n bodies, at this state.

        M qacc + h = Y p, with the inertial parameters p from ``dynamic_parameters``. M is the mass
        matrix without armature. Computed by ``pin.computeJointTorqueRegressor``.

        Args:
            qacc: Generalised acceleration (nv,).

        Returns:
            Y, with ten columns per moving body: first the base if it is free, then the body of each
            joint in actuator order.

        Raises:
            ConfigurationError: If the vector has a wrong length, or a value is not a finite number.
        """
        acceleration = self._structure.to_model_order(check_vector("qacc", qacc, self.robot.nv))
        workspace = self._structure.acquire_workspace()
        regressor = pin.computeJointTorqueRegressor(
            self._model, workspace.data, self._q, self._v, acceleration
        )
        blocks = np.reshape(regressor, (self.robot.nv, -1, 10))[:, self._list_moving_bodies() - 1]
        rows = [
            self._structure.to_qvel_order(column) for column in blocks.reshape(self.robot.nv, -1).T
        ]
        return np.array(rows).T

    def dynamic_parameters(self) -> Array:
        """Return the inertial parameters p (10 n,) of the n bodies of ``joint_torque_regressor``.

        Ten numbers per body: mass m [kg]; m c [kg m] with the CoM c; Ixx, Ixy, Iyy, Ixz, Iyz, Izz
        [kg m^2]. Moments of inertia are about the origin of the body's joint, in the axes of the
        joint, as in Pinocchio's ``Inertia.toDynamicParameters``. Links on fixed joints are part of
        the body.
        """
        inertias = self._model.inertias
        parameters = [
            inertias[int(body)].toDynamicParameters() for body in self._list_moving_bodies()
        ]
        return np.array(parameters, dtype=float).reshape(-1)

    def _list_moving_bodies(self) -> IntArray:
        """Return Pinocchio's joint indices of the moving bodies, shape (n,), in public order."""
        base = [2] if self._structure.floating else []  # translation 1, then rotation 2
        return np.array([*base, *self._structure.joints.values()], dtype=np.int64)

    def foot_accelerations(self, qacc: ArrayLike) -> dict[str, Array]:
        """Return the acceleration of the sphere centre of each contact point, in world axes.

        The acceleration is the time derivative of J qvel, with J of ``frame_jacobian``.

        Args:
            qacc: Generalised acceleration, shape (nv,).

        Returns:
            {contact point: linear acceleration [m/s^2] and angular acceleration [rad/s^2], shape
            (6,)}.

        Raises:
            ConfigurationError: If the vector has a wrong length, or a value is not a finite number.
        """
        workspace, accelerations = self._compute_accelerations(qacc), {}
        for foot, frame in self._structure.feet.items():
            motion = pin.getFrameClassicalAcceleration(
                self._model, workspace.data, frame, pin.LOCAL_WORLD_ALIGNED
            )
            accelerations[foot] = np.concatenate([motion.linear, motion.angular])
        return accelerations

    def com_acceleration(self, qacc: ArrayLike) -> Array:
        """Return the acceleration of the CoM, J qacc + dJ/dt qvel, shape (3,) [m/s^2], world axes.

        Args:
            qacc: Generalised acceleration, shape (nv,): linear acceleration of a free base in world
                axes, angular acceleration in base axes, then the joints in actuator order.

        Raises:
            ConfigurationError: If the vector has a wrong length, or a value is not a finite number.
        """
        workspace = self._compute_accelerations(qacc)
        if self._structure.fixed == 1:  # the moving links have no mass
            return np.zeros(3)
        pin.centerOfMass(self._model, workspace.data, pin.ACCELERATION, False)
        moving: Array = np.array(workspace.data.acom[0])
        return (1 - self._structure.fixed) * moving

    def _compute_accelerations(self, qacc: ArrayLike) -> Workspace:
        """Compute link velocities and accelerations for a qacc (nv,), in separate data."""
        acceleration = self._structure.to_model_order(check_vector("qacc", qacc, self.robot.nv))
        workspace = self._structure.acquire_workspace()
        pin.forwardKinematics(self._model, workspace.data, self._q, self._v, acceleration)
        pin.updateFramePlacements(self._model, workspace.data)
        return workspace

    @property
    def _v(self) -> Array:
        """Velocity of this state in the order of the Pinocchio model, shape (nv,)."""
        return self._structure.to_model_order(self.qvel)

    def imu(self, qacc: ArrayLike, name: str | None = None) -> tuple[Array, Array]:
        """Return the ideal readings of a gyro and an accelerometer at the frame of a link.

        The accelerometer reads the acceleration of the frame's origin minus gravity.

        Args:
            qacc: Generalised acceleration, shape (nv,).
            name: Link with the sensors; by default ``Robot.imu``.

        Returns:
            Angular velocity (3,) [rad/s] and acceleration (3,) [m/s^2], both in the axes of the
            link.

        Raises:
            ConfigurationError: If no link is given, and the robot has no IMU; or if ``qacc`` has a
                wrong length, or a value is not a finite number.
            UnknownNameError: If there is no such link.
        """
        frame = self.robot.imu if name is None else name
        if frame is None:
            raise ConfigurationError("name", diagnose("no-imu", robot=self.robot.name))
        index = self._frame_index(frame)
        workspace = self._compute_accelerations(qacc)
        data = workspace.data
        gyro = pin.getFrameVelocity(self._model, data, index, pin.LOCAL).angular
        linear = pin.getFrameClassicalAcceleration(self._model, data, index, pin.LOCAL).linear
        gravity = data.oMf[index].rotation.T @ self.robot.gravity
        return np.array(gyro), np.array(linear - gravity)

    def base_rotation(self) -> Array:
        """Return the rotation (3, 3) from the axes of the base to the world axes."""
        if self._structure.floating:
            return rotation_from_quaternion(self.qpos[3:7])
        return self.frame_rotation(self.robot.base)


def _check_reference(reference: Reference) -> tuple[str, pin.ReferenceFrame]:
    """Return name and Pinocchio's constant of a reference frame; ConfigurationError if unknown."""
    if isinstance(reference, pin.ReferenceFrame):
        reference = reference.name.lower()
    if not isinstance(reference, str) or reference not in _REFERENCE_FRAMES:
        problem = diagnose("not-one-of", given=str(reference), known=list(_REFERENCE_FRAMES))
        raise ConfigurationError("reference", problem)
    return reference, _REFERENCE_FRAMES[reference]


_DIFFERENCE_STEP = 1e-6
"""Step of the central differences of passive forces [rad, m]. Chosen, not tuned."""


class AtRest:
    """Passive forces of the MJCF at zero velocity, such as springs (MuJoCo's ``qfrc_passive``).

    Obtain an instance by ``borrow``, which reuses instances.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._model, self._convention = robot.mj_model, robot.mj_convention
        self._data = mujoco.MjData(self._model)

    def forces(self, qpos: Array) -> Array:
        """Return the passive generalised forces at rest (nv,) [N, N m] at a configuration (nq,)."""
        self._convention.set_state(self._data, qpos)
        return self._passive_forces()

    def force_derivative(self, qpos: Array) -> Array:
        """Return the derivative of the passive forces at rest with respect to the configuration.

        Computed by central differences.

        Args:
            qpos: Configuration, shape (nq,).

        Returns:
            Shape (nv, nv). Column i: derivative with respect to a displacement along qvel[i].
        """
        data, index = self._data, self._convention.qvel_index
        self._convention.set_state(data, qpos)
        start_qpos = data.qpos.copy()
        columns = []
        for dof in index:
            step, values = np.zeros(self._model.nv), []
            step[dof] = 1.0
            for signed_step in (_DIFFERENCE_STEP, -_DIFFERENCE_STEP):
                data.qpos[:] = start_qpos
                mujoco.mj_integratePos(self._model, data.qpos, step, signed_step)
                values.append(self._passive_forces())
            columns.append((values[0] - values[1]) / (2 * _DIFFERENCE_STEP))
        return np.array(columns).T

    def _passive_forces(self) -> Array:
        """Compute MuJoCo's passive generalised forces at the present state, (nv,) [N, N m]."""
        mujoco.mj_fwdPosition(self._model, self._data)
        mujoco.mj_fwdVelocity(self._model, self._data)
        forces: Array = self._data.qfrc_passive[self._convention.qvel_index]
        return forces.copy()
