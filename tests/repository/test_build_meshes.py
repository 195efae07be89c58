"""The drawn parts: closed solids of the right size, small, and the same as those committed."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.support.repository import ROOT

pytest.importorskip("trimesh", reason="the STL parts are built with trimesh")
pytest.importorskip("manifold3d", reason="trimesh joins the STL parts with manifold3d")
pytest.importorskip("shapely", reason="the outlines of the STL parts are drawn with shapely")

import trimesh
from click.testing import CliRunner
from trimesh import Trimesh

from tests.support.repository import script

NAMES = ("torso", "hip", "thigh", "calf")
MAX_BYTES = 400_000
TORSO_TOLERANCE = 0.003  # [m] over the collision box
STRETCH = 1.5  # of the long-leg variants


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


def holds(part: Trimesh, *points: np.ndarray) -> bool:
    """Whether a small cube around each point lies wholly inside the part."""
    cubes = [trimesh.creation.box([1e-4] * 3).apply_translation(point) for point in points]
    return all(
        trimesh.boolean.intersection([part, cube]).volume == pytest.approx(cube.volume, rel=1e-2)
        for cube in cubes
    )


@pytest.mark.parametrize("name", NAMES)
def test_is_one_closed_solid(fresh: Path, name: str) -> None:
    part = load(fresh / f"{name}.stl")
    assert part.is_watertight
    assert part.is_winding_consistent
    assert part.body_count == 1
    assert part.volume > 0


def test_files_are_small(fresh: Path) -> None:
    assert sorted(path.name for path in fresh.iterdir()) == sorted(f"{n}.stl" for n in NAMES)
    assert sum(path.stat().st_size for path in fresh.iterdir()) < MAX_BYTES


def test_build_is_deterministic(fresh: Path, tmp_path: Path) -> None:
    assert CliRunner().invoke(build_meshes.main, ["--output", str(tmp_path)]).exit_code == 0
    for name in NAMES:
        file = f"{name}.stl"
        assert (tmp_path / file).read_bytes() == (fresh / file).read_bytes()


@pytest.mark.parametrize("name", NAMES)
def test_committed_file_is_a_fresh_build(fresh: Path, name: str) -> None:
    committed = load(ROOT / "mjcf" / "meshes" / f"{name}.stl")
    part = load(fresh / f"{name}.stl")
    # Library versions may cut a surface into other triangles: compare the shape, loosely.
    assert committed.volume == pytest.approx(part.volume, rel=1e-3)
    np.testing.assert_allclose(committed.bounds, part.bounds, atol=1e-3 * part.scale)


def test_torso_stays_in_its_collision_box(fresh: Path) -> None:
    low, high = load(fresh / "torso.stl").bounds
    # The collision box of base_link, turned into the base frame [m].
    centre, half_size = np.array([0.02146, 0, 0.03345]), np.array([0.129715, 0.06379, 0.04507])
    assert np.all(low >= centre - half_size - TORSO_TOLERANCE)
    assert np.all(high <= centre + half_size + TORSO_TOLERANCE)


def test_hip_joins_torso_and_turns_freely(fresh: Path) -> None:
    torso, hip = load(fresh / "torso.stl"), load(fresh / "hip.stl")
    # Where the hip's inner face meets the torso, the torso is there (1 mm further in).
    for x, y in ((0.075, -0.0835), (-0.075, -0.0725)):
        inner_face = np.array([x, y + hip.bounds[1, 1] + 0.001, 0.0])
        assert holds(torso, inner_face)
    radius = np.hypot(hip.vertices[:, 0], hip.vertices[:, 2])
    assert radius.max() < 0.036


def test_thigh_reaches_the_knee(fresh: Path) -> None:
    thigh = load(fresh / "thigh.stl")
    knee = np.array([0.0, 0.0, np.hypot(0.0494, 0.0685)])
    assert holds(thigh, knee, 0.02 * knee)
    # The housing around it: the collision cylinder of leg_*_2, radius 25 mm.
    assert thigh.bounds[1, 2] == pytest.approx(knee[2] + 0.025, abs=1e-3)


def test_calf_runs_from_the_knee_housing_to_the_foot(fresh: Path) -> None:
    calf = load(fresh / "calf.stl")
    foot = np.array([0.0, 0.018, np.hypot(0.06231, 0.06216)])
    assert holds(calf, np.array([0.0, 0.018, 0.0]), foot - [0, 0, 0.002])
    # The end is hidden in the ball.
    end = calf.vertices[calf.vertices[:, 2] > foot[2] - 0.012]
    assert np.linalg.norm(end - foot, axis=1).max() < 0.01995
    # At the knee, it lies outside the motor's housing but for the 3 mm that hide the joint.
    at_knee = calf.vertices[np.abs(calf.vertices[:, 2]) < 0.01]
    assert at_knee[:, 1].min() > 0.012


def test_mujoco_loads_every_part_both_ways_round_and_stretched(fresh: Path) -> None:
    spec = mujoco.MjSpec()
    spec.meshdir = str(fresh)
    for name in NAMES:
        for side, scale in (("r", [1, 1, STRETCH]), ("l", [1, -1, STRETCH])):
            spec.add_mesh(name=f"{name}_{side}", file=f"{name}.stl", scale=scale)
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{name}_{side}")
    model = spec.compile()
    assert model.nmesh == 2 * len(NAMES)
