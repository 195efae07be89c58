"""A greatest torque is written where the file states it, and is the joint's then, gear and all."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import pytest

import pupper_analysis as pa
from pupper_analysis.models.efforts import effort_limit
from tests.support.robots import changed, mjcf_text, quadruped, urdf_text, write

MOTORS = {
    "control": '<motor joint="hip1" gear="3" ctrllimited="true" ctrlrange="-5 5"/>',
    "force": '<motor joint="hip1" gear="3" forcelimited="true" forcerange="-5 5"/>',
    "gain": '<general joint="hip1" gear="-2" gainprm="1.5" ctrllimited="true" ctrlrange="-5 5"/>',
}


@pytest.mark.parametrize("kind", MOTORS)
def test_the_torque_behind_a_gear_is_the_urdfs(tmp_path: Path, kind: str) -> None:
    """All three allow 15 N m at the joint; 7 of what they state are the URDF's 21 N m."""
    robot = quadruped()
    text, count = re.subn('<motor [^>]*joint="hip1"[^>]*/>', MOTORS[kind], mjcf_text(robot))
    assert count == 1
    files = write(tmp_path, urdf_text(robot), text)
    assert _limit(files.mjcf) == pytest.approx(15.0)
    result = pa.sync_models(files.urdf, files.mjcf, take="urdf")
    assert result.agree
    ((edit),) = result.edits
    assert edit.new == "-7 7"
    assert _limit(files.mjcf) == pytest.approx(21.0) == pytest.approx(robot["thigh1"].effort)


def _limit(path: Path) -> float:
    model = mujoco.MjModel.from_xml_path(str(path))
    return float(effort_limit(model, model.joint("hip1").id))


# ------------ A mass is written into the body that has one, also where that has no joint of its own


def test_the_body_that_weighs_is_changed(tmp_path: Path) -> None:
    """The joint's own body is empty; what it carries without a joint has all of its mass."""
    robot = quadruped()
    head, rest = mjcf_text(robot).split('<body name="thigh1"', 1)
    rest, count = re.subn("(<inertial [^>]*/>)", r'<body name="core">\1</body>', rest, count=1)
    assert count == 1
    heavier = urdf_text(changed(robot, "thigh1", mass=1.25))
    files = write(tmp_path, heavier, f'{head}<body name="thigh1"{rest}')
    result = pa.sync_models(files.urdf, files.mjcf, take="urdf")
    assert result.agree
    ((edit),) = result.edits
    assert (edit.attribute, edit.new) == ("mass", "1.25")
    model = mujoco.MjModel.from_xml_path(str(files.mjcf))
    assert model.body("core").mass[0] == pytest.approx(1.25)
    assert model.body("thigh1").mass[0] == 0
