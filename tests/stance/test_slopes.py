"""Feet on separate planes (roofs, walls), compared with MuJoCo and with linear programs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
import pytest
from scipy import optimize

import pupper_analysis as pa
from pupper_analysis.cli.stance_fields import parse_contact
from pupper_analysis.robot.robot import borrow
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.statics.support_polygon import margin_of_position, support_corners
from tests.support.variants import load

UP = np.array([0.0, 0.0, 1.0])
LEFT, RIGHT = math.pi / 2, -math.pi / 2


Contacts = dict[str, pa.Contact]


def slopes(angle: float, uphill: dict[str, float]) -> Contacts:
    return {foot: pa.Contact(pa.Slope(angle, way)) for foot, way in uphill.items()}


def make_side_slopes(degrees: float, *, roof: bool) -> Contacts:
    """Return contacts of left and right feet on two planes that rise towards the middle (a roof),
    or away from the middle.
    """
    inwards = {"FL": RIGHT, "RL": RIGHT, "FR": LEFT, "RR": LEFT}
    return slopes(
        math.radians(degrees), {foot: turn if roof else -turn for foot, turn in inwards.items()}
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "contacts"),
    [
        ("v3", make_side_slopes(30, roof=True)),
        ("v3", make_side_slopes(50, roof=False)),
        ("original", make_side_slopes(20, roof=True)),
        ("v3", make_side_slopes(70, roof=False)),
    ],
    ids=["roof", "gutter", "capsules", "steep"],
)
def test_mujoco_holds_a_stand_between_two_planes(
    name: str, contacts: dict[str, pa.Contact]
) -> None:
    """Reference: MuJoCo's torques and forces; the sideways components exceed 1 N, and the forces
    sum to the weight."""
    robot = load(name)
    stand = pa.solve_stand_as_simulated(robot, pa.StandTask(contacts=contacts))
    found = pa.verify_stand(robot, stand)
    assert found.passed, [str(failure) for failure in found.failures]
    assert found.torque_error < 1e-5
    assert found.force_error < 1e-5
    statics = pa.stance.stand_statics(robot, stand)
    sideways_forces = [force[1] for force in statics.contact_forces.values()]
    assert max(map(abs, sideways_forces)) > 1.0  # N
    total = sum(statics.contact_forces.values())
    np.testing.assert_allclose(total, -robot.total_mass * robot.gravity, atol=1e-9)


def test_foot_on_its_own_plane_touches_at_the_given_place() -> None:
    """Reference: a vertical wall; its contact point is one radius beside the centre of the foot."""
    robot, step = load("v3"), pa.Ground(heights={"FR": 0.05})
    wall = slopes(math.pi / 2, {"FR": 0.0})
    task = pa.StandTask(contacts=wall, ground=step, feet={"FR": (0.14, -0.09)})
    stand = pa.solve_stand(robot, task)
    np.testing.assert_allclose(stand.contact_points["FR"], (0.14, -0.09, 0.05), atol=1e-12)
    np.testing.assert_allclose(stand.normals["FR"], (-1, 0, 0), atol=1e-12)
    centre = pa.Configuration(robot, stand.qpos).foot_positions()["FR"]
    radius = robot.contact_radius["FR"]
    np.testing.assert_allclose(centre, (0.14 - radius, -0.09, 0.05), atol=1e-9)
    assert stand.task.contacts == wall
    ground = stand.task.ground
    assert ground == step  # the planes belong to the contacts
    assert ground.planes["FR"].point == pytest.approx((0.14, -0.09, 0.05), abs=1e-15)
    assert not pa.StandTask(ground=ground).ground.planes
    # A hand on a wall lifts no base.
    assert stand.qpos[2] == pytest.approx(robot.stand_height, abs=1e-9)


def test_equal_planes_of_all_feet_are_equivalent_to_a_slope() -> None:
    """Reference: stand, margin and sag of the slope; only the definition of a foot's place
    differs.
    """
    robot, angle, uphill = load("v3"), 0.2, 0.7
    slope = pa.Ground(slope=angle, uphill=uphill)
    one = pa.solve_stand_as_simulated(robot, pa.StandTask(ground=slope))
    places = {foot: tuple(one.contact_points[foot][:2]) for foot in robot.feet}
    rises = {foot: slope.height(place) for foot, place in places.items()}
    each = slopes(angle, dict.fromkeys(rises, uphill))
    steps = pa.Ground(heights=rises)
    task = pa.StandTask(contacts=each, ground=steps, feet=places)
    two = pa.solve_stand_as_simulated(robot, task)
    np.testing.assert_allclose(two.qpos, one.qpos, atol=1e-9)
    assert two.com_margin == pytest.approx(one.com_margin, abs=1e-9)
    sags = [pa.steady_state(robot, stand) for stand in (one, two)]
    np.testing.assert_allclose(sags[1].qpos, sags[0].qpos, atol=1e-9)
    for foot in robot.feet:
        np.testing.assert_allclose(
            sags[1].contact_forces[foot], sags[0].contact_forces[foot], atol=1e-7
        )


@pytest.mark.slow
def test_sag_between_two_planes_equals_mujoco() -> None:
    """Reference: MuJoCo's simulation without feed-forward, in a gutter."""
    robot = load("v3")
    stand = pa.solve_stand_as_simulated(
        robot, pa.StandTask(contacts=make_side_slopes(20, roof=False))
    )
    sag = pa.steady_state(robot, stand)
    found = pa.verify_stand(robot, stand, feedforward=False)
    assert sag.height_loss == pytest.approx(found.height_loss, rel=0.02)
    for foot, force in sag.contact_forces.items():
        out = stand.normals[foot]
        assert (
            math.hypot(*np.cross(force, out))
            <= robot.contacts[foot].sliding_friction * (force @ out) + 1e-9
        )


