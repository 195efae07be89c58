"""Shapes that a URDF states."""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.models.stated.urdf import read_urdf_model
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
