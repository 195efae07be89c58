"""Contact forces in friction cones that balance a robot: a second-order cone programme."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.linalg import lapack

Array = NDArray[np.float64]

BALANCE_TOLERANCE = 1e-9
"""Residual of the static balance that counts as zero, relative to the weight."""


_INSIDE = 1e-6
"""The cones are narrowed by this much for the solver, so that its rounding stays inside them."""


_TANGENTIAL = 1e3
"""Weight of tangential forces against normal ones, for the minimum-tangential distribution."""


_PEAK_SLACK = 1e-7
"""How much above the least peak the second search may be: ten times the first one's rounding."""


_INDEPENDENT = 1e-8
"""Reciprocal condition from which on rows count as independent. Four feet in a square have 1e-2;
below it singular values decide, slowly."""

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Balance:
    """weight = base f and torques = joints f + tau, f in friction cones; f is (3 n,).

    Wrenches of welds come after these, (6 w,), and are in no cone; and then the forces of grips,
    (3 g,), each of which is at most ``grips``.
    """

    base: Array
    weight: Array
    joints: Array
    torques: Array
    normals: Array
    grips: Array = field(default_factory=lambda: np.zeros(0))

    def minimum_tangential(self, friction: Array | None, metric: TangentialMetric) -> Array | None:
        """Returns the least tangential f (3 n,), or None if there is none.

        Args:
            friction: (n,) coefficients.
            metric: By what "least" is measured.
        """
        forces = metric.shortest(self.base, self.weight)
        if forces is not None:
            held = friction is None or self._violation(forces, friction) <= 0
            if held and self._balances(forces):
                return forces
        return self.solve(friction, metric, np.zeros(self.base.shape[1]))

    def pressing(self) -> Array | None:
        """Returns the f (3 n + 6 w + 3 g,) of least |tau| that only presses; None if there is none.

        Beside a weld, which takes what is left, that is what lasts: no force along a plane, so that
        nothing creeps, and along normals those that spare the motors. Beside grips alone, no weld,
        they are as equal as may be: to spare motors a sole would stand on its edge.
        """
        count, size = len(self.normals), self.base.shape[1]
        along = np.zeros((size, size - 2 * count))
        along[: 3 * count, :count] = linalg.block_diag(*self.normals[:, :, None])
        along[3 * count :, count:] = np.eye(size - 3 * count)
        own = replace(
            self,
            base=self.base @ along,
            joints=self.joints @ along,
            normals=np.zeros((0, 3)),
        )
        welded = size > 3 * (count + len(self.grips))
        if not welded:
            own = replace(own, joints=np.eye(size - 2 * count), torques=np.zeros(size - 2 * count))
        found, nothing = own._without_cones(own.joints, own.torques), np.zeros(0)
        if found is not None and min([*found[:count], -own._violation(found, nothing)]) < 0:
            particular, free = own._by_singular_values
            bounds = -free[:count], particular[:count]
            cost, target = own.joints @ free, own.torques - own.joints @ particular
            least = own._solve_cones(particular, free, cost, target, nothing, bounds)
            found = None if least is None else particular + free @ least
            tiny = BALANCE_TOLERANCE * float(np.linalg.norm(self.weight))
            if found is not None and self.grips.size and found[:count].min(initial=0.0) < -tiny:
                return None  # beside grips alone there need be none
        return None if found is None else along @ found

    def min_max_torque(self, friction: Array | None, limits: Array) -> Array | None:
        """Returns the f (3 n,) of least peak |tau| / limit, or None if there is none.

        A motor without a limit, or with none of its own strength (0), does not count, but where no
        motor has a limit all count alike.
        """
        rated = np.isfinite(limits) & (limits > 0)
        share = np.where(rated, 1 / np.where(rated, limits, 1.0), 0.0) if rated.any() else None
        share = np.ones(len(limits)) if share is None else share
        cost, target = share[:, None] * self.joints, share * self.torques
        return self.solve(friction, cost, target, peak=True)

    def farthest(self, linear: Array, friction: Array, rows: Array, most: Array) -> Array | None:
        """Returns the f (3 n,) in the cones of greatest linear f, or None if there is none.

        Args:
            linear: (3 n,).
            friction: (n,) coefficients.
            rows: (k, 3 n) of what is bounded, rows f <= most.
            most: (k,) these bounds.
        """
        particular, free = self._by_singular_values
        if not self._balances(particular):
            return None
        bounds = rows @ free, most - rows @ particular
        quadratic = np.zeros((free.shape[1],) * 2)
        found = self._conic(particular, free, quadratic, -linear @ free, friction, bounds)
        return None if found is None else particular + free @ found

    def solve(
        self,
        friction: Array | None,
        cost: Array | TangentialMetric,
        target: Array,
        *,
        peak: bool = False,
    ) -> Array | None:
        """Returns the f (3 n,) with the least |cost f - target|, or None if there is none.

        Args:
            friction: (n,) coefficients; None if feet are held to the ground and may pull and slip.
            cost: (m, 3 n), or what multiplies as such a matrix does.
            target: (m,).
            peak: The least greatest element comes first.
        """
        if not peak or friction is None:
            forces = self._without_cones(cost, target)
            if forces is None or friction is None or self._violation(forces, friction) <= 0:
                return forces
        particular, free = self._by_singular_values
        if not self._balances(particular):
            return None
        cost, target = cost @ free, target - cost @ particular
        search = self._solve_peak if peak else self._solve_cones
        coordinates = search(particular, free, cost, target, friction)
        return None if coordinates is None else particular + free @ coordinates

    def _without_cones(self, cost: Array | TangentialMetric, target: Array) -> Array | None:
        """Returns the f (3 n,) that balances with the least |cost f - target|; see ``solve``."""
        if isinstance(cost, np.ndarray):
            forces = self._by_one_decomposition(cost, target)
            if forces is not None and self._balances(forces):
                return forces
        particular, free = self._by_singular_values
        if not self._balances(particular):
            return None
        best = np.linalg.lstsq(cost @ free, target - cost @ particular)[0]
        return particular + free @ best  # f = particular + free z

    def _by_one_decomposition(self, cost: Array, target: Array) -> Array | None:
        """Does so where but one f has the least, by rows that are independent; None elsewhere.

        A third of the time of singular values, which then decide.
        """
        count, size = self.base.shape
        if not count < size <= count + len(cost):
            return None
        free, triangle, _, forces, _ = lapack.dgglse(cost, self.base, target, self.weight)
        left = size - count
        conditions = lapack.dtrcon(triangle[:, left:])[0], lapack.dtrcon(free[:left, :left])[0]
        found: Array | None = forces if min(conditions) > _INDEPENDENT else None
        return found

    @cached_property
    def _by_singular_values(self) -> tuple[Array, Array]:
        """The shortest f (3 n,) that balances, or nearly, and a basis of those that do nothing."""
        left, sizes, right = np.linalg.svd(self.base)
        rank = int((sizes > 1e-12 * sizes[0]).sum())
        particular: Array = (left[:, :rank].T @ self.weight / sizes[:rank]) @ right[:rank]
        return particular, right[rank:].T

    def normal_forces(self, forces: Array) -> Array:
        """Returns the normal parts (n,) of forces (3 n,)."""
        parts: Array = (self._of_contacts(forces) * self.normals).sum(axis=1)
        return parts

    def _of_contacts(self, forces: Array) -> Array:
        """Returns the contacts' part (n, 3) of forces (3 n + 6 w,)."""
        return forces[: self.normals.size].reshape(-1, 3)

    def _balances(self, forces: Array) -> bool:
        error = math.hypot(*(self.base @ forces - self.weight).tolist())
        return error < BALANCE_TOLERANCE * math.hypot(*self.weight.tolist())

    def _violation(self, forces: Array, friction: Array) -> float:
        """Returns the largest tangential force beyond its cone (N); negative inside all."""
        excess = []
        for (x, y, z), (a, b, c), coefficient in zip(
            self._of_contacts(forces).tolist(),
            self.normals.tolist(),
            friction.tolist(),
            strict=True,
        ):
            pressing = x * a + y * b + z * c
            sliding = math.hypot(x - pressing * a, y - pressing * b, z - pressing * c)
            excess.append(sliding - coefficient * pressing)
        gripping = forces[len(forces) - 3 * len(self.grips) :].reshape(-1, 3)
        held = zip(gripping.tolist(), self.grips.tolist(), strict=True)
        excess += [math.hypot(*force) - most for force, most in held]
        return _nan_or_max(excess)

    def _cones(self, friction: Array) -> Array:
        """Returns rows (4 n + 4 g, 3 n + 6 w + 3 g): per foot (mu f_n, f_t), per grip (0, f)."""
        normals, count = self.normals, len(self.normals)
        rows, each = np.zeros((count, 4, count, 3)), np.arange(count)
        rows[each, 0, each] = (friction * (1 - _INSIDE))[:, None] * normals
        rows[each, 1:, each] = np.eye(3) - normals[:, :, None] * normals[:, None, :]
        cones: Array = rows.reshape(4 * count, 3 * count)
        others = self.base.shape[1] - 3 * count
        if not others:
            return cones
        held = np.kron(np.eye(len(self.grips)), np.eye(4, 3, k=-1))
        left = np.zeros((len(held), 3 * count + others - held.shape[1]))
        free = np.zeros((4 * count, others))
        return np.vstack([np.hstack([cones, free]), np.hstack([left, held])])

    def _solve_peak(
        self, particular: Array, free: Array, cost: Array, target: Array, friction: Array
    ) -> Array | None:
        """Minimises the greatest |cost z - target|, then their squares, in the cones."""
        size = len(target)
        scale = float(np.abs(cost @ np.linalg.lstsq(cost, target)[0] - target).max(initial=0.0))
        scale = max(scale, float(np.abs(target).max(initial=0.0)), 1e-300)
        # Variables: z and the peak, which bounds every element from both sides.
        above = np.column_stack([cost, -np.full(size, scale)])
        below = np.column_stack([-cost, -np.full(size, scale)])
        bounds = (np.concatenate([above, below]), np.concatenate([target, -target]))
        wide = np.column_stack([free, np.zeros(len(free))])
        peak = np.zeros(free.shape[1] + 1)
        peak[-1] = 1.0
        found = self._conic(particular, wide, np.zeros((len(peak),) * 2), peak, friction, bounds)
        if found is None:
            return None
        least = float(np.abs(cost @ found[:-1] - target).max(initial=0.0))
        room = np.full(2 * size, least * (1 + _PEAK_SLACK))
        bounds = (np.concatenate([cost, -cost]), np.concatenate([target, -target]) + room)
        again = self._solve_cones(particular, free, cost, target, friction, bounds)
        return found[:-1] if again is None else again

    def _solve_cones(
        self,
        particular: Array,
        free: Array,
        cost: Array,
        target: Array,
        friction: Array,
        bounds: tuple[Array, Array] | None = None,
    ) -> Array | None:
        """Minimises |cost z - target|^2 over the z with particular + free z in the cones."""
        quadratic = cost.T @ cost
        # Where legs are singular some forces cost no torque: the smallest of those.
        quadratic += 1e-10 * np.trace(quadratic) * np.eye(len(quadratic))
        return self._conic(particular, free, quadratic, -cost.T @ target, friction, bounds)

    def _conic(
        self,
        particular: Array,
        free: Array,
        quadratic: Array,
        linear: Array,
        friction: Array,
        bounds: tuple[Array, Array] | None,
    ) -> Array | None:
        """Minimises z^T quadratic z / 2 + linear z, particular + free z in the cones.

        ``bounds`` are rows A and b of A z <= b.
        """
        scale = np.linalg.norm(self.weight[:3]) or 1.0  # nothing to carry: a robot in free fall
        rows = self._cones(friction)
        most = np.zeros(len(rows))
        most[4 * len(self.normals) :: 4] = self.grips * (1 - _INSIDE)
        matrix, right = [-rows @ free], [(rows @ particular + most) / scale]
        cones: list[object] = [clarabel.SecondOrderConeT(4)] * (len(rows) // 4)
        if bounds is not None:
            matrix.insert(0, bounds[0])
            right.insert(0, bounds[1] / scale)
            cones.insert(0, clarabel.NonnegativeConeT(len(bounds[1])))
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
        solver = clarabel.DefaultSolver(
            _sparse(np.triu(quadratic)),
            linear / scale,
            _sparse(np.concatenate(matrix)),
            np.concatenate(right),
            cones,
            settings,
        )
        coordinates = np.array(solver.solve().x) * scale
        if not np.abs(coordinates).max(initial=0.0) < 1e9 * scale:
            return None  # the certificate of an infeasible problem
        # RelativeError the answer itself, not the solver's opinion of it.
        excess = self._violation(particular + free @ coordinates, friction)
        return coordinates if excess <= 1e-9 * scale else None


class TangentialMetric:
    """The (3 n, 3 n) matrix whose product with f shall be short: tangential forces weigh more.

    Args:
        normals: (n, 3).
        grip: (n,) the feet's viscosities, relative to each other; by default they are alike.
    """

    def __init__(self, normals: Array, grip: Array | None = None) -> None:
        alike = np.ones(len(normals))
        self._normals = normals
        self._weights = (_TANGENTIAL / np.sqrt(alike if grip is None else grip))[:, None]
        self._diagonal: Array | None = None  # where the ground is level, the matrix has no more
        if (normals == _UP).all():
            scale = np.ones((len(normals), 3))
            scale[:, :2] = self._weights
            self._diagonal = scale.ravel()

    def __matmul__(self, forces: Array) -> Array:
        if len(forces) > self._normals.size:  # what welds and grips do counts as normal forces do
            own, others = np.split(forces, [self._normals.size])
            return np.concatenate([self @ own, others])
        if self._diagonal is not None:
            return (self._diagonal * forces.T).T
        return self._times(self._weights, forces)

    def _undone(self, forces: Array) -> Array:
        """Returns the product with the inverse."""
        if len(forces) > self._normals.size:
            own, others = np.split(forces, [self._normals.size])
            return np.concatenate([self._undone(own), others])
        if self._diagonal is not None:
            return (forces.T / self._diagonal).T
        return self._times(1 / self._weights, forces)

    def _times(self, weights: Array, forces: Array) -> Array:
        columns = forces.reshape(len(self._normals), 3, -1)
        normals = self._normals[:, :, None]
        along = normals * (normals * columns).sum(axis=1, keepdims=True)
        product: Array = along + weights[:, :, None] * (columns - along)
        return product.reshape(forces.shape)

    def shortest(self, rows: Array, right: Array) -> Array | None:
        """Returns the f (3 n,) of rows f = right with the shortest product with this matrix W.

        That is W^-1 u, u being the shortest with rows W^-1 u = right: no square of W's condition.
        None if the rows are dependent, or nearly so.
        """
        count, size = rows.shape
        if size < count:
            return None
        wanted = np.zeros(size)
        wanted[:count] = right
        triangle, found, _ = lapack.dgels(self._undone(rows.T).T, wanted)
        if lapack.dtrcon(triangle[:, :count], uplo="L")[0] < _INDEPENDENT:
            return None
        return self._undone(found.ravel())


def _sparse(matrix: Array) -> sparse.csc_matrix:
    """Returns a matrix as Clarabel takes it: a third of the time that SciPy's own way takes."""
    by_column = matrix.T
    columns, rows = np.nonzero(by_column)
    ends = np.searchsorted(columns, np.arange(len(by_column) + 1))
    given = by_column[columns, rows], rows.astype(np.int32), ends.astype(np.int32)
    return sparse.csc_matrix(given, shape=matrix.shape)


def _nan_or_max(values: list[float]) -> float:
    return math.nan if math.isnan(sum(values)) else max(values, default=-math.inf)
