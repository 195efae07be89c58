"""Closed kinematic loops and joint couplings from the equality constraints of an MJCF.

A URDF is a tree; apart from ``<mimic>``, it cannot express constraints. MuJoCo's residuals phi(q)
are the constraint violations: they are zero if the loops are closed. With the Jacobian A of phi, A
qvel = 0, and the constraints exert A^T lambda. The dependent joints (index F) have no motor and
exert no torque:

    0 = x_F - A_F^T lambda,    x' = x - A^T lambda

for a generalised load x. The motors of the independent joints hold x' (principle of virtual work).

MuJoCo's constraints are soft: at rest, each constraint has a static deflection that depends on its
force. There may be more equations than dependent joints: a planar loop has three equations, of
which one is redundant. The compliances then determine the distribution of the load.
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.mjcf import equality_name
from pupper_analysis.robot.coordinates import MujocoConvention
from pupper_analysis.robot.impedance import EqualityCompliance

CLOSED_ATOL = 1e-10
"""Residual of the independent loop equations [m, rad] below which the loops count as closed, and
Newton's method ends. Chosen, not tuned."""

MAX_OPENING = 1e-6
"""Constraint violation [m, rad] above which an unloaded loop counts as open, and the configuration
is rejected. Under load, a static deflection is accepted in addition. Chosen, not tuned."""

_RANK_RTOL = 1e-7
"""Lower bound of a singular value of the constraint Jacobian, relative to the largest singular
value, above which an equation or a joint counts as independent [1]. Also the absolute value above
which elements and determinants count as nonzero. The redundant equation of a planar loop has a
ratio of up to 1e-9 in files with rounded numbers."""

_MAX_ITERATIONS = 50
"""Maximum number of Newton iterations that close a loop. Chosen, not tuned."""

_MAX_NEWTON_STEP = 0.3
"""Upper bound of the displacement of each joint [rad, m] in a Newton step that closes loops. A
longer step is scaled down. Chosen, not tuned."""

_START_ATOL = 1e-3
"""Constraint violation [m, rad] below which the loops of qpos0 or of a keyframe count as closed.
Such a configuration can be the reference configuration. A keyframe with a few digits may violate
constraints by almost a millimetre. Chosen, not tuned."""

_DIFFERENCE_STEP = 1e-7
"""Step of the joint positions [rad, m] in the central differences of the constraint torques. The
step is small, because the stiffness of a soft constraint varies within a millimetre of constraint
violation. Chosen, not tuned."""

_MAX_COMPLIANCE_FACTOR = 2.0
"""Factor of the static deflection of a loop constraint that `Closure.check` accepts [1]. It is
larger than 1, because the force is computed for the closed loop, not for the deflected loop.
Chosen, not tuned."""

_FOOT_JOINT_MOBILITY = 1e-2
"""Step weight [1] of joints that should stay in place when Newton's method closes loops, such as
joints between base and feet. Chosen, not tuned."""

_DISABLE_FLAGS = (
    *("mjDSBL_CONTACT", "mjDSBL_LIMIT", "mjDSBL_FRICTIONLOSS", "mjDSBL_ACTUATION"),
    "mjDSBL_SENSOR",
)
"""MuJoCo's disable flags that are set in the copy of the model with which `Closure` evaluates the
constraints. The equality constraints are then the only constraints."""


