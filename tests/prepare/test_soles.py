"""Soles that are meshes, and soles on legs with few joints: contact points and stands, compared
with MuJoCo and closed forms.
"""

from __future__ import annotations

import re
from itertools import permutations
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from pupper_analysis.models.shapes import Pose, Shape
from pupper_analysis.prepare import passes
from pupper_analysis.prepare.contact_points import (
    can_keep_sole_flat,
    compute_osculating_sphere,
    find_sole_corners,
    fit_sphere,
)
from pupper_analysis.robot.robot import Robot
from tests.support.legged import (
    BIPED_FEET,
    Pair,
    biped,
    fix_hinges,
    quadruped,
    rewrite_file,
    shift_base_com,
    sole_mesh,
)


def load(pair: Pair) -> Robot:
    return pa.load_robot(*pair)


VERTICES = re.compile('(?<=vertex=")[^"]*')


def with_vertices(pair: Pair, vertices: str) -> Pair:
    pair.mjcf.write_text(VERTICES.sub(vertices, pair.mjcf.read_text(), count=1))
    return pair


def verify_held_stand(robot: Robot, task: pa.StandTask | None = None, *, within: float) -> pa.Stand:
    """Return the stand on soft ground; assert that MuJoCo holds it with relative torque and force
    errors below `within`.
    """
    stand = pa.stance.solve_stand_on_soft_ground(robot, task)
    found = pa.verify_stand(robot, stand)
    assert found.passed, found.failures
    assert max(found.torque_error, found.force_error) < within
    return stand


@pytest.mark.slow
def test_mesh_sole_gets_spheres_at_its_corners(tmp_path: Path) -> None:
    """MuJoCo's contacts of a mesh with many vertices jump as loads shift: by 1.4 % on an H1-2."""
    pair = sole_mesh(biped(tmp_path), BIPED_FEET["box"])
    robot = load(pair)
    assert any(note.code == "balls-for-soles" for note in robot.notes)
    for points in robot.feet.values():
        assert len(points) == 8
        assert {robot.contact_radius[point] for point in points} == {2e-3}
    for shape in range(robot.mj_model.ngeom):
        if robot.mj_model.geom_type[shape] == mujoco.mjtGeom.mjGEOM_MESH.value:
            assert robot.mj_model.geom_contype[shape] == 0
    # The shoe's lowest points are 60 mm below its frame, and from -60 to 120 mm along it.
    places = pa.Configuration(robot, robot.neutral()).foot_positions()
    soles = np.array([places[point] for point in robot.feet["left_tilt_link"]])
    tilt = pa.Configuration(robot, robot.neutral()).joint_position("left_tilt")
    np.testing.assert_allclose(soles[:, 2] - tilt[2], -0.06 + 2e-3, atol=1e-9)
    assert 0.17 < np.ptp(soles[:, 0]) < 0.18  # the corners are inside the round ends
    verify_held_stand(robot, within=1e-5)
    # Uneven loads: the depths that a plane leaves are those of a law that is no line.
    verify_held_stand(robot, pa.StandTask(offset=(0.02, 0.015)), within=1e-3)


@pytest.mark.slow
def test_spheres_of_a_sole_are_in_one_plane(tmp_path: Path) -> None:
    """A corner of a Zeroth bot's sole is 0.14 mm off; unprojected, the foot tilts by 1.9 %."""
    pair = sole_mesh(biped(tmp_path), BIPED_FEET["box"])
    numbers = VERTICES.findall(pair.mjcf.read_text())[0].split()
    random = np.random.default_rng(1)
    for number in range(2, len(numbers), 3):
        if float(numbers[number]) == -0.06:
            numbers[number] = repr(float(-0.06 - 5e-5 * random.uniform()))
    with_vertices(pair, " ".join(numbers))
    robot = load(pair)
    assert len(robot.feet) == 2
    for points in robot.feet.values():
        places = np.array([robot.contact_places[point][1] for point in points])
        assert len(places) == 8
        assert np.linalg.svd(places - places.mean(axis=0))[1][2] < 1e-9
    verify_held_stand(robot, within=1e-8)  # 3e-5 with balls where the mesh has its corners


@pytest.mark.slow
def test_mesh_sole_with_four_corners_has_four_contact_points(tmp_path: Path) -> None:
    """A box as a mesh: MuJoCo's contacts are its corners at any tilt, so no balls are added."""
    box = " ".join(
        f"{x} {y} {z}" for x in (-0.06, 0.12) for y in (-0.04, 0.04) for z in (-0.06, -0.04)
    )
    robot = load(with_vertices(sole_mesh(biped(tmp_path), BIPED_FEET["box"]), box))
    assert not any("small balls" in str(note) for note in robot.notes)
    assert {len(points) for points in robot.feet.values()} == {4}
    verify_held_stand(robot, within=1e-5)


