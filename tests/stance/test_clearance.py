"""Link and ground clearances of Pinocchio's shapes, compared with MuJoCo's distances between
geoms.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.terrain import build_on_ground, find_touched_surface
from pupper_analysis.stance.clearance import ClearanceShapes
from pupper_analysis.stance.judge import is_base_in_ground
from pupper_analysis.stance.problem import compute_targets
from tests.support.engines import evaluate_mujoco
from tests.support.states import random_state
from tests.support.variants import NAMES, load

FAR = 10.0  # m


def shapes_of(robot: pa.Robot, body: int) -> list[int]:
    """Return the colliding geoms of a body."""
    model = robot.mj_model
    return [
        geom
        for geom in range(model.ngeom)
        if model.geom_bodyid[geom] == body
        and (model.geom_contype[geom] or model.geom_conaffinity[geom])
    ]


def distance(model: mujoco.MjModel, data: mujoco.MjData, one: int, two: int) -> float:
    return float(mujoco.mj_geomDistance(model, data, one, two, FAR, None))


def ground_distances(robot: pa.Robot, qpos: np.ndarray) -> Iterator[float]:
    """Yield MuJoCo's distances between geoms other than feet, and floor and steps."""
    model, data = robot.mj_model, evaluate_mujoco(robot, qpos)
    for body in range(1, model.nbody):
        for part in shapes_of(robot, body):
            if part in robot.foot_geoms:
                continue
            for obstacle in shapes_of(robot, 0):
                if model.geom_type[obstacle] == mujoco.mjtGeom.mjGEOM_PLANE.value:
                    normal = data.geom_xmat[obstacle].reshape(3, 3)[:, 2]
                    yield compute_lowest_height(model, data, part, normal, data.geom_xpos[obstacle])
                else:
                    yield distance(model, data, part, obstacle)


def compute_lowest_height(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, normal: np.ndarray, point: np.ndarray
) -> float:
    """Return the height of a geom's lowest point above a plane [m], in closed form."""
    size, kind = model.geom_size[geom], mujoco.mjtGeom(int(model.geom_type[geom]))
    local = data.geom_xmat[geom].reshape(3, 3).T @ normal
    reach = {
        mujoco.mjtGeom.mjGEOM_SPHERE: size[0],
        mujoco.mjtGeom.mjGEOM_CAPSULE: size[0] + size[1] * abs(local[2]),
        mujoco.mjtGeom.mjGEOM_CYLINDER: size[0] * np.hypot(*local[:2]) + size[1] * abs(local[2]),
        mujoco.mjtGeom.mjGEOM_BOX: float(size @ np.abs(local)),
    }[kind]
    return float(normal @ (data.geom_xpos[geom] - point) - reach)


@pytest.mark.parametrize("name", ["original", "v3"])
def test_lowest_part_above_slope_and_steps_equals_mujoco(name: str) -> None:
    """Reference: distances between geoms in MuJoCo; of penetrating shapes only the sign."""
    robot, shapes = load(name), ClearanceShapes(load(name))
    ground = pa.Ground(0.2, 0.8, {"FL": 0.03, "RR": 0.05})
    feet = pa.Configuration(robot, robot.home).foot_positions()
    there, seen = build_on_ground(robot, ground, feet), 0
    for seed in range(40):
        qpos, _ = random_state(robot, seed)
        qpos[:3] = 0.05 * np.tanh(qpos[:3]) + (0, 0, 0.3)
        found = shapes.find_lowest_part(shapes.move_to(qpos), ground, feet, {})
        expected = min(ground_distances(there, qpos))
        assert found is not None
        if expected > 0:  # the two libraries define the depth of a penetration differently
            seen += 1
            assert found.distance == pytest.approx(expected, abs=1e-5)
        else:
            assert found.distance < 1e-5
    assert seen > 10


