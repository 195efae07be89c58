"""What differences are judged by: the quantities of a model at many states, in both engines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.models.conversion import MujocoTree
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.robot.contact import foot_site
from pupper_analysis.robot.matching.trees import Reference
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


class MujocoBehaviour:
    """Evaluates the same quantities as `Behaviour` in MuJoCo, of models that differ in numbers."""

    def __init__(
        self,
        robot: Robot,
        reference: Reference,
        states: States,
        moved: Mapping[str, Array],
    ) -> None:
        """Looks up what all evaluations share: thousands of names, in a large robot.

        Args:
            robot: The robot.
            reference: Names the elements of the models.
            states: The states.
            moved: {joint: (3,) where its position is taken, from MuJoCo's anchor, in its body's
                axes}.
        """
        model, names = reference.model, reference.names
        self._reference, self._states, self._name = reference, states, robot.name
        self._convention = reference.convention()
        public = self._convention.qvel_index
        self._dofs = public[robot.nv - robot.nu :]
        self._joints = [names.joint(name).id for name in robot.joint_names]
        self._slides = model.jnt_type[self._joints] == JointKind.SLIDE
        self._coordinates = model.jnt_qposadr[self._joints]
        self._members = _members(robot, reference)
        frames = {**robot.description.contact_points, **robot.description.frames}
        self._frames = [frame for _, frame in frames.values()]
        self._local = np.array([moved.get(name, np.zeros(3)) for name in robot.joint_names])

    def __call__(self, model: mujoco.MjModel) -> dict[str, Array]:
        """Evaluates a model with the elements of the reference, at all states."""
        data, joints = mujoco.MjData(model), self._joints
        places = [foot_site(self._reference.names, frame, self._name) for frame in self._frames]
        carriers = [body for body, _ in places]
        positions = np.array([position for _, position in places])
        public = self._convention.qvel_index
        weights = np.where(self._members, self._reference.model.body_mass, 0.0)
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
            # MuJoCo's anchor of a slide is where it is at rest.
            anchors = data.xanchor[joints] + offsets_in_world(model, data, joints, self._local)
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


def offsets_in_world(
    model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[int], local: Array
) -> Array:
    """Turns vectors (n, 3) in the axes of the joints' bodies to the world's axes."""
    bodies = data.xmat[model.jnt_bodyid[joints]].reshape(-1, 3, 3)
    # Of a hinge they are along its axis, and later joints of its body do not turn that.
    along = np.sum(local * model.jnt_axis[joints], axis=1)[:, None] * data.xaxis[joints]
    hinges = model.jnt_type[joints] == JointKind.HINGE
    return np.where(hinges[:, None], along, np.einsum("nij,nj->ni", bodies, local))


def _members(robot: Robot, reference: Reference) -> list[bool]:
    """Returns which bodies (nbody,) of the reference are the robot's.

    On a fixed base all that is static counts, as in `pinocchio_from_mujoco`.
    """
    model, moving = reference.model, reference.bodies()
    kept = {robot.mj_model.body(body).name for body in range(robot.mj_model.nbody)}
    return [
        (body in moving or not (robot.floating or model.body_weldid[body]))
        and reference.names.body(body).name in kept
        for body in range(model.nbody)
    ]


class Behaviour:
    """Evaluates trees of parameters of one robot, all at the same states, in MuJoCo.

    A model of one structure serves all trees that differ in numbers alone. Whether Pinocchio makes
    the same of them, who asks both engines shows (``tools/crosscheck``).

    Attributes:
        states: The states.
    """

    def __init__(self, robot: Robot, states: States) -> None:
        """Keeps what the evaluations share."""
        self.states, self._robot = states, robot
        self._tree: MujocoTree | None = None
        self._in_tree: MujocoBehaviour | None = None

    def __call__(self, values: MultibodyTree) -> dict[str, Array]:
        """Evaluates the quantities that differences are judged by, at all states."""
        if self._tree is None or self._in_tree is None or not self._tree.fits(values):
            self._tree = MujocoTree(values)
            model = self._tree.model
            frames = {name: (name, name) for name in values.frames}
            description = replace(self._robot.description, contact_points={}, frames=frames)
            robot = replace(self._robot, description=description, mj_model=model)
            reference = Reference(model, model, robot.joint_names, self._tree.base)
            self._in_tree = MujocoBehaviour(robot, reference, self.states, {})
        else:
            self._tree.take(values)
        return self._in_tree(self._tree.model)


@dataclass(frozen=True, eq=False)
class States:
    """States and motor torques.

    Attributes:
        qpos: (n, nq).
        qvel: (n, nv).
        torques: (n, nu) (N m).
    """

    qpos: Array
    qvel: Array
    torques: Array


_LARGEST_ANGLE = 1e3
"""rad or m. Files state limits like 1e16 for none; such an angle has no digit after the point."""

_STRONG = 1e6
"""N m or N. Likewise."""


def random_states(robot: Robot, count: int, seed: int) -> States:
    """Draws states: joints inside their limits, the base anywhere, with velocities and torques."""
    rng = np.random.default_rng(seed)
    lower = np.where(np.isfinite(robot.lower_limits), robot.lower_limits, -np.pi)
    upper = np.where(np.isfinite(robot.upper_limits), robot.upper_limits, np.pi)
    # A file may have them the wrong way round; that is for the comparison to find.
    ends = np.clip(
        [np.minimum(lower, upper), np.maximum(lower, upper)], -_LARGEST_ANGLE, _LARGEST_ANGLE
    )
    qpos = rng.uniform(ends[0], ends[1], (count, robot.nu))
    if robot.floating:
        quaternion = rng.normal(size=(count, 4))
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        qpos = np.concatenate([rng.uniform(-1, 1, (count, 3)), quaternion, qpos], axis=1)
    efforts = np.where(np.isfinite(robot.effort_limits), robot.effort_limits, 1.0)
    efforts = np.clip(efforts, -_STRONG, _STRONG)
    return States(
        qpos=qpos,
        qvel=rng.normal(size=(count, robot.nv)),
        torques=rng.uniform(-np.abs(efforts), np.abs(efforts), (count, robot.nu)),
    )


MOST_IN_PINOCCHIO: Final = 200
"""Degrees of freedom of the largest robot whose engines are compared in Pinocchio, too.

Pinocchio's data hold four tensors of second derivatives, nv x nv x nv each, that nothing here asks
for: 32 nv^3 bytes, 0.26 GB at 200 and 256 GB at 2000, and as long as it takes to write them.
"""

_STATES: Final = 80e6
"""Bytes of the mass matrices of all states (nv x nv each), one evaluation's; there are five.

A robot of 306 degrees of freedom is compared at 106 states, one of 1000 at 10.
"""

_LEAST_STATES: Final = 2
"""States at which a robot of any size is compared: one may happen to be singular."""


def is_large(robot: Robot) -> bool:
    """Says whether a robot is too large for Pinocchio's data."""
    return robot.nv > MOST_IN_PINOCCHIO


def affordable_states(robot: Robot, count: int) -> int:
    """Returns at how many of so many states a robot is compared: all, unless it is large."""
    if not is_large(robot):
        return count
    return min(count, max(_LEAST_STATES, int(_STATES / (8 * robot.nv**2))))
