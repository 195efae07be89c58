"""URDFs with xacro elements that they do not use, and with blank lines before the declaration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.loading import kind_of, read_model
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.robot.compare.compare import compare_files
from tests.support.robots import change_part, quadruped, write_parts

XACRO = ' xmlns:xacro="http://www.ros.org/wiki/xacro"'
MATERIALS = f'<robot{XACRO}><xacro:property name="x" value="1"/><material name="grey"/></robot>'

HARMLESS = {
    "namespace": "",
    "property": '<xacro:property name="width" value=".2" />',
    "arg": '<xacro:arg name="gripper" default="true"/>',
    "block": '<xacro:property name="pose"><origin xyz="0 0 ${z}"/></xacro:property>',
    "macro": '<xacro:macro name="leg" params="n"><link name="leg_${n}"/></xacro:macro>',
    "materials beside": '<xacro:include filename="parts/inks.xacro"/>',
    "materials elsewhere": '<xacro:include filename="$(find my_cobot)/urdf/materials.xacro"/>',
    "transmissions elsewhere": '<xacro:include filename="robot.transmission.xacro"/>',
}
"""Unused xacro elements of public files: for example, the 84 URDFs of myCobot declare an unused
width.
"""

USED = {
    "macro called": '<xacro:leg n="1"/>',
    "condition": '<xacro:if value="1"><link name="extra"/></xacro:if>',
    "include of links": '<xacro:include filename="parts/arm.xacro"/>',
    "include of an include of links": '<xacro:include filename="parts/all.xacro"/>',
    "include of itself": '<xacro:include filename="robot.urdf"/>',
    "include elsewhere": '<xacro:include filename="$(find my_cobot)/urdf/arm.xacro"/>',
    "include without name": "<xacro:include/>",
    "expression": '<xacro:property name="n" value="1"/><link name="leg_${n}"/>',
    "argument": '<xacro:arg name="n" default="1"/><gazebo>$(arg n)</gazebo>',
}


@pytest.fixture
def files(tmp_path: Path) -> Any:
    """Return a robot's files, and files that its URDF may include."""
    parts = tmp_path / "parts"
    parts.mkdir()
    (parts / "inks.xacro").write_text(MATERIALS)
    (parts / "arm.xacro").write_text(MATERIALS.replace("material", "link"))
    (parts / "all.xacro").write_text(
        MATERIALS.replace("<material", '<xacro:include filename="parts/arm.xacro"/><material')
    )
    return write_parts(tmp_path, quadruped(), change_part(quadruped(), "base", mass=7.0))


def with_xacro(urdf: Path, content: str) -> int:
    """Add elements below the root element of a URDF; return the line of the first."""
    head, rest = urdf.read_text().split(">", 1)
    urdf.write_text(f"{head}{XACRO}>\n{content}{rest}")
    return head.count("\n") + 2


@pytest.mark.parametrize("name", HARMLESS)
def test_unused_xacro_is_ignored_with_a_note(files: Any, name: str) -> None:
    """Reference: Pinocchio's model of the same file without xacro elements."""
    before = pin.buildModelFromXML(read_urdf(files.urdf).text)
    with_xacro(files.urdf, HARMLESS[name])
    file = read_urdf(files.urdf)
    after = pin.buildModelFromXML(file.text)
    assert [note.code for note in file.notes] == (["xacro-ignored"] if HARMLESS[name] else [])
    assert list(after.names) == list(before.names)
    assert np.array_equal(
        [inertia.mass for inertia in after.inertias], [b.mass for b in before.inertias]
    )
    assert "xacro:" not in file.text or not HARMLESS[name]
    assert kind_of(files.urdf) == "urdf"


@pytest.mark.parametrize("name", USED)
def test_used_xacro_is_refused_at_its_line(files: Any, name: str) -> None:
    line = with_xacro(files.urdf, USED[name])
    with pytest.raises(
        ModelError, match=f"robot.urdf:{line}: the file is a xacro file; give the expanded"
    ):
        read_urdf(files.urdf)


def test_note_lists_the_ignored_xacro_elements(files: Any) -> None:
    with_xacro(files.urdf, HARMLESS["property"] + HARMLESS["materials beside"])
    (note,) = read_urdf(files.urdf).notes
    assert str(note).endswith("are ignored: property width; include parts/inks.xacro")


def test_an_mjcf_with_xacro_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.xml"
    path.write_text(f'<mujoco{XACRO}><xacro:property name="a" value="1"/></mujoco>')
    with pytest.raises(ModelError, match="the file is a xacro file"):
        read_model(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "declared",
    [
        '\n \n<?xml version="1.0" encoding="latin-1"?>\n',
        '\ufeff\n \n<?xml version="1.0" encoding="latin-1"?>\n',
        '<?xml version="0.0" ?>\n',  # of PyBullet's data
        '<?xml version="1"?>\n',
    ],
)
def test_faulty_xml_declarations_are_accepted(files: Any, declared: str) -> None:
    """White space before the declaration, or another version: MuJoCo and Pinocchio read them.

    Line numbers count the lines of the declaration, and edited files keep it.
    """
    with_xacro(files.urdf, HARMLESS["property"])
    for path in (files.urdf, files.mjcf):
        path.write_text(declared + path.read_text())
    comparison = compare_files(files.urdf, files.mjcf).result
    assert [difference.kind for difference in comparison.differences] == ["mass"]
    line = files.urdf.read_text().split('<link name="base"')[0].count("\n") + 1
    assert read_urdf(files.urdf).place("link", "base").line == line
    assert pin.buildModelFromXML(read_urdf(files.urdf).text).nv > 0
    assert pa.sync_models(files.urdf, files.mjcf, take="mjcf").agree
    assert files.urdf.read_text().startswith(declared)
    assert HARMLESS["property"] in files.urdf.read_text()


def test_white_space_before_other_content_does_not_hide_a_doctype(tmp_path: Path) -> None:
    """A DOCTYPE may define entities, so it is refused on any line."""
    path = tmp_path / "r.urdf"
    path.write_text('\n<?xml version="1.0"?>\n<!DOCTYPE r [<!ENTITY x "y">]><robot name="&x;"/>')
    with pytest.raises(ModelError, match=r"r\.urdf:3: .*DOCTYPE"):
        read_urdf(path)
