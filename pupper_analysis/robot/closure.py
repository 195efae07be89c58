"""Closed loops and couplings of joints: what an MJCF's equality constraints ask of them.

A URDF is a tree, and states none of it but ``<mimic>``. MuJoCo's residuals phi(q) are zero where
loops are closed; with A their derivative, A qvel = 0, and the constraints push with A^T lambda.
Joints without a motor that are bound so carry nothing themselves:

    0 = x_F - A_F^T lambda,    x' = x - A^T lambda

for a load x that motors have to hold, F being the joints that follow: what would be theirs to carry
is carried by those that drive them (virtual work).

MuJoCo's constraints are soft: at rest each is open by its ``give``, in proportion to its force, as
the ground is. Where there are more constraints than joints that they bind (a loop in a plane has
three equations, one of which says nothing), the softness says which carries what.
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.mjcf import equality_name
from pupper_analysis.robot.coordinates import MujocoConvention
from pupper_analysis.robot.impedance import Softness

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

CLOSED = 1e-10
"""What may be left of a loop that is closed (m, rad)."""

OPEN = 1e-6
"""A loop that is open by more than this, and than its own softness, is not the robot's (m, rad)."""

_INDEPENDENT = 1e-7
"""Constraints whose singular value is less, in parts of the greatest, say nothing new: a planar
loop's equations across its plane, which rounded files leave with 1e-9."""

_MAX_ITERATIONS = 50
_LONGEST_NEWTON_STEP = 0.3  # rad, m: a longer Newton step is shortened

_NEARLY = 1e-3
"""Loops of a file's own start are closed to rounding, or in a keyframe to a millimetre (m, rad)."""

_DIFFERENCE_STEP = 1e-7
"""Of central differences (rad, m): softness changes within a millimetre."""

_SOFTER = 2.0
"""What a loop may be open by, in parts of its give where it is softest: forces are others where
it is closed, as at first a search has it."""

_UNMOVED = 1e-2
"""How much joints that place feet move, in parts of what others do, when a loop is closed: a start
that was made for the feet is to stay one."""

_OFF = (
    *("mjDSBL_CONTACT", "mjDSBL_LIMIT", "mjDSBL_FRICTIONLOSS", "mjDSBL_ACTUATION"),
    "mjDSBL_SENSOR",
)