def is_in_balance(points: np.ndarray, cones: list[np.ndarray], place: np.ndarray) -> bool:
    """Return True if forces on the edges of friction cones balance a CoM position, by a linear
    program.
    """
    count = len(cones[0])
    edges = np.vstack(cones).T  # (3, k)
    at = np.repeat(points, count, axis=0)
    moments = np.cross(at, edges.T).T
    wanted = [0, 0, 1, place[1], -place[0], 0]
    found = optimize.linprog(
        np.zeros(edges.shape[1]), A_eq=np.vstack([edges, moments]), b_eq=wanted, method="highs"
    )
    return bool(found.status == 0)


def edges_of(normal: np.ndarray, friction: float, count: int = 24) -> np.ndarray:
    side = np.cross(normal, UP if abs(normal[2]) < 0.9 else np.array([1.0, 0, 0]))
    side /= np.linalg.norm(side)
    other = np.cross(normal, side)
    turns = 2 * math.pi * np.arange(count) / count
    return np.array([normal + friction * (math.cos(t) * side + math.sin(t) * other) for t in turns])


def search_region(
    corners: Sequence[tuple[float, float]],
    points: np.ndarray,
    cones: list[np.ndarray],
    shares: np.ndarray,
    near: float,
) -> tuple[int, int]:
    """Assert that CoM positions are in a region exactly if contact forces balance them.

    The positions are ``shares`` (n, 2) of the region and a fifth of its size around it; those
    ``near`` its edge are left out. Returns the numbers of positions outside and inside.
    """
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    size, tried = float((high - low).max()), [0, 0]
    for x, y in low - 0.2 * size + shares * (high - low + 0.4 * size):
        margin = margin_of_position((float(x), float(y)), corners)
        if abs(margin) > near * size:
            assert is_in_balance(points, cones, np.array([x, y])) is (margin > 0)
            tried[margin > 0] += 1
    return tried[0], tried[1]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_com_region_on_slopes_equals_a_linear_program(seed: int) -> None:
    """Reference: a linear program for each of 60 CoM positions. Its friction pyramids have 24
    edges, within 0.9 % of round cones.
    """
    random = np.random.default_rng(seed)
    count, friction = 4, 0.5
    points = np.column_stack([random.uniform(-0.2, 0.2, (count, 2)), random.uniform(0, 0.1, count)])
    tilts, turns = random.uniform(0.2, 1.0, count), random.uniform(-math.pi, math.pi, count)
    normals = np.array(
        [
            (-math.sin(a) * math.cos(t), -math.sin(a) * math.sin(t), math.cos(a))
            for a, t in zip(tilts, turns, strict=True)
        ]
    )
    corners = support_corners(points, normals, [friction] * count)
    cones = [edges_of(normal, friction) for normal in normals]
    ends = np.array(corners)
    assert np.abs(ends - points[:, None, :2]).min(axis=(0, 2)).max() > 0.01  # not the feet's hull
    assert min(search_region(corners, points, cones, random.uniform(size=(60, 2)), 0.02)) > 3


