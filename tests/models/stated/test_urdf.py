"""Shapes that a URDF states."""

from __future__ import annotations

import logging
import re
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import coal
import numpy as np
import pytest
import trimesh

from pupper_analysis.models.mesh_scenes import read_collada_asset, read_merged_mesh
from pupper_analysis.models.shapes import Mesh
from pupper_analysis.models.stated import urdf as stated_urdf
from pupper_analysis.models.stated.urdf import mesh_hull, read_mesh_file, read_urdf_model
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.tools.audit.rules.files import find_mesh_problem

URDF = """<robot name="robot"><link name="base">
  <visual name="seen"><geometry><mesh filename="a.obj"/></geometry></visual>
  <collision name="touched"><geometry><mesh filename="a.obj"/></geometry></collision>
  <collision name="ball"><geometry><sphere radius="0.1"/></geometry></collision>
</link></robot>"""


def test_collision_meshes_collide_and_visual_meshes_do_not(tmp_path: Path) -> None:
    """Reference: the elements of the file; a mesh has no size of its own."""
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")
    path = tmp_path / "robot.urdf"
    path.write_text(URDF)
    shapes = read_urdf_model(read_urdf(path)).links["base"].shapes
    assert {shape.name: (shape.collides, shape.size) for shape in shapes} == {
        "seen": (False, ()),
        "touched": (True, ()),
        "ball": (True, (0.1,)),
    }


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_stl_files_are_read_as_by_trimesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """Reference: trimesh, which writes and reads the file; a binary file is read without it."""
    solid = trimesh.creation.icosphere(subdivisions=1, radius=0.1)
    path = tmp_path / "a.stl"
    solid.export(path, file_type=kind)
    read = trimesh.load(path, force="mesh", process=False)
    expected = Mesh(np.asarray(read.vertices), np.asarray(read.faces)).hull()
    if kind == "stl":
        monkeypatch.setitem(sys.modules, "trimesh", None)
    hull = read_mesh_file(path, 0)
    assert isinstance(hull, Mesh)
    np.testing.assert_array_equal(hull.vertices, expected.vertices)
    np.testing.assert_array_equal(hull.faces, expected.faces)


@pytest.mark.parametrize("content", [b"", b" " * 80 + b"\x02\0\0\0" + b"\0" * 50])
def test_stl_files_without_the_stated_triangles_are_refused(tmp_path: Path, content: bytes) -> None:
    """Reference: the number of triangles in the header, 2, and the bytes of one triangle."""
    path = tmp_path / "a.stl"
    path.write_bytes(content)
    assert not isinstance(read_mesh_file(path, 0), Mesh)


def test_a_mesh_that_vanishes_after_its_path_was_found_is_no_mesh(tmp_path: Path) -> None:
    """Another program may delete the file while a command runs."""
    path = tmp_path / "a.stl"
    trimesh.creation.icosphere(subdivisions=1, radius=0.1).export(path)
    assert mesh_hull(path) is not None
    assert find_mesh_problem(path) is None
    path.unlink()
    assert mesh_hull(path) is None
    problem = find_mesh_problem(path)
    assert problem is not None
    assert "No such file" in str(problem)
    dae = find_mesh_problem(tmp_path / "a.dae")
    assert dae is not None
    assert "No such file" in str(dae)


