"""Clearances of robots whose shapes are meshes: convex hulls, as in MuJoCo's collisions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.stance.clearance import ClearanceShapes
from tests.support.engines import change_model, evaluate_mujoco
from tests.support.legged import Pair, quadruped

FAR = 50.0  # m
TRUNK = '<geom type="box" size="0.2 0.1 0.04"/>'

# A box that is open above (its hull is not) with a keel below, in front and to the left.
SHELL = [
    *itertools.product((-0.2, 0.22), (-0.1, 0.09), (-0.03, 0.04)),
    *itertools.product((-0.1, 0.1), (-0.05, 0.05), (0.0, 0.01)),
    (0.16, 0.03, -0.17),
]
ROD = [*itertools.product((-0.012, 0.01), (-0.009, 0.011)), (0.0, 0.0)]


def format_obj(points: list[tuple[float, ...]]) -> str:
    """Return an OBJ mesh in which each point belongs to a triangle; only its convex hull
    matters.
    """
    lines = [f"v {x} {y} {z}" for x, y, z in points]
    count = len(points)
    faces = [f"f {i + 1} {(i + 1) % count + 1} {(i + 3) % count + 1}" for i in range(count)]
    return "\n".join([*lines, *faces, ""])


def write_meshed(folder: Path, more: str = "") -> Pair:
    """Write a quadruped whose trunk and legs are meshes in the MJCF and have no shapes in the
    URDF.
    """
    rod = [(x, y, z) for x, y in ROD[:4] for z in (-0.17, -0.01)]
    (folder / "shell.obj").write_text(format_obj(SHELL))
    (folder / "rod.obj").write_text(format_obj([*rod, (0.02, 0.0, -0.1)]))
    feet = '<geom type="sphere" size="0.02" pos="0 0 -0.2"/><geom type="mesh" mesh="rod"/>'
    pair = quadruped(folder, foot=feet, floor=True, actuators="position")
    text = pair.mjcf.read_text()
    assert TRUNK in text
    text = text.replace(TRUNK, '<geom type="mesh" mesh="shell" pos="0.01 0 0" euler="0 0.1 0"/>')
    text = text.replace(
        "<worldbody>",
        '<asset><mesh name="shell" file="shell.obj" inertia="shell"/>'
        '<mesh name="rod" file="rod.obj" inertia="shell"/></asset>' + more + "<worldbody>",
    )
    for leg in ("FL", "FR"):
        bar = f'<joint name="{leg}_pitch" axis="0 1 0" range="-1.5 2.5"/>'
        assert bar in text
        form = '<geom type="mesh" mesh="rod"/><geom type="ellipsoid" size="0.02 0.03 0.04"/>'
        text = text.replace(bar, bar + form)
    pair.mjcf.write_text(text)
    return pair


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> pa.Robot:
    pair = write_meshed(tmp_path_factory.mktemp("meshed"))
    return pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)


def list_collidable_geoms(model: mujoco.MjModel) -> Iterator[int]:
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] and (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            yield geom


def compute_ground_distance(robot: pa.Robot, qpos: np.ndarray) -> float:
    """Return MuJoCo's smallest distance [m] between the ground and geoms other than feet."""
    model, data = robot.mj_model, evaluate_mujoco(robot, qpos)
    floor = int(np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE.value)[0])
    geoms = set(list_collidable_geoms(model)) - set(robot.foot_geoms)
    return min(mujoco.mj_geomDistance(model, data, floor, geom, FAR, None) for geom in geoms)


