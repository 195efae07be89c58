"""Force polytopes against MuJoCo's statics, SciPy's half-space intersection and linear programs."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy import optimize, spatial

import pupper_analysis as pa
from pupper_analysis.statics.polytope import find_vertices
from tests.support.engines import addresses, evaluate_mujoco, with_efforts
from tests.support.legged import biped
from tests.support.states import random_state
from tests.support.variants import load, stand_of


def mujoco_torques(config: pa.Configuration, foot: str, force: np.ndarray) -> dict[str, float]:
    """Motor torques (N m) under gravity and an external force on the lowest point of a foot."""
    robot, model = config.robot, config.robot.mj_model
    data = evaluate_mujoco(robot, config.qpos)
    body, _ = robot.contact_places[foot]
    rows = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, rows, None, config.contact_points()[foot], body)
    torques = (data.qfrc_bias - data.qfrc_passive - rows.T @ force)[addresses(robot)[1]]
    return dict(zip(robot.joint_names, torques[robot.nv - robot.nu :], strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "original", "long-leg"])
def test_vertices_load_three_motors_to_their_limits_in_mujoco(name: str) -> None:
    """Reference: torques of MuJoCo's Jacobian for the force of each vertex."""
    robot = load(name)
    limits = dict(zip(robot.joint_names, robot.effort_limits, strict=True))
    for seed in range(5):
        config = pa.Configuration(robot, random_state(robot, seed)[0])
        foot = robot.contact_points[seed % 4]
        polytope = pa.statics.force_polytope(config, foot)
        assert polytope.vertices is not None
        assert len(polytope.vertices) == 8
        np.testing.assert_allclose(polytope.point, config.contact_points()[foot], atol=1e-12)
        for vertex in polytope.vertices:
            torques = mujoco_torques(config, foot, vertex)
            shares = [abs(torques[joint]) / limits[joint] for joint in polytope.joints]
            np.testing.assert_allclose(shares, 1.0, rtol=1e-9)


def test_largest_push_loads_the_limiting_motor_to_its_limit_in_mujoco() -> None:
    """Reference: MuJoCo's torques under the push; the largest is 100 % of the limit, at
    ``limiting_joint``."""
    robot = load("v3")
    config = pa.Configuration(robot, stand_of("v3").qpos)
    for direction in np.random.default_rng(0).normal(size=(10, 3)):
        unit = direction / np.linalg.norm(direction)
        polytope = pa.statics.force_polytope(config, "FR")
        push = polytope.largest_push(direction)
        torques = mujoco_torques(config, "FR", -push * unit)
        shares = {
            joint: abs(torques[joint]) / limit
            for joint, limit in zip(polytope.joints, polytope.limits, strict=True)
        }
        assert max(shares.values()) == pytest.approx(1.0, rel=1e-9)
        assert max(shares, key=lambda joint: shares[joint]) == polytope.limiting_joint(-unit)


@pytest.mark.slow
def test_vertices_equal_the_intersection_of_half_spaces() -> None:
    """Redundant limbs with random faces: SciPy's Qhull, and a linear program per direction."""
    random = np.random.default_rng(1)
    for count in (3, 4, 7):
        for _ in range(10):
            rows, limits = random.normal(size=(count, 3)), random.uniform(0.5, 5.0, 2 * count)
            faces = np.concatenate([rows, -rows])
            vertices_found = find_vertices(rows, limits)
            assert vertices_found is not None
            halves = np.column_stack([faces, -limits])
            theirs = spatial.HalfspaceIntersection(halves, np.zeros(3)).intersections
            mine_hull, their_hull = spatial.ConvexHull(vertices_found), spatial.ConvexHull(theirs)
            assert mine_hull.volume == pytest.approx(their_hull.volume, rel=1e-9)
            assert len(vertices_found) == len(np.unique(theirs.round(8), axis=0))
            direction = random.normal(size=3)
            bounds = [(None, None)] * 3
            best = optimize.linprog(-direction, A_ub=faces, b_ub=limits, bounds=bounds)
            assert (vertices_found @ direction).max() == pytest.approx(-best.fun, rel=1e-9)


