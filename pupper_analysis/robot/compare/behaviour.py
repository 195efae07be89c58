"""Evaluation of models at many random states in MuJoCo, for a comparison of their dynamics.

Input: a multibody tree (`Behaviour`) or a MuJoCo model (`MujocoBehaviour`), and random states
within the limits of the robot (`random_states`). Output: {quantity: values at all states}, in the
coordinates of ``robot.coordinates``. Quantities: mass matrix, gravity, bias forces, CoM, forward
dynamics, positions of joints and feet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.models.conversion import MujocoTree
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.robot.contact import foot_site
from pupper_analysis.robot.matching.trees import Reference
from pupper_analysis.robot.robot import Robot


class MujocoBehaviour:
    """Evaluation of the compared quantities for MuJoCo models that differ only in parameters.

    Call the object with a model to evaluate mass matrix, gravity, bias forces, CoM, forward
    dynamics, and positions of joints and feet at all states.
    """

    def __init__(
        self,
        robot: Robot,
        reference: Reference,
        states: States,
        moved: Mapping[str, Array],
    ) -> None:
        """Store the states and the element ids of all evaluations.

        Args:
            robot: The robot.
            reference: Compiled MJCF, and element names.
            states: States and torques at which the quantities are evaluated.
            moved: {joint: vector (3,) [m] from MuJoCo's joint anchor to the evaluated point of the
                joint, in the axes of the body}.
        """
        model, names = reference.model, reference.names
        self._reference, self._states, self._name = reference, states, robot.name
        self._convention = reference.convention()
        public = self._convention.qvel_index
        self._dofs = public[robot.nv - robot.nu :]
        self._joints = [names.joint(name).id for name in robot.joint_names]
        self._slides = model.jnt_type[self._joints] == JointKind.SLIDE
        self._coordinates = model.jnt_qposadr[self._joints]
        self._is_robot_body = _mask_robot_bodies(robot, reference)
        frames = {**robot.description.contact_points, **robot.description.frames}
        self._frames = [frame for _, frame in frames.values()]
        self._local_offsets = np.array([moved.get(name, np.zeros(3)) for name in robot.joint_names])

    def __call__(self, model: mujoco.MjModel) -> dict[str, Array]:
        """Evaluate a model: {quantity, such as ``mass matrix``: values at all states}.

        Args:
            model: Model with the same elements as the reference.
        """
        data, joints = mujoco.MjData(model), self._joints
        places = [foot_site(self._reference.names, frame, self._name) for frame in self._frames]
        carriers = [body for body, _ in places]
        positions = np.array([position for _, position in places])
        public = self._convention.qvel_index
        weights = np.where(self._is_robot_body, model.body_mass, 0.0)
        full = np.zeros((model.nv, model.nv))
        rows: dict[str, list[Array]] = {}
        states = zip(self._states.qpos, self._states.qvel, self._states.torques, strict=True)
        for qpos, qvel, torques in states:
            self._convention.set_state(data, qpos)
            data.qfrc_applied[:] = 0.0
            mujoco.mj_forward(model, data)
            gravity = data.qfrc_bias[public].copy()
            self._convention.set_state(data, qpos, qvel)
            data.qfrc_applied[self._dofs] = torques
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, full)
            # MuJoCo's anchor of a slide is its position at qpos0.
            anchors = data.xanchor[joints] + compute_offsets_in_world(
                model, data, joints, self._local_offsets
            )
            slid = data.qpos[self._coordinates] - model.qpos0[self._coordinates]
            slid = np.where(self._slides, slid, 0.0)
            result = {
                "mass matrix": full[np.ix_(public, public)],
                "gravity": gravity,
                "bias forces": data.qfrc_bias[public].copy(),
                "com": weights @ data.xipos / max(weights.sum(), 1e-300),
                "forward dynamics": data.qacc[public].copy(),
                "joint positions": anchors + slid[:, None] * data.xaxis[joints],
            }
            if places:
                turned = np.einsum("nij,nj->ni", data.xmat[carriers].reshape(-1, 3, 3), positions)
                result["foot positions"] = data.xpos[carriers] + turned
            for name, value in result.items():
                rows.setdefault(name, []).append(value)
        return {name: np.array(values) for name, values in rows.items()}


def compute_offsets_in_world(
    model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[int], local: Array
) -> Array:
    """Rotate one vector per joint from the axes of the joint's body to world axes.

    The vector of a hinge is projected onto the joint axis.

    Args:
        model: MuJoCo model.
        data: Data with kinematics.
        joints: Ids of n joints.
        local: Vectors, shape (n, 3), in the axes of the bodies that the joints move, in any unit.

    Returns:
        Vectors, shape (n, 3), in world axes, in the same unit.
    """
    bodies = data.xmat[model.jnt_bodyid[joints]].reshape(-1, 3, 3)
    # The vector of a hinge is parallel to its axis, which later joints of the body do not rotate.
    along = np.sum(local * model.jnt_axis[joints], axis=1)[:, None] * data.xaxis[joints]
    hinges = model.jnt_type[joints] == JointKind.HINGE
    return np.where(hinges[:, None], along, np.einsum("nij,nj->ni", bodies, local))


def _mask_robot_bodies(robot: Robot, reference: Reference) -> list[bool]:
    """Return a mask (nbody,) that separates the robot's bodies from other objects of the MJCF."""
    model, moving = reference.model, reference.bodies()
    kept = {robot.mj_model.body(body).name for body in range(robot.mj_model.nbody)}
    return [
        (body in moving or not (robot.floating or model.body_weldid[body]))
        and reference.names.body(body).name in kept
        for body in range(model.nbody)
    ]