@pytest.mark.parametrize("name", NAMES)
def test_distance_of_the_closest_links_equals_mujoco(name: str) -> None:
    """Reference: distances between geoms in MuJoCo; of penetrating shapes only the sign."""
    robot, shapes = load(name), ClearanceShapes(load(name))
    model, seen = robot.mj_model, 0
    home = evaluate_mujoco(robot, robot.home)

    def pairs(data: mujoco.MjData) -> dict[tuple[int, int], float]:
        found = {}
        for first, second in itertools.combinations(range(1, model.nbody), 2):
            if model.body_parentid[second] == first or model.body_parentid[first] == second:
                continue
            gaps = [
                distance(model, data, *pair)
                for pair in itertools.product(shapes_of(robot, first), shapes_of(robot, second))
            ]
            if gaps:
                found[first, second] = min(gaps)
        return found

    neighbours = {pair for pair, gap in pairs(home).items() if gap <= 0}
    for seed in range(10):
        qpos, _ = random_state(robot, seed)
        found = shapes.find_closest_links(qpos)
        assert found is not None
        gaps = {
            p: gap for p, gap in pairs(evaluate_mujoco(robot, qpos)).items() if p not in neighbours
        }
        if min(gaps.values()) > 0:
            seen += 1
            assert found.distance == pytest.approx(min(gaps.values()), abs=1e-5)
        else:
            assert found.distance < 1e-5
    assert seen


# ------------------------------------------------------------------------------------- stands

LOW = pa.StandTask(height=0.1113, pitch=0.3755, ground=pa.Ground(0.465, np.pi))


def test_a_stand_with_a_knee_in_the_ground_is_refused() -> None:
    """Reference: distances to the ground in MuJoCo at the nearest stand that is proposed."""
    robot = load("v3")
    with pytest.raises(
        pa.StanceUnreachableError, match=r"leg_\w+_2 penetrates the ground by .* mm"
    ) as caught:
        pa.solve_stand(robot, LOW)
    error = caught.value
    assert error.shortfall == {}
    assert len(error.blocked) == 1
    assert "height" in error.possible
    assert error.nearest is not None
    nearest = error.nearest
    there = build_on_ground(robot, nearest.task.ground, nearest.foot_targets)
    near = min(ground_distances(there, nearest.qpos))
    assert near == pytest.approx(nearest.ground_clearance.distance, abs=1e-9)
    assert near == pytest.approx(0, abs=1e-3)
    assert near > -1e-6


@pytest.mark.parametrize("name", ["original", "v3"])
@pytest.mark.parametrize("ground", [pa.Ground(), pa.Ground(0.3, 0.7, {"FL": 0.05, "RR": 0.03})])
def test_height_jacobian_equals_central_differences(name: str, ground: pa.Ground) -> None:
    """Reference: central differences with a step of 1e-4.

    Coal's distances near steps are iterative, hence the tolerance of 2e-3.
    """
    robot = load(name)
    shapes, random = ClearanceShapes(robot), np.random.default_rng(0)
    places = pa.Configuration(robot, robot.neutral()).foot_positions()
    for _ in range(3):
        qpos = robot.home.copy()
        qpos[3:7] += random.uniform(-0.2, 0.2, 4)
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
        qpos[7:] = random.uniform(robot.lower_limits, robot.upper_limits)
        rates = shapes.height_jacobian(pa.Configuration(robot, qpos), ground, places)
        for column, index in zip(
            (0, 1, 2, *range(6, robot.nv)), (0, 1, 2, *range(7, robot.nq)), strict=True
        ):
            ends = []
            for step in (1e-4, -1e-4):
                moved = qpos.copy()
                moved[index] += step
                ends.append(
                    np.array(shapes.measure_part_heights(shapes.move_to(moved), ground, places, {}))
                )
            rates_found = (ends[0] - ends[1]) / 2e-4
            np.testing.assert_allclose(rates[:, column], rates_found, atol=2e-3)


@pytest.mark.parametrize(
    ("kind", "normal"),
    [("ceiling", (0.0, 0.0, -1.0)), ("plane", (1.0, 0.0, 0.0)), ("step", (0.0, 0.0, 1.0))],
)
def test_messages_name_the_surface_that_a_part_touches(
    kind: str, normal: tuple[float, float, float]
) -> None:
    """A part inside the box of a foot is not said to be in the ground, in PlaCo as in MuJoCo.

    Reference: names of the geoms in MuJoCo's contacts.
    """
    robot = load("v3")
    place = np.array(pa.solve_stand(robot).contact_points["FR"])
    place[2] = 0.2
    plane = pa.Plane(tuple(place.tolist()), normal)
    centres = {**pa.solve_stand(robot).foot_targets, "FR": place}
    ground = pa.Ground(heights={"FR": 0.2} if kind == "step" else {})
    ground = ground if kind == "step" else ground.with_planes({"FR": plane})
    there, shapes = build_on_ground(robot, ground, centres), ClearanceShapes(robot)
    qpos = np.array(robot.home)
    geom = shapes_of(robot, robot.mj_model.body("leg_front_r_2").id)[0]
    inside = place - 0.015 * np.array(normal)  # m
    qpos[:3] += inside - evaluate_mujoco(robot, qpos).geom_xpos[geom]
    found = shapes.find_lowest_part(shapes.move_to(qpos), ground, centres, {})
    assert found is not None
    assert (found.surface, found.distance < 0) == ("FR", True)
    assert str(ground.describe_surface(found.surface)) == f"{kind} of FR"
    data = evaluate_mujoco(there, qpos)
    touched = find_touched_surface(there.mj_model, data, "leg_front_r_2")
    assert str(touched) == f"{kind} of FR"