def test_motor_without_torque_makes_the_polytope_flat() -> None:
    """Reference: corners of the rectangle with half sides of 1 and 2."""
    rows, limits = np.eye(3), np.array([1.0, 2.0, 0.0, 1.0, 2.0, 0.0])
    vertices = find_vertices(rows, limits)
    expected = [(x, y, 0) for x in (-1, 1) for y in (-2, 2)]
    assert vertices is not None
    np.testing.assert_allclose(sorted(vertices.tolist()), sorted(expected), atol=1e-15)


def test_contradicting_and_unbounded_inequalities_have_no_vertices() -> None:
    """An empty set has no vertices; an unbounded set returns None."""
    empty = find_vertices(
        np.vstack([np.eye(3), np.eye(3)[:1]]), np.array([1, 1, 1, -3, 1, 1, 1, 4])
    )
    assert empty is not None
    assert len(empty) == 0
    assert find_vertices(np.eye(3)[:2], np.ones(4)) is None  # two motors
    assert find_vertices(np.array([[1, 0, 0], [0, 1, 0], [1, 1, 1e-12]]), np.ones(6)) is None


def test_sole_is_pushed_at_the_mean_of_its_contact_points(tmp_path: Path) -> None:
    """Reference: the mean of the four corners of the sole."""
    pair = biped(tmp_path)
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf, as_is=True)
    config = pa.Configuration(robot, robot.home)
    foot = next(iter(robot.feet))
    points = config.contact_points(robot.feet[foot])
    assert len(points) == 4
    polytope = pa.statics.force_polytope(config, foot)
    np.testing.assert_allclose(polytope.point, np.mean(list(points.values()), axis=0), atol=1e-12)


def test_unknown_limit_leaves_the_force_unknown() -> None:
    """An infinite torque limit counts as unknown: the push is not a number."""
    unlimited = with_efforts(load("v3"), np.inf)
    free = pa.statics.force_polytope(pa.Configuration(unlimited, stand_of("v3").qpos), "FR")
    assert free.vertices is None
    assert np.isnan(free.largest_push([0, 0, -1]))
    assert free.limiting_joint([0, 0, 1]) is None


def test_force_polytope_accepts_links_and_places_of_the_base() -> None:
    """Reference: the position of the frame of the link; the fixed base bears any force."""
    robot = load("v3")
    config = pa.Configuration(robot, stand_of("v3").qpos)
    frame = robot.contact_frames["FR"]
    at_link = pa.statics.force_polytope(config, frame)
    np.testing.assert_allclose(at_link.point, config.frame_position(frame), atol=1e-12)
    at_base = pa.statics.force_polytope(config, (0.0, 0.0, 0.1))
    assert at_base.joints == ()
    assert at_base.vertices is None  # the held base bears all forces
    assert at_base.largest_push([1, 0, 0]) == np.inf


@pytest.mark.parametrize("length", [1e-320, 1e-200, 1e200, 1e308])
def test_direction_of_any_length_gives_the_push_of_the_unit_vector(length: float) -> None:
    """Squares of such components underflow or overflow; the reference has components of 1."""
    config = pa.Configuration(load("v3"), stand_of("v3").qpos)
    polytope = pa.statics.force_polytope(config, "FR")
    expected = polytope.largest_push([0, 1, -1])
    assert polytope.largest_push([0, length, -length]) == pytest.approx(expected, rel=1e-12)
    assert polytope.limiting_joint([0, 0, length]) == polytope.limiting_joint([0, 0, 1])
    plane = pa.Plane((0, 0, 0), (0, length, length))
    assert plane.normal == pytest.approx((0, 0.5**0.5, 0.5**0.5), rel=1e-12)
    qpos = config.qpos.copy()
    qpos[3:7] = (1e308, 1e308, 1e308, -1e308)
    assert pa.Configuration(config.robot, qpos).qpos[3:7] == pytest.approx([0.5, 0.5, 0.5, -0.5])


@pytest.mark.parametrize("direction", [[0, 0, 0], [1, 2], [0, 0, np.nan]])
def test_direction_of_zero_length_or_wrong_shape_is_refused(direction: list[float]) -> None:
    """The message names the argument; an unknown point raises another error."""
    config = pa.Configuration(load("v3"), stand_of("v3").qpos)
    polytope = pa.statics.force_polytope(config, "FR")
    with pytest.raises(pa.ConfigurationError, match="direction"):
        polytope.largest_push(direction)
    with pytest.raises(pa.UnknownNameError):
        pa.statics.force_polytope(config, "tail")
