"""Collision shapes as sums of simple parts (support functions), compared with MuJoCo's distances,
masses and hulls.
"""

from __future__ import annotations

import itertools

import coal
import mujoco
import numpy as np
import pytest

from pupper_analysis.models.shapes import NUM_SIZES, Mesh, Pose, Shape, read_shape

TETRAHEDRON = "0 0 0  0.3 0 0  0 0.2 0  0 0 0.1  0.05 0.05 0.02"  # the last is inside
SIZES = {
    "sphere": "0.1",
    "box": "0.1 0.2 0.3",
    "ellipsoid": "0.1 0.2 0.3",
    "cylinder": "0.1 0.3",
    "capsule": "0.1 0.3",
    "mesh": "",
}
PLACE = 'pos="0.4 -0.3 0.2" quat="0.8 0.3 -0.4 0.33"'


def model_of(kind: str, density: float = 1.0) -> mujoco.MjModel:
    form = 'mesh="it"' if kind == "mesh" else f'size="{SIZES[kind]}"'
    return mujoco.MjModel.from_xml_string(f"""<mujoco>
      <asset><mesh name="it" vertex="{TETRAHEDRON}"/></asset>
      <worldbody><geom type="plane" size="9 9 1" name="floor"/>
        <body pos="0.1 0.2 3" euler="20 -30 140"><freejoint/>
          <geom name="form" type="{kind}" {form} {PLACE} density="{density}"/></body>
      </worldbody></mujoco>""")


def directions_of(seed: int) -> np.ndarray:
    found = np.random.default_rng(seed).normal(size=(200, 3))
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


@pytest.mark.parametrize("kind", SIZES)
def test_shape_height_equals_mujoco(kind: str) -> None:
    """Reference: ``mj_geomDistance``; height, lowest point and support function in the frame of the
    body."""
    model = model_of(kind)
    data = mujoco.MjData(model)
    shape, body = read_shape(model, 1), 1
    assert (shape.name, shape.kind) == ("form", kind)
    for down in directions_of(3)[:20]:
        model.geom_quat[0], model.geom_sameframe[0] = quaternion_from_z(-down), 0
        mujoco.mj_kinematics(model, data)
        turn, place = data.xmat[body].reshape(3, 3), data.xpos[body]
        expected = mujoco.mj_geomDistance(model, data, 0, 1, 99.0, None)
        height = shape.height((turn, place), tuple((-down).tolist()))
        lowest = shape.find_lowest_point((turn, place), -down)
        reach = shape.support((down @ turn)[None])
        assert reach is not None
        assert height == pytest.approx(expected, abs=1e-6)
        assert -down @ lowest == pytest.approx(height, abs=1e-12)
        assert -down @ place - reach[0] == pytest.approx(height, abs=1e-12)


def quaternion_from_z(normal: np.ndarray) -> np.ndarray:
    found = np.zeros(4)
    mujoco.mju_quatZ2Vec(found, normal)
    return found


@pytest.mark.parametrize("kind", SIZES)
def test_no_point_of_a_shape_is_beyond_its_support(kind: str) -> None:
    """Reference: the projection of the shape's points on 200 random directions [m]; the points
    reach 90 % of the extent.
    """
    shape, directions = read_shape(model_of(kind), 1), directions_of(5)
    reach, points = shape.support(directions), shape.points
    assert reach is not None
    assert points is not None
    far = (directions @ points.T).max(axis=1)
    assert (far <= reach + 1e-12).all()
    assert (reach - far).max() < 0.1 * np.ptp(points, axis=0).max()


@pytest.mark.parametrize("kind", SIZES)
def test_coal_shape_distance_equals_the_support_function(kind: str) -> None:
    """Reference: Coal's distance to half spaces in 20 random directions."""
    shape = read_shape(model_of(kind), 1)
    own = coal.Transform3s(shape.pose.rotation, shape.pose.position)
    directions = directions_of(7)[:20]
    reach = shape.support(directions)
    assert reach is not None
    for out, far in zip(directions, reach, strict=True):
        wall, found = coal.Halfspace(-out, -2.0), coal.DistanceResult()  # beyond 2 m
        coal.distance(shape.collision, own, wall, coal.Transform3s(), coal.DistanceRequest(), found)
        assert 2.0 - found.min_distance == pytest.approx(far, abs=1e-6)


def test_mesh_shape_is_its_convex_hull() -> None:
    """Reference: MuJoCo's hull of a colliding mesh. MuJoCo has no hull of other meshes; their
    computed hull has the same corners.
    """
    touching = model_of("mesh")
    drawn = model_of("mesh")
    drawn.mesh_graphadr[0] = -1  # as for a mesh without contacts
    hulls = [read_shape(model, 1).mesh for model in (touching, drawn)]
    sets = []
    for hull in hulls:
        assert hull is not None
        assert len(hull.vertices) == len(hull.faces) == 4
        assert {*hull.faces.ravel().tolist()} == {0, 1, 2, 3}
        sets.append({tuple(point) for point in hull.vertices.round(9).tolist()})
    assert sets[0] == sets[1]


def test_a_placed_shape_is_moved_with_its_body() -> None:
    """Closed form: h(d) = d . p + h0(R^T d)."""
    pose = Pose(np.array([1.0, 2.0, 3.0]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    shape, directions = read_shape(model_of("cylinder"), 1), directions_of(1)
    there, here = (
        shape.placed_in(pose).support(directions),
        shape.support(directions @ pose.rotation),
    )
    assert here is not None
    assert there == pytest.approx(directions @ pose.position + here, abs=1e-12)


def test_shape_without_extent_has_no_support() -> None:
    for kind, size in (("plane", ()), ("mesh", ()), ("none", ())):
        shape = Shape("", kind, Pose(), size, collides=True)
        assert (shape.support(np.eye(3)), shape.points) == (None, None)
    assert read_shape(model_of("box"), 0).kind == "plane"
    assert {*NUM_SIZES} == {*SIZES}


def test_points_in_a_plane_are_their_own_hull() -> None:
    flat = Mesh(
        np.array([*itertools.product((0.0, 1.0), (0.0, 1.0), (0.0,))]), np.eye(3, dtype=int)
    )
    assert flat.hull() is flat