def test_support_corners_on_one_plane_do_not_depend_on_friction() -> None:
    """Reference: the contact points themselves."""
    points = np.array([(0.1, 0.1, 0.0), (-0.1, 0.1, 0.02), (0.0, -0.1, 0.01)])
    normals = np.tile((0.0, -0.6, 0.8), (3, 1))
    assert support_corners(points, normals, [0.1] * 3) == tuple(map(tuple, points[:, :2]))


def test_parallel_slopes_beyond_the_friction_angle_are_refused() -> None:
    """No leg can press against another: the friction angle is the limit."""
    robot = load("v3")
    task = pa.StandTask(contacts=slopes(1.2, dict.fromkeys(robot.feet, 0.0)))
    stand = pa.solve_stand(robot, task)
    with pytest.raises(pa.StaticsInfeasibleError, match="friction"):
        pa.stance.stand_statics(robot, stand)


@pytest.mark.parametrize("tilt", [-0.1, 3.2, math.nan, "steep"])
def test_slope_angles_below_zero_or_above_180_degrees_are_refused(tilt: float) -> None:
    """The message names the field."""
    with pytest.raises(pa.ConfigurationError, match=r"slope\.angle"):
        pa.Slope(tilt)


def test_slope_of_an_unknown_foot_is_refused() -> None:
    """The message names similar links; without a similar name, the feet first."""
    with pytest.raises(pa.UnknownNameError, match="leg_front_r_3"):
        pa.solve_stand(load("v3"), pa.StandTask(contacts=slopes(0.1, {"leg_front_3": 0.0})))
    with pytest.raises(pa.UnknownNameError, match="are: FR, FL, RR, RL"):
        pa.solve_stand(load("v3"), pa.StandTask(contacts=slopes(0.1, {"X": 0.0})))


def test_clearance_from_a_wall_equals_mujoco() -> None:
    """Reference: ``mj_geomDistance`` of each capsule to the wall's box; the smaller of wall and
    floor distance counts."""
    robot = load("original")
    stand = pa.solve_stand(robot, pa.StandTask(contacts=slopes(0.6, {"FR": 0.0})))
    ground = stand.task.ground
    grounded = build_on_ground(robot, ground, stand.rigid_targets)
    model = grounded.mj_model
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_forward(model, data)
    wall = model.geom("step_FR").id
    parts = [
        geom
        for geom in range(model.ngeom)
        if model.geom_bodyid[geom] and geom not in grounded.foot_geoms
    ]
    walled = [mujoco.mj_geomDistance(model, data, geom, wall, 1.0, None) for geom in parts]
    with borrow(robot, SearchContext) as context:
        shapes = context.shapes
        at = shapes.move_to(stand.qpos)
        heights = shapes.measure_part_heights(at, ground, stand.rigid_targets, {})
        flat = shapes.measure_part_heights(at, pa.Ground(), {}, {})
    assert (np.array(walled) < flat).sum() >= 2
    np.testing.assert_allclose(heights, np.minimum(walled, flat), atol=1e-6)
    assert stand.ground_clearance is not None
    assert stand.ground_clearance.distance == pytest.approx(min(heights), abs=1e-12)


@pytest.mark.slow
def test_stated_limit_of_a_slope_is_solvable() -> None:
    """A slope of 150 deg hangs over the foot and intersects the calf.

    The limit in the message is solved; 0.2 deg more is refused.
    """
    robot, step = load("original"), pa.Ground(heights={"FR": 0.05})

    def ask(contact: pa.Contact, *, explain: bool = True) -> pa.Stand:
        task = pa.StandTask(contacts={"FR": contact}, ground=step)
        return pa.solve_stand(robot, task, explain=explain)

    with pytest.raises(pa.StanceUnreachableError) as caught:
        ask(pa.Contact(pa.Slope(math.radians(150))))
    limit = caught.value.limits["contacts"]["contacts"]["FR"]
    assert f"contacts FR={limit:.7g}" in str(caught.value)
    typed = parse_contact("contact", f"{limit:.7g}", "")
    assert ask(typed).solved
    with pytest.raises(pa.StanceUnreachableError, match="FR_calf"):
        ask(typed.with_plane_parameter(typed.plane.parameter + math.radians(0.2)), explain=False)
