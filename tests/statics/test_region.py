"""Support regions: CoM positions inside balance within all limits, positions outside do not.

The references move the mass of the base in Pinocchio's model, and solve the equilibrium of the
resulting robot, or use a closed form.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import shapely
from scipy.optimize import linprog

import pupper_analysis as pa
from tests.support.engines import evaluate_mujoco, with_efforts
from tests.support.variants import load, stand_of


def with_com_at(robot: pa.Robot, qpos: np.ndarray, place: np.ndarray) -> pa.Robot:
    """Displace the CoM of the base so that the CoM of the robot is above ``place`` (2,) [m]."""
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
    """Reference: the balance of robots with the CoM 1 mm inside and outside every fourth corner.
    The normals of the contacts lean inwards.
    """
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


INFEASIBLE = 2
"""Status of `linprog` for a program without solution."""


def farthest_by_linear_programs(
    config: pa.Configuration,
    normals: dict[str, np.ndarray],
    friction: float,
    direction: np.ndarray,
) -> float:
    """Return the largest ``direction @ com`` [m] in equilibrium within the limits of the motors.

    -inf without equilibrium. HiGHS solves linear programs. Tangent planes of the friction cones are
    added until no cone is violated by more than 1e-9 of the weight. Points, Jacobians and loads are
    those of MuJoCo.
    """
    robot, names = config.robot, list(normals)
    model = robot.mj_model
    data = evaluate_mujoco(robot, config.qpos, np.zeros(robot.nv))
    dofs = [int(model.joint(name).dofadr[0]) for name in robot.joint_names]
    count = len(names)
    balance, to_com, columns = np.zeros((4, 3 * count)), np.zeros((2, 3 * count)), []
    cones = []
    for index, name in enumerate(names):
        body, centre = robot.contact_places[name]
        rotation = data.xmat[body].reshape(3, 3)
        normal = normals[name]
        x, y, z = point = data.xpos[body] + rotation @ centre - robot.contact_radius[name] * normal
        part = slice(3 * index, 3 * index + 3)
        balance[:3, part], balance[3, part] = np.eye(3), [-y, x, 0]
        to_com[:, part] = [[-z, 0, x], [0, -z, y]]
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, point, body)
        columns.append(jacobian[:, dofs].T)
        plane = np.eye(3) - np.outer(normal, normal)
        cones.append((part, normal, plane))
    torques = robot.weight * np.hstack(columns)
    load, limits = (data.qfrc_bias - data.qfrc_passive)[dofs], robot.effort_limits
    rows = [*torques, *-torques]
    upper = [*(limits + load), *(limits - load)]

    def add_tangent(part: slice, normal: np.ndarray, along: np.ndarray) -> None:
        row = np.zeros(3 * count)
        row[part] = along - friction * normal
        rows.append(row)
        upper.append(0.0)

    for part, normal, plane in cones:
        for axis in (*np.eye(3), *-np.eye(3)):
            add_tangent(part, normal, plane @ axis / np.linalg.norm(plane @ axis + 1e-9))
    while True:
        found = linprog(
            -direction @ to_com,
            np.array(rows),
            upper,
            balance,
            [0, 0, 1, 0],
            (None, None),
            method="highs-ds",
            options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
        )
        if found.status == INFEASIBLE:
            return -np.inf
        assert found.success
        violated = False
        for part, normal, plane in cones:
            force = found.x[part]
            tangential = plane @ force
            size = float(np.linalg.norm(tangential))
            if size > friction * normal @ force + 1e-9:
                violated = True
                add_tangent(part, normal, tangential / size)
        if not violated:
            return -float(found.fun)


def test_support_region_without_friction_is_the_polygon_of_the_feet() -> None:
    """Reference: area of the quadrangle of v3's feet [m^2]; pulling feet gave 0.488 m^2."""
    config = pa.Configuration(load("v3"), pa.solve_stand(load("v3")).qpos)
    feet = config.foot_positions()
    area = shapely.Polygon([feet[foot][:2] for foot in ("FL", "FR", "RR", "RL")]).area
    region = pa.statics.support_region(config, friction=0.0, torque_limits=False)
    assert region.area == pytest.approx(area, rel=1e-6)


def test_region_equals_linear_programs_within_a_hundredth_of_a_millimetre() -> None:
    """Reference: linear programs in four random directions. The polygon exceeds the region by at
    most 1e-7 m. With 48 fixed directions, the distance was up to 0.3 mm. Motors, friction and three
    slopes limit the region.
    """
    robot = with_efforts(load("v3"), 0.75)
    config = pa.Configuration(robot, stand_of("v3").qpos)
    slopes = ((0.2, 0.1), (-0.15, 0.2), (0.0, -0.2), (0.0, 0.0))
    normals = {
        name: np.array([x, y, 1.0]) / np.linalg.norm([x, y, 1.0])
        for name, (x, y) in zip(robot.contact_points, slopes, strict=True)
    }
    region = pa.statics.support_region(config, normals=normals, friction=0.5)
    for angle in np.random.default_rng(2).uniform(0, 2 * np.pi, 4):
        direction = np.array([np.cos(angle), np.sin(angle)])
        missing = farthest_by_linear_programs(config, normals, 0.5, direction) - float(
            (region.corners @ direction).max()
        )
        assert -1e-7 < missing < 1e-5


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
