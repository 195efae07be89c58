"""An MJCF of a URDF: efforts, names of shapes, couplings, meshes that come twice."""

from __future__ import annotations

from pathlib import Path

import pupper_analysis as pa

ARM = """
<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>
    <collision><origin xyz="0.1 0 0"/><geometry><sphere radius="0.02"/></geometry></collision>
  </link>
  <link name="lower"><inertial><mass value="0.5"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>
  </link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="{effort}" velocity="1"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="2" velocity="1"/>{mimic}</joint>
</robot>
"""


def converted(folder: Path, effort: str = "0.5", mimic: str = "") -> Path:
    source, out = folder / "arm.urdf", folder / "arm.xml"
    out.unlink(missing_ok=True)
    source.write_text(ARM.format(effort=effort, mimic=mimic))
    pa.convert_model(source, out)
    return out


def test_a_mimic_without_a_multiplier_turns_as_much(tmp_path: Path) -> None:
    """As the URDF's documentation has it, multiplier 1 and offset 0."""
    texts = [
        converted(tmp_path, mimic=f'<mimic joint="shoulder"{words}/>').read_text()
        for words in ("", ' multiplier="1" offset="0"')
    ]
    assert texts[0] == texts[1]
