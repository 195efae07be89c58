"""A robot described from other frames is the same matter in the same place."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pupper_analysis.models.multibody import MultibodyTree, TreeBody
from pupper_analysis.robot.matching.alignment import with_base


def inertia_of(points: np.ndarray, masses: np.ndarray) -> np.ndarray:
    """The inertia (3, 3) of point masses about their com."""
    arms = points - masses @ points / masses.sum()
    return np.einsum(
        "n,nij->ij", masses, [arm @ arm * np.eye(3) - np.outer(arm, arm) for arm in arms]
    )


def test_base_inertia_in_another_frame_equals_the_sum_of_point_masses() -> None:
    """Reference: each point mass moved by x' = R x + p, then mass, CoM and inertia summed."""
    random = np.random.default_rng(1)
    points, masses = random.normal(size=(5, 3)), random.uniform(0.1, 1.0, 5)
    pose = pin.SE3(pin.exp3(np.array([0.4, -0.9, 0.7])), np.array([0.1, -0.2, 0.3]))
    body = TreeBody(
        mass=float(masses.sum()),
        com=masses @ points / masses.sum(),
        inertia=inertia_of(points, masses),
    )
    values = MultibodyTree("trunk", True, {"trunk": body}, {}, {}, np.array([0.0, 0.0, -9.81]))
    found = with_base(values, pose).bodies["trunk"]
    moved = points @ pose.rotation.T + pose.translation
    np.testing.assert_allclose(found.com, masses @ moved / masses.sum(), atol=1e-12)
    np.testing.assert_allclose(found.inertia, inertia_of(moved, masses), atol=1e-12)
    assert found.mass == body.mass
