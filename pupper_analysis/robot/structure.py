"""What depends on a robot alone: numbers of frames and joints, orders of coordinates, workspaces.

It is worked out once per robot, so that a configuration, of which there may be thousands, looks
up no name and allocates nothing of Pinocchio's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.robot.coordinates import PinocchioConvention

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_MOST_SPARE = 32
"""Workspaces that are kept for later (some 10 kB each); those that are in use are not counted."""


_TRANSLATION = np.eye(6, 3)
"""What the base's translation in the world does to what it carries: it moves as much."""


class Workspace:
    """A Pinocchio ``Data`` that belongs to its holder alone; another may have it afterwards.

    Attributes:
        data: The data.
    """

    __slots__ = ("_spare", "data")

    def __init__(self, data: pin.Data, spare: list[pin.Data]) -> None:
        self.data, self._spare = data, spare

    def __del__(self) -> None:
        if len(self._spare) < _MOST_SPARE:
            self._spare.append(self.data)


class Structure:
    """What depends on a robot alone.

    Attributes:
        model: Pinocchio's model.
        convention: The maps between public coordinates and the model's.
        links: {link: number of its frame}.
        joints: {joint: its number}.
        feet: {foot: number of its frame}.
        parents: {foot: number of the joint that carries it}.
        total_mass: kg.
        fixed: Mass of what does not move, a fixed base's, in parts of the total.
        lever: (3,) its centre (m).
    """

    def __init__(
        self,
        model: pin.Model,
        convention: PinocchioConvention,
        joint_names: Sequence[str],
        foot_frames: Mapping[str, str],
    ) -> None:
        self.model, self.convention = model, convention
        # Of links of one name Pinocchio's own search finds the first.
        frames = [(n, f.name) for n, f in enumerate(model.frames) if f.type == pin.FrameType.BODY]
        self.links: dict[str, int] = {name: number for number, name in reversed(frames)}
        self.joints: dict[str, int] = {name: int(model.getJointId(name)) for name in joint_names}
        self.feet = {foot: self.links[frame] for foot, frame in foot_frames.items()}
        self.parents = {
            foot: int(model.frames[frame].parentJoint) for foot, frame in self.feet.items()
        }
        self.total_mass = float(sum(inertia.mass for inertia in model.inertias))
        self.fixed = float(model.inertias[0].mass) / self.total_mass if self.total_mass else 0.0
        self.lever = np.array(model.inertias[0].lever)
        base = np.arange(convention.base_nv)
        self._columns = np.concatenate([base, convention.v_index])
        one, other = np.meshgrid(self._columns, self._columns, indexing="ij")
        self._upper = np.minimum(one, other) * convention.nv + np.maximum(one, other)
        self._spare: list[pin.Data] = []

    def workspace(self) -> Workspace:
        """Returns a workspace that nobody else holds."""
        try:
            data = self._spare.pop()
        except IndexError:
            data = self.model.createData()
        return Workspace(data, self._spare)

    def share(self, spare: list[pin.Data]) -> None:
        """Takes workspaces from a pool that others take theirs from, too.

        Args:
            spare: Data of models with the same joints, axes and frames, which may have other
                numbers.
        """
        self._spare = spare

    def columns(self, jacobian: Array, turn: Array | None, *, with_base: bool = False) -> Array:
        """Returns J_pin T: Pinocchio's Jacobians (..., 3 or 6, nv) in public coordinates.

        Args:
            jacobian: The Jacobians, in world axes: of a point's velocity, and of rotation.
            turn: (3, 3) the base's rotation R; None for a fixed base.
            with_base: They are of points that move with the base, as feet do. J_pin has R itself in
                the first columns then, and R R^T = 1.
        """
        public: Array = jacobian.take(self._columns, axis=-1)
        if turn is not None:
            moved = _TRANSLATION[: public.shape[-2]] if with_base else public[..., :3] @ turn.T
            public[..., :3] = moved
        return public

    def dual(self, forces: Array, turn: Array | None) -> Array:
        """Returns T^T f_pin: Pinocchio's generalised forces (nv,) in public coordinates."""
        public: Array = forces.take(self._columns)
        if turn is not None:
            public[:3] = turn @ public[:3]
        return public

    def inertia(self, upper: Array, turn: Array | None) -> Array:
        """Returns T^T M_pin T of a matrix (nv, nv) whose upper triangle counts."""
        return self._turned(upper.take(self._upper), turn)

    def square(self, matrix: Array, turn: Array | None) -> Array:
        """Returns T^T A T of any matrix A (nv, nv)."""
        return self._turned(matrix.take(self._columns, axis=0).take(self._columns, axis=1), turn)

    @staticmethod
    def _turned(public: Array, turn: Array | None) -> Array:
        if turn is not None:
            public[:3] = turn @ public[:3]
            public[:, :3] = public[:, :3] @ turn.T
        return public

    def velocity(self, qvel: Array, turn: Array | None) -> Array:
        """Returns T qvel (nv,): Pinocchio's velocity of a public one."""
        own = np.empty(len(qvel))
        own[self._columns] = qvel
        if turn is not None:
            own[:3] = qvel[:3] @ turn
        return own

    def drift(self, qvel: Array, turn: Array | None) -> Array:
        """Returns dT/dt qvel (nv,): the base frame turns under a constant world velocity."""
        rate = np.zeros(len(qvel))
        if turn is not None:
            x, y, z = (qvel[:3] @ turn).tolist()
            a, b, c = qvel[3:6].tolist()
            rate[:3] = c * y - b * z, a * z - c * x, b * x - a * y
        return rate
