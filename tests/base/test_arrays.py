"""Cross products and rotations, compared with NumPy and SciPy."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pupper_analysis.base.arrays import cross_matrices, rotation_from_quaternion


def test_cross_product_equals_numpy() -> None:
    vectors, others = np.random.default_rng(0).normal(size=(2, 5, 3))
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", cross_matrices(vectors), others),
        np.cross(vectors, others),
        atol=1e-15,
    )


def test_rotations_equal_scipy() -> None:
    for turn in Rotation.random(10, random_state=0):
        found = rotation_from_quaternion(turn.as_quat(scalar_first=True))
        np.testing.assert_allclose(found, turn.as_matrix(), atol=1e-14)
