"""Small least-squares problems, with and without equations; None where nearly singular."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

Array = NDArray[np.float64]

INDEPENDENT = 1e-8
"""Reciprocal condition from which on rows or columns count as independent. Four feet in a square
have 1e-2; below it singular values decide, slowly."""


def solve_constrained(cost: Array, target: Array, rows: Array, right: Array) -> Array | None:
    """Solves rows x = right for the x (n,) with the least |cost x - target|.

    Returns:
        x; None if there are several, or nearly so, or if the rows are dependent, or nearly so.
    """
    count, size = rows.shape
    if not count < size <= count + len(cost):
        return None
    free, triangle, _, found, _ = lapack.dgglse(cost, rows, target, right)
    left = size - count
    conditions = lapack.dtrcon(triangle[:, left:])[0], lapack.dtrcon(free[:left, :left])[0]
    x: Array = found
    return x if min(conditions) > INDEPENDENT else None


def solve_orthogonal(rows: Array, right: Array) -> tuple[Array, Array] | None:
    """Solves rows x = right for the shortest x, and finds what rows takes to zero.

    By an orthogonal triangulation of the rows: rows^T = Q R, so that x = Q_1 R^-T right, and Q_2
    is the null space. An order of magnitude quicker than singular values; for independent rows.

    Returns:
        x (n,) and Q_2 (n, n - m); None if the m rows are dependent, or nearly so.
    """
    count, size = rows.shape
    if size <= count:
        return None
    full = np.zeros((size, size), order="F")
    full[:, :count] = rows.T
    reflectors, scales, _, _ = lapack.dgeqrf(full[:, :count])
    if lapack.dtrcon(reflectors[:count])[0] < INDEPENDENT:
        return None
    full[:, :count] = reflectors
    turn = lapack.dorgqr(full, scales)[0]
    coordinates = lapack.dtrtrs(reflectors[:count], right, trans=1)[0].ravel()
    return turn[:, :count] @ coordinates, turn[:, count:]


def solve_least_squares(matrix: Array, right: Array) -> Array:
    """Returns the shortest x with the least |matrix x - right|."""
    count, size = matrix.shape
    if count >= size > 0:
        triangle, found, _ = lapack.dgels(matrix, right)
        if lapack.dtrcon(triangle[:size])[0] > INDEPENDENT:
            x: Array = found.ravel()[:size]
            return x
    return np.asarray(np.linalg.lstsq(matrix, right)[0], float)