def test_foot_on_a_step_of_height_zero_touches_no_step() -> None:
    """Reference: the ground is level, and has no box for the foot in MuJoCo."""
    ground = pa.Ground(heights={"FR": 0.0, "FL": 0.02})
    assert ground.describe_surface("FR") is None
    assert list(ground.steps({"FR": np.zeros(3), "FL": np.zeros(3)})) == ["FL"]
    assert str(ground.describe_surface("FL")) == "step of FL"


def test_part_in_the_floor_beside_a_step_touches_no_step() -> None:
    """Reference: the floor is the only geom in MuJoCo's contacts of the part."""
    robot = load("v3")
    centres = pa.solve_stand(robot).foot_targets
    ground = pa.Ground(heights={"FR": 0.02})
    there, shapes = build_on_ground(robot, ground, centres), ClearanceShapes(robot)
    qpos = np.array(robot.home)
    qpos[2] -= 0.1
    qpos[0] += 1.0
    found = shapes.find_lowest_part(shapes.move_to(qpos), ground, centres, {})
    assert found is not None
    assert (found.surface, ground.describe_surface(found.surface)) == ("", None)
    data = evaluate_mujoco(there, qpos)
    assert find_touched_surface(there.mj_model, data, found.links[0]) is None


def test_refused_clearance_names_the_wall_of_the_contact() -> None:
    """In both languages; without a plane nearby the message names the ground, as before."""
    robot = load("v3")
    x, y, _ = (float(value) for value in pa.solve_stand(robot).contact_points["FR"])
    place = (x, y, 0.02)
    ceiling = pa.Contact(pa.Plane(place, (0.0, 0.0, -1.0)), place)
    task = pa.StandTask(contacts={"FR": ceiling}, ground_clearance=0.02)
    with pytest.raises(pa.StanceUnreachableError) as refusal:
        pa.solve_stand(robot, task)
    (blocked,) = refusal.value.blocked
    assert blocked.text("en").endswith("mm from the ceiling of FR")
    assert "FR 的顶面" in blocked.text("zh")


def test_sunk_foot_lowers_the_ground_for_its_calf() -> None:
    """The skeleton's calf ends in its foot, 7 mm above the ground; the foot sinks by 9 mm."""
    robot, shapes = load("original"), ClearanceShapes(load("original"))
    stand = pa.solve_stand(robot)
    qpos = stand.qpos.copy()
    qpos[2] -= 0.009
    at, targets = shapes.move_to(qpos), stand.foot_targets
    rigid = shapes.find_lowest_part(at, pa.Ground(), targets, {})
    depths = dict.fromkeys(robot.contact_points, 0.009)
    soft = shapes.find_lowest_part(at, pa.Ground(), targets, depths)
    assert rigid is not None
    assert soft is not None
    assert rigid.links[0].endswith("_calf")
    assert rigid.distance == pytest.approx(-0.002)
    assert soft.distance == pytest.approx(0.007)


@pytest.mark.parametrize("name", ["original", "v3"])
def test_limit_of_the_self_clearance_is_the_distance_of_the_nominal_stand(name: str) -> None:
    """Reference: distance of the closest links, which other postures of the feet do not exceed."""
    robot = load(name)
    near = pa.solve_stand(robot, pa.StandTask(self_clearance=0.0)).self_clearance
    assert near is not None
    stand = pa.solve_stand(robot, pa.StandTask(self_clearance=near.distance - 1e-4))
    assert stand.foot_error < 1e-9
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stand(robot, pa.StandTask(self_clearance=near.distance + 1e-3))
    assert list(caught.value.possible) == ["self_clearance"]
    least = caught.value.limits["self_clearance"]["self_clearance"]
    assert 0.99 * near.distance < least <= near.distance + 1e-9


