"""``pupper-analysis workspace``, ``payload``, ``best`` and ``path``, and the options they share."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import click
import numpy as np
import pytest

from pupper_analysis import (
    Ground,
    StandTask,
    cli,
    payload_limit,
    solve_stand,
)
from pupper_analysis.cli.robots import RobotOptions
from pupper_analysis.cli.stance_fields import TYPED
from pupper_analysis.cli.stance_options import RobotAndTask
from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.tools.path.tracking import way_to
from tests.support.commands import answer, check_refusal, run_command
from tests.support.variants import load

THREE_LEGS = ("--swing", "RR=0.01", "--com", "inside", "--com-margin", "0.01")
OURS = ("stand", "workspace", "payload", "best", "path", "push")


def test_payload_prints_its_limits(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "all.json"
    arguments = (
        "original",
        "--payload-at",
        "1cm,0,0.08",
        "--kp",
        "30",
        "--kd",
        "1",
        "--yaw",
        "0.1",
    )
    status, out, err = run_command(capfd, "payload", "-v", *arguments, "--json", str(path))
    assert status == 0, err
    content = json.loads(path.read_text())
    assert content["point"] == [0.01, 0.0, 0.08]
    robot = load("original")
    limit = payload_limit(robot, StandTask(yaw=0.1), (0.01, 0.0, 0.08), kp=30.0, kd=1.0)
    marks = {name: content[name] for name in ("generator", "provenance")}
    assert {**json.loads(limit.to_json()), **marks} == content
    assert content["trial"]["held"]
    assert "payload at (10, 0, 80) mm" in out
    assert f"base is ({1e3 * limit.offset[0]:.1f}, " in out
    assert "nudged: it stays up" in out


def test_servos_that_carry_nothing_are_exit_status_1(capfd: pytest.CaptureFixture[str]) -> None:
    status, out, err = run_command(capfd, "payload", "v3-long-leg", "--kp", "1", "--kd", "0.1")
    assert status == 1, err
    assert "0.00 kg on the simulated ground, then loses static stability" in out


@pytest.mark.longest
def test_best_finds_the_largest_payload(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "all.json"
    status, out, err = run_command(
        capfd, "best", "payload", "v3", "--payload-at", "0,0,0.08", "--json", str(path)
    )
    assert status == 0, err
    content = json.loads(path.read_text())
    payload = content["best"]["payload"]
    assert payload["mass"] == content["best"]["value"]
    assert payload["point"] == [0.0, 0.0, 0.08]
    assert payload["trial"]["held"]
    assert "payload at (0, 0, 80) mm" in out


def test_path_in_a_given_time(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    csv, npz, file = tmp_path / "way.csv", tmp_path / "way.npz", tmp_path / "all.json"
    output = ("--csv", str(csv), "--npz", str(npz), "--json", str(file))
    status, out, err = run_command(
        capfd, "path", "original", *THREE_LEGS, "--seconds", "3", "-v", *output
    )
    assert status == 0, err
    assert "TRACKED" in out
    assert ["time", "3", "s"] in [line.split() for line in out.splitlines()]
    assert f"written: {csv}\nwritten: {npz}\nwritten: {file}\n" in out
    rows = csv.read_text().splitlines()
    with np.load(npz) as content:
        arrays = dict(content)
    assert len(rows) == 1 + len(arrays["time"]) > 100
    robot = load("original")
    goal = solve_stand(robot, StandTask(swing={"RR": 0.01}, com="inside", com_margin=0.01))
    np.testing.assert_allclose(arrays["qpos"][-1][2:7], goal.qpos[2:7], atol=1e-9)
    np.testing.assert_allclose(arrays["qpos"][-1], goal.qpos, atol=0.05)  # its feet have rolled
    np.testing.assert_allclose(arrays["qpos"][0], solve_stand(robot).qpos, atol=1e-9)


def test_the_way_keeps_moved_feet_and_ground() -> None:
    robot = load("v3")
    task = StandTask(0.12, foot_offsets={"FL": (0.01, 0.0)}, ground=Ground(0.05), com=(0.005, 0.0))
    way = way_to(robot, solve_stand(robot, task))
    assert len(way) == 2
    for stance in way:
        assert stance.ground == task.ground
        assert stance.foot_offsets == task.foot_offsets
    assert way[1].height == 0.12
    assert way[1].com == pytest.approx((0.005, 0.0), abs=1e-9)


def test_all_commands_have_the_same_options_of_robot_and_stance() -> None:
    """Of the same name, kind, default and help: one list."""
    own = {*RobotAndTask.__dataclass_fields__, *RobotOptions.__dataclass_fields__}
    names = {*own, *TYPED} - {"stance", "which", "fixed_base"}
    simulated = {"kp", "kd", "integrator", "cone", "impratio"}  # a workspace is of kinematics
    shared = []
    for command in OURS:
        options = {option.name: option for option in cli.find_command(command).params}
        own_names = names - simulated if command == "workspace" else names
        assert own_names <= set(options), command
        assert command != "workspace" or simulated.isdisjoint(options)
        shared.append({name: options[name].to_info_dict() for name in sorted(own_names)})
    for one in shared:
        assert all(info == shared[0][name] for name, info in one.items())
    analyze = {option.name: option for option in cli.find_command("analyze").params}
    common = sorted(names & set(analyze))
    stand = {option.name: option for option in cli.find_command("stand").params}
    base = [one for one in TYPED.values() if one.slider and one.slider.folder == "Base"]
    assert len(common) == 13 + len(base)
    for name in common:
        assert analyze[name].to_info_dict() == stand[name].to_info_dict()


def examples(command: click.Command) -> list[list[str]]:
    text = (command.help or "").replace("\\\n", " ")
    return [
        shlex.split(line)[1:]
        for line in text.splitlines()
        if line.strip().startswith("pupper-analysis ")
    ]


@pytest.mark.parametrize("name", sorted(cli.COMMANDS))
def test_examples_of_the_help_are_understood(name: str) -> None:
    command = cli.find_command(name)
    for arguments in examples(command):
        assert arguments[0] == name
        command.make_context(name, arguments[1:])


@pytest.mark.parametrize("name", OURS)
def test_the_help_teaches_with_examples(name: str) -> None:
    assert len(examples(cli.find_command(name))) >= 3
    assert "Exit status:" in (cli.find_command(name).help or "")


@pytest.mark.parametrize("name", sorted(cli.COMMANDS))
def test_the_help_fits_into_80_columns(name: str) -> None:
    command = cli.find_command(name)
    said = command.get_help(click.Context(command, info_name=name, terminal_width=80))
    assert [line for line in said.splitlines() if len(line) > 80] == []


BAD = {
    "CSV in a folder": (["path", "v3", "--seconds", "2", "--csv", "."], "it is a folder"),
    "no duration": (["path", "v3", "--seconds", "-2"], "seconds"),
    "no point": (["payload", "v3", "--payload-at", "1,2"], "not of the form X,Y,Z"),
    "no objective": (["best", "speed"], "'speed' is not one of"),
    "out of reach": (["workspace", "v3", "--height", "0.3"], "height 191.9 mm"),
    "heavy legs": (["payload", "v3", "--slope", "0.8", "--pitch", "-0.8"], "1.030 is needed"),
    "two robots": (["workspace", "v3", "--base", "v3"], "give the robot once"),
    "figure in a folder": (["workspace", "v3", "--figure", "."], "it is a folder"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_exit_status_2(
    case: str, capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments, message = BAD[case]
    monkeypatch.chdir(tmp_path)
    check_refusal(capfd, tmp_path, [*arguments, "--json", "all.json"], message)


def derived(*given: object) -> object:
    names = ("base", "leg_scale", "torso_mass_scale")
    return RobotOptions.taken_from(dict(zip(names, given, strict=True))).one(())


def test_a_derived_variant_keeps_what_is_not_given() -> None:
    for given, legs, torso in (
        (("v3", None, None), 1.0, 1.0),
        (("v3", 1.2, None), 1.2, 1.0),
        (("v3", None, 1.5), 1.0, 1.5),
    ):
        found = derived(*given)
        assert isinstance(found, VariantSpec)
        assert (found.base, found.leg_scale, found.torso_mass_scale) == ("v3", legs, torso)
    skeleton = derived(None, 1.5, None)
    assert isinstance(skeleton, VariantSpec)
    assert (skeleton.base, skeleton.torso_mass_scale) == ("skeleton", 1.0)
    assert derived(None, None, None) is None


def test_a_package_is_looked_for_where_it_is_said(tmp_path: Path) -> None:
    files = ("--urdf", "x.urdf", "--mjcf", "x.xml")
    done = answer("stand", *files, "--package", "p=nowhere", folder=tmp_path)
    assert done.returncode == 2
    assert "p: nowhere is not a folder" in done.stderr
