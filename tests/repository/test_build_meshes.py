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
    """A folder with a fresh build of all parts, made by the command itself."""
    folder: Path = tmp_path_factory.mktemp("meshes")
    result = CliRunner().invoke(build_meshes.main, ["--output", str(folder)])
    assert result.exit_code == 0, result.output
    return folder


def load(path: Path) -> Trimesh:
    """The part as a reader of the file sees it, equal vertices joined."""
    part = trimesh.load_mesh(path)
    assert isinstance(part, Trimesh)
    return part


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