def test_sole_corners_are_the_lowest_corners_of_the_hull() -> None:
    """Reference by hand: 8 of 60 points of an ellipse, the corners of a square, and none of a
    line.
    """
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = np.column_stack([0.1 * np.cos(angles), 0.05 * np.sin(angles), np.zeros(60)])
    above = ring + np.array([0, 0, 0.01])
    found = find_sole_corners(np.vstack([ring, above]), np.array([0.0, 0.0, -1.0]), 1e-3)
    assert len(found) == 8
    assert max(found) < 60
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0, 0], [0.5, 0.5, 0]])
    assert sorted(find_sole_corners(square, np.array([0.0, 0.0, 1.0]), 1e-3)) == [0, 1, 2, 3]
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert find_sole_corners(line, np.array([0.0, 0.0, 1.0]), 1e-3) == []


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["box", "four spheres", "two capsules"])
def test_legs_of_four_joints_stand_on_soles(shape: str, tmp_path: Path) -> None:
    """Roll at the hip; pitch at hip, knee and ankle: as TRON 1's. The com is 2 um aside."""
    pair = fix_hinges(biped(tmp_path, BIPED_FEET[shape]), "_yaw", "_tilt")
    robot = load(shift_base_com(pair, 2e-6))
    assert robot.nu == 8
    assert len(robot.contact_points) == 8
    assert any(note.code == "com-anywhere-inside" for note in robot.notes)
    stand = verify_held_stand(robot, within=1e-2)
    assert stand.foot_error < 1e-9
    verify_held_stand(robot, pa.StandTask(height=0.95 * robot.stand_height), within=1e-2)


@pytest.mark.slow
def test_nearly_level_sole_keeps_the_tilt_of_its_leg(tmp_path: Path) -> None:
    """The sole is tilted by 3 urad, the rounding of a mesh, which no joint of the leg can
    correct.
    """
    foot = BIPED_FEET["box"].replace("/>", ' euler="3e-6 0 0"/>')
    pair = fix_hinges(biped(tmp_path, foot), "_yaw", "_tilt")
    verify_held_stand(load(pair), within=1e-2)


@pytest.mark.slow
def test_soles_on_legs_of_five_joints_lie_flat(tmp_path: Path) -> None:
    """As for Xuanwu, with its CoM 0.9 mm off the centre: the feet roll with the hips only.

    Reference: heights of the sole points, equal to 1e-6.
    """
    pair = fix_hinges(biped(tmp_path), "_tilt")
    robot = load(shift_base_com(pair, 3e-5))
    assert robot.nu == 10
    stand = verify_held_stand(robot, within=1e-4)  # 1e-2 with the com in the middle
    config = pa.Configuration(robot, stand.qpos)
    for points in robot.feet.values():
        heights = [config.foot_positions()[point][2] for point in points]
        assert np.ptp(heights) < 1e-6


@pytest.mark.slow
def test_unreachable_stance_of_four_joint_legs_is_refused(tmp_path: Path) -> None:
    """Legs without yaw and tilt joints: a foot cannot be moved sideways or lifted with a level
    sole.
    """
    robot = load(fix_hinges(biped(tmp_path), "_yaw", "_tilt"))
    task = pa.StandTask(foot_offsets={"left_tilt_link": (0.0, 0.03)})
    with pytest.raises(pa.StanceUnreachableError, match="foot_offsets"):
        pa.solve_stand(robot, task)
    with pytest.raises(pa.StanceUnreachableError) as caught:  # names the missing joints
        pa.solve_stand(robot, pa.StandTask(swing={"left_tilt_link": 0.05}))
    assert caught.value.possible == {}
    assert "needs a leg of six joints; the leg of left_tilt_link has 4" in str(caught.value)
    assert str(caught.value.lacks) in str(caught.value)


def test_feet_of_four_joint_legs_that_tilt_have_one_contact_point(tmp_path: Path) -> None:
    """Control: the biped with all six joints per leg. With yaw, roll, pitch and knee only, the foot
    tilts with the leg.
    """
    pair = fix_hinges(biped(tmp_path), "_ankle", "_tilt")
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    foot = model.body("left_tilt_link").id
    assert not can_keep_sole_flat(model, foot, np.array([0.0, 0.0, -1.0]))
    complete = tmp_path / "complete"
    complete.mkdir()
    model = mujoco.MjModel.from_xml_path(str(biped(complete).mjcf))
    assert can_keep_sole_flat(model, model.body("left_tilt_link").id, np.array([0.0, 0.0, -1.0]))


