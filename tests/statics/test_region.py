"""Support regions: CoM positions inside balance within all limits, positions outside do not.

The references move the mass of the base in Pinocchio's model, and solve the equilibrium of the
resulting robot, or use a closed form.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

import pupper_analysis as pa
from tests.support.engines import with_efforts
from tests.support.variants import load, stand_of


def with_com_at(robot: pa.Robot, qpos: np.ndarray, place: np.ndarray) -> pa.Robot:
    """The robot with the mass of its base moved, so that the CoM is above a place (2,) [m]."""
    config = pa.Configuration(robot, qpos)
    model = robot.pin_model.copy()
    way = np.append(place - config.center_of_mass()[:2], 0.0)
    base = model.inertias[1]
    shift = config.base_rotation().T @ way * robot.total_mass / base.mass
    inertia = base.copy()
    inertia.lever = base.lever + shift
    model.inertias[1] = inertia
    moved = replace(robot, pin_model=model)
    com = pa.Configuration(moved, qpos).center_of_mass()
    np.testing.assert_allclose(com[:2], place, atol=1e-9)
    return moved


def is_in_balance(robot: pa.Robot, qpos: np.ndarray, friction: float | None = None) -> bool:
    """Return True if forces in the friction cones exist with motors below 100 %."""
    try:
        statics = pa.gravity_compensation(
            pa.Configuration(robot, qpos), friction=friction, distribution="min-max torque"
        )
    except pa.StaticsInfeasibleError:
        return False
    return bool(statics.motor_utilisation.max() <= 1 + 1e-6)


def test_region_without_torque_limits_is_the_hull_of_the_contacts() -> None:
    """Reference: shapely's convex hull of the contact points."""
    config = pa.Configuration(load("v3"), stand_of("v3").qpos)
    region = pa.statics.support_region(config, torque_limits=False)
    points = np.array([point[:2] for point in config.contact_points().values()])
    hull = shapely.MultiPoint(points).convex_hull
    assert shapely.Polygon(region.corners).equals(hull)
    assert region.area == pytest.approx(hull.area)
    com = shapely.Point(config.center_of_mass()[:2])
    assert region.com_margin == pytest.approx(hull.exterior.distance(com))
    strong = pa.statics.support_region(pa.Configuration(with_efforts(load("v3"), 1e3), config.qpos))
    # Cone programs are accurate to 1e-8.
    assert shapely.Polygon(strong.corners).symmetric_difference(hull).area < 1e-8
    assert len(strong.corners) == 4


@pytest.mark.slow
@pytest.mark.parametrize("effort", [0.55, 0.75, 1.0])
def test_torque_limits_reduce_the_region_to_com_positions_that_motors_hold(effort: float) -> None:
    """Reference: the balance of robots whose CoM is moved by 0.1 mm inwards and outwards."""
    robot, qpos = with_efforts(load("v3"), effort), stand_of("v3").qpos
    config = pa.Configuration(robot, qpos)
    region = pa.statics.support_region(config)
    geometric = pa.statics.support_region(config, torque_limits=False)
    assert 0 < region.area < 0.99 * geometric.area
    polygon = shapely.Polygon(region.corners)
    assert polygon.exterior.is_ccw
    center = np.array(polygon.centroid.coords[0])
    for corner in region.corners:
        out = (corner - center) / np.linalg.norm(corner - center)
        assert is_in_balance(with_com_at(robot, qpos, corner - 1e-4 * out), qpos)
        assert not is_in_balance(with_com_at(robot, qpos, corner + 1e-4 * out), qpos)
    # Sides: the region is an inner approximation; its true boundary is at most 1 mm outside.
    for first, second in zip(region.corners, np.roll(region.corners, -1, axis=0), strict=True):
        middle = (first + second) / 2
        normal = np.array([second[1] - first[1], first[0] - second[0]])
        normal /= np.linalg.norm(normal)
        assert is_in_balance(with_com_at(robot, qpos, middle - 1e-4 * normal), qpos)
        assert not is_in_balance(with_com_at(robot, qpos, middle + 1e-3 * normal), qpos)


@pytest.mark.slow
def test_friction_bounds_the_region_between_sloped_contacts() -> None:
    """Contacts with normals that lean inwards: corners balance, and points outside do not."""
    robot, qpos = load("v3"), stand_of("v3").qpos
    config = pa.Configuration(robot, qpos)
    points = config.contact_points()
    normals = {
        foot: np.array([-np.sign(x) * 0.5, -np.sign(y) * 0.5, 1.0])
        for foot, (x, y, _) in points.items()
    }
    region = pa.statics.support_region(config, friction=0.3, normals=normals, torque_limits=False)
    polygon = shapely.Polygon(region.corners)
    center = np.array(polygon.centroid.coords[0])

    def balances(place: np.ndarray) -> bool:
        moved = pa.Configuration(with_com_at(robot, qpos, place), qpos)
        try:
            pa.gravity_compensation(moved, friction=0.3, normals=normals)
        except pa.StaticsInfeasibleError:
            return False
        return True

    assert len(region.corners) > 4
    for corner in region.corners[::4]:
        out = (corner - center) / np.linalg.norm(corner - center)
        assert balances(corner - 1e-3 * out)
        assert not balances(corner + 1e-3 * out)


def test_region_without_equilibrium_has_no_corners() -> None:
    """Motors of 0.05 N m need ten times their limit, with the forces of least peak torque."""
    config = pa.Configuration(with_efforts(load("v3"), 0.05), stand_of("v3").qpos)
    region = pa.statics.support_region(config)
    assert region.corners.shape == (0, 2)
    assert region.area == 0
    assert region.com_margin == -np.inf
    line = pa.statics.support_region(config, ["FR", "RL"], torque_limits=False)
    assert line.corners.shape == (2, 2)
    assert line.area == 0


def test_unknown_limits_and_missing_contacts_are_refused() -> None:
    """The message of an unknown limit names the option that ignores limits."""
    robot, qpos = load("v3"), stand_of("v3").qpos
    unknown = pa.Configuration(with_efforts(robot, np.inf), qpos)
    with pytest.raises(pa.ConfigurationError, match="torque_limits=False"):
        pa.statics.support_region(unknown)
    assert pa.statics.support_region(unknown, torque_limits=False).area > 0
    with pytest.raises(pa.ConfigurationError, match="contact"):
        pa.statics.support_region(unknown, [], torque_limits=False)
    fixed = load("v3", fixed_base=True)
    with pytest.raises(pa.ConfigurationError, match="fixed"):
        pa.statics.support_region(pa.Configuration(fixed, fixed.neutral()))
