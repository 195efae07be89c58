"""Shapes that a URDF states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pupper_analysis.models.stated.urdf import _read_triangles, read_urdf_model
from pupper_analysis.models.urdf_file import read_urdf

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


@pytest.mark.parametrize("file_type", ["stl", "stl_ascii", "obj"])
def test_triangles_of_a_mesh_file_equal_those_of_trimesh(tmp_path: Path, file_type: str) -> None:
    """Reference: ``trimesh.load`` without processing, which does not merge vertices."""
    path = tmp_path / f"mesh.{file_type[:3]}"
    trimesh.creation.box((0.1, 0.2, 0.3)).export(path, file_type=file_type)
    points, faces = _read_triangles(path)
    expected = trimesh.load(path, force="mesh", process=False)
    np.testing.assert_array_equal(points, expected.vertices)
    np.testing.assert_array_equal(faces, expected.faces)
    assert points.dtype == np.float64
