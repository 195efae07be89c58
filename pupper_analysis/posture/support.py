"""Support functions on a sphere of directions: what bounds gravity torques over all postures.

A joint that turns by q about z holds, of a subtree whose first mass moment about the joint is s in
the joint's own frame, and with the vertical u there,

    tau = |g| s . (u x z),        s in S, the moments that the joints behind it attain,

so that the worst of all is the support function of S, h(d) = max {s . d, s in S}, at u x z, and the
worst over what carries the joint that of the directions u that are attained. Both are made joint by
joint: a joint turns d by -q, a fixed offset p of mass m adds m p . d, branches add up. Whatever is
so made is sublinear, h(a d + b e) <= a h(d) + b h(e) for a, b >= 0: between directions of a grid,
of which a third is a conic combination, it is bounded from above by its values at these. The bound
is off by some (grid spacing)^2 / 8 of the largest moment for each joint where a worst posture is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

STEPS = 360
"""Of a turn: 1 degree leaves 1e-4 of the largest moment per joint."""

_STEP = 2 * np.pi / STEPS
_ROWS = STEPS // 2 + 1


@dataclass(frozen=True, eq=False)
class Grid:
    """The directions at a joint: by angle to its axis, and about it.

    Attributes:
        basis: (3, 3) whose columns are two directions across the axis, and the axis.
        directions: (rows, STEPS, 3) unit vectors, in the joint's frame.
    """

    basis: Array
    directions: Array

    @staticmethod
    def about(axis: Array) -> Grid:
        """Returns the grid about an axis (3,), a unit vector."""
        across = np.eye(3)[int(np.argmin(np.abs(axis)))]
        first = np.cross(across, axis)
        first /= np.linalg.norm(first)
        basis = np.column_stack([first, np.cross(axis, first), axis])
        tilt, turn = np.arange(_ROWS)[:, None] * _STEP, np.arange(STEPS) * _STEP
        own = np.stack(
            np.broadcast_arrays(
                np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)
            ),
            axis=-1,
        )
        return Grid(basis, own @ basis.T)

    def across(self, values: Array) -> Array:
        """Returns a support function (rows, STEPS) at u x axis, and at axis x u (2, rows, STEPS).

        Both are across the axis, a quarter of a turn off u, where the grid has directions.
        """
        level = values[STEPS // 4]
        tilt = np.sin(np.arange(_ROWS) * _STEP)[:, None]
        return np.stack([tilt * np.roll(level, quarter) for quarter in (STEPS // 4, -STEPS // 4)])


@dataclass(frozen=True, eq=False)
class Support:
    """Upper bounds (k, rows, STEPS) of k support functions on a grid.

    Attributes:
        grid: Their directions.
        values: There.
        sizes: (k,) the greatest that any is at unit vectors.
    """

    grid: Grid
    values: Array
    sizes: Array

    def at(self, directions: Array) -> Array:
        """Returns upper bounds (k, ...) at unit vectors (..., 3), in the joint's frame."""
        own = directions @ self.grid.basis
        tilt = np.arctan2(np.hypot(own[..., 0], own[..., 1]), own[..., 2]) / _STEP
        turn = np.mod(np.arctan2(own[..., 1], own[..., 0]) / _STEP, STEPS)
        row = np.minimum(tilt.astype(np.int64), _ROWS - 2)
        column = np.minimum(turn.astype(np.int64), STEPS - 1)
        part = _chord(turn - column)
        # Along a meridian a direction is a conic combination of its neighbours.
        below = np.sin((tilt - row) * _STEP) / np.sin(_STEP)
        above = np.sin((row + 1 - tilt) * _STEP) / np.sin(_STEP)
        bound: Array = above * self._on(row, column, part) + below * self._on(row + 1, column, part)
        return bound

    def _on(self, row: IntArray, column: IntArray, part: tuple[Array, Array, Array]) -> Array:
        """Returns upper bounds on parallels, between two columns; see ``_chord``.

        There a direction is beyond the chord of its neighbours, by some part of its length.
        """
        one, other, beyond = part
        first = self.values[:, row, column]
        second = self.values[:, row, (column + 1) % STEPS]
        over = np.sin(row * _STEP) * beyond
        bound: Array = one * first + other * second + self._sizes(over.ndim) * over
        return bound

    def _sizes(self, dimensions: int) -> Array:
        return self.sizes.reshape(-1, *(1,) * dimensions)

    def turned(self, low: float, high: float) -> Support:
        """Returns the greatest that each is at R(q)^T d, with q about the axis, of low to high."""
        most = float(_chord(np.array(0.5))[2]) * np.sin(np.arange(_ROWS) * _STEP)[:, None]
        between = self._sizes(2) * most  # on the arc between two directions that are looked at
        if not high - low < 2 * np.pi:
            whole = self.values.max(axis=-1, keepdims=True) + between
            return Support(self.grid, np.broadcast_to(whole, self.values.shape).copy(), self.sizes)
        first, last = -high / _STEP, -low / _STEP
        found = np.maximum(self._moved(first), self._moved(last))
        start = int(np.ceil(first))
        count = int(np.floor(last)) - start + 1
        if count > 0:
            inside = ndimage.maximum_filter1d(self.values, count, axis=-1, mode="wrap")
            found = np.maximum(found, np.roll(inside, -(start + count // 2), axis=-1))
        return Support(self.grid, found + between, self.sizes)

    def _moved(self, steps: float) -> Array:
        """Returns bounds at directions that are so many columns further."""
        whole = int(np.floor(steps))
        one, other, beyond = _chord(np.array(steps - whole))
        over = np.sin(np.arange(_ROWS) * _STEP)[:, None] * beyond
        first = np.roll(self.values, -whole, axis=-1)
        second = np.roll(self.values, -whole - 1, axis=-1)
        bound: Array = one * first + other * second + self._sizes(2) * over
        return bound


def _chord(share: Array) -> tuple[Array, Array, Array]:
    """Returns how a direction on a parallel lies between two of its columns.

    Args:
        share: Of the step from the first to the second.

    Returns:
        The parts of the two in the point of their chord in its direction, and by how much it is
        beyond that point, in parts of the parallel's radius.
    """
    to_first, to_second = np.sin(share * _STEP), np.sin((1 - share) * _STEP)
    part = to_second / (to_first + to_second)
    beyond = 1 - np.cos(_STEP / 2) / np.cos((share - 0.5) * _STEP)
    return part, 1 - part, np.maximum(beyond, 0.0)
