"""Roots found without importing ``scipy.optimize``, compared with ``scipy.optimize.root``."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import optimize

from pupper_analysis.base.minpack import find_root


@pytest.mark.parametrize("size", [1, 3])
@pytest.mark.parametrize("xtol", [1e-14, 1e-3])
def test_root_equals_that_of_scipy(size: int, xtol: float) -> None:
    """Reference: ``scipy.optimize.root``, to the last bit; with and without a root."""
    random = np.random.default_rng(3)
    for shift in (0.3, 2.0):  # the sine of no number is 2
        matrix, start = random.standard_normal((size, size)), random.standard_normal(size)

        def residual(x: np.ndarray, shift: float = shift) -> np.ndarray:
            return np.sin(x) - shift

        def derivative(x: np.ndarray) -> np.ndarray:
            return np.diag(np.cos(x))

        expected = optimize.root(residual, start, jac=derivative, options={"xtol": xtol}).x
        np.testing.assert_array_equal(find_root(residual, start, derivative, xtol=xtol), expected)
        np.testing.assert_array_equal(
            find_root(lambda x, m=matrix: m @ x - 1, start, lambda _, m=matrix: m, xtol=xtol),
            optimize.root(
                lambda x, m=matrix: m @ x - 1,
                start,
                jac=lambda _, m=matrix: m,
                options={"xtol": xtol},
            ).x,
        )


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [False, True])
def test_optimize_is_imported_only_if_minpack_cannot_be_loaded_alone(hidden: bool) -> None:
    """In a new process; the import of SciPy's package afterwards works, with the same module."""
    program = f"""
import importlib.machinery, sys
import numpy as np
find = importlib.machinery.PathFinder.find_spec
importlib.machinery.PathFinder.find_spec = lambda name, path=None, target=None: (
    None if {hidden} and name.endswith("_minpack") and "scipy.optimize" not in sys.modules
    else find(name, path)
)
from pupper_analysis.base.minpack import find_root
root = find_root(lambda x: x**3 - 8, np.array([1.0]), lambda x: np.diag(3 * x**2), xtol=1e-14)
assert abs(root[0] - 2) < 1e-12
assert ("scipy.optimize" in sys.modules) is {hidden}
from scipy import optimize
assert optimize.root(lambda x: x**3 - 8, [1.0], jac=lambda x: [[3 * x[0]**2]]).success
"""
    subprocess.run([sys.executable, "-c", program], check=True)
