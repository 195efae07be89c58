"""The limits of dry friction: against MuJoCo's cone, sampled, and as torques of joints."""

import numpy as np
import pytest

from pupper_analysis.robot.friction import DryFriction
from tests.support.variants import NAMES, load


def cone(limits: np.ndarray, mu: float, force: np.ndarray, moment: np.ndarray) -> float:
    """MuJoCo's elliptic cone: at most 1 inside."""
    used = (np.linalg.norm(force[:2]) / mu) ** 2 + sum((moment / limits) ** 2)
    return float(used / force[2] ** 2)


def test_moment_is_the_most_that_the_cone_holds() -> None:
    limits, mu = np.array([0.01, 0.01, 0.02]), 0.8
    friction = DryFriction(np.zeros(1), {"foot": mu}, {"foot": limits})
    random = np.random.default_rng(0)
    for _ in range(20):
        direction = random.standard_normal(3)
        force = np.array([*random.uniform(-2, 2, 2), random.uniform(5, 10)])
        most = friction.moment("foot", force, direction)
        assert cone(limits, mu, force, most) == pytest.approx(1)
        ball = random.standard_normal((4000, 3))
        room = np.sqrt(force[2] ** 2 - (np.linalg.norm(force[:2]) / mu) ** 2)
        others = room * limits * ball / np.linalg.norm(ball, axis=1)[:, None]
        assert 0.99 * most @ direction < (others @ direction).max() <= most @ direction * (1 + 1e-9)


def test_nothing_is_left_beyond_the_cone_and_without_load() -> None:
    friction = DryFriction(np.zeros(1), {"foot": 0.5}, {"foot": np.array([0.01, 0.01, 0.0])})
    up = np.array([1.0, 0.0, 0.0])
    for force in ([5.1, 0.0, 10.0], [0.0, 0.0, 0.0], [0.0, 0.0, -3.0]):
        np.testing.assert_array_equal(friction.moment("foot", np.array(force), up), 0)
    about_normal = np.array([0.0, 0.0, 1.0])  # no torsional friction
    np.testing.assert_array_equal(
        friction.moment("foot", np.array([0.0, 0.0, 10.0]), about_normal), 0
    )


def test_torques_hold_either_way() -> None:
    friction = DryFriction(np.array([0.01, 0.02, 0.0]), {}, {})
    torques = friction.torques(np.array([-3.0, 0.1, 5.0]))
    np.testing.assert_array_equal(torques, [-0.01, 0.02, 0.0])


@pytest.mark.parametrize("name", NAMES)
def test_of_a_robot(name: str) -> None:
    """Contacts take the greater friction of foot and floor, and of condim; the skeleton's is 3."""
    robot = load(name)
    friction = DryFriction.of(robot)
    v3 = name.startswith("v3")
    np.testing.assert_array_equal(friction.joints, np.full(robot.nu, 0.01 if v3 else 0.002))
    for foot in robot.contact_points:
        expected = (0.01, 0.01, 0.02) if v3 else (0, 0, 0)
        np.testing.assert_allclose(friction.turning[foot], expected)
        assert friction.sliding[foot] == pytest.approx(1.0 if v3 else 1.2)
