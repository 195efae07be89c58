"""The equations of a robot at rest: their derivative in closed form, against differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
import pytest
from scipy import optimize

import pupper_analysis as pa
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.stance.sag.equilibrium import (
    Anchor,
    SagEquilibrium,
    compute_sole_projection,
    integrate_step,
)
from tests.support.variants import NAMES, load, stand_of


def differences(function: Callable[[np.ndarray], np.ndarray], size: int, step: float) -> np.ndarray:
    """Return the derivative of a function by central differences of fourth order, by column."""
    columns = []
    for direction in np.eye(size):
        far, near = (
            (function(way * direction) - function(-way * direction)) / (2 * way)
            for way in (2 * step, step)
        )
        columns.append((4 * near - far) / 3)
    return np.array(columns).T


@pytest.mark.slow
@pytest.mark.parametrize("feet", ["pinned", "sliding"])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("slope", [0.0, 0.15])
def test_derivative_is_that_of_the_residual(
    name: str, feet: Literal["pinned", "sliding"], slope: float
) -> None:
    """Reference: central differences away from the equilibrium, with rotated feet and a slope."""
    robot, rng = load(name), np.random.default_rng(5)
    stand = stand_of(name)
    if slope:
        task = pa.StandTask(ground=pa.Ground(slope=slope, uphill=0.4), yaw=0.1)
        stand = pa.solve_stand(robot, task)
    system = SagEquilibrium(robot, stand, None, feet)
    forces = rng.normal(size=(len(system.anchors), 3)) + np.array([0.0, 0.0, 8.0])
    qpos = integrate_step(stand.qpos, 2e-4 * rng.normal(size=robot.nv))  # the feet stick
    n = robot.nv
    found = system.derivative(qpos, forces)
    by_qpos = differences(lambda step: system.residual(integrate_step(qpos, step), forces), n, 1e-5)
    by_force = differences(
        lambda step: system.residual(qpos, forces + step.reshape(-1, 3)), forces.size, 1e-3
    )
    for block, expected in ((found[:, :n], by_qpos), (found[:, n:], by_force)):
        size = max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(block, expected, rtol=0, atol=1e-7 * size)


def test_depth_equals_the_root_of_the_ground_law() -> None:
    """Reference: SciPy's root of the law at 300 random parameters and forces."""
    rng = np.random.default_rng(7)
    for _ in range(300):
        low, high = np.sort(rng.uniform(1e-4, 0.9999, 2))
        law = GroundLaw(
            stiffness=float(10 ** rng.uniform(1, 6)),
            damping=1.0,
            solimp=(
                *map(float, (low, high, 10 ** rng.uniform(-5, -1), rng.uniform(1e-4, 0.9999))),
                float(rng.choice([1.0, 2.0, 6.0, rng.uniform(1, 8)])),
            ),
            normal=float(10 ** rng.uniform(-3, 2)),
            tangential=1.0,
        )
        force = float(10 ** rng.uniform(-6, 4))
        bound = 2 * force / law.normal_stiffness(0.0)
        expected = optimize.brentq(lambda x, law=law, f=force: law.force(x) - f, 0, bound)
        assert law.depth(force) == pytest.approx(expected, rel=1e-9, abs=1e-11)
        assert law.force(law.depth(force)) == pytest.approx(force, rel=1e-12)
    # If the impedance decreases with the depth, the depth is above twice the first guess.
    law = GroundLaw(1e3, 1.0, (0.95, 0.05, 1e-3, 0.5, 2.0), 1.0, 1.0)
    assert law.force(law.depth(10.0)) == pytest.approx(10.0, rel=1e-12)
    assert law.depth(10.0) > 2 * 10.0 / law.normal_stiffness(0.0)


def test_two_points_of_a_sole_cannot_part() -> None:
    """Reference: slips written by hand; a sole can translate and turn, but not stretch."""
    places = {"a/1": (0.1, 0.0, 0.0), "a/2": (-0.1, 0.0, 0.0), "b": (0.0, 0.3, 0.0)}
    anchors = {name: Anchor(np.array(place), np.eye(3)) for name, place in places.items()}
    soles = {"a/1": "a", "a/2": "a", "b": "b"}
    projection = compute_sole_projection(anchors, soles, dict.fromkeys(places, np.eye(3)))
    assert projection is not None
    for slips, left in (
        ([(1, 0), (-1, 0), (2, 3)], [(0, 0), (0, 0), (2, 3)]),
        ([(1, 2), (1, 2), (0, 0)], [(1, 2), (1, 2), (0, 0)]),  # translation
        ([(0, 1), (0, -1), (0, 0)], [(0, 1), (0, -1), (0, 0)]),  # rotation
    ):
        np.testing.assert_allclose(np.tensordot(projection, np.array(slips), 2), left, atol=1e-12)


def test_points_of_different_feet_slip_freely() -> None:
    places = {"a": (0.1, 0.0, 0.0), "b": (0.0, 0.3, 0.0)}
    anchors = {name: Anchor(np.array(place), np.eye(3)) for name, place in places.items()}
    assert compute_sole_projection(anchors, {name: name for name in places}, {}) is None
