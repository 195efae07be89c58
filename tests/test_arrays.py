"""Arrays: turns and cross products against NumPy's and SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pupper_analysis.arrays import angle_between, cross_matrices, rotation_from_quaternion


def test_crosses_are_numpys() -> None:
    vectors, others = np.random.default_rng(0).normal(size=(2, 5, 3))
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", cross_matrices(vectors), others),
        np.cross(vectors, others),
        atol=1e-15,
    )


def test_rotations_and_the_angles_between_them_are_scipys() -> None:
    turns = Rotation.random(20, random_state=0)
    for one, other in zip(turns[:10], turns[10:], strict=True):
        first, second = (turn.as_quat(scalar_first=True) for turn in (one, other))
        np.testing.assert_allclose(rotation_from_quaternion(first), one.as_matrix(), atol=1e-14)
        expected = (one.inv() * other).magnitude()
        assert angle_between(first, second) == pytest.approx(expected, abs=1e-12)
        assert angle_between(first, -second) == pytest.approx(expected, abs=1e-12)
