"""The least time along a path: a second-order cone programme in squared speed and contact forces.

With u the path's parameter, a = d2u/dt2 and b = (du/dt)^2, qvel is dq/du sqrt(b), and qacc
dq/du a + d2q/du2 b. So the balance of a robot, the torques of its motors and the limits of its
speed are linear in a, b and the contact forces f; friction cones are cones; a = (db/du) / 2 is
linear in b; and the time, the integral of du / sqrt(b), is convex. How quickly the acceleration may
change, |da/dt| <= J, is |da/du| <= J / sqrt(b), whose right side is convex: with its tangent, which
is below it, for it the programme stays one, and its answers keep to the bound.

Source: Verscheure et al., "Time-optimal path tracking for robots: a convex optimization approach"
(IEEE Trans. Automatic Control 54, 2009); with contact forces as in Hauser, "Fast interpolation and
time-optimization with contact" (Int. J. Robotics Research 33, 2014).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]

_TOLERANCE = 1e-8
"""Of the solver: a hundred-thousandth of what an iteration of the tangents leaves."""

_SLOWEST = 1e-4
"""Squared speed, in units of the guess's, below which no tangent is taken: it would be too steep
for the solver, and a place that is passed a hundred times slower does not count."""


@dataclass(frozen=True, eq=False)
class Demands:
    """What K places of a path demand, with n feet, forces in units of the weight, and m motors.

    Attributes:
        base: (K, rows, 3) along, square and rest: along a + square b + rest is what contact forces
            give.
        base_forces: (K, rows, 3 n) with which they do: equal to base_forces f.
        motors: (K, m, 3) along, square and rest of motors' torques, in units of their limits.
        motor_forces: (K, m, 3 n) what of it contact forces take: the rest is at most 1.
        fastest: (K,) the largest b that joints' speeds allow; infinite where none moves.
        normals: (n, 3) out of the ground.
        friction: (n,) coefficients.
        least: (K, n) normal forces at least.
        most: (K, n) normal forces at most; infinite without such a bound.
    """

    base: Array
    base_forces: Array
    motors: Array
    motor_forces: Array
    fastest: Array
    normals: Array
    friction: Array
    least: Array
    most: Array


@dataclass(frozen=True, eq=False)
class Grid:
    """How b, (N,) at nodes of a path's parameter, gives a and b at places, and the time.

    Attributes:
        acceleration: (K, N) a = acceleration b at the places.
        speed: (K, N) b there.
        sums: (P, N) and
        spans: (P,): the time is the sum of spans / (sums sqrt(b)).
        still: Nodes at which it rests.
        along: (K, 2) acceleration of the path's share s: along[:, 0] a + along[:, 1] b.
        steps: (K - 1,) of the parameter between places.
    """

    acceleration: Array
    speed: Array
    sums: Array
    spans: Array
    still: tuple[int, ...]
    along: Array
    steps: Array


def free_grid(shares: Array) -> Grid:
    """Returns the grid of an acceleration that may jump: b is linear between every other share.

    Args:
        shares: (2 P + 1,) places along the path, from rest to rest; demands are those of the odd.
    """
    nodes, places = shares[::2], shares[1::2]
    size, count = len(nodes), len(places)
    each = np.arange(count)
    steps = np.diff(nodes)
    right = (places - nodes[:-1]) / steps
    acceleration, speed, sums = (np.zeros((count, size)) for _ in range(3))
    acceleration[each, each], acceleration[each, each + 1] = -0.5 / steps, 0.5 / steps
    speed[each, each], speed[each, each + 1] = 1 - right, right
    sums[each, each] = sums[each, each + 1] = 1.0
    along = np.tile([1.0, 0.0], (count, 1))
    return Grid(acceleration, speed, sums, 2 * steps, (0, size - 1), along, np.diff(places))


def smooth_grid(progress: Array, along: Array) -> Grid:
    """Returns the grid of an acceleration without jumps: b is a cubic spline of every other place.

    Args:
        progress: (2 N - 1,) places of a parameter in which the path itself begins and ends at rest.
        along: (2 N - 1, 2) the share's derivatives with respect to it.
    """
    nodes = progress[::2]
    each = np.eye(len(nodes))
    law, steps = CubicSpline(nodes, each), np.diff(nodes)
    spans = (np.append(steps, 0.0) + np.append(0.0, steps)) / 2
    acceleration = law(progress, 1) / 2
    return Grid(acceleration, law(progress), each, spans, (), along, np.diff(progress))


def even_grid(along: Array) -> Grid:
    """Returns the grid of one b for all places: the path's parameter passes evenly.

    Args:
        along: (K, 2) as in ``smooth_grid``.
    """
    count = len(along)
    one = np.ones((1, 1))
    steps = np.full(count - 1, 1 / (count - 1))
    return Grid(np.zeros((count, 1)), np.ones((count, 1)), one, np.ones(1), (), along, steps)


@dataclass(frozen=True, eq=False)
class Optimum:
    """The least time; on a free grid the lower bound of a least time with bounded jerk.

    Attributes:
        seconds: s.
        square: (N,) b at the nodes (1/s^2).
        forces: (K, 3 n) contact forces, in units of the weight; some, where there is a choice.
        prices: {limit: (K, ...)}: by how many seconds the time would be less if the limit were
            greater by its own size; the parts are motors, feet, or one. Limits are "torque",
            "velocity", "load" (a foot's least one), "passing" (its greatest), "friction", "jerk".
    """

    seconds: float
    square: Array
    forces: Array
    prices: dict[str, Array]


@dataclass
class _Rows:
    """Rows A x + slack = b of a cone programme in x = (b, f, c, t), group by group."""

    widths: tuple[int, ...]
    blocks: list[list[sparse.spmatrix | None]] = field(default_factory=list)
    right: list[Array] = field(default_factory=list)
    cones: list[object] = field(default_factory=list)
    places: dict[str, slice] = field(default_factory=dict)

    def add(
        self, name: str, cone: object, right: Array, **columns: Array | sparse.spmatrix
    ) -> None:
        """Adds a group; ``columns`` are of the variables b, f, c and t, zero where not given."""
        row = []
        for key, width in zip("bfct", self.widths, strict=True):
            block = columns.get(key)
            row.append(sparse.csr_matrix((len(right), width) if block is None else block))
        first = sum(map(len, self.right))
        self.places[name] = slice(first, first + len(right))
        self.blocks.append(row)
        self.right.append(right)
        self.cones += cone if isinstance(cone, list) else [cone]


def least_time(
    grid: Grid, demands: Demands, guess: Array, *, jerk: float | None = None
) -> Optimum | None:
    """Solves for the least time; None if no speed does, however slow.

    Args:
        grid: How speed is described.
        demands: What its places demand.
        guess: (N,) b of another speed, at which the tangents are taken (1/s^2).
        jerk: Largest third derivative of the path's share by time (1/s^3), if it has one.
    """
    unit = float(np.sum(grid.spans / np.maximum(grid.sums @ np.sqrt(guess), 1e-12)))
    count, size = grid.speed.shape
    feet, parts = len(demands.friction), len(grid.spans)
    rows = _Rows((size, 3 * feet * count, size, parts))
    scaled = grid.acceleration / unit**2, grid.speed / unit**2
    _add_balance(rows, grid, demands, scaled)
    _add_limits(rows, demands, scaled)
    if jerk is not None:
        _add_jerk(rows, grid, guess * unit**2, jerk * unit**3)
    _add_cones(rows, grid, demands)
    cost = np.zeros(sum(rows.widths))
    cost[-parts:] = 1.0
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _TOLERANCE
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix((len(cost), len(cost))),
        cost,
        sparse.csc_matrix(sparse.bmat(rows.blocks)),
        np.concatenate(rows.right),
        rows.cones,
        settings,
    ).solve()
    found = np.array(solution.x)
    square, forces = found[:size], found[size : size + 3 * feet * count]
    moving = np.delete(square, grid.still)
    if not np.isfinite(found).all() or "Infeasible" in str(solution.status) or (moving <= 0).any():
        return None
    seconds = unit * float(np.sum(grid.spans / (grid.sums @ np.sqrt(np.maximum(square, 0.0)))))
    forces = forces.reshape(count, 3 * feet)
    prices = _prices(rows, demands, forces, np.array(solution.z) * unit)
    return Optimum(seconds, square / unit**2, forces, prices)


def _motion(parts: Array, scaled: tuple[Array, Array]) -> Array:
    """Returns rows (K m, N) that take b at the nodes to along a + square b at the places."""
    acceleration, speed = scaled
    rows = parts[:, :, 0, None] * acceleration[:, None] + parts[:, :, 1, None] * speed[:, None]
    return np.asarray(rows.reshape(-1, speed.shape[1]))


def _apart(blocks: Array) -> sparse.spmatrix:
    """Returns matrices (K, m, n) as blocks of one, (K m, K n)."""
    return sparse.block_diag(list(blocks), format="csr")


def _add_balance(rows: _Rows, grid: Grid, demands: Demands, scaled: tuple[Array, Array]) -> None:
    right = -demands.base[:, :, 2].ravel()
    if len(right):
        columns = {"b": _motion(demands.base, scaled)}
        if demands.base_forces.size:
            columns["f"] = -_apart(demands.base_forces)
        rows.add("balance", clarabel.ZeroConeT(len(right)), right, **columns)
    if grid.still:
        still = np.eye(grid.speed.shape[1])[list(grid.still)]
        rows.add("still", clarabel.ZeroConeT(len(still)), np.zeros(len(still)), b=still)


def _add_limits(rows: _Rows, demands: Demands, scaled: tuple[Array, Array]) -> None:
    count, feet = demands.least.shape
    motors = _motion(demands.motors, scaled)
    rest = demands.motors[:, :, 2].ravel()
    for name, sign in (("torque+", 1.0), ("torque-", -1.0)):
        columns = {"b": sign * motors}
        if demands.motor_forces.size:
            columns["f"] = -sign * _apart(demands.motor_forces)
        rows.add(name, clarabel.NonnegativeConeT(len(rest)), 1.0 - sign * rest, **columns)
    share = np.where(np.isfinite(demands.fastest), 1 / demands.fastest, 0.0)
    rows.add(
        "velocity", clarabel.NonnegativeConeT(count), np.ones(count), b=share[:, None] * scaled[1]
    )
    if not feet:
        return
    pressing = _apart(np.tile(_pressing(demands.normals), (count, 1, 1)))
    right = -demands.least.ravel()
    rows.add("load", clarabel.NonnegativeConeT(len(right)), right, f=-pressing)
    bound = np.isfinite(demands.most.ravel())
    if bound.any():
        right = demands.most.ravel()[bound]
        rows.add("passing", clarabel.NonnegativeConeT(len(right)), right, f=pressing[bound])


def _pressing(normals: Array) -> Array:
    """Returns the rows (n, 3 n) that take forces to their parts along the normals."""
    return np.asarray(sparse.block_diag(list(normals[:, None])).toarray())


def _add_jerk(rows: _Rows, grid: Grid, guess: Array, jerk: float) -> None:
    """From place to place the share's acceleration changes by at most jerk x the time between."""
    rates = grid.along[:, :1] * grid.acceleration + grid.along[:, 1:] * grid.speed
    change = np.diff(rates, axis=0) / jerk
    near = np.maximum(grid.speed @ guess, _SLOWEST)
    # The tangent of 1 / sqrt(b), the time per parameter, as the mean of both places.
    level, slope = 1.5 * near**-0.5, 0.5 * near[:, None] ** -1.5 * grid.speed
    time = grid.steps * (level[1:] + level[:-1]) / 2
    fall = grid.steps[:, None] * (slope[1:] + slope[:-1]) / 2
    for name, sign in (("jerk+", 1.0), ("jerk-", -1.0)):
        rows.add(name, clarabel.NonnegativeConeT(len(time)), time, b=sign * change + fall)


def _add_cones(rows: _Rows, grid: Grid, demands: Demands) -> None:
    """Friction; c <= sqrt(b); and t (sums c) >= spans."""
    count, size = grid.speed.shape
    feet, parts = len(demands.friction), len(grid.spans)
    if feet:
        cones = []
        for normal, coefficient in zip(demands.normals, demands.friction, strict=True):
            aside = np.eye(3) - np.outer(normal, normal)
            cones.append(np.vstack([coefficient * normal, aside]))
        block = sparse.block_diag(cones * count, format="csr")
        kinds: list[object] = [clarabel.SecondOrderConeT(4)] * (feet * count)
        rows.add("friction", kinds, np.zeros(4 * feet * count), f=-block)
    each = np.eye(size)
    # c^2 <= b is |(2 c, b - 1)| <= b + 1.
    square = np.stack([-each, -each, 0 * each], axis=1).reshape(-1, size)
    root = np.stack([0 * each, 0 * each, -2 * each], axis=1).reshape(-1, size)
    kinds = [clarabel.SecondOrderConeT(3)] * size
    rows.add("roots", kinds, np.tile([1.0, -1.0, 0.0], size), b=square, c=root)
    # t v >= h is |(2 sqrt(h), t - v)| <= t + v.
    each, sums = np.eye(parts), grid.sums
    time = np.stack([-each, -each, 0 * each], axis=1).reshape(-1, parts)
    speed = np.stack([-sums, sums, 0 * sums], axis=1).reshape(-1, size)
    right = np.zeros((parts, 3))
    right[:, 2] = 2 * np.sqrt(grid.spans)
    kinds = [clarabel.SecondOrderConeT(3)] * parts
    rows.add("time", kinds, right.ravel(), c=speed, t=time)


def _prices(rows: _Rows, demands: Demands, forces: Array, duals: Array) -> dict[str, Array]:
    """Returns what limits cost, from the programme's multipliers (s); see ``Optimum``."""

    def of(name: str) -> Array:
        found: Array = duals[rows.places[name]] if name in rows.places else np.zeros(0)
        return found

    count, feet = demands.least.shape
    right = {name: np.concatenate(rows.right)[place] for name, place in rows.places.items()}
    prices = {
        "torque": (of("torque+") + of("torque-")).reshape(count, -1),
        # b is the square of the speed, so that its relative change counts twice.
        "velocity": (2 * of("velocity") * np.isfinite(demands.fastest)).reshape(count, 1),
    }
    if "jerk+" in rows.places:
        jerk = (of("jerk+") + of("jerk-")) * right["jerk+"]
        prices["jerk"] = np.append(jerk, 0.0)[:, None]
    if feet:
        # What a foot would have to carry less: all of it counts as a limit of its own size.
        prices["load"] = of("load").reshape(count, feet) / feet
        prices["passing"] = np.zeros((count, feet))
        bound = np.isfinite(demands.most)
        prices["passing"][bound] = of("passing") * demands.most[bound]
        limit = forces.reshape(count, feet, 3) @ demands.normals.T
        limit = np.einsum("kii->ki", limit) * demands.friction
        prices["friction"] = of("friction").reshape(count, feet, 4)[..., 0] * limit
    return prices