class Closure:
    """Closed loops and joint couplings of a robot: violations, Jacobians and load transfer.

    A dependent joint has no motor; its position follows from the constraints.

    Args:
        model: MuJoCo model of the robot.
        convention: Coordinate maps of the model.
        joint_names: Joints in actuator order.

    Attributes:
        dependent_joints: Indices of the dependent joints, shape (k,).
        driving_joints: Indices of the other joints in loops and couplings, shape (n,).
        constraint_names: Type and name of each active equality constraint, such as ``connect rod``.
        is_world_coupled: Whether a constraint couples a free base to the world, which is not
            supported.
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
        self.constraint_names = _list_constraints(model)
        self._is_used: NDArray[np.bool_] | None = None
        self._rank = len(joint_names)
        self._reference_qpos = self._find_closed_start()
        rows = self._compute_generic_jacobian()
        used = np.flatnonzero(np.abs(rows).max(axis=0, initial=0.0) > _RANK_RTOL)
        self.dependent_joints = self._select_dependent_joints(rows, used)
        self.driving_joints = np.setdiff1d(used, self.dependent_joints)
        # Joints that rotate a loop as a whole only matter while the loop is open.
        self._is_used = np.isin(np.arange(len(joint_names)), used)
        self._rank = len(self._independent_combinations(rows))
        self._loops = self._find_loops(rows)
        self._reference_rows = self.jacobian(self._reference_qpos)[:, self.dependent_joints]

    def residual(self, qpos: Array) -> Array:
        """Return the violations of the equality constraints, shape (m,) [m, rad].

        The violations are MuJoCo's ``efc_pos``, and are zero if all loops are closed.

        Args:
            qpos: Configuration, shape (nq,).
        """
        openings: Array = self._evaluate_constraints(qpos).efc_pos.copy()
        return openings

    def jacobian(self, qpos: Array) -> Array:
        """Return the Jacobian of the loop and coupling errors (`residual`), shape (m, nu).

        The derivatives are by the joint positions, in actuator order; columns of joints outside of
        loops and couplings are zero.

        Args:
            qpos: Configuration, shape (nq,).
        """
        rows = self._mujoco_jacobian(self._evaluate_constraints(qpos))[:, self._first_dof :]
        return rows if self._is_used is None else rows * self._is_used

    def static_deflection(self, qpos: Array, load: Array) -> Array:
        """Return the static deflection of the soft constraints under a load, shape (m,) [m, rad].

        Sign and order are the same as in ``residual``.

        Args:
            qpos: Configuration, shape (nq,), with closed loops.
            load: Joint torques and forces that motors and constraints must exert together, shape
                (nu,) [N m, N].

        Raises:
            ConfigurationError: If the configuration is singular.
        """
        forces = self._force_distribution(qpos) @ load[self.dependent_joints]
        return -self._evaluate_compliance(qpos).solve_violations(forces)

    @property
    def num_restrained_motions(self) -> int:
        """Number of independent motions of driven joints that the constraints prevent.

        It is the rank of the constraint Jacobian minus the number of dependent joints.
        """
        return self._rank - len(self.dependent_joints)

    def load_transfer(self, qpos: Array) -> Array:
        """Return the matrix P that maps a joint load x to the torques P x of the loop constraints.

        The motors exert the remaining load x - P x, which is zero at the dependent joints.

        Args:
            qpos: Configuration, shape (nq,).

        Returns:
            P, shape (nu, nu), for a load x of shape (nu,) [N m, N].

        Raises:
            ConfigurationError: If the configuration is singular.
        """
        matrix = np.zeros((len(self._joint_names), len(self._joint_names)))
        matrix[:, self.dependent_joints] = self.jacobian(qpos).T @ self._force_distribution(qpos)
        # The rows of dependent joints are exact unit rows, because these joints have no motor.
        matrix[self.dependent_joints] = np.eye(len(self._joint_names))[self.dependent_joints]
        return matrix

    def constraint_torques(self, qpos: Array) -> Array:
        """Return the joint torques and forces that the soft loop constraints exert at rest.

        tau = -A^T (r / c), with the Jacobian A, the constraint violations r [m, rad], and the
        compliances c [m/N, rad/(N m)] of the constraints. All velocities are zero.

        Args:
            qpos: Configuration, shape (nq,).

        Returns:
            Torques and forces on the joints, shape (nu,) [N m, N].
        """
        forces: Array = self.jacobian(qpos).T @ (
            -self.residual(qpos) / self._evaluate_compliance(qpos).current_compliance()
        )
        return forces

    def constraint_torque_jacobian(self, qpos: Array) -> Array:
        """Return the derivative of ``constraint_torques`` with respect to the joint positions.

        Computed by central differences.

        Args:
            qpos: Configuration, shape (nq,).

        Returns:
            Shape (nu, nu): rows are torques and forces [N m, N], columns are joint positions [rad,
            m].
        """
        first, columns = self._num_coordinates - len(self._joint_names), []
        for joint in range(first, self._num_coordinates):
            values = []
            for step in (_DIFFERENCE_STEP, -_DIFFERENCE_STEP):
                moved = qpos.copy()
                moved[joint] += step
                values.append(self.constraint_torques(moved))
            columns.append((values[0] - values[1]) / (2 * _DIFFERENCE_STEP))
        return np.array(columns).T

    def null_space(self, qpos: Array) -> Array:
        """Return an orthonormal basis, shape (nu, n), of joint velocities that keep loops closed.

        Args:
            qpos: Configuration, shape (nq,).
        """
        _, _, right = np.linalg.svd(self.jacobian(qpos))
        basis: Array = right[self._rank :].T
        return basis

    def independent_equations(self, qpos: Array) -> tuple[Array, Array]:
        """Select r independent combinations of the equations of all loops and couplings.

        Args:
            qpos: Configuration, shape (nq,).

        Returns:
            Jacobian with respect to the joint positions, shape (r, nu); constraint violations,
            shape (r,) [m and rad mixed].
        """
        rows = self.jacobian(qpos)
        combinations = self._independent_combinations(rows)
        return combinations @ rows, combinations @ self.residual(qpos)

    def close_loops(self, qpos: Array, moving: Array, give: Array | None = None) -> Array | None:
        """Close the loops near a configuration, by Newton's method with minimum weighted step norm.

        Args:
            qpos: Initial guess, shape (nq,), whose loops may be open.
            moving: Step weight of each joint, shape (nu,), 0 to 1. A joint with weight 0 does not
                move.
            give: Constraint violations that the result must have, shape (m,) [m, rad]: the static
                deflections under a load. Default: 0.

        Returns:
            Configuration, shape (nq,), with the base pose of ``qpos`` and the assembly mode of the
            reference configuration; None if no such configuration is found.
        """
        result = self._close_by_newton(qpos, moving, give)
        return result if result is not None and self.has_reference_assembly(result) else None

    def has_reference_assembly(self, qpos: Array) -> bool:
        """Return True if all loops have the assembly mode of the reference configuration.

        A four-bar linkage, for example, has two assembly modes: with and without crossed rods. The
        mode of a loop counts as different if det(A^T A_ref) < ``-_RANK_RTOL``. A is the Jacobian of
        the loop equations with respect to the dependent joints of the loop, A_ref its value in the
        reference configuration: qpos0 or a keyframe with closed loops, otherwise qpos0, if possible
        after its loops were closed.

        Args:
            qpos: Configuration, shape (nq,).
        """
        rows = self.jacobian(qpos)[:, self.dependent_joints]
        return all(
            float(np.linalg.det(rows[:, loop].T @ self._reference_rows[:, loop])) >= -_RANK_RTOL
            for loop in self._loops
        )

    def _close_by_newton(self, qpos: Array, moving: Array, give: Array | None) -> Array | None:
        """Close the loops as in `close_loops`, but accept any assembly mode; None if it fails."""
        result = qpos.copy()
        joints = result[self._num_coordinates - len(self._joint_names) :]  # a view
        for _ in range(_MAX_ITERATIONS):
            error = self.residual(result) - (0.0 if give is None else give)
            rows = self.jacobian(result)
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

    def largest_violation(self, qpos: Array) -> float:
        """Return the largest absolute constraint violation of the loops and couplings [m or rad].

        Args:
            qpos: Configuration, shape (nq,).
        """
        return float(np.abs(self.residual(qpos)).max(initial=0.0))

    def violation_error(self, qpos: Array, give: Array | None = None) -> float:
        """Return the largest difference between actual and required constraint violations.

        Metres and radians are mixed. The deviations are independent combinations of the equations,
        because files with rounded numbers violate the redundant equation of a planar loop by
        nanometres.

        Args:
            qpos: Configuration, shape (nq,).
            give: Required constraint violations, shape (m,) [m, rad]: the static deflections under
                a load. Default: 0.
        """
        combinations = self._independent_combinations(self.jacobian(qpos))
        error = self.residual(qpos) - (0.0 if give is None else give)
        return float(np.abs(combinations @ error).max(initial=0.0))

    def check(self, qpos: Array, load: Array) -> None:
        """Raise an error unless the loops are closed, up to their deflection under a static load.

        The accepted violation of a constraint is ``MAX_OPENING`` + ``_MAX_COMPLIANCE_FACTOR`` *
        force * compliance, with the largest compliance that the constraint can have.

        Args:
            qpos: Configuration, shape (nq,).
            load: Joint torques and forces that motors and constraints must exert together, shape
                (nu,) [N m, N].

        Raises:
            ConfigurationError: If a constraint violation exceeds the accepted violation, or the
                configuration is singular.
        """
        forces = self._force_distribution(qpos) @ load[self.dependent_joints]
        allowed = MAX_OPENING + _MAX_COMPLIANCE_FACTOR * self._evaluate_compliance(
            qpos
        ).max_compliance() * np.abs(forces)
        openings = np.abs(self.residual(qpos))
        if (openings > allowed).any():
            max_opening = Quantity(openings.max(), "rad or m")
            raise ConfigurationError(
                "qpos", diagnose("loops-open", bonds=self.constraint_names, off=max_opening)
            )

    def step_weights(self, placing: IntArray) -> Array:
        """Return step weights (nu,) with which `close_loops` moves given joints only a little.

        Args:
            placing: Indices of the given joints, for example of the joints between base and feet.
        """
        mobility = np.ones(len(self._joint_names))
        mobility[placing] = _FOOT_JOINT_MOBILITY
        return mobility

    def describe(self) -> Diagnostic:
        """Return a message that lists the dependent joints, if any, and the driving joints."""
        following = [self._joint_names[joint] for joint in self.dependent_joints]
        leading = [self._joint_names[joint] for joint in self.driving_joints]
        if not following:
            return diagnose("joints-bound", joints=leading)
        return diagnose("joints-follow", following=following, leading=leading)

    def _evaluate_constraints(self, qpos: Array) -> mujoco.MjData:
        """Return MuJoCo data (per thread, until the next call) with constraint rows at qpos."""
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

    def _mujoco_jacobian(self, data: mujoco.MjData) -> Array:
        """Return the constraint Jacobian (m, nv) of MuJoCo's data, columns in the order of qvel."""
        values = data.efc_J[: data.nefc * self._model.nv]  # MuJoCo may allocate more rows
        rows: Array = values.reshape(-1, self._model.nv)[:, self._convention.qvel_index]
        return rows

    def _evaluate_compliance(self, qpos: Array) -> EqualityCompliance:
        """Evaluate the compliance of the soft constraints at a configuration qpos, shape (nq,)."""
        return EqualityCompliance(self._model, self._evaluate_constraints(qpos))

    def _force_distribution(self, qpos: Array) -> Array:
        """Return the constraint forces (m, k) that carry a unit load on each of k dependent joints.

        Of all forces that balance the load, the forces with minimum elastic energy are selected. A
        singular configuration ``qpos``, shape (nq,), raises a ConfigurationError.
        """
        stiffness = 1 / self._evaluate_compliance(qpos).current_compliance()
        rows = self.jacobian(qpos)[:, self.dependent_joints]
        matrix = rows.T @ (stiffness[:, None] * rows)
        scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        scaled = scale[:, None] * matrix * scale
        if len(matrix) and np.linalg.eigvalsh(scaled)[0] < _RANK_RTOL**2:
            raise ConfigurationError(
                "qpos", diagnose("loops-at-dead-point", bonds=self.constraint_names)
            )
        solution = scale[:, None] * np.linalg.solve(scaled, scale[:, None] * rows.T)
        distribution: Array = stiffness[:, None] * solution.T
        return distribution

    def _find_closed_start(self) -> Array:
        """Return the reference configuration (nq,), with closed loops if possible, else qpos0."""
        model, index = self._model, self._convention.qpos_index
        starts = [np.array(pose)[index] for pose in (model.qpos0, *model.key_qpos)]
        for start in starts:
            if np.abs(self.residual(start)).max(initial=0.0) < _START_ATOL:
                return start
        closed = self._close_by_newton(starts[0], np.ones(len(self._joint_names)), None)
        return starts[0] if closed is None else closed

    def _compute_generic_jacobian(self) -> Array:
        """Return the constraint Jacobian (m, nu) at a generic pose, and set ``is_world_coupled``.

        The joint positions are random and near the reference configuration, so that no straight leg
        makes the Jacobian singular.
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
        rows = self._mujoco_jacobian(self._evaluate_constraints(qpos))
        # An open loop may rotate the base, but only a constraint with the world translates it.
        self.is_world_coupled = bool(
            np.abs(rows[:, : min(3, self._first_dof)]).max(initial=0.0) > 1e-6
        )
        return rows[:, self._first_dof :]

    def _independent_combinations(self, rows: Array) -> Array:
        """Return a matrix (r, m) of r independent combinations of the rows, shape (m, nu)."""
        left_vectors, singular_values, _ = np.linalg.svd(rows, full_matrices=False)
        count = int(
            np.count_nonzero(singular_values > _RANK_RTOL * singular_values.max(initial=0.0))
        )
        combinations: Array = left_vectors[:, : min(count, self._rank)].T
        return combinations

    def _find_loops(self, rows: Array) -> tuple[IntArray, ...]:
        """Group the dependent joints (by index) that share equations in ``rows``, shape (m, nu)."""
        is_coupled = np.abs(rows[:, self.dependent_joints]) > _RANK_RTOL
        loops: list[tuple[set[int], NDArray[np.bool_]]] = []  # (joints, mask of their equations)
        for joint in range(is_coupled.shape[1]):
            joints, equations = {joint}, is_coupled[:, joint]
            for loop in [loop for loop in loops if (loop[1] & equations).any()]:
                loops.remove(loop)
                joints, equations = joints | loop[0], equations | loop[1]
            loops.append((joints, equations))
        return tuple(np.array(sorted(joints), dtype=np.int64) for joints, _ in loops)

    def _select_dependent_joints(self, rows: Array, used: IntArray) -> IntArray:
        """Return the indices of joints without actuator that the constraints determine."""
        undriven = [joint for joint in used if self._convention.actuator_index[joint] < 0]
        model = self._model
        coupled_joints = [
            self._joint_names.index(model.joint(int(model.eq_obj1id[index])).name)
            for index in np.flatnonzero(model.eq_active0)
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
    """Return type and name of each active equality constraint, such as ``connect rod``."""
    names = []
    for index in np.flatnonzero(model.eq_active0):
        kind = mujoco.mjtEq(int(model.eq_type[index])).name.removeprefix("mjEQ_").lower()
        names.append(f"{kind} {equality_name(model, int(index))}")
    return tuple(names)


def find_closure(
    model: mujoco.MjModel, convention: MujocoConvention, joint_names: Sequence[str]
) -> Closure | None:
    """Find the closed loops and joint couplings of a robot.

    Args:
        model: MuJoCo model of the robot.
        convention: Coordinate maps of the model.
        joint_names: Joints in actuator order.

    Returns:
        The loops and couplings. None without active constraints of the robot's joints, for example,
        or if a constraint couples a free base to the world, which is not supported.
    """
    disabled = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_EQUALITY
    if not model.eq_active0.any() or model.opt.disableflags & int(disabled):
        return None
    closure = Closure(model, convention, joint_names)
    has_joints = len(closure.driving_joints) + len(closure.dependent_joints) > 0
    return closure if has_joints and not closure.is_world_coupled else None
