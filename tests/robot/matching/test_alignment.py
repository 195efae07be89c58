"""A robot described from other frames is the same matter in the same place."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from pupper_analysis.models.multibody import MultibodyTree, TreeBody, TreeJoint
from pupper_analysis.robot.matching.alignment import measure_tree_deviation, with_base
from pupper_analysis.robot.matching.tolerances import Tolerances


def inertia_of(points: np.ndarray, masses: np.ndarray) -> np.ndarray:
    """Return the inertia (3, 3) of point masses about their com."""
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


def make_leg(foot: tuple[float, float, float]) -> MultibodyTree:
    """Return a trunk with one knee; ``foot`` is the position [m] of the foot in the shank."""
    joint = TreeJoint(
        "trunk", np.array([0.1, 0.2, 0.3]), np.eye(3), np.array([0.0, 1.0, 0.0]), False,
        -1.0, 1.0, 5.0, 10.0, 0.01, 0.1, 0.2,
    )  # fmt: skip
    body = TreeBody(1.0, np.array([0.0, 0.0, -0.1]), 0.01 * np.eye(3))
    frames, bodies = {"foot": ("knee", np.array(foot))}, {"trunk": body, "knee": body}
    return MultibodyTree("trunk", True, bodies, {"knee": joint}, frames, np.array([0, 0, -9.81]))


def test_tree_deviation_is_that_of_the_displaced_frame_alone() -> None:
    """Equal trees deviate by 0 bits; a foot displaced by (30, 40) mm by log2(1 + 50 mm /
    tolerance).
    """
    tolerances = Tolerances()
    one = make_leg((0.01, 0.0, -0.2))
    assert measure_tree_deviation(one, make_leg((0.01, 0.0, -0.2)), tolerances) == 0
    found = measure_tree_deviation(one, make_leg((0.01, 0.03, -0.16)), tolerances)
    assert found == pytest.approx(math.log2(1 + 0.05 / tolerances.position))
    assert found > 3