class Closure:
    """The loops and couplings of a robot.

    Args:
        model: The robot's, in MuJoCo.
        convention: Its maps.
        joint_names: In actuator order.

    Attributes:
        following: (k,) numbers of the joints that others move: they have no motor.
        leading: (n,) numbers of those that move them, or are bound to each other.
        bonds: The equality constraints that bind them: their kinds and names.
        tethered: Whether something of it holds the robot in the world, which is not computed.
    """

    def __init__(
        self, model: mujoco.MjModel, convention: MujocoConvention, joint_names: Sequence[str]
    ) -> None:
        self._model = copy.copy(model)
        for flag in _OFF:
            self._model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, flag))
        self._model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE.value
        self._convention, self._joint_names = convention, tuple(joint_names)
        self._first = len(convention.qvel_index) - len(joint_names)
        self._size = len(convention.qpos_index)
        self._own = threading.local()
        self.bonds = _bonds(model)
        self._used: NDArray[np.bool_] | None = None
        self._rank = len(joint_names)
        self._reference = self._closed_start()
        rows = self._generic()
        used = np.flatnonzero(np.abs(rows).max(axis=0, initial=0.0) > _INDEPENDENT)
        self.following = self._followers(rows, used)
        self.leading = np.setdiff1d(used, self.following)
        # What turns a loop as a whole matters to one that is open alone, and then it turns with it.
        self._used = np.isin(np.arange(len(joint_names)), used)
        self._rank = len(self._turned(rows))
        self._loops = self._components(rows)
        self._held = self.rows(self._reference)[:, self.following]

    def residual(self, qpos: Array) -> Array:
        """Returns by how much the constraints are open (m,), in metres and radians."""
        opened: Array = self._look(qpos).efc_pos.copy()
        return opened

    def rows(self, qpos: Array) -> Array:
        """Returns their derivative (m, nu) by the joints; the base does not matter to them."""
        rows = self._jacobian(self._look(qpos))[:, self._first :]
        return rows if self._used is None else rows * self._used

    def give(self, qpos: Array, load: Array) -> Array:
        """Returns by how much the constraints are open at rest under a load.

        Args:
            qpos: (nq,) the configuration.
            load: (nu,) what motors and constraints hold (N m).

        Returns:
            (m,) like ``residual``.
        """
        forces = self._shares(qpos) @ load[self.following]
        return -self._softness(qpos).opened(forces)

    def push(self, qpos: Array) -> Array:
        """Returns P (nu, nu): of a load x the constraints hold P x, so that motors hold x - P x."""
        whole = np.zeros((len(self._joint_names), len(self._joint_names)))
        whole[:, self.following] = self.rows(qpos).T @ self._shares(qpos)
        # Exactly: what follows has no motor.
        whole[self.following] = np.eye(len(self._joint_names))[self.following]
        return whole

    def springs(self, qpos: Array) -> Array:
        """Returns what the constraints, as open as they are, push joints with (nu,), at rest."""
        pushed: Array = self.rows(qpos).T @ (-self.residual(qpos) / self._softness(qpos).here())
        return pushed

    def spring_rates(self, qpos: Array) -> Array:
        """Returns the derivative (nu, nu) of ``springs`` by the joints, by central differences."""
        first, columns = self._size - len(self._joint_names), []
        for joint in range(first, self._size):
            ends = []
            for way in (_DIFFERENCE_STEP, -_DIFFERENCE_STEP):
                moved = qpos.copy()
                moved[joint] += way
                ends.append(self.springs(moved))
            columns.append((ends[0] - ends[1]) / (2 * _DIFFERENCE_STEP))
        return np.array(columns).T

    def null_space(self, qpos: Array) -> Array:
        """Returns a basis (nu, n) of the joints' velocities that keep the loops closed."""
        _, _, right = np.linalg.svd(self.rows(qpos))
        basis: Array = right[self._rank :].T
        return basis

    def bound(self, qpos: Array) -> tuple[Array, Array]:
        """Returns independent rows (r, nu) of the derivative, and the residuals (r,) along them."""
        rows = self.rows(qpos)
        turned = self._turned(rows)
        return turned @ rows, turned @ self.residual(qpos)

    def closed(self, qpos: Array, moving: Array, give: Array | None = None) -> Array | None:
        """Closes the loops near a configuration, by Newton's iteration of least movement.

        Args:
            qpos: (nq,) the configuration.
            moving: (nu,) how readily each joint moves; see ``readiness``.
            give: (m,) by how much they are to stay open; 0 by default.

        Returns:
            (nq,) with other joints; None if it does not converge.
        """
        found = self._newton(qpos, moving, give)
        return found if found is not None and self.as_built(found) else None

    def as_built(self, qpos: Array) -> bool:
        """Tells whether loops are assembled as at the start, and not as beyond a dead point.

        There the determinant that closes a loop changes its sign: a four-bar's rods, say, cross.
        """
        held = self.rows(qpos)[:, self.following]
        return all(
            float(np.linalg.det(held[:, loop].T @ self._held[:, loop])) >= -_INDEPENDENT
            for loop in self._loops
        )

    def _newton(self, qpos: Array, moving: Array, give: Array | None) -> Array | None:
        """See ``closed``; whichever way the loops come to be assembled."""
        found = qpos.copy()
        joints = found[self._size - len(self._joint_names) :]  # a view
        for _ in range(_MAX_ITERATIONS):
            left = self.residual(found) - (0.0 if give is None else give)
            rows = self.rows(found)
            turned = self._turned(rows)
            if np.abs(turned @ left).max(initial=0.0) < CLOSED:
                return found if give is not None or np.abs(left).max(initial=0.0) < OPEN else None
            step = -moving * (np.linalg.pinv(turned @ rows * moving) @ (turned @ left))
            joints += step * min(1.0, _LONGEST_NEWTON_STEP / max(float(np.abs(step).max()), 1e-300))
        return None

    def open(self, qpos: Array) -> float:
        """Returns by how much the loops and couplings are open (m, rad)."""
        return float(np.abs(self.residual(qpos)).max(initial=0.0))

    def open_by(self, qpos: Array, give: Array | None = None) -> float:
        """Returns by how much the loops are open beyond what they give way (m, rad).

        As far as they can be closed: in rounded files a planar loop's ends are nanometres apart.
        """
        turned = self._turned(self.rows(qpos))
        left = self.residual(qpos) - (0.0 if give is None else give)
        return float(np.abs(turned @ left).max(initial=0.0))

    def check(self, qpos: Array, load: Array) -> None:
        """Checks that a configuration is one of the robot's, its loops closed but for their give.

        Raises:
            ConfigurationError: If it is not, or if it is a dead point.
        """
        forces = self._shares(qpos) @ load[self.following]
        allowed = OPEN + _SOFTER * self._softness(qpos).most() * np.abs(forces)
        off = np.abs(self.residual(qpos))
        if (off > allowed).any():
            most = Quantity(off.max(), "rad or m")
            raise ConfigurationError("qpos", diagnose("loops-open", bonds=self.bonds, off=most))

    def readiness(self, placing: IntArray) -> Array:
        """Returns ``moving`` (nu,) for ``closed`` where some joints place feet, and are to stay."""
        moving = np.ones(len(self._joint_names))
        moving[placing] = _UNMOVED
        return moving

    def describe(self) -> Diagnostic:
        """Tells which joints follow which."""
        following = [self._joint_names[joint] for joint in self.following]
        leading = [self._joint_names[joint] for joint in self.leading]
        if not following:
            return diagnose("joints-bound", joints=leading)
        return diagnose("joints-follow", following=following, leading=leading)

    def _look(self, qpos: Array) -> mujoco.MjData:
        """Returns MuJoCo's data, a thread's own, at a configuration, with the constraints' rows."""
        own, model = self._own, self._model
        if not hasattr(own, "data"):
            own.data, own.at = mujoco.MjData(model), np.full(len(qpos), np.nan)
        if not np.array_equal(qpos, own.at):
            self._convention.set_state(own.data, qpos)
            mujoco.mj_kinematics(model, own.data)
            mujoco.mj_comPos(model, own.data)
            mujoco.mj_tendon(model, own.data)
            mujoco.mj_makeConstraint(model, own.data)
            own.at = qpos.copy()
        data: mujoco.MjData = own.data
        return data

    def _jacobian(self, data: mujoco.MjData) -> Array:
        """Returns the derivative (m, nv) in public coordinates where the data are."""
        held = data.efc_J[: data.nefc * self._model.nv]  # room is made for bodies that cannot move
        rows: Array = held.reshape(-1, self._model.nv)[:, self._convention.qvel_index]
        return rows

    def _softness(self, qpos: Array) -> Softness:
        return Softness(self._model, self._look(qpos))

    def _shares(self, qpos: Array) -> Array:
        """Returns the constraints' forces (m, k) per load on the joints that follow.

        Of all that hold these, the ones with the least energy in the constraints' springs.

        Raises:
            ConfigurationError: If none do: at a dead point.
        """
        stiff = 1 / self._softness(qpos).here()
        held = self.rows(qpos)[:, self.following]
        matrix = held.T @ (stiff[:, None] * held)
        scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        scaled = scale[:, None] * matrix * scale
        if len(matrix) and np.linalg.eigvalsh(scaled)[0] < _INDEPENDENT**2:
            raise ConfigurationError("qpos", diagnose("loops-at-dead-point", bonds=self.bonds))
        solved = scale[:, None] * np.linalg.solve(scaled, scale[:, None] * held.T)
        shares: Array = stiff[:, None] * solved.T
        return shares

    def _closed_start(self) -> Array:
        """Returns a configuration (nq,) in which loops are closed as they are built, or nearly."""
        model, index = self._model, self._convention.qpos_index
        starts = [np.array(pose)[index] for pose in (model.qpos0, *model.key_qpos)]
        for start in starts:
            if np.abs(self.residual(start)).max(initial=0.0) < _NEARLY:
                return start
        found = self._newton(starts[0], np.ones(len(self._joint_names)), None)
        return starts[0] if found is None else found

    def _generic(self) -> Array:
        """Returns the derivative (m, nu) near the start, where no leg happens to be straight."""
        qpos, size = self._reference.copy(), len(self._joint_names)
        qpos[self._size - size :] += np.random.default_rng(0).uniform(-0.1, 0.1, size)
        qpos = next(
            (near for near in [self._newton(qpos, np.ones(size), None)] if near is not None), qpos
        )
        rows = self._jacobian(self._look(qpos))
        # An open loop turns the base; only what is tied to the world pulls it along.
        self.tethered = bool(np.abs(rows[:, : min(3, self._first)]).max(initial=0.0) > 1e-6)
        return rows[:, self._first :]

    def _turned(self, rows: Array) -> Array:
        """Returns what turns rows (m, nu) to those that are independent, (r, m)."""
        left, lengths, _ = np.linalg.svd(rows, full_matrices=False)
        count = int(np.count_nonzero(lengths > _INDEPENDENT * lengths.max(initial=0.0)))
        turned: Array = left[:, : min(count, self._rank)].T
        return turned

    def _components(self, rows: Array) -> tuple[IntArray, ...]:
        """Returns which of the joints that follow are in one loop, or in loops that share one."""
        held = np.abs(rows[:, self.following]) > _INDEPENDENT
        loops: list[tuple[set[int], NDArray[np.bool_]]] = []  # joints, and their equations
        for joint in range(held.shape[1]):
            joints, equations = {joint}, held[:, joint]
            for loop in [loop for loop in loops if (loop[1] & equations).any()]:
                loops.remove(loop)
                joints, equations = joints | loop[0], equations | loop[1]
            loops.append((joints, equations))
        return tuple(np.array(sorted(joints), dtype=np.int64) for joints, _ in loops)

    def _followers(self, rows: Array, used: IntArray) -> IntArray:
        """Finds joints without motors, as many as the constraints can move by the others."""
        unmoved = [joint for joint in used if self._convention.actuator_index[joint] < 0]
        model = self._model
        messages = [
            self._joint_names.index(model.joint(int(model.eq_obj1id[index])).name)
            for index in range(model.neq)
            if model.eq_type[index] == mujoco.mjtEq.mjEQ_JOINT.value
            and model.joint(int(model.eq_obj1id[index])).name in self._joint_names
        ]
        first = [joint for joint in messages if joint in unmoved]
        order = list(dict.fromkeys([*first, *reversed(unmoved)]))
        chosen: list[int] = []
        for joint in order:
            lengths = np.linalg.svd(rows[:, [*chosen, joint]], compute_uv=False)
            if len(lengths) > len(chosen) and lengths[-1] > _INDEPENDENT * lengths[0]:
                chosen.append(int(joint))
        return np.array(sorted(chosen), dtype=np.int64)


def _bonds(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names the equality constraints that act."""
    messages = []
    for index in np.flatnonzero(model.eq_active0):
        kind = mujoco.mjtEq(int(model.eq_type[index])).name.removeprefix("mjEQ_").lower()
        messages.append(f"{kind} {equality_name(model, int(index))}")
    return tuple(messages)


def closure_of(
    model: mujoco.MjModel, convention: MujocoConvention, joint_names: Sequence[str]
) -> Closure | None:
    """Returns a robot's loops and couplings; None if its MJCF has none that act."""
    disabled = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_EQUALITY
    if not model.eq_active0.any() or model.opt.disableflags & int(disabled):
        return None
    found = Closure(model, convention, joint_names)
    bound = len(found.leading) + len(found.following) > 0
    return found if bound and not found.tethered else None
