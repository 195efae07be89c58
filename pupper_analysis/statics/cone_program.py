"""Solve for contact forces in friction cones that keep a robot in static equilibrium.

Input: the linear balance equations of a robot (`Balance`), friction coefficients, and a criterion
(minimum norm, minimum peak torque, or maximum of a linear function). Output: a vector of contact
forces that satisfies balance and friction, or None if no such vector is found.

If the criterion is a norm and the optimum without cones is inside the cones, this optimum is
returned (LAPACK). Otherwise Clarabel solves a second-order cone program. For the cone program the
balance of the base, ``base_rows @ f = base_load``, is eliminated: ``f = particular + free @ z``
with ``free`` a basis of the null space, so that balance holds to rounding for every z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import SimpleNamespace

import clarabel
import numpy as np

from pupper_analysis.base import lapack
from pupper_analysis.base.array_types import Array

BALANCE_TOLERANCE = 1e-9
"""Largest residual norm of the balance equations that counts as zero, relative to the norm of the
base load (N and N m mixed). Also used for other comparisons of rounded numbers, such as normals.
Chosen, not tuned."""


MAX_TOTAL_NORMAL_FORCE = 10.0
"""Upper bound of the sum of all normal forces, in units of the robot's weight, for example in the
cone programs for the support region. Without the bound, forces between steep walls would balance
any CoM position. Chosen, not tuned."""

_CONE_MARGIN = 1e-6
"""Relative reduction of the friction coefficients (and of grip limits) in the cone program, so that
solutions satisfy the true cones in spite of the solver's rounding. Chosen, not tuned."""


_LARGE_FRICTION = 10.0
"""Friction coefficient above which the four rows of a friction cone are divided by the coefficient.
Without this scaling, Clarabel may fail for large coefficients. Chosen far above the coefficients of
real materials, so that usual cones stay unscaled."""


_TANGENTIAL_WEIGHT = 1e3
"""Weight of tangential force components relative to normal components in `TangentialMetric`. Chosen
so large that the normal forces hardly affect the tangential forces."""


_PEAK_SLACK = 1e-7
"""Relative slack of the peak utilisation in the second cone program of `Balance.min_max_torque`, so
that rounding does not make this program infeasible. Chosen, not tuned."""


_BOUND_TOLERANCE = 1e-6
"""Largest violation of an inequality of `Balance.maximize` with which a solution is accepted,
relative to the largest absolute value of the upper bounds. Chosen, not tuned."""


_MIN_RECIPROCAL_CONDITION = 1e-8
"""Smallest reciprocal condition number with which the linear equations for the contact forces count
as independent. Measured for four feet on level ground: 1e-4 with the weights of
`TangentialMetric`."""

_UP = np.array([0.0, 0.0, 1.0])
"""Normal of level ground in the world frame."""


def split_force(force: Sequence[float], normal: Sequence[float]) -> tuple[float, float]:
    """Split a contact force into the normal component and the norm of its tangential part.

    Args:
        force: Three components [N].
        normal: Unit vector out of the ground, in the same frame.

    Returns:
        Normal component, positive if the contact presses [N]; tangential norm [N].
    """
    (x, y, z), (a, b, c) = force, normal
    pressing = x * a + y * b + z * c
    return pressing, math.hypot(x - pressing * a, y - pressing * b, z - pressing * c)