@pytest.mark.slow
def test_tilted_flat_soles_give_a_failure(tmp_path: Path) -> None:
    """Legs of three joints cannot align the soles.

    Standing on edges passes; corners that carry load without prediction fail.
    """
    box = '<geom type="box" size="0.03 0.02 0.01" pos="0 0 -0.2" euler="0 0.6 0"/>'
    pair = quadruped(tmp_path, foot=box, floor=True)
    robot = pa.load_robot(*pair)
    tasks = (pa.StandTask(height=height) for height in (0.3, 0.36))
    stands = (pa.stance.solve_stand_on_soft_ground(robot, task) for task in tasks)
    tilted, found = (pa.verify_stand(robot, stand) for stand in stands)
    assert tilted.passed  # on an edge each
    assert not found.passed
    assert "foot-force-off" in {failure.code for failure in found.failures}


@pytest.mark.slow
def test_tilted_soles_of_spheres_are_refused(tmp_path: Path) -> None:
    """The lowest of four balls at zero angles is the foot; at this stand another ball is 0.1 mm in
    the ground."""
    balls = "".join(
        f'<geom type="sphere" size="0.01" pos="{x} {y} -0.2"/>'
        for x in (-0.02, 0.02)
        for y in (-0.02, 0.02)
    )
    robot = load(quadruped(tmp_path, foot=balls))
    assert pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot)).passed
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.stance.solve_stand_on_soft_ground(robot, pa.StandTask(height=0.36, offset=(0.15, 0.0)))
    assert "_calf penetrates the ground by 0.1 mm" in str(caught.value.blocked[0])


TILTED = Rotation.from_euler("xyz", (0.3, 0.5, 0.2))


def with_ellipsoids(folder: Path, size: tuple[float, ...], turn: Rotation) -> Pair:
    """Write a quadruped whose feet are ellipsoids with the half axes ``size`` [m]."""
    quaternion = " ".join(map(repr, turn.as_quat(scalar_first=True).tolist()))
    axes = " ".join(map(str, size))
    foot = f'<geom type="ellipsoid" size="{axes}" pos="0 0 -0.2" quat="{quaternion}"/>'
    return quadruped(folder, foot=foot, floor=True)