def draw_configuration(robot: pa.Robot, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    qpos = robot.home.copy()
    qpos[:3] = np.array([0.0, 0.0, 0.6]) + random.uniform(-0.2, 0.2, 3)
    qpos[3:7] = random.normal(size=4)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    qpos[7:] = random.uniform(robot.lower_limits, robot.upper_limits)
    return qpos


def test_lowest_part_above_steps_equals_mujocos_distance(robot: pa.Robot) -> None:
    """Reference: ``mj_geomDistance`` to the plane and each step; depths of penetrations are not
    compared."""
    shapes = ClearanceShapes(robot)
    ground = pa.Ground(0.2, 0.8, dict(zip(robot.contact_points, (0.05, 0.08), strict=False)))
    places = pa.Configuration(robot, robot.home).foot_positions()
    there, seen = build_on_ground(robot, ground, places), 0
    model = there.mj_model
    model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-9, 200
    still = np.flatnonzero(model.geom_bodyid == 0)
    for seed in range(20):
        qpos = draw_configuration(robot, seed)
        data = evaluate_mujoco(there, qpos)
        geoms = set(list_collidable_geoms(model)) - set(there.foot_geoms)
        expected = min(
            mujoco.mj_geomDistance(model, data, int(fixed), geom, FAR, None)
            for fixed, geom in itertools.product(still, geoms)
        )
        found = shapes.find_lowest_part(shapes.move_to(qpos), ground, places, {})
        assert found is not None
        if expected > 0:
            seen += 1
            assert found.distance == pytest.approx(expected, abs=1e-6)
        else:
            assert found.distance < 1e-6
    assert seen > 10


def test_link_distances_equal_those_of_mujoco_hulls(robot: pa.Robot) -> None:
    """Reference: distances between convex hulls in MuJoCo; of penetrating shapes only the sign."""
    shapes, model = ClearanceShapes(robot), robot.mj_model
    neighbours, seen = list_neighbours(robot), 0
    for seed in range(15):
        qpos = draw_configuration(robot, seed)
        data = evaluate_mujoco(robot, qpos)
        expected = min(
            mujoco.mj_geomDistance(model, data, first, second, FAR, None)
            for first, second in itertools.combinations(list_collidable_geoms(model), 2)
            if pair_of(model, first, second) not in neighbours
        )
        found = shapes.find_closest_links(qpos)
        assert found is not None
        if expected > 0:
            seen += 1
            assert found.distance == pytest.approx(expected, abs=1e-5)  # MuJoCo's tolerance: 1e-6
        else:
            assert found.distance < 1e-5
    assert seen > 5


def pair_of(model: mujoco.MjModel, one: int, two: int) -> frozenset[int]:
    return frozenset((int(model.geom_bodyid[one]), int(model.geom_bodyid[two])))


def list_neighbours(robot: pa.Robot) -> set[frozenset[int]]:
    """Return pairs of bodies that are equal, parent and child, or overlap in the home pose."""
    model, data = robot.mj_model, evaluate_mujoco(robot, robot.home)
    found = set()
    for first, second in itertools.combinations(list_collidable_geoms(model), 2):
        pair = pair_of(model, first, second)
        parents = {int(model.body_parentid[body]) for body in pair}
        near = mujoco.mj_geomDistance(model, data, first, second, FAR, None) <= 0
        if len(pair) == 1 or pair & parents or near:
            found.add(pair)
    return found


def test_requested_clearance_is_kept_and_its_limit_equals_mujoco(robot: pa.Robot) -> None:
    """Reference: MuJoCo's distance between the meshes and the ground. 1 % above the stated limit,
    the stand is refused."""
    with pytest.raises(pa.StanceUnreachableError, match=r"_calf is .* above the ground") as caught:
        pa.solve_stand(robot, pa.StandTask(ground_clearance=0.5))
    limit = caught.value.limits["ground_clearance"]["ground_clearance"]
    typed = pa.solve_stand(robot, pa.StandTask(ground_clearance=limit))
    assert limit <= compute_ground_distance(robot, typed.qpos) + 1e-9 < limit * 1.01
    with pytest.raises(pa.StanceUnreachableError):
        pa.solve_stand(robot, pa.StandTask(ground_clearance=1.01 * limit), explain=False)


def test_excluded_link_pairs_have_no_clearance(tmp_path: Path) -> None:
    """The pair of closest links is excluded in the MJCF; another pair is then the closest."""
    pair = write_meshed(tmp_path)
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    near = pa.solve_stand(robot, pa.StandTask(self_clearance=0.0)).self_clearance
    assert near is not None
    first, second = near.links
    pair = write_meshed(tmp_path, f'<contact><exclude body1="{first}" body2="{second}"/></contact>')
    other = pa.solve_stand(
        pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf), pa.StandTask(self_clearance=0.0)
    ).self_clearance
    assert other is not None
    assert set(other.links) != set(near.links)
    assert other.distance > near.distance - 1e-9


def test_clearance_is_refused_without_shapes_beside_the_feet(tmp_path: Path) -> None:
    """A robot whose only collision shapes are the feet has no ground clearance, and a required
    clearance is refused.
    """
    pair = quadruped(tmp_path, floor=True)
    text = pair.mjcf.read_text()
    pair.mjcf.write_text(text.replace(TRUNK, ""))
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    assert pa.solve_stand(robot).ground_clearance is None
    with pytest.raises(
        pa.ConfigurationError, match=r"^ground_clearance: .* no collision shapes except"
    ):
        pa.solve_stand(robot, pa.StandTask(ground_clearance=0.001))
    pa.solve_stand(robot, pa.StandTask(self_clearance=0.01))  # of the feet


def test_distance_to_a_signed_distance_field_is_refused(robot: pa.Robot) -> None:
    """The message names the type of the shape."""

    def as_field(model: mujoco.MjModel) -> None:
        model.geom_type[next(list_collidable_geoms(model))] = mujoco.mjtGeom.mjGEOM_SDF

    with pytest.raises(
        pa.ModelError, match="is a sdf with contacts, for which no distance can be computed"
    ):
        pa.solve_stand(change_model(robot, as_field))


def test_shapes_without_contacts_have_no_clearance(tmp_path: Path) -> None:
    """MuJoCo lets the trunk penetrate the ground if no bits of both shapes match."""
    pair = write_meshed(tmp_path)
    text = pair.mjcf.read_text()
    for bits, seen in (('contype="0" conaffinity="0"', False), ('contype="1"', True)):
        pair.mjcf.write_text(text.replace('mesh="shell" pos', f'mesh="shell" {bits} pos'))
        robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
        assert any(shape.link == "trunk" for shape in robot.shapes) == seen


@pytest.mark.slow
def test_workspace_ends_at_the_contact_of_a_mesh_with_the_ground(robot: pa.Robot) -> None:
    """Reference: MuJoCo's distance to the ground at the largest pitch, and 0.01 rad beyond it."""
    start = pa.StandTask(height=0.22)
    pitch = pa.stance.base_workspace(robot, start).intervals["pitch"].high
    stand = pa.solve_stand(robot, pa.StandTask(height=0.22, pitch=pitch))
    assert 0 <= compute_ground_distance(robot, stand.qpos) + 1e-6 < 1e-3
    qpos, half = stand.qpos.copy(), (pitch + 0.01) / 2
    qpos[3:7] = math.cos(half), 0.0, math.sin(half), 0.0
    assert compute_ground_distance(robot, qpos) < 0