def test_posture_with_a_larger_distance_of_the_links_is_found() -> None:
    """Turned by 30 deg, one branch of the legs of v3 keeps all links 15.1 mm apart."""
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(yaw=np.radians(30), self_clearance=0.014))
    assert stand.self_clearance is not None
    assert stand.self_clearance.distance >= 0.014 - 1e-6


@pytest.mark.slow
def test_stand_with_a_high_base_on_three_feet_is_found() -> None:
    """With the knees above the hips and a clearance of 66 mm, the base can move 3 mm. Reference of
    the foot heights and the centre of mass: MuJoCo.
    """
    robot = load("v3")
    task = pa.StandTask(swing={"FR": 0.003}, ground_clearance=0.066, com="inside")
    stand = pa.solve_stand(robot, task, explain=False)
    data = evaluate_mujoco(robot, stand.qpos)
    mujoco.mj_kinematics(robot.mj_model, data)
    mujoco.mj_comPos(robot.mj_model, data)
    for foot, (body, place) in robot.contact_places.items():
        position = data.xpos[body] + data.xmat[body].reshape(3, 3) @ place
        height = robot.contact_radius[foot] + task.swing.get(foot, 0.0)
        assert position[2] == pytest.approx(height)
    rear = min(stand.contact_points[foot][0] for foot in ("RR", "RL"))
    assert data.subtree_com[0][0] > rear - 1e-9
    assert stand.ground_clearance is not None
    assert stand.ground_clearance.distance > 0.066 - 1e-6


@pytest.mark.slow
def test_feet_at_one_place_are_refused_if_links_must_be_apart() -> None:
    """Both left feet are moved to one place; the nearest stance keeps the distance."""
    robot, x = load("v3"), 0.075
    offsets = {"FL": (-x, 0.0), "RL": (x, 0.0)}
    pa.solve_stand(robot, pa.StandTask(foot_offsets=offsets, com="inside"))
    task = pa.StandTask(foot_offsets=offsets, com="inside", self_clearance=0.004)
    with pytest.raises(pa.StanceUnreachableError, match="overlaps leg_") as caught:
        pa.solve_stand(robot, task)
    nearest = caught.value.nearest
    assert nearest is not None
    assert nearest.self_clearance.distance > nearest.task.self_clearance - 1e-6
    assert "foot_offsets" in caught.value.possible


@pytest.mark.parametrize("name", ["original", "v3"])
def test_base_in_the_ground_is_detected_from_the_task(name: str) -> None:
    """Reference: height of the base geoms in MuJoCo; orientation and height are those of the
    task, whatever the legs do."""
    robot, seen = load(name), set()
    base = robot.mj_model.body(robot.mj_base).id
    for seed in range(20):
        random = np.random.default_rng(seed)
        task = pa.StandTask(
            height=robot.stand_height * random.uniform(0.4, 1.0),
            pitch=random.uniform(-0.8, 0.8),
            roll=random.uniform(-0.4, 0.4),
            ground_clearance=float(random.choice([0.0, 0.03])),
            com="inside",
        )
        qpos, _ = random_state(robot, seed)
        targets = compute_targets(robot, task, {})
        qpos[2], qpos[3:7] = targets.height, targets.base_quaternion
        data = evaluate_mujoco(robot, qpos)
        up, zero = np.array([0.0, 0.0, 1.0]), np.zeros(3)
        height = min(
            compute_lowest_height(robot.mj_model, data, geom, up, zero)
            for geom in shapes_of(robot, base)
        )
        found = is_base_in_ground(ClearanceShapes(robot), targets)
        assert found == (height < task.ground_clearance)
        seen.add(found)
    assert seen == {True, False}


def test_nearest_pairs_of_a_configuration_follow_those_of_others() -> None:
    """The last result is cached; reference: shapes that evaluate a single configuration."""
    robot = load("v3")
    shapes, bent = ClearanceShapes(robot), robot.home.copy()
    bent[7:] += 0.1
    for qpos in (robot.home, bent, bent, robot.home):
        for most in (4, 2):
            found = [
                (pair.one, pair.other, pair.distance)
                for pair in shapes.find_nearest_pairs(qpos, most)
            ]
            fresh = ClearanceShapes(robot).find_nearest_pairs(qpos, most)
            assert found == [(pair.one, pair.other, pair.distance) for pair in fresh]
            np.testing.assert_array_equal(shapes.kinematics.qpos, qpos)
