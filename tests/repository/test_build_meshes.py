"""Meshes of the drawn parts are closed solids, and equal a new build."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.repository import ROOT

pytest.importorskip("trimesh", reason="the STL parts are built with trimesh")
pytest.importorskip("manifold3d", reason="trimesh joins the STL parts with manifold3d")
pytest.importorskip("shapely", reason="the outlines of the STL parts are drawn with shapely")

import mujoco
import trimesh
from click.testing import CliRunner
from trimesh import Trimesh

from tests.support.repository import script

NAMES = ("torso", "hip", "thigh", "calf")


build_meshes = script("scripts/build_meshes.py")


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a fresh build of all parts, made by the command itself."""
    folder: Path = tmp_path_factory.mktemp("meshes")
    result = CliRunner().invoke(build_meshes.main, ["--output", str(folder)])
    assert result.exit_code == 0, result.output
    return folder


def load(path: Path) -> Trimesh:
    """Load the mesh of a part with trimesh, which merges equal vertices."""
    part = trimesh.load_mesh(path)
    assert isinstance(part, Trimesh)
    return part


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_mesh_is_one_closed_solid(fresh: Path, name: str) -> None:
    part = load(fresh / f"{name}.stl")
    assert part.is_watertight
    assert part.is_winding_consistent
    assert part.body_count == 1
    assert part.volume > 0


@pytest.mark.parametrize("name", NAMES)
def test_committed_file_is_a_fresh_build(fresh: Path, name: str) -> None:
    """Volumes and bounds within 0.1 %: library versions cut surfaces into different triangles."""
    committed = load(ROOT / "mjcf" / "meshes" / f"{name}.stl")
    part = load(fresh / f"{name}.stl")
    # Library versions may cut a surface into other triangles: compare the shape, loosely.
    assert committed.volume == pytest.approx(part.volume, rel=1e-3)
    np.testing.assert_allclose(committed.bounds, part.bounds, atol=1e-3 * part.scale)


def test_torso_is_drawn_in_the_collision_box_of_the_model() -> None:
    """Reference: MuJoCo's box of the base, whose extents along x, y and z are |R| times the half
    sizes. Only the collars of the hips extend further."""
    model = mujoco.MjModel.from_xml_path(str(ROOT / "mjcf" / "pupper_v3.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    base = model.body("base_link").id
    (box,) = (
        geom
        for geom in range(model.ngeom)
        if model.geom_bodyid[geom] == base and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
    )
    half = np.abs(data.geom_xmat[box].reshape(3, 3)) @ model.geom_size[box]
    centre = data.geom_xpos[box] - data.xpos[base]
    torso = load(ROOT / "mjcf" / "meshes" / "torso.stl")
    for axis in (0, 2):
        np.testing.assert_allclose(
            torso.bounds[:, axis], centre[axis] + np.array([-1, 1]) * half[axis], atol=2e-3
        )
    section = torso.section(plane_origin=[0, 0, 0], plane_normal=[1, 0, 0])  # between the collars
    np.testing.assert_allclose(section.bounds[:, 1], [-half[1], half[1]], atol=2e-3)


def contains(part: Trimesh, *points: np.ndarray) -> bool:
    """Return True if a cube of 0.1 mm around each point is inside the part."""
    cubes = [trimesh.creation.box([1e-4] * 3).apply_translation(point) for point in points]
    return all(
        trimesh.boolean.intersection([part, cube]).volume == pytest.approx(cube.volume, rel=1e-2)
        for cube in cubes
    )


def test_build_is_deterministic(fresh: Path, tmp_path: Path) -> None:
    assert CliRunner().invoke(build_meshes.main, ["--output", str(tmp_path)]).exit_code == 0
    assert sorted(path.name for path in fresh.iterdir()) == sorted(f"{n}.stl" for n in NAMES)
    for name in NAMES:
        assert (tmp_path / f"{name}.stl").read_bytes() == (fresh / f"{name}.stl").read_bytes()


def test_all_files_have_less_than_400_kb(fresh: Path) -> None:
    assert sum(path.stat().st_size for path in fresh.iterdir()) < 400_000


def test_hip_touches_the_torso_and_has_clearance_to_turn(fresh: Path) -> None:
    torso, hip = load(fresh / "torso.stl"), load(fresh / "hip.stl")
    for x, y in ((0.075, -0.0835), (-0.075, -0.0725)):
        assert contains(torso, np.array([x, y + hip.bounds[1, 1] + 0.001, 0.0]))
    assert np.hypot(hip.vertices[:, 0], hip.vertices[:, 2]).max() < 0.036


def test_thigh_extends_to_the_motor_of_the_knee(fresh: Path) -> None:
    """The housing around the knee is the collision cylinder of the model, of radius 25 mm."""
    thigh, knee = load(fresh / "thigh.stl"), np.array([0.0, 0.0, np.hypot(0.0494, 0.0685)])
    assert contains(thigh, knee, 0.02 * knee)
    assert thigh.bounds[1, 2] == pytest.approx(knee[2] + 0.025, abs=1e-3)


def test_calf_extends_from_the_motor_of_the_knee_into_the_foot(fresh: Path) -> None:
    calf = load(fresh / "calf.stl")
    foot = np.array([0.0, 0.018, np.hypot(0.06231, 0.06216)])
    assert contains(calf, np.array([0.0, 0.018, 0.0]), foot - [0, 0, 0.002])
    end = calf.vertices[calf.vertices[:, 2] > foot[2] - 0.012]
    assert np.linalg.norm(end - foot, axis=1).max() < 0.01995
    at_knee = calf.vertices[np.abs(calf.vertices[:, 2]) < 0.01]
    assert at_knee[:, 1].min() > 0.012


def test_mujoco_loads_mirrored_and_stretched_meshes(fresh: Path) -> None:
    spec = mujoco.MjSpec()
    spec.meshdir = str(fresh)
    for name in NAMES:
        for side, scale in (("r", [1, 1, 1.5]), ("l", [1, -1, 1.5])):
            spec.add_mesh(name=f"{name}_{side}", file=f"{name}.stl", scale=scale)
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{name}_{side}")
    assert spec.compile().nmesh == 2 * len(NAMES)
