"""A mass is written into the MJCF body that has the mass, also if this body has no joint."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import pytest

import pupper_analysis as pa
from tests.support.robots import change_part, mjcf_text, quadruped, urdf_text, write


def test_mass_is_changed_in_the_child_body_that_has_the_mass(tmp_path: Path) -> None:
    """The body of the joint has no inertial; a child body without joint has the mass of the
    link."""
    robot = quadruped()
    head, rest = mjcf_text(robot).split('<body name="thigh1"', 1)
    rest, count = re.subn("(<inertial [^>]*/>)", r'<body name="core">\1</body>', rest, count=1)
    assert count == 1
    heavier = urdf_text(change_part(robot, "thigh1", mass=1.25))
    files = write(tmp_path, heavier, f'{head}<body name="thigh1"{rest}')
    result = pa.sync_models(files.urdf, files.mjcf, take="urdf")
    assert result.agree
    (edit,) = result.edits
    assert (edit.attribute, edit.new) == ("mass", "1.25")
    model = mujoco.MjModel.from_xml_path(str(files.mjcf))
    assert model.body("core").mass[0] == pytest.approx(1.25)
    assert model.body("thigh1").mass[0] == 0


MOTORS = {
    "control": '<motor joint="hip1" gear="3" ctrllimited="true" ctrlrange="-5 5"/>',
    "force": '<motor joint="hip1" gear="3" forcelimited="true" forcerange="-5 5"/>',
    "gain": '<general joint="hip1" gear="-2" gainprm="1.5" ctrllimited="true" ctrlrange="-5 5"/>',
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", MOTORS)
def test_effort_of_the_urdf_is_written_before_the_gear(tmp_path: Path, kind: str) -> None:
    """All three permit 15 N m at the joint; 21 N m of the URDF need 7 in place of 5."""
    robot = quadruped()
    text, count = re.subn('<motor [^>]*joint="hip1"[^>]*/>', MOTORS[kind], mjcf_text(robot))
    assert count == 1
    files = write(tmp_path, urdf_text(robot), text)
    result = pa.sync_models(files.urdf, files.mjcf, take="urdf")
    assert result.agree
    assert [edit.new for edit in result.edits] == ["-7 7"]


TWO_DIRECTIONS = {"smaller upper end": (-21.0, 9.0), "smaller lower end": (-9.0, 21.0)}


@pytest.mark.parametrize("ends", TWO_DIRECTIONS.values(), ids=TWO_DIRECTIONS)
def test_range_that_is_smaller_in_one_direction_differs_from_the_effort(
    ends: tuple[float, float], tmp_path: Path
) -> None:
    """Reference: the compiled range. MuJoCo's motor exerts 9 of the 21 N m of the URDF in one
    direction, with which `stand` evaluates the motors; `crosscheck` compared the larger end.
    """
    robot = quadruped()
    motor = f'<motor joint="hip1" forcelimited="true" forcerange="{ends[0]} {ends[1]}"/>'
    text, count = re.subn('<motor [^>]*joint="hip1"[^>]*/>', motor, mjcf_text(robot))
    assert count == 1
    files = write(tmp_path, urdf_text(robot), text)
    (difference,) = pa.compare_models(files.urdf, files.mjcf).differences
    assert (difference.kind, difference.element) == ("effort", "hip1")
    assert (difference.urdf, difference.mjcf) == (21.0, 9.0)
    assert pa.sync_models(files.urdf, files.mjcf, take="urdf").agree
    model = mujoco.MjModel.from_xml_path(str(files.mjcf))
    index = next(i for i in range(model.nu) if model.actuator_trnid[i, 0] == model.joint("hip1").id)
    assert model.actuator_forcerange[index] == pytest.approx((-21.0, 21.0))


ROTOR = {
    "urdf": """<robot name="arm"><link name="base"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
<link name="arm"><inertial><origin xyz="0.004 0.022 -0.033"/><mass value="1.2"/>
<inertia ixx="0.006" iyy="0.006" izz="0.001" ixy="0" ixz="-0.0003" iyz="0"/></inertial></link>
<joint name="weld" type="fixed"><origin xyz="0 -0.03 0"/><parent link="arm"/>
<child link="rotor"/></joint>
<link name="rotor"><inertial><mass value="0.05"/>
<inertia ixx="6e-5" iyy="1e-4" izz="6e-5" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>""",
    "mjcf": """<mujoco><compiler angle="radian"/><worldbody><body name="base"><body name="arm">
<joint name="turn" axis="0 1 0" range="-1 1" actuatorfrcrange="-9 9"/>
<inertial pos="0.004 0.022 -0.033" mass="1.2" fullinertia="0.006 0.006 0.001 0 -0.0003 0"/>
<body name="rotor" pos="0 -0.03 0"><inertial pos="0 0 0" mass="0.05" diaginertia="6e-5 1e-4 6e-5"/>
</body></body></body></worldbody></mujoco>""",
}


@pytest.mark.parametrize("side", ROTOR)
def test_changed_mass_of_a_link_with_fixed_link_changes_no_inertia(
    side: str, tmp_path: Path
) -> None:
    """Reference: the file before the mass was edited. The edit moves the CoM of link and fixed link
    together by 0.9 mm, and changes the inertia about it by 0.05 %, below the tolerance.
    """
    words = {"urdf": ('value="1.2"', 'value="1.9"'), "mjcf": ('mass="1.2"', 'mass="1.9"')}[side]
    texts = ROTOR | {side: ROTOR[side].replace(*words)}
    assert texts != ROTOR
    files = write(tmp_path, texts["urdf"], texts["mjcf"])
    result = pa.sync_models(files.urdf, files.mjcf, take="mjcf" if side == "urdf" else "urdf")
    assert [(edit.attribute, float(edit.new)) for edit in result.edits] == [
        ("value" if side == "urdf" else "mass", 1.2)
    ]
    assert {"urdf": files.urdf, "mjcf": files.mjcf}[side].read_text() == ROTOR[side]
