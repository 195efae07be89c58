"""LAPACK routines called without importing ``scipy.linalg``, compared with ``scipy.linalg``."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import linalg

from pupper_analysis.base import lapack


def _draw_matrices(shapes: list[tuple[int, int]]) -> list[np.ndarray]:
    """Return random matrices, matrices of reduced rank, and zeros, of given shapes."""
    random = np.random.default_rng(3)
    full = [random.standard_normal(shape) for shape in shapes]
    reduced = [matrix - matrix[:1] if len(matrix) else matrix for matrix in full]
    return [*full, *reduced, *(0 * matrix for matrix in full)]


@pytest.mark.parametrize("matrix", _draw_matrices([(1, 1), (7, 7), (36, 36), (0, 0)]))
def test_eigenvectors_equal_those_of_scipy(matrix: np.ndarray) -> None:
    """Reference: ``scipy.linalg.eig``, to the last bit; also for symmetric matrices."""
    for given in (matrix, matrix + matrix.T, np.ascontiguousarray(matrix.T)):
        for found, expected in zip(lapack.eig(given), linalg.eig(given, left=True), strict=True):
            np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    "matrix", _draw_matrices([(3, 8), (8, 3), (6, 6), (0, 4), (4, 0), (12, 30)])
)
def test_bases_and_pivoted_triangle_equal_those_of_scipy(matrix: np.ndarray) -> None:
    """Reference: ``scipy.linalg.null_space``, ``orth`` and ``qr``, to the last bit."""
    for rcond in (None, 1e-9):
        expected = linalg.null_space(matrix, rcond=rcond)
        np.testing.assert_array_equal(lapack.null_space(matrix, rcond), expected)
    np.testing.assert_array_equal(lapack.orth(matrix), linalg.orth(matrix))
    triangle, order = lapack.pivoted_qr(matrix)
    _, expected_triangle, expected_order = linalg.qr(matrix, mode="economic", pivoting=True)
    np.testing.assert_array_equal(triangle, expected_triangle)
    np.testing.assert_array_equal(order, expected_order)


@pytest.mark.parametrize(
    "function", [lapack.eig, lapack.null_space, lapack.orth, lapack.pivoted_qr]
)
def test_numbers_that_are_not_finite_are_refused(function: object) -> None:
    with pytest.raises(ValueError, match="NaN"):
        function(np.array([[1.0, np.nan], [0.0, 1.0]]))  # type: ignore[operator]


@pytest.mark.slow
def test_modules_of_a_stand_do_not_import_scipy_linalg() -> None:
    """In a new process; SciPy's own import afterwards works, with the same routines."""
    program = """
import sys
import pupper_analysis.tools.stand.stance
assert "scipy.linalg" not in sys.modules
assert "scipy.sparse" not in sys.modules
assert "scipy.spatial" not in sys.modules
from pupper_analysis.base import lapack
from scipy import linalg
assert linalg.lapack.dgesv is lapack.dgesv
assert linalg.eigvals([[2.0]]) == 2.0
"""
    subprocess.run([sys.executable, "-c", program], check=True)