def test_reading_of_a_mesh_prints_no_log_of_trimesh(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """trimesh logs a traceback for each texture that it does not find."""
    original = trimesh.load_scene

    def load_scene(*arguments: Any, **options: Any) -> Any:
        logging.getLogger("trimesh").error("unable to load bumpmap")
        return original(*arguments, **options)

    monkeypatch.setattr(trimesh, "load_scene", load_scene)
    data = trimesh.creation.box((0.1, 0.2, 0.3)).export(file_type="ply")
    level = logging.getLogger("trimesh").level
    assert read_merged_mesh(data, ".ply").volume == pytest.approx(0.006)
    assert not caplog.records
    assert logging.getLogger("trimesh").level == level


def test_collada_file_is_read_in_metres_with_all_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: closed form of a box of 0.1 x 0.2 x 0.3 m; each part is open.

    Hull and integrals share one parsed file.

    The file is in cm. Each part is half of the surface; a node moves both parts by 0.5 m along x.
    """
    box = trimesh.creation.box((10.0, 20.0, 30.0))
    halves = (box.faces[:6], box.faces[6:])
    parts = [trimesh.Trimesh(box.vertices, half, process=False) for half in halves]
    text = trimesh.exchange.dae.export_collada(parts).decode()
    text = re.sub(r"(<node [^>]*>)", r"\1<translate>50 0 0</translate>", text)
    asset = '<unit name="centimeter" meter="0.01"/><up_axis>Z_UP'
    (tmp_path / "a.dae").write_text(text.replace("<up_axis>Y_UP", asset))
    path = tmp_path / "robot.urdf"
    path.write_text(URDF.replace("a.obj", "a.dae"))
    read_parts = Mock(wraps=stated_urdf.read_merged_mesh)
    monkeypatch.setattr(stated_urdf, "read_merged_mesh", read_parts)
    shape = read_urdf_model(read_urdf(path)).links["base"].shapes[0]
    assert shape.points is not None
    np.testing.assert_allclose(np.ptp(shape.points, axis=0), [0.1, 0.2, 0.3])
    solid = shape.read_solid()
    assert solid is not None
    assert solid.mass == pytest.approx(0.1 * 0.2 * 0.3)
    np.testing.assert_allclose(solid.lever, [0.5, 0, 0], atol=1e-9)
    assert shape.compute_volume() == pytest.approx(0.006)
    assert read_parts.call_count == 1


UPWARDS = {"X_UP": [1.0, 0, 0], "Y_UP": [0, 1.0, 0], "Z_UP": [0, 0, 1.0], "": [0, 1.0, 0]}
"""{up axis of a COLLADA file: direction in the file}. Without a statement, y points up (COLLADA
1.4.1)."""


@pytest.mark.parametrize("axis", UPWARDS)
def test_collada_mesh_is_turned_on_request_only(tmp_path: Path, axis: str) -> None:
    """References: Coal, Pinocchio's reader, as read; the direction that the file states, turned.

    The mesh is long in the direction that points up. Nested nodes move, turn and scale the mesh.
    """
    up = np.array(UPWARDS[axis])
    box = trimesh.creation.box(2.0 + 8.0 * up)
    text = trimesh.exchange.dae.export_collada(box).decode()
    stated = f"<up_axis>{axis}</up_axis>" if axis else ""
    text = text.replace("<up_axis>Y_UP</up_axis>", stated)
    nodes = "<node><rotate>{} {} {} 90</rotate><scale>0.5 0.5 0.5</scale>".format(*up)
    text = re.sub(
        r"(?s)<node (.*)</node>",
        rf"<node><translate>0 0 10</translate>{nodes}<node \1</node></node></node>",
        text,
    )
    path = tmp_path / "a.dae"
    path.write_text(text)
    mesh = coal.MeshLoader().load(str(path), np.ones(3))
    mesh.computeLocalAABB()
    hull = mesh_hull(path)
    assert hull is not None
    np.testing.assert_allclose(hull.vertices.min(0), mesh.aabb_local.min_, atol=1e-6)
    np.testing.assert_allclose(hull.vertices.max(0), mesh.aabb_local.max_, atol=1e-6)
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(URDF.replace("a.obj", "a.dae"))
    points = read_urdf_model(read_urdf(urdf), turn=True).links["base"].shapes[0].points
    assert points is not None
    np.testing.assert_allclose(np.ptp(points, axis=0), [1, 1, 5], atol=1e-6)


@pytest.mark.parametrize("data", [b"", b"<COLLADA><asset>", b"no XML"])
def test_conventions_of_a_broken_collada_file_are_a_value_error(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"\S"):
        read_collada_asset(data)
