"""A robot at a state: what Pinocchio says of it, in the public convention."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_type, check_vector
from pupper_analysis.base.arrays import cross_matrices, rotation_from_quaternion
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.robot.robot import Robot, lend
from pupper_analysis.robot.structure import Workspace

Array = NDArray[np.float64]

UP = np.array([0.0, 0.0, 1.0])


class Configuration:
    """A robot at (qpos, qvel). That it exists means that forward kinematics has been run there.

    Coordinates are those of ``pupper_analysis.robot.coordinates``: MuJoCo's, joints in actuator
    order. A configuration does not change; its quaternion is normalised on entry.

    Attributes:
        robot: The robot.
        qpos: (nq,) read-only.
        qvel: (nv,) read-only.
    """

    def __init__(self, robot: Robot, qpos: ArrayLike, qvel: ArrayLike | None = None) -> None:
        """Runs forward kinematics.

        Args:
            robot: The robot.
            qpos: (nq,) generalised position.
            qvel: (nv,) generalised velocity; zero if not given.

        Raises:
            ConfigurationError: If a vector has a wrong length, a value is not finite, or the
                quaternion is zero.
        """
        if type(robot) is not Robot:
            check_type("robot", robot, Robot)
        self._structure = structure = robot.structure
        self.robot = robot
        self.qpos = own = structure.state(qpos)
        self.qvel = structure.rest
        if qvel is not None:
            self.qvel = check_vector("qvel", qvel, structure.nv)
            self.qvel.flags.writeable = False
        own.flags.writeable = False

        self._model = structure.model
        # Held for as long as this configuration, or a copy of it, exists.
        self._workspace = structure.workspace()
        self._data = self._workspace.data
        self._q = structure.convention.unit_q(own)
        pin.computeJointJacobians(self._model, self._data, self._q)
        pin.updateFramePlacements(self._model, self._data)

    def frame_position(self, name: str) -> Array:
        """Returns a frame's position (3,) in the world (m).

        Raises:
            UnknownNameError: If the URDF has no such frame.
        """
        return np.array(self._data.oMf[self._frame(name)].translation)

    def frame_rotation(self, name: str) -> Array:
        """Returns the rotation (3, 3) from a frame's axes to the world's.

        Raises:
            UnknownNameError: If the URDF has no such frame.
        """
        return np.array(self._data.oMf[self._frame(name)].rotation)

    def frame_jacobian(self, name: str, offset: ArrayLike | None = None) -> Array:
        """Returns the Jacobian (6, nv) of a point that moves with a frame.

        J qvel = (linear velocity of the point, angular velocity), in world axes.

        Args:
            name: The frame.
            offset: (3,) from the frame's origin to the point, in world axes (m); zero by default.

        Raises:
            UnknownNameError: If the URDF has no such frame.
        """
        jacobian = self._jacobian(self._frame(name))
        if offset is not None:
            jacobian[:3] -= pin.skew(np.asarray(offset, dtype=float)) @ jacobian[3:]
        return jacobian

    def point_jacobian(self, name: str, point: Array) -> Array:
        """Returns the Jacobian (3, nv) of a point that moves with a frame, in world axes.

        Args:
            name: The frame.
            point: (3,) where the point is, in the world (m).

        Raises:
            UnknownNameError: If the URDF has no such frame.
        """
        frame = self._frame(name)
        jacobian = self._jacobian(frame)
        offset = point - self._data.oMf[frame].translation
        moved: Array = jacobian[:3] - pin.skew(offset) @ jacobian[3:]
        return moved

    def _frame(self, name: str) -> int:
        number = self._structure.links.get(name)
        if number is None:
            links = [f.name for f in self._model.frames if f.type == pin.FrameType.BODY]
            raise UnknownNameError(self.robot.name, "link", name, links)
        return number

    def _jacobian(self, frame: int) -> Array:
        """Returns the Jacobian (6, nv) of a frame, which nobody else has."""
        own = pin.getFrameJacobian(self._model, self._data, frame, pin.LOCAL_WORLD_ALIGNED)
        return self._structure.columns(own)

    def _jacobians(self, feet: Iterable[str]) -> Array:
        """Returns the Jacobians (n, 6, nv) of some feet's centres."""
        numbers = self._structure.feet
        all_of_them = np.array([self._jacobian(numbers[foot]) for foot in feet])
        return all_of_them.reshape(-1, 6, self._structure.nv)

    def joint_position(self, name: str) -> Array:
        """Returns where a joint is (3,), in the world (m).

        Raises:
            UnknownNameError: If it is no joint of the robot.
        """
        return np.array(self._data.oMi[self._joint(name)].translation)

    def joint_axis(self, name: str) -> Array:
        """Returns a joint's axis (3,), a unit vector in the world: of rotation, or of sliding.

        Raises:
            UnknownNameError: If it is no joint of the robot.
        """
        joint = self._joint(name)
        column = self._data.J.reshape(6, -1)[:, self._model.joints[joint].idx_v]
        rotation, at_origin = column[3:], column[:3]
        axis: Array = rotation if np.linalg.norm(rotation) > 0.5 else at_origin
        return np.array(axis / np.linalg.norm(axis))

    def _joint(self, name: str) -> int:
        number = self._structure.joints.get(name)
        if number is None:
            raise UnknownNameError(self.robot.name, "joint", name, self.robot.joint_names)
        return number

    def foot_positions(self) -> dict[str, Array]:
        """Returns the centre of each foot's sphere, {foot: (3,)}, in the world (m)."""
        placements, numbers = self._data.oMf, self._structure.feet
        return {foot: np.array(placements[at].translation) for foot, at in numbers.items()}

    def foot_places(self, feet: Iterable[str]) -> Array:
        """Returns the centres (n, 3) of some feet's spheres, in the world (m)."""
        placements, numbers = self._data.oMf, self._structure.feet
        places = [placements[numbers[foot]].translation for foot in feet]
        return np.array(places, dtype=float).reshape(-1, 3)

    def foot_jacobians(self) -> dict[str, Array]:
        """Returns the Jacobian of each foot's centre, {foot: (3, nv)}, in world axes.

        J qvel is the foot's velocity in the world (m/s).
        """
        return {foot: self._jacobian(at)[:3] for foot, at in self._structure.feet.items()}

    def foot_rotations(self, feet: Iterable[str]) -> Array:
        """Returns the rotations (n, 3, 3) of some feet's frames, to the world's axes."""
        placements, numbers = self._data.oMf, self._structure.feet
        return np.array([placements[numbers[foot]].rotation for foot in feet]).reshape(-1, 3, 3)

    def foot_twists(self, feet: Sequence[str]) -> Array:
        """Returns the Jacobians (n, 6, nv) of some feet, of centre and rotation, in world axes."""
        return self._jacobians(feet)

    def contact_points(self, feet: Iterable[str] | None = None) -> dict[str, Array]:
        """Returns where each foot's sphere touches level ground, {foot: (3,)}, in the world (m).

        Args:
            feet: Names of feet; all by default.

        Raises:
            UnknownNameError: If a foot is unknown.
        """
        positions = self.foot_positions()
        return {
            self.robot.check_foot(foot): positions[foot] - self.robot.contact_radius[foot] * UP
            for foot in (self.robot.contact_points if feet is None else feet)
        }

    def point_jacobians(self, feet: Sequence[str], offsets: Array) -> Array:
        """Returns the Jacobians (n, 3, nv) of points that move with feet, in world axes.

        Args:
            feet: n names of feet.
            offsets: (n, 3) from each foot's centre to its point, in world axes (m).
        """
        both = self._jacobians(feet)
        moved: Array = both[:, :3] - cross_matrices(offsets) @ both[:, 3:]
        return moved

    def center_of_mass(self) -> Array:
        """Returns the centre of mass (3,) in the world (m)."""
        # Where the joints are has been computed: with q it would be so again.
        moving = pin.centerOfMass(self._model, self._data, pin.KinematicLevel.POSITION, False)
        return np.array(self._structure.centre(moving))

    def com_jacobian(self) -> Array:
        """Returns the Jacobian (3, nv) of the centre of mass: J qvel is its velocity (m/s)."""
        moving = pin.jacobianCenterOfMass(self._model, self._data, self._q)
        jacobian: Array = (1 - self._structure.fixed) * self._structure.columns(moving)
        return jacobian

    def mass_matrix(self) -> Array:
        """Returns the joint-space inertia matrix M (nv, nv), armature included."""
        return self._structure.inertia(pin.crba(self._structure.loaded(), self._data, self._q))

    def bias_forces(self) -> Array:
        """Returns h (nv,): Coriolis, centrifugal and gravity forces.

        In M qacc + h = tau + J^T f, with no passive joint forces in h.
        """
        forces = pin.nonLinearEffects(self._model, self._data, self._q, self._v)
        return self._structure.dual(forces)

    def gravity(self) -> Array:
        """Returns g (nv,): the bias forces at rest. Its first three rows are the weight (N)."""
        forces = pin.computeGeneralizedGravity(self._model, self._data, self._q)
        return self._structure.dual(forces)

    def passive(self) -> Array:
        """Returns what the MJCF's springs, gravity compensation and wind do at rest (nv,).

        MuJoCo's forces: a URDF cannot state them. Zero if there are none.
        """
        if not self.robot.acts_at_rest:
            return np.zeros(self.robot.nv)
        with lend(self.robot, AtRest) as springs:
            return springs.forces(self.qpos)

    def load(self) -> Array:
        """Returns what motors and contacts hold at rest (nv,): gravity less ``passive``."""
        return self.gravity() - self.passive() if self.robot.acts_at_rest else self.gravity()

    def by_motors(self, forces: Array) -> Array:
        """Returns what motors have to hold of generalised forces (nv,) or (nv, n).

        All of them, but where loops or couplings of joints carry them over to other joints
        (``pupper_analysis.robot.closure``).
        """
        closure = self.robot.closure
        if closure is None:
            return forces
        held, first = forces.copy(), self.robot.nv - self.robot.nu
        held[first:] -= closure.push(self.qpos) @ forces[first:]
        return held

    def static_rates(self, wrenches: Mapping[str, Array]) -> Array:
        """Returns the derivative (nv, nv) of ``load`` less wrenches on feet: of l - sum J^T w.

        By a step in the directions of qvel. J is the Jacobian (6, nv) of a foot's centre.

        Args:
            wrenches: {foot: (6,)} force (N), and moment about the foot's centre (N m), in world
                axes, in which they do not change.
        """
        pushes = np.array(list(wrenches.values())).reshape(-1, 6)
        return self.pushed_rates(self._jacobians(wrenches), pushes)

    def pushed_rates(self, jacobians: Array, wrenches: Array) -> Array:
        """Returns ``static_rates`` for feet's Jacobians (n, 6, nv) and wrenches (n, 6)."""
        structure, n = self._structure, self._structure.nv
        held = structure.workspace()
        rates = pin.computeGeneralizedGravityDerivatives(self._model, held.data, self._q)
        changed = structure.square(np.atleast_2d(rates))
        turned = cross_matrices(wrenches.reshape(-1, 3)).reshape(-1, 6, 3) @ jacobians[:, 3:]
        pushed = jacobians[:, :3].reshape(-1, n).T @ turned[:, :3].reshape(-1, n)
        both = jacobians.reshape(-1, n).T @ turned.reshape(-1, n)
        # What carries a joint turns its column of J; what it carries moves its foot.
        changed -= np.where(structure.carried, both, pushed.T)
        if self.robot.acts_at_rest:
            with lend(self.robot, AtRest) as springs:
                changed -= springs.rates(self.qpos)
        return changed

    def forward_dynamics(self, force: ArrayLike) -> Array:
        """Returns the acceleration qacc (nv,) under a generalised force, without contacts.

        Args:
            force: (nv,) all generalised forces but the bias: motors, damping, contacts.

        Raises:
            ConfigurationError: If the vector has a wrong length or a value is not finite.
        """
        wanted = self._structure.velocity(check_vector("force", force, self.robot.nv))
        acceleration = pin.aba(self._structure.loaded(), self._data, self._q, self._v, wanted)
        return self._structure.dual(acceleration)

    def foot_accelerations(self, qacc: ArrayLike) -> dict[str, Array]:
        """Returns the acceleration of each foot, {foot: (6,)}, in world axes.

        Linear (m/s^2), of the centre of its sphere, and angular (rad/s^2): the derivative of J qvel
        with J of ``frame_jacobian``.

        Args:
            qacc: (nv,) generalised acceleration.
        """
        held, found = self._accelerated(qacc), {}
        for foot, number in self._structure.feet.items():
            motion = pin.getFrameClassicalAcceleration(
                self._model, held.data, number, pin.LOCAL_WORLD_ALIGNED
            )
            found[foot] = np.concatenate([motion.linear, motion.angular])
        return found

    def com_acceleration(self, qacc: ArrayLike) -> Array:
        """Returns the acceleration (3,) of the centre of mass in the world (m/s^2).

        Args:
            qacc: (nv,) generalised acceleration.
        """
        held = self._accelerated(qacc)
        pin.centerOfMass(self._model, held.data, pin.ACCELERATION, False)
        moving: Array = np.array(held.data.acom[0])
        return (1 - self._structure.fixed) * moving

    def _accelerated(self, qacc: ArrayLike) -> Workspace:
        a = self._structure.velocity(check_vector("qacc", qacc, self.robot.nv))
        held = self._structure.workspace()
        pin.forwardKinematics(self._model, held.data, self._q, self._v, a)
        pin.updateFramePlacements(self._model, held.data)
        return held

    @property
    def _v(self) -> Array:
        return self._structure.velocity(self.qvel)

    def imu(self, qacc: ArrayLike, name: str | None = None) -> tuple[Array, Array]:
        """Returns what a gyro and an accelerometer at a frame read.

        The accelerometer reads the proper acceleration: that of its point less gravity.

        Args:
            qacc: (nv,) generalised acceleration.
            name: The frame; the robot's ``imu`` by default.

        Returns:
            Angular velocity (3,) in rad/s and acceleration (3,) in m/s^2, both in the frame's axes.

        Raises:
            ConfigurationError: If the robot has no IMU and no frame is named.
            UnknownNameError: If there is no such frame.
        """
        frame = name or self.robot.imu
        if frame is None:
            raise ConfigurationError("name", diagnose("no-imu", robot=self.robot.name))
        index = self._frame(frame)
        held = self._accelerated(qacc)
        data = held.data
        gyro = pin.getFrameVelocity(self._model, data, index, pin.LOCAL).angular
        linear = pin.getFrameClassicalAcceleration(self._model, data, index, pin.LOCAL).linear
        gravity = data.oMf[index].rotation.T @ self.robot.gravity
        return np.array(gyro), np.array(linear - gravity)

    def base_rotation(self) -> Array:
        """Returns the rotation (3, 3) from the base's axes to the world's."""
        if self._structure.floating:
            return rotation_from_quaternion(self.qpos[3:7])
        return self.frame_rotation(self.robot.base)


