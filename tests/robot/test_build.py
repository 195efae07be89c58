"""Building robots from files with unusual options, masses and joints: corrected with a note, or
refused.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.models.additions import Options
from pupper_analysis.robot.build import with_additions, with_efforts
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import with_payload
from tests.support.arm import load_arm
from tests.support.commands import run_command
from tests.support.legged import quadruped, rewrite_file
from tests.support.tiny import TINY_MJCF, TINY_URDF


def load_quadruped(folder: Path, option: str = "", free: str = "<freejoint/>") -> Robot:
    pair = quadruped(folder)
    rewrite_file(pair.mjcf, ("<worldbody>", f"{option}<worldbody>"), ("<freejoint/>", free))
    return pa.load_robot(*pair)


@pytest.mark.slow
@pytest.mark.parametrize(
    "option",
    [
        '<option gravity="0 0 0"/>',
        '<option gravity="9.81 0 0"/>',
        '<option gravity="0 0 9.81"/>',
        '<option><flag gravity="disable"/></option>',
    ],
)
def test_stand_is_refused_if_gravity_is_not_downwards(option: str, tmp_path: Path) -> None:
    robot = load_quadruped(tmp_path, option)
    with pytest.raises(pa.ConfigurationError, match="gravity of the MJCF is"):
        pa.solve_stand(robot)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "message"),
    [
        ('<option gravity="0 0 -1.62"/>', "gravity is taken from the MJCF: (0, 0, -1.62) m/s^2"),
        ('<option gravity="1 0 -9.81"/>', "gravity is taken from the MJCF: (1, 0, -9.81) m/s^2"),
        ('<option><flag contact="disable"/></option>', "nothing touches the ground"),
        ('<option><flag constraint="disable"/></option>', "nothing touches the ground"),
        ('<option><flag actuation="disable"/></option>', "no motor has any torque"),
        (
            '<option actuatorgroupdisable="0"/>',
            "actuatorgroupdisable of the MJCF disables actuators: ",
        ),
        ('<option gravity="0 0 -9.80665" timestep="0.001"/>', None),
    ],
)
def test_unusual_options_give_a_note(option: str, message: str | None, tmp_path: Path) -> None:
    notes = [str(note) for note in load_quadruped(tmp_path, option).notes]
    if message is None:
        assert not [note for note in notes if "gravity" in note or "flag" in note]
    else:
        assert [note for note in notes if message in note], notes


@pytest.mark.slow
def test_friction_of_a_free_joint_does_not_hold_the_base(tmp_path: Path) -> None:
    """With 500 N of dry friction at the free joint, the base would stand on disabled servos."""
    free = '<joint type="free" frictionloss="500" damping="0" armature="0"/>'
    robot = load_quadruped(tmp_path, '<option actuatorgroupdisable="0"/>', free)
    assert [note for note in robot.notes if note.code == "free-joint-friction-taken-off"]
    assert not pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot)).passed
    robot = load_quadruped(tmp_path, free=free)
    assert pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot)).passed


def tiny_with(tmp_path: Path, old: str, new: str) -> tuple[Path, Path]:
    assert old in TINY_URDF
    urdf, mjcf = tmp_path / "tiny.urdf", tmp_path / "tiny.xml"
    urdf.write_text(TINY_URDF.replace(old, new, 1))
    mjcf.write_text(TINY_MJCF)
    return urdf, mjcf


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'mass value="0.5"',
            'mass value="-0.5"',
            "the body that joint 'turn' moves has a mass of -0.5 kg",
        ),
        ('mass value="2"', 'mass value="-2"', "the base has a mass of -2 kg"),
        ('ixx="0.02"', 'ixx="-0.02"', "a mass of 2 kg and moments of inertia from -0.02"),
        ('ixx="0.001"', 'ixx="-1"', "the body that joint 'bend' moves"),
    ],
)
def test_negative_masses_and_inertias_are_refused_for_a_stand(
    old: str, new: str, message: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The message names the link and the value; `crosscheck` still compares the files."""
    urdf, mjcf = tiny_with(tmp_path, old, new)
    with pytest.raises(pa.ModelError) as caught:
        pa.solve_stand(pa.load_robot(urdf=urdf, mjcf=mjcf, feet=["foot"]))
    assert message in str(caught.value)
    # The comparison is there to find it.
    status, _, err = run_command(capfd, "crosscheck", str(urdf), str(mjcf))
    assert status in (1, 2)
    assert "unexpected" not in err


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_planar_or_floating_joint_of_a_urdf_is_fixed_with_a_note(
    kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The joint is no coordinate of the robot; `stand` refuses the robot for its single foot, as it
    does with a prismatic joint.
    """
    urdf, mjcf = tiny_with(tmp_path, 'name="push" type="prismatic"', f'name="push" type="{kind}"')
    robot = pa.load_robot(urdf=urdf, mjcf=mjcf, feet=["foot"])
    assert robot.joint_names == ("bend", "turn")
    note = f"joint 'push' of the URDF is {kind} and was fixed at rest"
    assert any(str(message).startswith(note) for message in robot.notes)
    arguments = ("stand", "--urdf", str(urdf), "--mjcf", str(mjcf), "--foot", "foot")
    status, _, err = run_command(capfd, *arguments)
    assert status == 2
    assert "touches the ground at only 1 points (foot)" in err


def test_refusal_of_a_colour_with_commas_is_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "colour.xml"
    path.write_text(TINY_MJCF.replace('type="sphere"', 'type="sphere" rgba="1,0,0,1"'))
    status, _, err = run_command(capfd, "audit", str(path))
    assert status == 2
    assert "rgba" in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("kind", ["efforts", "additions", "payload"])
def test_changes_of_the_pinocchio_model_are_kept(kind: str, tmp_path: Path) -> None:
    """Only the requested effort limit [N m] differs from the changed model."""
    robot = load_arm(tmp_path)
    model, convention = robot.pin_model, robot.pin_convention
    shoulder, elbow = (robot.joint_names.index(name) for name in ("shoulder", "elbow"))
    model.upperPositionLimit[:] = 0.25
    model.effortLimit[convention.v_index[[shoulder, elbow]]] = 7.0, 8.0
    model.armature = np.full(model.nv, 0.5)
    if kind == "efforts":
        changed = with_efforts(robot, {"elbow": 5.0})
    elif kind == "additions":
        addition = Options(diagnose("no-joints"), {"timestep": 0.001})
        changed = with_additions(robot, addition)
        assert changed.mj_model.opt.timestep == 0.001
    else:
        changed = with_payload(robot, 0.1, ("tip", 0.0, 0.0, 0.0))
    assert changed.pin_model is not model
    np.testing.assert_array_equal(changed.pin_model.upperPositionLimit, 0.25)
    np.testing.assert_array_equal(changed.pin_model.armature, 0.5)
    assert changed.effort_limits[shoulder] == 7.0
    assert changed.effort_limits[elbow] == (5.0 if kind == "efforts" else 8.0)
    assert model.effortLimit[convention.v_index[elbow]] == 8.0