class Behaviour:
    """Evaluation of the compared quantities for multibody trees of a robot, in MuJoCo.

    Call the object with a tree to evaluate mass matrix, gravity, bias forces, CoM, forward
    dynamics, and positions of joints and feet at all states. If a tree has the same structure as
    the previous tree, the MuJoCo model is reused.

    Attributes:
        states: States of the evaluation.
    """

    def __init__(self, robot: Robot, states: States) -> None:
        """Store the robot and the states; the model is compiled at the first call."""
        self.states, self._robot = states, robot
        self._tree: MujocoTree | None = None
        self._evaluate_tree: MujocoBehaviour | None = None

    def __call__(self, values: MultibodyTree) -> dict[str, Array]:
        """Evaluate a tree: {quantity, such as ``mass matrix``: values at all states}."""
        if (
            self._tree is None
            or self._evaluate_tree is None
            or not self._tree.has_structure_of(values)
        ):
            self._tree = MujocoTree(values)
            model = self._tree.model
            frames = {name: (name, name) for name in values.frames}
            description = replace(self._robot.description, contact_points={}, frames=frames)
            robot = replace(self._robot, description=description, mj_model=model)
            reference = Reference(model, model, robot.joint_names, self._tree.base)
            self._evaluate_tree = MujocoBehaviour(robot, reference, self.states, {})
        else:
            self._tree.copy_parameters(values)
        return self._evaluate_tree(self._tree.model)


@dataclass(frozen=True, eq=False)
class States:
    """States and joint torques at which two models are compared.

    Attributes:
        qpos: Configurations, shape (n, nq).
        qvel: Velocities, shape (n, nv).
        torques: Joint torques and forces, shape (n, nu) [N m, N].
    """

    qpos: Array
    qvel: Array
    torques: Array


_MAX_JOINT_POSITION = 1e3
"""Upper bound of the absolute joint position of a random state [rad, m]. Some files use limits such
as 1e16 for unlimited joints. Numbers of this size have no fractional digits in double precision."""

_MAX_EFFORT = 1e6
"""Upper bound of the absolute torque of a random state [N m, N], because some files state huge
limits. Chosen, not tuned."""


def random_states(robot: Robot, count: int, seed: int) -> States:
    """Return pseudo-random states and torques within the limits of a robot.

    - Joint positions: uniform within the joint limits, clipped to 1000 rad or m; +-pi [rad, m]
      replaces a missing limit.
    - Torques: uniform within the effort limits, clipped to 1e6 N m or N; +-1 replaces a missing
      limit.
    - Velocities: normally distributed with a standard deviation of 1 [m/s, rad/s].
    - Free base: any orientation, position within +-1 m in each coordinate.

    Args:
        robot: The robot.
        count: Number of states.
        seed: Seed of the random numbers.
    """
    rng = np.random.default_rng(seed)
    lower = np.where(np.isfinite(robot.lower_limits), robot.lower_limits, -np.pi)
    upper = np.where(np.isfinite(robot.upper_limits), robot.upper_limits, np.pi)
    # Limits may be exchanged in a file, which the comparison reports.
    limits = np.clip(
        [np.minimum(lower, upper), np.maximum(lower, upper)],
        -_MAX_JOINT_POSITION,
        _MAX_JOINT_POSITION,
    )
    qpos = rng.uniform(limits[0], limits[1], (count, robot.nu))
    if robot.floating:
        quaternion = rng.normal(size=(count, 4))
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        qpos = np.concatenate([rng.uniform(-1, 1, (count, 3)), quaternion, qpos], axis=1)
    efforts = np.where(np.isfinite(robot.effort_limits), robot.effort_limits, 1.0)
    efforts = np.clip(efforts, -_MAX_EFFORT, _MAX_EFFORT)
    return States(
        qpos=qpos,
        qvel=rng.normal(size=(count, robot.nv)),
        torques=rng.uniform(-np.abs(efforts), np.abs(efforts), (count, robot.nu)),
    )


MAX_PINOCCHIO_NV: Final = 200
"""Largest number of degrees of freedom (nv) of a robot that is also compared in Pinocchio; bounds
the memory. Pinocchio's data contain four tensors of second derivatives (nv, nv, nv) that are not
needed here. The tensors take 32 nv^3 bytes: 0.26 GB for nv = 200, and 256 GB for nv = 2000."""

_MAX_STATE_BYTES: Final = 80e6
"""Memory that the mass matrices of all states of a large robot should not exceed [bytes]. The bound
limits the number of states: 106 states for 306 degrees of freedom, 10 states for 1000.
Chosen, not tuned."""

_MIN_STATES: Final = 2
"""Lower bound of the limited number of random states of a large robot; a single state might be
singular. Chosen, not tuned."""


def is_large(robot: Robot) -> bool:
    """Return True if a robot has more than 200 degrees of freedom (`MAX_PINOCCHIO_NV`).

    Such a robot is not compared in Pinocchio, whose data would take too much memory.
    """
    return robot.nv > MAX_PINOCCHIO_NV


def count_affordable_states(robot: Robot, count: int) -> int:
    """Return the number of random states for a comparison: ``count``, or fewer for a large robot.

    For a large robot (`is_large`), the mass matrices of all states should take at most 80 MB
    (`_MAX_STATE_BYTES`).

    Args:
        robot: The robot.
        count: Requested number of states.
    """
    if not is_large(robot):
        return count
    return min(count, max(_MIN_STATES, int(_MAX_STATE_BYTES / (8 * robot.nv**2))))