_DIFFERENCE_STEP = 1e-6
"""Step of central differences (rad, m): springs are linear, and weights' levers are sines."""


class AtRest:
    """The forces of a robot's springs, gravity compensation and wind, in public coordinates.

    A URDF states none of them. In MuJoCo they push at rest (``qfrc_passive``); what is left of the
    weight is held by motors and contacts. It is to be lent: MuJoCo's data takes 50 times as long to
    make.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._model, self._convention = robot.mj_model, robot.mj_convention
        self._data = mujoco.MjData(self._model)

    def forces(self, qpos: Array) -> Array:
        """Returns the generalised forces (nv,) at a configuration (nq,), at rest (N, N m)."""
        self._convention.set_state(self._data, qpos)
        return self._now()

    def rates(self, qpos: Array) -> Array:
        """Returns their derivative (nv, nv) by steps in the directions of qvel."""
        data, index = self._data, self._convention.qvel_index
        self._convention.set_state(data, qpos)
        here = data.qpos.copy()
        columns = []
        for dof in index:
            step, ends = np.zeros(self._model.nv), []
            step[dof] = 1.0
            for way in (_DIFFERENCE_STEP, -_DIFFERENCE_STEP):
                data.qpos[:] = here
                mujoco.mj_integratePos(self._model, data.qpos, step, way)
                ends.append(self._now())
            columns.append((ends[0] - ends[1]) / (2 * _DIFFERENCE_STEP))
        return np.array(columns).T

    def _now(self) -> Array:
        mujoco.mj_fwdPosition(self._model, self._data)
        mujoco.mj_fwdVelocity(self._model, self._data)
        forces: Array = self._data.qfrc_passive[self._convention.qvel_index]
        return forces.copy()
