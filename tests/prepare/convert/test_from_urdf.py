"""Conversion of a URDF to an MJCF: defaults of mimic joints, and names of meshes."""

from __future__ import annotations

from pathlib import Path

from lxml import etree

import pupper_analysis as pa
from pupper_analysis.prepare.convert.from_urdf import MjcfXml
from tests.support.robots import arm, urdf_text


def test_a_mimic_without_a_multiplier_turns_as_much(tmp_path: Path) -> None:
    """As the URDF's documentation has it, multiplier 1 and offset 0."""
    source, out, texts = tmp_path / "arm.urdf", tmp_path / "arm.xml", []
    joint = '<joint name="push" type="prismatic">'
    assert joint in urdf_text(arm())
    for words in ("", ' multiplier="1" offset="0"'):
        mimic = f'{joint}<mimic joint="lift"{words}/>'
        source.write_text(urdf_text(arm()).replace(joint, mimic))
        pa.convert_model(source, out, force=True)
        texts.append(out.read_text())
    assert texts[0] == texts[1]
    assert "<equality>" in texts[0]


def test_geoms_without_mesh_use_no_mesh() -> None:
    """The used meshes are those of mesh geoms; a sphere adds no name, and not None either."""
    geoms = '<geom type="sphere" size="1"/><geom type="mesh" mesh="toe"/>'
    root = etree.fromstring(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    assert MjcfXml(root).used_meshes == {"toe"}
