"""Motors of kinds that others use: with several controls, or seen from the parent."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import pytest
from click.testing import CliRunner
from legged import Pair, quadruped

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.models.conversion import effort_limit

MOTOR = re.compile(r'<motor joint="(\w+)" ctrlrange="-30 30"/>')

PID = (
    '<pid name="{0}" joint="{0}" kp="150" kv="5" input="pos vel" forcelimited="true" '
    'forcerange="-30 30"/>'
)
DC = '<dcmotor name="{0}" joint="{0}" motorconst="0.5" resistance="1" input="pos vel ff"/>'
IN_PARENT = '<motor jointinparent="{0}" ctrlrange="-30 30"/>'


def with_motors(pair: Pair, element: str, joints: str = "") -> Pair:
    """Other actuators at the joints whose names begin so, in place of motors of 30 N m."""

    def other(match: re.Match[str]) -> str:
        return element.format(match[1]) if match[1].startswith(joints) else match[0]

    pair.mjcf.write_text(MOTOR.sub(other, pair.mjcf.read_text()))
    pair.urdf.write_text(pair.urdf.read_text().replace('effort="80"', 'effort="30"'))
    return pair


@pytest.mark.parametrize(("element", "controls"), [(PID, 15), (DC, 18)])
def test_motors_of_several_controls_are_read(element: str, controls: int, tmp_path: Path) -> None:
    """There are more controls than motors in MuJoCo's model; each is counted by itself."""
    pair = with_motors(quadruped(tmp_path), element, "FL")
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    assert (model.nu, model.nactuator) == (controls, 12)
    said = pa.compare_models(pair.urdf, pair.mjcf).differences
    lost = {"FL_roll", "FL_pitch", "FL_knee"} if element == DC else set()
    assert {(found.kind, found.element) for found in said} == {("effort", name) for name in lost}
    assert pa.audit_model(pair.mjcf).passed
    assert pa.diff_models(pair.mjcf, pair.mjcf).same


def test_the_range_of_each_control_is_compared(tmp_path: Path) -> None:
    old, new = tmp_path / "old.xml", tmp_path / "new.xml"
    text = with_motors(quadruped(tmp_path), PID, "FL").mjcf.read_text()
    old.write_text(text)
    new.write_text(text.replace('ctrlrange="-30 30"', 'ctrlrange="-30 40"', 1))
    (change,) = (c for c in pa.diff_models(old, new).changes if c.kind == "motor")
    assert change.message.startswith("motor #3: ctrlrange (-30, 30) in the old file")


@pytest.mark.slow
@pytest.mark.parametrize("element", [PID, DC, IN_PARENT])
def test_robots_stand_on_them(element: str, tmp_path: Path) -> None:
    pair = with_motors(quadruped(tmp_path), element)
    command = ["stand", "--urdf", str(pair.urdf), "--mjcf", str(pair.mjcf)]
    done = CliRunner().invoke(cli.group, command)
    assert "HOLDS in MuJoCo: torques within" in done.output, done.output
    assert done.exit_code == 0


def test_a_motor_seen_from_the_parent_is_the_joints(tmp_path: Path) -> None:
    pair = with_motors(quadruped(tmp_path), IN_PARENT)
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    assert effort_limit(model, model.joint("RL_knee").id) == 30
    assert pa.compare_models(pair.urdf, pair.mjcf).agree