def lowest_points(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the lowest point of each ellipsoid, shape (n, 3) [m], in closed form.

    With the half axes in S and the direction d downwards in the geom's frame, the point is
    S^2 d / |S d|.
    """
    found = []
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        turn, squares = data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom] ** 2
        down = -turn[2]
        found.append(
            data.geom_xpos[geom] + turn @ (squares * down) / np.sqrt(down @ (squares * down))
        )
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("turn", [Rotation.identity(), TILTED], ids=["level", "tilted"])
@pytest.mark.parametrize(
    "size",
    [*permutations((0.03, 0.02, 0.01)), (0.02, 0.02, 0.02), (0.06, 0.02, 0.01)],
    ids=str,
)
def test_contact_points_of_ellipsoid_feet_are_the_lowest_points_of_the_published_file(
    size: tuple[float, ...], turn: Rotation, tmp_path: Path
) -> None:
    """References: the closed form, and MuJoCo's contacts of the unmodified MJCF.

    Half axes of 60 mm: the fits oscillated, and after six fits points were 40 mm off.
    """
    pair = with_ellipsoids(tmp_path, size, turn)
    robot = pa.load_robot(*pair)
    stand = pa.solve_stand(robot)
    points = np.array(list(stand.contact_points.values()))
    published = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(published)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_fwdPosition(published, data)
    closed_form = lowest_points(published, data)
    np.testing.assert_allclose(distances_to_nearest(closed_form, points), 0, atol=2e-5)
    data.qpos[2] -= 1e-4
    mujoco.mj_fwdPosition(published, data)
    assert len(data.contact) == 4
    np.testing.assert_allclose(data.contact.dist, -1e-4, atol=1e-6)
    np.testing.assert_allclose(distances_to_nearest(data.contact.pos, points), 0, atol=1.1e-4)
    assert "balls-for-ellipsoids" in {note.code for note in robot.notes}
    if len(set(size)) == 1:  # the limit: a sphere
        assert set(robot.contact_radius.values()) == {0.02}
    soft = pa.stance.solve_stand_on_soft_ground(robot)
    assert pa.verify_stand(robot, soft).torque_error < 1e-5


def test_ellipsoid_feet_without_converged_contact_points_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: the closed form is 40 mm from the contact points after six fits."""
    monkeypatch.setattr(passes, "_MAX_ELLIPSOID_FITS", 2)
    with pytest.raises(pa.ModelError, match="contact points still move by 45 mm"):
        pa.load_robot(*with_ellipsoids(tmp_path, (0.06, 0.02, 0.01), TILTED))


def distances_to_nearest(these: np.ndarray, those: np.ndarray) -> np.ndarray:
    """Return the distance of each point (n, 3) from the nearest of other points [m]."""
    apart: np.ndarray = np.linalg.norm(these[:, None] - those[None], axis=2).min(axis=1)
    return apart


def test_osculating_sphere_has_the_point_and_mean_curvature_of_the_support_function() -> None:
    """Reference: finite differences of h(d) = max x.d: its gradient is the point with the normal d,
    and its second derivative across d has the principal radii [m] as eigenvalues.
    """
    half_axes, step = np.array([0.03, 0.02, 0.01]), 1e-4
    down = TILTED.apply([0.0, 0.0, -1.0])
    shape = Shape("", "ellipsoid", Pose(), tuple(half_axes.tolist()), collides=True)

    def support(direction: np.ndarray) -> float:
        return float(np.linalg.norm(half_axes * direction))

    eye = step * np.eye(3)
    gradient = [(support(down + offset) - support(down - offset)) / (2 * step) for offset in eye]
    curvature = sum(
        (support(down + offset) - 2 * support(down) + support(down - offset)) / step**2
        for offset in eye
    )  # the trace: the direction itself adds nothing, as h is homogeneous of degree 1
    centre, radius = compute_osculating_sphere(shape, down)
    np.testing.assert_allclose(centre + radius * down, gradient, atol=1e-8)
    assert radius == pytest.approx(curvature / 2, rel=1e-5)


@pytest.mark.slow
def test_round_sole_touches_at_its_rim(tmp_path: Path) -> None:
    """Reference: the radius of the cylinder, 90 mm from its axis."""
    robot = load(biped(tmp_path, BIPED_FEET["cylinder"]))
    assert len(robot.feet) == 2
    for points in robot.feet.values():
        places = np.array([robot.contact_places[point][1] for point in points])
        assert len(points) >= 3
        from_axis = np.linalg.norm(places[:, :2] - (0.03, 0.0), axis=1)
        np.testing.assert_allclose(from_axis, 0.09, rtol=0.02)


@pytest.mark.slow
def test_sole_sinks_as_a_plane_that_carries_force_and_moment(tmp_path: Path) -> None:
    """Reference: simulation.

    Unequal loads tilt the soles; in the second stand a corner is lifted by more than 0.1 mm.
    """
    pair = biped(tmp_path)
    robot = pa.load_robot(*pair)
    tilted = verify_held_stand(robot, pa.StandTask(com=(0.06, 0.04)), within=1e-6)
    assert min(tilted.depths.values()) > 1e-4
    lifted = verify_held_stand(robot, pa.StandTask(com=(0.08, 0.06)), within=1e-6)
    assert min(lifted.depths.values()) < -1e-4


def test_fitted_sphere_has_the_centre_and_radius_of_its_points() -> None:
    """Reference: 4,000 random points on a sphere at (0.4, -0.3, 0.2) m."""
    centre, radius, down = np.array([0.4, -0.3, 0.2]), 0.021, np.array([0.0, 0.0, -1.0])
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    points = centre + radius * directions / np.linalg.norm(directions, axis=1)[:, None]
    found, size = fit_sphere(points, centre + radius * down, down)
    np.testing.assert_allclose(found, centre, atol=1e-9)
    assert size == pytest.approx(radius, abs=1e-9)


def test_box_feet_of_a_quadruped_with_three_joints_per_leg_are_contact_points(
    tmp_path: Path,
) -> None:
    foot = '<geom type="box" size="0.03 0.02 0.01" pos="0 0 -0.2"/>'
    assert len(load(quadruped(tmp_path, foot=foot)).contact_points) == 4


@pytest.mark.slow
def test_biped_with_soles_and_without_stand_is_told_why_it_cannot_stand(tmp_path: Path) -> None:
    """The CoM is 2.4 m in front of the feet: no posture of legs of 0.7 m balances it.

    The answer was that the robot has no feet.
    """
    urdf = biped(tmp_path).urdf
    box = '<origin xyz="0.03 0 -0.05"/><geometry><box size="0.18 0.08 0.02"/></geometry>'
    for side in ("left", "right"):
        link = f'<link name="{side}_tilt_link">'
        rewrite_file(urdf, (link, f"{link}<collision>{box}</collision>"))
    assert pa.load_robot(urdf).floating
    rewrite_file(urdf, ('<origin xyz="0.0 0.0 0.1"/><mass value="8.0"',
                        '<origin xyz="3.0 0.0 0.1"/><mass value="8.0"'))  # fmt: skip
    robot = pa.load_robot(urdf)
    with pytest.raises(pa.errors.ConfigurationError) as caught:
        pa.solve_stand(robot)
    message = str(caught.value)
    assert "no stand was found on left_tilt_link, right_tilt_link" in message
    assert "--foot" in message
    assert "no feet" not in message
