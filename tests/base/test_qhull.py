"""Convex hulls loaded without importing ``scipy.spatial``, compared with those of SciPy."""

from __future__ import annotations

import subprocess
import sys

import pytest

_PROGRAM = """
import sys
import numpy as np

{before}
from pupper_analysis.base.qhull import ConvexHull, QhullError

points = np.random.default_rng(3).standard_normal((200, 3))
hull = ConvexHull(points)
try:
    ConvexHull(points[:2])
except QhullError as error:
    refused = error
assert {loaded} == ("scipy.linalg" in sys.modules)
import scipy.linalg.cython_lapack
from scipy import linalg, spatial

assert spatial.ConvexHull is ConvexHull
assert isinstance(refused, spatial.QhullError)
assert linalg.cython_lapack is sys.modules["scipy.linalg.cython_lapack"]
assert linalg.solve([[2.0]], [4.0]) == 2.0
expected = spatial.ConvexHull(points)
assert (hull.simplices == expected.simplices).all() and hull.volume == expected.volume
"""
"""Program that computes a hull, then imports SciPy's packages, and compares both."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "loaded"),
    [
        ("", False),
        ("import scipy.spatial", True),
        ("import scipy.linalg", True),
    ],
)
def test_convex_hull_equals_that_of_scipy_and_leaves_its_packages_usable(
    before: str, loaded: bool
) -> None:
    """Reference: ``scipy.spatial``, imported in the same process before or afterwards."""
    program = _PROGRAM.format(before=before, loaded=loaded)
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.slow
def test_scipy_spatial_is_used_if_the_extension_module_cannot_be_loaded() -> None:
    """The private module is hidden from the import system, as if SciPy had renamed the module."""
    program = """
import importlib.machinery, sys
find = importlib.machinery.PathFinder.find_spec
importlib.machinery.PathFinder.find_spec = lambda name, path=None, target=None: (
    None if name.endswith("_qhull") and "scipy.spatial" not in sys.modules else find(name, path)
)
from pupper_analysis.base import qhull
from scipy import spatial
assert qhull.ConvexHull is spatial.ConvexHull
"""
    subprocess.run([sys.executable, "-c", program], check=True)
