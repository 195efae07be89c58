"""``Structure``: model and indices of a robot. ``Kinematics``: positions of CoM, feet and links.

`Structure` contains a Pinocchio model with the velocity axes of qvel (``robot.coordinates``), and
the indices of frames and joints. A robot has a single `Structure`. A `Configuration` then needs no
search for names and no rotation of axes, and can reuse Pinocchio data.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_vector
from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.robot.coordinates import PinocchioConvention, normalise_quaternion

_MAX_SPARE_DATA = 32
"""Maximum number of unused Pinocchio data that a robot keeps for reuse; further data are dropped.
The number bounds the memory: one set of data takes 0.4 MB for Pupper v3 (measured). Chosen, not
tuned."""


class Workspace:
    """Pinocchio data for a single owner, which go back to a pool when the owner is deleted.

    When the workspace is deleted, the data return to the pool for reuse. If the pool already
    contains 32 data (`_MAX_SPARE_DATA`), the data are dropped.

    Args:
        data: Pinocchio data.
        spare: Pool of unused data.

    Attributes:
        data: Pinocchio data.
    """

    __slots__ = ("_spare_data", "data")

    def __init__(self, data: pin.Data, spare: list[pin.Data]) -> None:
        self.data, self._spare_data = data, spare

    def __del__(self) -> None:
        if len(self._spare_data) < _MAX_SPARE_DATA:
            self._spare_data.append(self.data)


class Structure:
    """Pinocchio model of a robot with the velocity axes of qvel; indices of joints, links and feet.

    The public coordinates qpos and qvel are MuJoCo's, with the joints in actuator order. The order
    of the joints in the Pinocchio model may differ.

    Args:
        model: Pinocchio model of the URDF; a free base is a free flyer.
        convention: Maps between public coordinates and the coordinates of this model.
        joint_names: Joints in actuator order.
        contact_frames: {contact point: name of its link}.

    Attributes:
        model: Pinocchio model with the velocity axes of qvel; see ``in_public_coordinates``.
        floating: Whether the base is free.
        nq: Size of qpos.
        nv: Size of qvel.
        convention: Maps between public coordinates and the coordinates of the attribute ``model``.
        links: {link: frame index in ``model``}.
        joints: {joint: joint index in ``model``}.
        feet: {contact point: frame index in ``model``}.
        parents: {contact point: index of the joint that moves the point}.
        rest: Zero velocity (nv,), read-only.
        carried: Mask (nv, nv). True if coordinate i (row) is not before coordinate j (column) in
            ``model``, or both are rotations of the base. On the same chain, coordinate j then moves
            the body of coordinate i.
        total_mass: Mass [kg] of all links, including a fixed base and the links fixed to it.
        fixed: Fraction of the total mass that does not move [1]: a fixed base and the links fixed
            to it. 0 for a free base.
        lever: CoM (3,) [m] of this fixed mass, in the world frame.
    """

    def __init__(
        self,
        model: pin.Model,
        convention: PinocchioConvention,
        joint_names: Sequence[str],
        contact_frames: Mapping[str, str],
    ) -> None:
        self.model = in_public_coordinates(model, joint_names)
        self._original_model = model
        self.floating = convention.floating
        self.nv = convention.base_nv + len(joint_names)
        self.nq = self.nv + self.floating
        # If several links have the same name, the first counts, as in Pinocchio.
        frames = [
            (index, frame.name)
            for index, frame in enumerate(self.model.frames)
            if frame.type == pin.FrameType.BODY
        ]
        self.links: dict[str, int] = {name: index for index, name in reversed(frames)}
        self.joints: dict[str, int] = {
            name: int(self.model.getJointId(name)) for name in joint_names
        }
        self.feet = {foot: self.links[frame] for foot, frame in contact_frames.items()}
        self.parents = {
            foot: int(self.model.frames[frame].parentJoint) for foot, frame in self.feet.items()
        }
        self.total_mass = float(sum(inertia.mass for inertia in model.inertias))
        self.fixed = float(model.inertias[0].mass) / self.total_mass if self.total_mass else 0.0
        self.lever = np.array(model.inertias[0].lever)
        # A view of a read-only array cannot be made writeable.
        rest = np.zeros(self.nv)
        rest.flags.writeable = False
        self.rest = rest[:]
        self.convention = PinocchioConvention.from_model(self.model, joint_names)
        # Index in the original model of each velocity coordinate of this model.
        self._original_order = np.arange(self.nv)
        self._original_order[self.convention.v_index] = convention.v_index
        columns = np.concatenate([np.arange(convention.base_nv), self.convention.v_index])
        row, column = np.meshgrid(columns, columns, indexing="ij")
        self._upper_triangle = np.minimum(row, column) * self.nv + np.maximum(row, column)
        self.carried = columns[:, None] >= columns
        if self.floating:
            self.carried[3:6, 3:6] = True
        in_order = bool((columns == np.arange(self.nv)).all())
        self._public_to_model: IntArray | None = None if in_order else columns
        self._spare_data: list[pin.Data] = []

    def acquire_workspace(self) -> Workspace:
        """Acquire Pinocchio data, new or from the pool, for exclusive use by the caller.

        The data return to the pool when the `Workspace` is deleted, unless the pool is full.
        """
        try:
            data = self._spare_data.pop()
        except IndexError:
            data = self.model.createData()
        return Workspace(data, self._spare_data)

    def update_armature(self) -> pin.Model:
        """Update the armature of ``model`` from the robot's Pinocchio model, and return ``model``.

        Reason: the armature of the robot's model may have changed since construction.
        """
        self.model.armature = self._original_model.armature.take(self._original_order)
        return self.model

    def normalise_qpos(self, qpos: ArrayLike) -> Array:
        """Check a qpos (nq,), and return a copy with normalised quaternion.

        Raises:
            ConfigurationError: If the length is wrong, a value is not finite, or the quaternion is
                zero.
        """
        result = check_vector("qpos", qpos, self.nq)
        if self.floating:
            normalise_quaternion(result)
        return result

    def total_com(self, moving: Array) -> Array:
        """Return the CoM (3,) [m] of the robot, including a fixed base, in the world frame.

        Args:
            moving: CoM of the moving links, shape (3,) [m], in the world frame.
        """
        if not self.fixed:
            return moving
        if self.fixed == 1:  # the moving links have no mass, and Pinocchio returns NaN
            return self.lever.copy()
        com: Array = moving + self.fixed * (self.lever - moving)
        return com

    def sort_columns(self, jacobian: Array) -> Array:
        """Sort the columns of a Pinocchio Jacobian, shape (n, nv), into the order of qvel."""
        if self.nv == 1:  # Pinocchio returns a vector
            jacobian = jacobian.reshape(-1, 1)
        return (
            jacobian
            if self._public_to_model is None
            else jacobian.take(self._public_to_model, axis=1)
        )

    def to_qvel_order(self, forces: Array) -> Array:
        """Reorder forces or accelerations (nv,) of ``model`` to the order of qvel."""
        public: Array = (
            forces if self._public_to_model is None else forces.take(self._public_to_model)
        )
        return public.copy()

    def fill_symmetric(self, upper: Array) -> Array:
        """Complete a symmetric matrix from its upper triangle, and sort it into the order of qvel.

        Args:
            upper: Matrix (nv, nv) in the order of ``model``; only the upper triangle is read.

        Returns:
            Symmetric matrix, shape (nv, nv), rows and columns in the order of qvel.
        """
        symmetric: Array = upper.take(self._upper_triangle)
        return symmetric

    def sort_matrix(self, matrix: Array) -> Array:
        """Sort rows and columns of a Pinocchio matrix, shape (nv, nv), into the order of qvel."""
        if self._public_to_model is None:
            return matrix.copy()
        return matrix.take(self._public_to_model, axis=0).take(self._public_to_model, axis=1)

    def to_model_order(self, qvel: Array) -> Array:
        """Sort a vector, shape (nv,), from the order of qvel into the order of ``model``.

        The vector contains velocities, accelerations or generalised forces.
        """
        if self._public_to_model is None:
            return qvel
        result = np.empty(self.nv)
        result[self._public_to_model] = qvel
        return result


def in_public_coordinates(model: pin.Model, joint_names: Sequence[str]) -> pin.Model:
    """Return a Pinocchio model whose velocities have the axes of MuJoCo's qvel.

    A free flyer becomes a translation joint (velocity in world axes) and a spherical joint
    (velocity in body axes), as in MuJoCo's free joint. The joints are in actuator order, as far as
    Pinocchio's depth-first order permits. The quaternion in q is (x, y, z, w). Armature, damping,
    friction and limits are not copied.

    Args:
        model: Model of the robot; a free base is a free flyer.
        joint_names: Joints in actuator order.
    """
    result = pin.Model()
    result.name, result.gravity = model.name, model.gravity
    new_indices = {0: 0}
    joint_order = [int(model.getJointId(name)) for name in joint_names]
    for joint in _sort_depth_first(model, joint_order):
        joint_model, parent = model.joints[joint], new_indices[model.parents[joint]]
        placement, name = model.jointPlacements[joint], model.names[joint]
        if joint_model.nv == 6:
            parent = result.addJoint(
                parent, pin.JointModelTranslation(), placement, f"{name} moves"
            )
            joint_model, placement = pin.JointModelSpherical(), pin.SE3.Identity()
        new_indices[joint] = result.addJoint(parent, joint_model, placement, name)
    for joint, new_joint in new_indices.items():
        result.appendBodyToJoint(new_joint, model.inertias[joint], pin.SE3.Identity())
    for frame in list(model.frames)[1:]:
        joint = new_indices[frame.parentJoint]
        result.addFrame(pin.Frame(frame.name, joint, 0, frame.placement, frame.type), False)
    return result


def _sort_depth_first(model: pin.Model, preferred_order: Sequence[int]) -> Iterator[int]:
    """Yield joint indices in depth-first order; siblings in the order of ``preferred_order``."""
    rank = {joint: index for index, joint in enumerate(preferred_order)}
    children: dict[int, list[int]] = {}
    for joint in sorted(range(1, model.njoints), key=lambda joint: -rank.get(joint, -1)):
        children.setdefault(int(model.parents[joint]), []).append(joint)
    stack = children.get(0, [])
    while stack:
        joint = stack.pop()
        yield joint
        stack += children.get(joint, ())


PoseArrays = tuple[Array, Array]
"""Pose: rotation matrix (3, 3) and position (3,) [m]."""


class Kinematics:
    """Fast forward kinematics: positions of CoM, feet and links. Not thread-safe.

    Cheaper than a ``Configuration``, which also computes Jacobians.

    Args:
        structure: Structure of the robot.

    Attributes:
        qpos: Current configuration (nq,), read-only.
        com: CoM (x, y, z) [m] in the world.
        feet: {contact point: centre (x, y, z) [m] of the sphere} in the world.
        links: {link: (rotation (3, 3), origin (3,) [m])} in the world. The arrays are views of
            Pinocchio's memory: the next ``update`` changes them, unless memory sharing is disabled
            (see ``is_pinocchio_memory``).
    """

    qpos: Array
    com: list[float]
    feet: dict[str, list[float]]

    def __init__(self, structure: Structure) -> None:
        self._structure, self._model = structure, structure.model
        self._q = structure.convention.unit_q
        self._data = structure.model.createData()
        self.links: dict[str, PoseArrays] = {}
        self._feet: dict[str, Array] = {}
        self._com = np.zeros(0)

    def update(self, qpos: ArrayLike) -> None:
        """Compute the positions of CoM, feet and links in the world frame at a configuration.

        The results are stored in ``qpos``, ``com``, ``feet`` and ``links``.

        Args:
            qpos: Configuration, shape (nq,); the quaternion is normalised in a copy.

        Raises:
            ConfigurationError: If the length is wrong, a value is not finite, or the quaternion is
                zero.
        """
        state = check_vector("qpos", qpos, self._structure.nq)
        if self._structure.floating:
            normalise_quaternion(state)
        pin.framesForwardKinematics(self._model, self._data, self._q(state))
        pin.centerOfMass(self._model, self._data, pin.POSITION, False)
        if not is_pinocchio_memory(self._com):
            self._update_views()
        state.flags.writeable = False
        com = self._structure.total_com(self._com) if self._structure.fixed else self._com
        self.qpos, self.com = state, com.tolist()
        self.feet = {foot: place.tolist() for foot, place in self._feet.items()}

    def _update_views(self) -> None:
        """Store views of CoM, feet and links in Pinocchio's memory; reading them is fast."""
        places, structure = self._data.oMf, self._structure
        self._com = self._data.com[0]
        self._feet = {
            foot: places[placement].translation for foot, placement in structure.feet.items()
        }
        placement = {link: places[frame] for link, frame in structure.links.items()}
        self.links = {
            link: (place.rotation, place.translation) for link, place in placement.items()
        }


def is_pinocchio_memory(array: Array) -> bool:
    """Return True if an array is a view of Pinocchio's memory, which later computations overwrite.

    Pinocchio returns views by default, and copies after ``pin.sharedMemory(False)``.

    Args:
        array: Array that Pinocchio returned. For other arrays, the result is True for any view.
    """
    return not array.flags.owndata
