"""Closed kinematic loops and joint couplings from the equality constraints of an MJCF.

A URDF is a tree, and can only express ``<mimic>``. MuJoCo's residuals phi(q) are zero if the loops
are closed. With the Jacobian A of phi, A qvel = 0, and the constraints exert A^T lambda. The
dependent joints F have no motor and carry no torque:

    0 = x_F - A_F^T lambda,    x' = x - A^T lambda

for a generalised load x. The motors of the independent joints hold x' (principle of virtual work).

MuJoCo's constraints are soft: at rest each has an opening (``give``) that depends on its force. If
there are more equations than dependent joints (a planar loop has three equations, of which one is
redundant), the compliances determine the distribution of the load.
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
from pupper_analysis.robot.impedance import EqualityCompliance

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

CLOSED_ATOL = 1e-10
"""Residual of the independent loop equations [m, rad] below which Newton's method has closed a
loop. Chosen, not tuned."""

MAX_OPENING = 1e-6
"""Largest opening of a loop [m, rad] beyond its static deflection, with which the loop counts as
closed; a configuration with larger openings is rejected. Chosen, not tuned."""

_RANK_RTOL = 1e-7
"""Relative lower bound of the singular values of independent constraints. The redundant equation of
a planar loop has up to 1e-9 in files with rounded numbers."""

_MAX_ITERATIONS = 50
"""Maximum number of Newton iterations that close a loop. Chosen, not tuned."""

_MAX_NEWTON_STEP = 0.3
"""Upper bound of the displacement of a joint [rad, m] in a Newton step that closes a loop; longer
steps are scaled down. Chosen, not tuned."""

_START_ATOL = 1e-3
"""Maximum opening [m, rad] of the loops at the initial configuration of the file. Loops in qpos0
are closed to rounding, in keyframes to a millimetre."""

_DIFFERENCE_STEP = 1e-7
"""Step of the central differences of the loop springs by the joints [rad, m]. The step is small,
because the stiffness of a constraint varies within a millimetre of opening. Chosen, not tuned."""

_MAX_COMPLIANCE_FACTOR = 2.0
"""Safety factor of the accepted opening of a loop: opening / static deflection at maximum
compliance. The deflection is computed with the forces of the closed loop, which differ from those
of the opened loop. Chosen, not tuned."""

_FOOT_JOINT_MOBILITY = 1e-2
"""Mobility of joints that place feet, relative to other joints, while a loop is closed. The
positions of the feet in the initial guess should change little. Chosen, not tuned."""

_DISABLE_FLAGS = (
    *("mjDSBL_CONTACT", "mjDSBL_LIMIT", "mjDSBL_FRICTIONLOSS", "mjDSBL_ACTUATION"),
    "mjDSBL_SENSOR",
)


class Closure:
    """Closed loops and couplings of a robot.

    Args:
        model: MuJoCo model of the robot.
        convention: Coordinate maps of the model.
        joint_names: Joints in actuator order.

    Attributes:
        following: Indices (k,) of the dependent joints, which have no motor.
        leading: Indices (n,) of the other joints in loops and couplings.
        bonds: Types and names of the active equality constraints.
        tethered: Whether a constraint couples the robot to the world, which is not supported.
    """

    def __init__(
        self, model: mujoco.MjModel, convention: MujocoConvention, joint_names: Sequence[str]
    ) -> None:
        self._model = copy.copy(model)
        for flag in _DISABLE_FLAGS:
            self._model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, flag))
        self._model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE.value
        self._convention, self._joint_names = convention, tuple(joint_names)
        self._first_dof = len(convention.qvel_index) - len(joint_names)
        self._num_coordinates = len(convention.qpos_index)
        self._thread_data = threading.local()
        self.bonds = _list_constraints(model)
        self._is_used: NDArray[np.bool_] | None = None
        self._rank = len(joint_names)
        self._reference_qpos = self._find_closed_start()
        rows = self._generic_jacobian()
        used = np.flatnonzero(np.abs(rows).max(axis=0, initial=0.0) > _RANK_RTOL)
        self.following = self._select_followers(rows, used)
        self.leading = np.setdiff1d(used, self.following)
        # Joints that rotate a loop as a whole only matter while the loop is open.
        self._is_used = np.isin(np.arange(len(joint_names)), used)
        self._rank = len(self._independent_combinations(rows))
        self._loops = self._find_loops(rows)
        self._reference_rows = self.rows(self._reference_qpos)[:, self.following]

    def residual(self, qpos: Array) -> Array:
        """Return the openings (violations) of the constraints, shape (m,) [m, rad].

        Zero for closed loops.

        Args:
            qpos: Configuration, shape (nq,).
        """
        openings: Array = self._evaluate_constraints(qpos).efc_pos.copy()
        return openings

    def rows(self, qpos: Array) -> Array:
        """Return the Jacobian, shape (m, nu), of the openings by the joint positions.

        The pose of the base does not affect the openings.

        Args:
            qpos: Configuration, shape (nq,).
        """
        rows = self._jacobian(self._evaluate_constraints(qpos))[:, self._first_dof :]
        return rows if self._is_used is None else rows * self._is_used

    def give(self, qpos: Array, load: Array) -> Array:
        """Return the openings of the soft constraints under a static load, shape (m,) [m, rad].

        Same sign and order as ``residual``.

        Args:
            qpos: Configuration, shape (nq,).
            load: Static load of motors and constraints, shape (nu,) [N m, N].
        """
        forces = self._force_distribution(qpos) @ load[self.following]
        return -self._make_softness(qpos).opened(forces)

    def push(self, qpos: Array) -> Array:
        """Return the matrix P: the closed loops carry the part P x of a static joint load x.

        The motors carry the rest, x - P x, which is zero at the dependent joints (``following``),
        because these joints have no motor. P x depends only on the load of the dependent joints.

        Args:
            qpos: Configuration, shape (nq,).

        Returns:
            P, shape (nu, nu), for a load x of shape (nu,) [N m, N].

        Raises:
            ConfigurationError: If the configuration is singular.
        """
        matrix = np.zeros((len(self._joint_names), len(self._joint_names)))
        matrix[:, self.following] = self.rows(qpos).T @ self._force_distribution(qpos)
        # Exact, because dependent joints have no motor.
        matrix[self.following] = np.eye(len(self._joint_names))[self.following]
        return matrix

    def springs(self, qpos: Array) -> Array:
        """Return the joint torques and forces that the soft loop constraints exert at rest.

        tau = -A^T (r / c), with the Jacobian A, the openings r (constraint violations, m and rad),
        and the compliances c at the same openings. All velocities are zero.

        Args:
            qpos: Configuration, shape (nq,).

        Returns:
            Shape (nu,) [N m, N], acting on the robot.
        """
        forces: Array = self.rows(qpos).T @ (
            -self.residual(qpos) / self._make_softness(qpos).here()
        )
        return forces

    def spring_rates(self, qpos: Array) -> Array:
        """Return the derivative of ``springs`` by the joint positions, shape (nu, nu).

        Computed by central differences. Units: N m/rad for hinges, N/m for slides.

        Args:
            qpos: Configuration, shape (nq,).
        """
        first, columns = self._num_coordinates - len(self._joint_names), []
        for joint in range(first, self._num_coordinates):
            values = []
            for step in (_DIFFERENCE_STEP, -_DIFFERENCE_STEP):
                moved = qpos.copy()
                moved[joint] += step
                values.append(self.springs(moved))
            columns.append((values[0] - values[1]) / (2 * _DIFFERENCE_STEP))
        return np.array(columns).T

    def null_space(self, qpos: Array) -> Array:
        """Return an orthonormal basis, shape (nu, n), of joint velocities that keep loops closed.

        Args:
            qpos: Configuration, shape (nq,).
        """
        _, _, right = np.linalg.svd(self.rows(qpos))
        basis: Array = right[self._rank :].T
        return basis

    def bound(self, qpos: Array) -> tuple[Array, Array]:
        """Return linearly independent combinations of the constraint equations.

        Args:
            qpos: Configuration, shape (nq,).

        Returns:
            Jacobian, shape (r, nu), and openings, shape (r,) [m and rad mixed].
        """
        rows = self.rows(qpos)
        combinations = self._independent_combinations(rows)
        return combinations @ rows, combinations @ self.residual(qpos)

    def closed(self, qpos: Array, moving: Array, give: Array | None = None) -> Array | None:
        """Close the loops near a configuration, by Newton's method with minimum weighted step norm.

        Args:
            qpos: Configuration, shape (nq,), with open loops.
            moving: Mobility of each joint, shape (nu,): a joint with a lower value moves less.
            give: Required openings, shape (m,) [m, rad]; 0 by default.

        Returns:
            Configuration, shape (nq,), with the same base pose. None if the iteration does not
            converge, converges to another assembly mode, or (without ``give``) leaves a redundant
            equation open by `MAX_OPENING`.
        """
        result = self._close_by_newton(qpos, moving, give)
        return result if result is not None and self.as_built(result) else None

    def as_built(self, qpos: Array) -> bool:
        """Return True if the loops have the assembly mode of the reference configuration.

        In another assembly mode (for example, with crossed rods of a four-bar linkage), the
        determinant of the loop's Jacobian has the opposite sign.
        """
        rows = self.rows(qpos)[:, self.following]
        return all(
            float(np.linalg.det(rows[:, loop].T @ self._reference_rows[:, loop])) >= -_RANK_RTOL
            for loop in self._loops
        )

    def _close_by_newton(self, qpos: Array, moving: Array, give: Array | None) -> Array | None:
        """Close the loops as ``closed``, in any assembly mode."""
        result = qpos.copy()
        joints = result[self._num_coordinates - len(self._joint_names) :]  # a view
        for _ in range(_MAX_ITERATIONS):
            error = self.residual(result) - (0.0 if give is None else give)
            rows = self.rows(result)
            combinations = self._independent_combinations(rows)
            if np.abs(combinations @ error).max(initial=0.0) < CLOSED_ATOL:
                return (
                    result
                    if give is not None or np.abs(error).max(initial=0.0) < MAX_OPENING
                    else None
                )
            step = -moving * (np.linalg.pinv(combinations @ rows * moving) @ (combinations @ error))
            joints += step * min(1.0, _MAX_NEWTON_STEP / max(float(np.abs(step).max()), 1e-300))
        return None

    def open(self, qpos: Array) -> float:
        """Return the largest opening (violation) of the loops and couplings.

        Metres and radians are mixed. 0 without constraints.

        Args:
            qpos: Configuration, shape (nq,).
        """
        return float(np.abs(self.residual(qpos)).max(initial=0.0))

    def open_by(self, qpos: Array, give: Array | None = None) -> float:
        """Return the largest deviation of the openings from the required openings (m, rad mixed).

        Only independent combinations of equations count: in files with rounded numbers, a planar
        loop is open by nanometres in the redundant direction.
        """
        combinations = self._independent_combinations(self.rows(qpos))
        error = self.residual(qpos) - (0.0 if give is None else give)
        return float(np.abs(combinations @ error).max(initial=0.0))

    def check(self, qpos: Array, load: Array) -> None:
        """Raise an error unless the loops are closed, up to their deflection under a static load.

        The opening of each constraint may be ``MAX_OPENING`` plus ``_MAX_COMPLIANCE_FACTOR`` times
        the deflection of the constraint under its force, at the largest compliance.

        Args:
            qpos: Configuration, shape (nq,).
            load: Static load of motors and constraints, shape (nu,) [N m, N].

        Raises:
            ConfigurationError: If a loop is open, or the configuration is singular.
        """
        forces = self._force_distribution(qpos) @ load[self.following]
        allowed = MAX_OPENING + _MAX_COMPLIANCE_FACTOR * self._make_softness(qpos).most() * np.abs(
            forces
        )
        openings = np.abs(self.residual(qpos))
        if (openings > allowed).any():
            max_opening = Quantity(openings.max(), "rad or m")
            raise ConfigurationError(
                "qpos", diagnose("loops-open", bonds=self.bonds, off=max_opening)
            )

    def readiness(self, placing: IntArray) -> Array:
        """Return the mobility of each joint, shape (nu,), with which `closed` weights the steps.

        The mobility is 1, and low for joints that place feet, so that closing the loops moves feet
        little.

        Args:
            placing: Indices of the joints that place feet.
        """
        mobility = np.ones(len(self._joint_names))
        mobility[placing] = _FOOT_JOINT_MOBILITY
        return mobility

    def describe(self) -> Diagnostic:
        """Return a message that lists the dependent joints and the driving joints."""
        following = [self._joint_names[joint] for joint in self.following]
        leading = [self._joint_names[joint] for joint in self.leading]
        if not following:
            return diagnose("joints-bound", joints=leading)
        return diagnose("joints-follow", following=following, leading=leading)

    def _evaluate_constraints(self, qpos: Array) -> mujoco.MjData:
        """Return MuJoCo data of the current thread with constraint rows at a configuration."""
        thread_data, model = self._thread_data, self._model
        if not hasattr(thread_data, "data"):
            thread_data.data, thread_data.at = mujoco.MjData(model), np.full(len(qpos), np.nan)
        if not np.array_equal(qpos, thread_data.at):
            self._convention.set_state(thread_data.data, qpos)
            mujoco.mj_kinematics(model, thread_data.data)
            mujoco.mj_comPos(model, thread_data.data)
            mujoco.mj_tendon(model, thread_data.data)
            mujoco.mj_makeConstraint(model, thread_data.data)
            thread_data.at = qpos.copy()
        data: mujoco.MjData = thread_data.data
        return data

    def _jacobian(self, data: mujoco.MjData) -> Array:
        """Return the Jacobian (m, nv) in public coordinates from MuJoCo's data."""
        values = data.efc_J[: data.nefc * self._model.nv]  # MuJoCo may allocate more rows
        rows: Array = values.reshape(-1, self._model.nv)[:, self._convention.qvel_index]
        return rows

    def _make_softness(self, qpos: Array) -> EqualityCompliance:
        """Return the compliance of the constraints at a configuration, shape (nq,)."""
        return EqualityCompliance(self._model, self._evaluate_constraints(qpos))

    def _force_distribution(self, qpos: Array) -> Array:
        """Return the constraint forces (m, k) per unit load on the dependent joints.

        Of all forces that balance the load, the forces with minimum elastic energy are selected.

        Raises:
            ConfigurationError: If the configuration is singular.
        """
        stiffness = 1 / self._make_softness(qpos).here()
        rows = self.rows(qpos)[:, self.following]
        matrix = rows.T @ (stiffness[:, None] * rows)
        scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        scaled = scale[:, None] * matrix * scale
        if len(matrix) and np.linalg.eigvalsh(scaled)[0] < _RANK_RTOL**2:
            raise ConfigurationError("qpos", diagnose("loops-at-dead-point", bonds=self.bonds))
        solution = scale[:, None] * np.linalg.solve(scaled, scale[:, None] * rows.T)
        distribution: Array = stiffness[:, None] * solution.T
        return distribution

    def _find_closed_start(self) -> Array:
        """Return a configuration (nq,) with closed loops: qpos0, a keyframe, or Newton's result.

        If Newton's method does not converge, the result is qpos0.
        """
        model, index = self._model, self._convention.qpos_index
        starts = [np.array(pose)[index] for pose in (model.qpos0, *model.key_qpos)]
        for start in starts:
            if np.abs(self.residual(start)).max(initial=0.0) < _START_ATOL:
                return start
        closed = self._close_by_newton(starts[0], np.ones(len(self._joint_names)), None)
        return starts[0] if closed is None else closed

    def _generic_jacobian(self) -> Array:
        """Return the Jacobian (m, nu) near the reference configuration, where no leg is singular.

        Also set ``tethered``.
        """
        qpos, size = self._reference_qpos.copy(), len(self._joint_names)
        qpos[self._num_coordinates - size :] += np.random.default_rng(0).uniform(-0.1, 0.1, size)
        qpos = next(
            (
                closed
                for closed in [self._close_by_newton(qpos, np.ones(size), None)]
                if closed is not None
            ),
            qpos,
        )
        rows = self._jacobian(self._evaluate_constraints(qpos))
        # An open loop may rotate the base, but only a constraint with the world translates it.
        self.tethered = bool(np.abs(rows[:, : min(3, self._first_dof)]).max(initial=0.0) > 1e-6)
        return rows[:, self._first_dof :]

    def _independent_combinations(self, rows: Array) -> Array:
        """Return the combinations (r, m) of the rows (m, nu) that are independent."""
        left_vectors, singular_values, _ = np.linalg.svd(rows, full_matrices=False)
        count = int(
            np.count_nonzero(singular_values > _RANK_RTOL * singular_values.max(initial=0.0))
        )
        combinations: Array = left_vectors[:, : min(count, self._rank)].T
        return combinations

    def _find_loops(self, rows: Array) -> tuple[IntArray, ...]:
        """Return the positions in ``following`` of the joints of each group of connected loops."""
        is_coupled = np.abs(rows[:, self.following]) > _RANK_RTOL
        loops: list[tuple[set[int], NDArray[np.bool_]]] = []  # (joints, mask of their equations)
        for joint in range(is_coupled.shape[1]):
            joints, equations = {joint}, is_coupled[:, joint]
            for loop in [loop for loop in loops if (loop[1] & equations).any()]:
                loops.remove(loop)
                joints, equations = joints | loop[0], equations | loop[1]
            loops.append((joints, equations))
        return tuple(np.array(sorted(joints), dtype=np.int64) for joints, _ in loops)

    def _select_followers(self, rows: Array, used: IntArray) -> IntArray:
        """Return the dependent joints: as many undriven joints as the constraints can determine.

        Followers of joint couplings are selected first.
        """
        undriven = [joint for joint in used if self._convention.actuator_index[joint] < 0]
        model = self._model
        coupled_joints = [
            self._joint_names.index(model.joint(int(model.eq_obj1id[index])).name)
            for index in range(model.neq)
            if model.eq_type[index] == mujoco.mjtEq.mjEQ_JOINT.value
            and model.joint(int(model.eq_obj1id[index])).name in self._joint_names
        ]
        preferred = [joint for joint in coupled_joints if joint in undriven]
        order = list(dict.fromkeys([*preferred, *reversed(undriven)]))
        chosen: list[int] = []
        for joint in order:
            singular_values = np.linalg.svd(rows[:, [*chosen, joint]], compute_uv=False)
            if (
                len(singular_values) > len(chosen)
                and singular_values[-1] > _RANK_RTOL * singular_values[0]
            ):
                chosen.append(int(joint))
        return np.array(sorted(chosen), dtype=np.int64)


def _list_constraints(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return types and names of the active equality constraints."""
    names = []
    for index in np.flatnonzero(model.eq_active0):
        kind = mujoco.mjtEq(int(model.eq_type[index])).name.removeprefix("mjEQ_").lower()
        names.append(f"{kind} {equality_name(model, int(index))}")
    return tuple(names)


def find_closure(
    model: mujoco.MjModel, convention: MujocoConvention, joint_names: Sequence[str]
) -> Closure | None:
    """Return the loops and couplings of a robot; None if there are none.

    The result is also None if the constraints are disabled, bind no joint, or couple the robot to
    the world.
    """
    disabled = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_EQUALITY
    if not model.eq_active0.any() or model.opt.disableflags & int(disabled):
        return None
    closure = Closure(model, convention, joint_names)
    has_joints = len(closure.leading) + len(closure.following) > 0
    return closure if has_joints and not closure.tethered else None