@dataclass(frozen=True, eq=False)
class Balance:
    """Equations of static equilibrium with n contacts, w welds and g grips.

    The unknown vector f contains the contact forces (3 n,), then the wrenches of welds (6 w,), then
    the forces of grips (3 g,), all in world axes [N, N m]. Equilibrium means

        base_load = base_rows @ f            (satisfied to rounding)
        joint_load = joint_rows @ f + tau    (defines the motor torques tau)

    with contact forces in the friction cones and the norm of each grip force at most its limit.
    Weld wrenches are unbounded. Below, ``size`` is 3 n + 6 w + 3 g.

    Attributes:
        base_rows: Shape (k, size); rows of the transposed Jacobian that belong to the base, one
            row per prescribed normal force, and rows of passive joints that must have no torque.
        base_load: Shape (k,) [N, N m]; generalised force on the base, the prescribed forces, and
            the load of these passive joints.
        joint_rows: Shape (nu, size); rows of the transposed Jacobian that belong to the joints.
        joint_load: Shape (nu,) [N m, N]; motor torques without contact forces.
        normals: Shape (n, 3); unit vectors out of the ground, in the world frame.
        grips: Shape (g,) [N]; upper bounds of the norms of grip forces.
    """

    base_rows: Array
    base_load: Array
    joint_rows: Array
    joint_load: Array
    normals: Array
    grips: Array = field(default_factory=lambda: np.zeros(0))

    def minimum_tangential(self, friction: Array | None, metric: TangentialMetric) -> Array | None:
        """Compute the equilibrium forces with the smallest norm, mainly of tangential forces.

        Args:
            friction: Shape (n,); friction coefficients. None removes cones, unilateral limits and
                grip limits.
            metric: Weights of the minimised norm: large for tangential forces.

        Returns:
            Forces in world axes, shape (size,) [N, N m]: contact forces (3 n,), wrenches of welds
            (6 w,), forces of grips (3 g,). None if no such forces are found.
        """
        forces = metric.solve_min_norm(self.base_rows, self.base_load)
        if forces is not None:
            feasible = friction is None or self._largest_violation(forces, friction) <= 0
            if feasible and self._is_balanced(forces):
                return forces
        return self.solve(friction, metric, np.zeros(self.base_rows.shape[1]))

    def solve_normal_only(self) -> Array | None:
        """Compute equilibrium forces without tangential contact forces, with welds or grips.

        Welds or grips carry the rest of the load. Without tangential force, MuJoCo's regularised
        friction does not creep. With welds, the norm of the joint torques is minimised. With grips
        only, the norm of all forces is minimised, since minimum torque may put the load on the edge
        of a sole.

        Returns:
            Forces, shape (size,) [N, N m]: contacts (3 n,), welds (6 w,), grips (3 g,). None if no
            such forces are found.
        """
        count, size = len(self.normals), self.base_rows.shape[1]
        # Columns: n normal directions, then the unchanged columns of welds and grips.
        directions = np.zeros((size, size - 2 * count))
        for point, normal in enumerate(self.normals):
            directions[3 * point : 3 * point + 3, point] = normal
        directions[3 * count :, count:] = np.eye(size - 3 * count)
        reduced = replace(
            self,
            base_rows=self.base_rows @ directions,
            joint_rows=self.joint_rows @ directions,
            normals=np.zeros((0, 3)),
        )
        has_welds = size > 3 * (count + len(self.grips))
        if not has_welds:
            unknowns = size - 2 * count
            reduced = replace(reduced, joint_rows=np.eye(unknowns), joint_load=np.zeros(unknowns))
        found, no_friction = (
            reduced._solve_linear(reduced.joint_rows, reduced.joint_load),
            np.zeros(0),
        )
        if (
            found is not None
            and min([*found[:count], -reduced._largest_violation(found, no_friction)]) < 0
        ):
            particular, free = reduced._particular_and_null_space
            bounds = -free[:count], particular[:count]  # normal forces >= 0
            cost, target = (
                reduced.joint_rows @ free,
                reduced.joint_load - reduced.joint_rows @ particular,
            )
            coordinates = reduced._minimize_squares(
                particular, free, cost, target, no_friction, bounds
            )
            found = None if coordinates is None else particular + free @ coordinates
            rounding = BALANCE_TOLERANCE * float(np.linalg.norm(self.base_load))
            if found is not None and self.grips.size and found[:count].min(initial=0) < -rounding:
                return None  # with grips alone, balance without tangential forces may not exist
        return None if found is None else directions @ found

    def min_max_torque(self, friction: Array | None, limits: Array) -> Array | None:
        """Compute the equilibrium forces with the smallest peak motor utilisation |tau| / limit.

        Among the solutions with this peak, the norm of all utilisations is minimised. Motors
        without a finite, positive limit are ignored. If no motor has such a limit, torques replace
        utilisations.

        Args:
            friction: Shape (n,); friction coefficients. None removes cones, unilateral limits and
                grip limits; the norm is then minimised instead of the peak.
            limits: Shape (nu,) [N m or N]; effort limits.

        Returns:
            Forces, shape (size,) [N, N m]: contacts (3 n,), welds (6 w,), grips (3 g,). None if no
            such forces are found.
        """
        rated = np.isfinite(limits) & (limits > 0)
        weights = np.where(rated, 1 / np.where(rated, limits, 1.0), 0.0) if rated.any() else None
        weights = np.ones(len(limits)) if weights is None else weights
        cost, target = weights[:, None] * self.joint_rows, weights * self.joint_load
        return self.solve(friction, cost, target, peak=True)

    def maximize(self, linear: Array, friction: Array, rows: Array, upper: Array) -> Array | None:
        """Compute the equilibrium forces in the friction cones that maximise a linear function.

        Args:
            linear: Coefficients of the maximised function ``linear @ f``, shape (size,), in the
                order contacts (3 n,), welds (6 w,), grips (3 g,).
            friction: Shape (n,); friction coefficients.
            rows: Shape (m, size); coefficients of the inequality ``rows @ f <= upper``.
            upper: Shape (m,); upper bounds.

        Returns:
            Forces f, shape (size,) [N, N m]. None if no such forces are found, or if the maximum is
            unbounded.
        """
        particular, free = self._particular_and_null_space
        if not self._is_balanced(particular):
            return None
        bounds = rows @ free, upper - rows @ particular
        quadratic = np.zeros((free.shape[1],) * 2)
        found = self._solve_cone_program(
            particular, free, quadratic, -linear @ free, friction, bounds
        )
        if found is None:
            return None
        forces: Array = particular + free @ found
        # For contradicting bounds, Clarabel returns forces that exceed these.
        excess = float((rows @ forces - upper).max(initial=0.0))
        largest = float(np.abs(upper).max(initial=0.0))
        return forces if excess <= _BOUND_TOLERANCE * largest else None

    def solve(
        self,
        friction: Array | None,
        cost: Array | TangentialMetric,
        target: Array,
        *,
        peak: bool = False,
    ) -> Array | None:
        """Compute the forces f in equilibrium with the smallest norm |cost @ f - target|.

        f has the shape (size,) [N, N m] in the order contacts (3 n,), welds (6 w,), grips (3 g,).

        Args:
            friction: Shape (n,); friction coefficients. None removes cones, unilateral limits and
                grip limits: feet may pull and slip.
            cost: Matrix, shape (m, size), or a `TangentialMetric`, which provides the product
                ``cost @ f``.
            target: Shape (m,).
            peak: If True, minimise the largest absolute element of ``cost @ f - target`` first,
                then the norm. Has no effect if ``friction`` is None.

        Returns:
            Forces, shape (size,), or None if no such forces are found.
        """
        if not peak or friction is None:
            forces = self._solve_linear(cost, target)
            if forces is None or friction is None or self._largest_violation(forces, friction) <= 0:
                return forces
        particular, free = self._particular_and_null_space
        if not self._is_balanced(particular):
            return None
        cost, target = cost @ free, target - cost @ particular
        minimize = self._minimize_peak if peak else self._minimize_squares
        coordinates = minimize(particular, free, cost, target, friction)
        return None if coordinates is None else particular + free @ coordinates

    def _solve_linear(self, cost: Array | TangentialMetric, target: Array) -> Array | None:
        """Compute the forces f with the smallest |cost @ f - target|, subject to balance alone.

        Friction cones and grip limits are ignored. None if no forces balance the load.
        """
        if isinstance(cost, np.ndarray):
            forces = self._solve_by_gglse(cost, target)
            if forces is not None and self._is_balanced(forces):
                return forces
        particular, free = self._particular_and_null_space
        if not self._is_balanced(particular):
            return None
        coordinates = np.linalg.lstsq(cost @ free, target - cost @ particular)[0]
        return particular + free @ coordinates

    def _solve_by_gglse(self, cost: Array, target: Array) -> Array | None:
        """Compute the result of `_solve_linear` by LAPACK's ``gglse``, faster than by an SVD.

        None, for example, if the equations are (nearly) singular. Balance is not checked.
        """
        count, size = self.base_rows.shape
        if not count < size <= count + len(cost):
            return None
        free, triangle, _, forces, _ = lapack.dgglse(cost, self.base_rows, target, self.base_load)
        left = size - count
        conditions = lapack.dtrcon(triangle[:, left:])[0], lapack.dtrcon(free[:left, :left])[0]
        found: Array | None = forces if min(conditions) > _MIN_RECIPROCAL_CONDITION else None
        return found

    @cached_property
    def _particular_and_null_space(self) -> tuple[Array, Array]:
        """Minimum-norm balancing forces (size,), least squares; null-space basis (size, k)."""
        left, sizes, right = np.linalg.svd(self.base_rows)
        rank = int((sizes > 1e-12 * sizes[0]).sum())
        particular: Array = (left[:, :rank].T @ self.base_load / sizes[:rank]) @ right[:rank]
        return particular, right[rank:].T

    def normal_forces(self, forces: Array) -> Array:
        """Return the normal components of the contact forces, shape (n,) [N].

        Args:
            forces: Forces on contacts, welds and grips, shape (size,), in the order of `solve`.
        """
        parts: Array = (self._contact_part(forces) * self.normals).sum(axis=1)
        return parts

    def _normal_rows(self) -> Array:
        """Create the matrix (n, size) whose product with forces (size,) is the normal forces."""
        count = len(self.normals)
        rows, index = np.zeros((count, count, 3)), np.arange(count)
        rows[index, index] = self.normals
        num_other_columns = self.base_rows.shape[1] - 3 * count
        return np.hstack([rows.reshape(count, 3 * count), np.zeros((count, num_other_columns))])

    def _contact_part(self, forces: Array) -> Array:
        """Select the contact forces (n, 3) [N] from forces (size,) of contacts, welds and grips."""
        return forces[: self.normals.size].reshape(-1, 3)

    def _is_balanced(self, forces: Array) -> bool:
        """Return True if forces (size,) balance the base load, up to `BALANCE_TOLERANCE`."""
        error = math.hypot(*(self.base_rows @ forces - self.base_load).tolist())
        return error <= BALANCE_TOLERANCE * math.hypot(*self.base_load.tolist())

    def _largest_violation(self, forces: Array, friction: Array) -> float:
        """Return the largest violation of cones and grip limits [N]; positive if one exists."""
        excess = []
        for force, normal, coefficient in zip(
            self._contact_part(forces).tolist(),
            self.normals.tolist(),
            friction.tolist(),
            strict=True,
        ):
            pressing, tangential = split_force(force, normal)
            violation = tangential - coefficient * pressing
            excess.append(violation if coefficient else max(violation, -pressing))
        grip_forces = forces[len(forces) - 3 * len(self.grips) :].reshape(-1, 3)
        pairs = zip(grip_forces.tolist(), self.grips.tolist(), strict=True)
        excess += [math.hypot(*force) - limit for force, limit in pairs]
        return _nan_or_max(excess)

    def _make_cone_rows(self, friction: Array) -> Array:
        """Create the matrix (4 n + 4 g, size) of the second-order cones of n contacts and g grips.

        The product with forces (size,) is (mu f_n, t_x, t_y, t_z) for a contact, up to a positive
        factor, and 0 and the three components for a grip. mu is reduced by `_CONE_MARGIN`.
        """
        normals, count = self.normals, len(self.normals)
        rows, index = np.zeros((count, 4, count, 3)), np.arange(count)
        scale = np.where(friction > _LARGE_FRICTION, friction, 1.0)
        rows[index, 0, index] = (friction / scale * (1 - _CONE_MARGIN))[:, None] * normals
        tangential = np.eye(3) - normals[:, :, None] * normals[:, None, :]
        rows[index, 1:, index] = tangential / scale[:, None, None]
        cones: Array = rows.reshape(4 * count, 3 * count)
        num_other_columns = self.base_rows.shape[1] - 3 * count
        if not num_other_columns:
            return cones
        grips = np.kron(np.eye(len(self.grips)), np.eye(4, 3, k=-1))
        before_grips = np.zeros((len(grips), 3 * count + num_other_columns - grips.shape[1]))
        beside_contacts = np.zeros((4 * count, num_other_columns))
        return np.vstack([np.hstack([cones, beside_contacts]), np.hstack([before_grips, grips])])

    def _minimize_peak(
        self, particular: Array, free: Array, cost: Array, target: Array, friction: Array
    ) -> Array | None:
        """Compute null-space coordinates z (k,) with the smallest peak ``max |cost @ z - target|``.

        If possible, the norm is then minimised. The forces ``particular + free @ z`` must be inside
        the friction cones. None if no such z is found.
        """
        size = len(target)
        scale = float(np.abs(cost @ np.linalg.lstsq(cost, target)[0] - target).max(initial=0.0))
        scale = max(scale, float(np.abs(target).max(initial=0.0)), 1e-300)
        # Variables: z, and the scaled peak, which bounds each residual from both sides.
        above = np.column_stack([cost, -np.full(size, scale)])
        below = np.column_stack([-cost, -np.full(size, scale)])
        bounds = (np.concatenate([above, below]), np.concatenate([target, -target]))
        wide = np.column_stack([free, np.zeros(len(free))])
        peak = np.zeros(free.shape[1] + 1)
        peak[-1] = 1.0
        found = self._solve_cone_program(
            particular, wide, np.zeros((len(peak),) * 2), peak, friction, bounds
        )
        if found is None:
            return None
        minimum_peak = float(np.abs(cost @ found[:-1] - target).max(initial=0.0))
        slack = np.full(2 * size, minimum_peak * (1 + _PEAK_SLACK))
        bounds = (np.concatenate([cost, -cost]), np.concatenate([target, -target]) + slack)
        refined = self._minimize_squares(particular, free, cost, target, friction, bounds)
        return found[:-1] if refined is None else refined

    def _minimize_squares(
        self,
        particular: Array,
        free: Array,
        cost: Array,
        target: Array,
        friction: Array,
        bounds: tuple[Array, Array] | None = None,
    ) -> Array | None:
        """Compute the null-space coordinates z (k,) with the smallest |cost @ z - target|^2.

        The forces (size,) are ``particular + free @ z``, and must be inside the friction cones.
        ``bounds`` is (A, b) of a further constraint A z <= b. None if no such z is found.
        """
        quadratic = cost.T @ cost
        # In singular leg configurations some forces need no torque: select the smallest of them.
        quadratic += 1e-10 * np.trace(quadratic) * np.eye(len(quadratic))
        return self._solve_cone_program(
            particular, free, quadratic, -cost.T @ target, friction, bounds
        )

    def _solve_cone_program(
        self,
        particular: Array,
        free: Array,
        quadratic: Array,
        linear: Array,
        friction: Array,
        bounds: tuple[Array, Array] | None,
    ) -> Array | None:
        """Compute the z (k,) that minimises z^T quadratic z / 2 + linear z within friction cones.

        The forces ``particular + free @ z`` must be inside the cones. ``bounds`` contains A and b
        of a further constraint A z <= b, whose violation is not checked. None if no such z is
        found.
        """
        scale = np.linalg.norm(self.base_load[:3]) or 1.0  # a robot in free fall has no weight
        rows = self._make_cone_rows(friction)
        constants = np.zeros(len(rows))
        constants[4 * len(self.normals) :: 4] = self.grips * (1 - _CONE_MARGIN)
        matrix, right = [-rows @ free], [(rows @ particular + constants) / scale]
        cones: list[object] = [clarabel.SecondOrderConeT(4)] * (len(rows) // 4)
        if not friction.all():  # the cone of a contact without friction does not bound f_n
            normal_rows = self._normal_rows()[friction == 0]
            left, right_side = -normal_rows @ free, normal_rows @ particular
            if bounds is not None:
                left = np.concatenate([bounds[0], left])
                right_side = np.concatenate([bounds[1], right_side])
            bounds = left, right_side
        if bounds is not None:
            matrix.insert(0, bounds[0])
            right.insert(0, bounds[1] / scale)
            cones.insert(0, clarabel.NonnegativeConeT(len(bounds[1])))
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
        solver = clarabel.DefaultSolver(
            _to_csc(np.triu(quadratic)),
            linear / scale,
            _to_csc(np.concatenate(matrix)),
            np.concatenate(right),
            cones,
            settings,
        )
        coordinates = np.array(solver.solve().x) * scale
        if not np.abs(coordinates).max(initial=0.0) < 1e9 * scale:
            return None  # Clarabel returned a certificate (infeasible, unbounded), not a solution
        # Check the solution itself instead of the solver's status.
        excess = self._largest_violation(particular + free @ coordinates, friction)
        return coordinates if excess <= 1e-9 * scale else None


class TangentialMetric:
    """Weighting matrix W (size, size) with which |W f| is a norm of mainly the tangential forces.

    For a contact, W multiplies the normal component by 1 and the tangential components by
    `_TANGENTIAL_WEIGHT` / sqrt(viscosity). Components of welds and grips are multiplied by 1. The
    class implements the products with W and with the inverse, without the dense matrix.

    Args:
        normals: Shape (n, 3); unit vectors out of the ground.
        viscosity: Shape (n,); positive relative viscosities of the contacts (tangential force /
            creep velocity); 1 by default.
    """

    def __init__(self, normals: Array, viscosity: Array | None = None) -> None:
        equal = np.ones(len(normals))
        self._normals = normals
        self._weights = (_TANGENTIAL_WEIGHT / np.sqrt(equal if viscosity is None else viscosity))[
            :, None
        ]
        self._diagonal: Array | None = None  # W is diagonal on level ground
        if (normals == _UP).all():
            scale = np.ones((len(normals), 3))
            scale[:, :2] = self._weights
            self._diagonal = scale.ravel()

    def __matmul__(self, forces: Array) -> Array:
        if len(forces) > self._normals.size:
            contacts, other_forces = np.split(forces, [self._normals.size])
            return np.concatenate([self @ contacts, other_forces])
        if self._diagonal is not None:
            return (self._diagonal * forces.T).T
        return self._scale_tangential(self._weights, forces)

    def apply_inverse(self, forces: Array) -> Array:
        """Multiply forces by the inverse W^-1 of this weighting matrix.

        ``forces`` and the result have the shape (size,) or (size, k).
        """
        if len(forces) > self._normals.size:
            contacts, other_forces = np.split(forces, [self._normals.size])
            return np.concatenate([self.apply_inverse(contacts), other_forces])
        if self._diagonal is not None:
            return (forces.T / self._diagonal).T
        return self._scale_tangential(1 / self._weights, forces)

    def _scale_tangential(self, weights: Array, forces: Array) -> Array:
        """Multiply the tangential parts of contact forces (3 n,) or (3 n, k) by weights (n, 1)."""
        columns = forces.reshape(len(self._normals), 3, -1)
        normals = self._normals[:, :, None]
        along_normals = normals * (normals * columns).sum(axis=1, keepdims=True)
        product: Array = along_normals + weights[:, :, None] * (columns - along_normals)
        return product.reshape(forces.shape)

    def solve_min_norm(self, rows: Array, right: Array) -> Array | None:
        """Solve ``rows @ f = right`` for the f with the smallest weighted norm |W f|.

        With u the minimum-norm solution of (rows W^-1) u = right, f = W^-1 u. This form avoids W^T
        W, which would square the condition number of W.

        Returns:
            Shape (size,). None if the rows are linearly dependent or nearly dependent.
        """
        count, size = rows.shape
        if size < count:
            return None
        padded = np.zeros(size)
        padded[:count] = right
        triangle, found, _ = lapack.dgels(self.apply_inverse(rows.T).T, padded)
        if lapack.dtrcon(triangle[:, :count], uplo="L")[0] < _MIN_RECIPROCAL_CONDITION:
            return None
        return self.apply_inverse(found.ravel())


def _to_csc(matrix: Array) -> SimpleNamespace:
    """Convert a dense matrix to an object with the fields of a ``csc_matrix`` that Clarabel reads.

    The import of ``scipy.sparse`` itself would take 0.1 s.
    """
    by_column = matrix.T
    columns, rows = np.nonzero(by_column)
    ends = np.searchsorted(columns, np.arange(len(by_column) + 1))
    return SimpleNamespace(
        data=by_column[columns, rows],
        indices=rows.astype(np.int32),
        indptr=ends.astype(np.int32),
        shape=matrix.shape,
        has_canonical_format=True,  # sorted, and without duplicates
    )


def _nan_or_max(values: list[float]) -> float:
    """Return the largest number: NaN if the sum of the numbers is NaN, -inf for an empty list."""
    return math.nan if math.isnan(sum(values)) else max(values, default=-math.inf)
