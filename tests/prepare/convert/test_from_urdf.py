"""Conversion of a URDF to an MJCF: defaults of mimic joints, and names of meshes."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from lxml import etree

import pupper_analysis as pa
from pupper_analysis.prepare.convert.from_urdf import MjcfXml
from tests.support.robots import arm, quadruped, urdf_text


def test_mimic_without_multiplier_and_offset_has_1_and_0(tmp_path: Path) -> None:
    """Reference: the defaults of the URDF specification."""
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
    """A sphere adds no name to the used meshes, in particular not None."""
    geoms = '<geom type="sphere" size="1"/><geom type="mesh" mesh="toe"/>'
    root = etree.fromstring(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    assert MjcfXml(root).used_meshes == {"toe"}


def test_small_effort_is_the_force_range_of_the_motor(tmp_path: Path) -> None:
    """Servos of 0.5 N m, as in small robots."""
    file = tmp_path / "arm.xml"
    text = re.sub(r'effort="[^"]*"', 'effort="0.5"', urdf_text(arm()))
    (tmp_path / "arm.urdf").write_text(text)
    pa.convert_model(tmp_path / "arm.urdf", file)
    model = mujoco.MjModel.from_xml_path(str(file))
    assert model.nu > 0
    np.testing.assert_allclose(np.abs(model.actuator_forcerange).max(axis=1), 0.5)


def test_colliding_geom_is_named_after_its_link(tmp_path: Path) -> None:
    """The link has a visual box and a collision sphere; the visual geom has no name."""
    shapes = (
        '<visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>'
        '<collision><geometry><sphere radius="0.02"/></geometry></collision></link>'
    )
    text = urdf_text(arm()).replace("</link>", shapes, 1)
    (tmp_path / "arm.urdf").write_text(text)
    (link,) = (part.get("name") for part in etree.fromstring(text).iter("link") if len(part) > 1
               and part.find("collision") is not None)  # fmt: skip
    pa.convert_model(tmp_path / "arm.urdf", tmp_path / "arm.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    collides = {model.geom(i).name: bool(model.geom_contype[i]) for i in range(model.ngeom)}
    assert {name for name, on in collides.items() if on and link in name} == {f"{link}_collision"}
    assert not [name for name, on in collides.items() if name and not on]


ZERO_INERTIAL = (
    '<inertial><mass value="0"/>'
    '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>'
)


@pytest.mark.parametrize("inertial", ["", ZERO_INERTIAL])
def test_massless_root_above_a_floating_joint_states_a_free_base(
    inertial: str, tmp_path: Path
) -> None:
    """Reference: 6 + 8 degrees of freedom, and the sum of the masses in the text."""
    path = tmp_path / "rooted.urdf"
    root = (
        f'<link name="root">{inertial}</link><joint name="free" type="floating">'
        '<parent link="root"/><child link="base"/></joint></robot>'
    )
    path.write_text(urdf_text(quadruped()).replace("</robot>", root))
    robot = pa.load_robot(path)
    assert robot.floating
    assert robot.pin_model.nv == robot.mj_model.nv == 14
    assert robot.total_mass == pytest.approx(sum(part.mass for part in quadruped().values()))
    assert robot.base == "base"
