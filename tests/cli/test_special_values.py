"""Absent, zero, negative and placeholder values, as the table of the documentation lists them.

Each row of ``docs/data/special-values.csv`` is one edit of a small robot and one command. Reference
of a limit of zero: MuJoCo with forces clamped to zero lets the arm fall.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import pytest

from pupper_analysis import cli
from tests.support import every_command
from tests.support.commands import run_command
from tests.support.legged import quadruped
from tests.support.patience import PATIENCE
from tests.support.repository import ROOT
from tests.support.shared_rollouts import share_rollouts
from tests.tools.walk import made

TABLE = ROOT / "docs" / "data" / "special-values.csv"

ARM_URDF = """<robot name="arm">
<link name="base"><inertial><mass value="2"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="upper"><inertial><origin xyz="0.1 0 0"/><mass value="0.5"/>
  <inertia ixx="0.001" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.1 0 0"/><mass value="0.3"/>
  <inertia ixx="0.001" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
  <origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1.2" effort="9" velocity="5"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
  <origin xyz="0.2 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1.2" effort="9" velocity="5"/></joint>
</robot>"""

ARM_MJCF = """<mujoco model="arm">
<compiler angle="radian"/><option integrator="implicitfast"/>
<worldbody><body name="upper" pos="0 0 0.1">
  <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.001 0.002 0.002"/>
  <joint name="shoulder" axis="0 1 0" range="-1 1.2" armature="0.01"/>
  <body name="fore" pos="0.2 0 0">
    <inertial pos="0.1 0 0" mass="0.3" diaginertia="0.001 0.002 0.002"/>
    <joint name="elbow" axis="0 1 0" range="-1 1.2" armature="0.01"/>
    <geom size="0.01" pos="0.2 0 0" mass="0"/></body></body></worldbody>
<actuator><position name="m1" joint="shoulder" kp="100" kv="4" forcerange="-9 9"/>
<position name="m2" joint="elbow" kp="100" kv="4" forcerange="-9 9"/></actuator></mujoco>"""

FOOT = '<collision><origin xyz="0 0 -0.2"/><geometry><sphere radius="0.02"/></geometry></collision>'

DEPLOYMENT = """joint_names: [shoulder, elbow]
effort_limits: [9.0, 9.0]
velocity_limits: [5.0, 5.0]
kp: [100.0, 100.0]
"""

STUDY = """robot = "{file}"
measure = ["peak_utilisation", "rest_utilisation", "verified"]
time_limit = {limit}
[vary]
payload = { values = [0.0] }
"""

OPTIONS = {
    "live": ("--drop", "--headless"),
    "path": ("--seconds", "1", "--height", "30cm"),
    "push": ("--directions", "3"),
    "best": ("utilisation",),
    "hold": ("--joints", "shoulder=0.3"),
}
COMPARING = {"crosscheck", "convert", "sync", "diff"}
SLOW = {"stand", "payload", "push", "best", "live", "path", "study", "walk", "gains"}

FILE_COMMANDS = {"audit", "contract", "convert", "crosscheck", "diff", "sync"}
"""Commands that compare or check files. Each has a row for each value of ``SPECIAL_VALUES``."""

SPECIAL_VALUES = {
    *(("effort", "0"), ("velocity", "0"), ("range", "0 to 0"), ("range", "0 0"), ("mass", "0")),
    *(("friction of a geom", "0"), ("kp", "0"), ("ctrlrange of a servo", "0 0")),
    *(("ctrlrange of a motor", "0 0"), ("forcerange", "0 0"), ("actuatorfrcrange", "0 0")),
    ("armature", "absent"),
}
"""{(attribute, value)}: the values that were read as favourable ones in earlier versions."""

ROBOT_COMMANDS = {"stand", "live", "gains", "walk", "study", "push", "path", "payload", "best"}
"""Commands about a standing robot. Each has a row for each value of ``ROBOT_VALUES``."""

ROBOT_VALUES = {
    *(("effort", "0", "quad.urdf"), ("effort", "absent", "quad.urdf")),
    *(("kp", "0", "quad.xml"), ("ctrlrange of a servo", "0 0", "quad.xml")),
    *(("forcerange", "0 0", "quad.xml"), ("actuatorfrcrange of the rolls", "0 0", "quad.xml")),
    *(("range", "0 to 0", "quad.xml"), ("mass of a calf", "0", "quad.xml")),
    ("friction of all geoms", "0", "quad.xml"),
}
"""{(attribute, value, file)}. A velocity limit concerns ``path`` and ``walk`` only; the quadruped
has no armature; a ``ctrlrange`` of a motor is a torque limit, as ``forcerange`` is."""

LONG_CASES = {
    ("kp", "0", "quad.xml"): {"best"},
    ("friction of all geoms", "0", "quad.xml"): {"push", "study"},
}
"""{value: commands without a row, which need more than 10 s}. ``push`` and ``study`` have rows for
a ground without friction ("condim 1"), ``best`` for a ``forcerange`` of zero."""

COMMANDS_WITHOUT_ROWS = {"analyze", "check", "fit", "heat", "workspace"}
"""``analyze`` reads variants of Pupper only, ``check`` runs the functions of ``audit``,
``crosscheck`` and ``contract``, ``fit`` needs measurements, ``heat`` reads no limits of the files,
and ``workspace`` gives no verdict."""


def rows() -> list[object]:
    """Return the rows of the table, slow ones marked."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        found = list(csv.DictReader(file))
    names = ("command", "attribute", "value", "file")
    return [
        pytest.param(
            row,
            id="-".join(row[name] for name in names).replace(" ", "_"),
            marks=[pytest.mark.slow] if row["command"] in SLOW else [],
        )
        for row in found
    ]


def write_edited(folder: Path, name: str, edit: str) -> Path:
    """Write a robot's file with the edit of a row."""
    if name == "quad.urdf":
        text = quadruped(folder).urdf.read_text()
        text = re.sub(r'(<link name="\w+_calf">.*?)</link>', rf"\1{FOOT}</link>", text)
    elif name == "quad.xml":
        text = quadruped(folder, actuators="position", floor=True).mjcf.read_text()
        commands = " ".join(["0 0.6 -1.2"] * 4)
        for old, new in (
            ("<worldbody>", '<option integrator="implicitfast"/><worldbody>'),
            ('kv="5"', 'kv="5" forcerange="-30 30"'),
            ('"/></keyframe>', f'" ctrl="{commands}"/></keyframe>'),
        ):
            text = text.replace(old, new)
    else:
        text = ARM_URDF if name.endswith("urdf") else ARM_MJCF
    for change in filter(None, edit.split("; ")):
        old, new = change.split(" -> ")
        assert old in text
        text = text.replace(old, new)
    path = folder / name
    path.write_text(text)
    return path


def list_arguments(folder: Path, row: dict[str, str]) -> list[str]:
    """Return the arguments of a command: the edited file, beside unedited ones if it takes two."""
    name, command = row["file"], row["command"]
    path = write_edited(folder, name, row["edit"])
    pair = {"arm.urdf": "arm.xml", "arm.xml": "arm.urdf"}
    beside = folder / "unedited"
    beside.mkdir(exist_ok=True)
    match command:
        case "crosscheck":
            other = write_edited(beside, pair[name], "")
            return [str(file) for file in sorted([path, other], key=lambda file: file.suffix)]
        case "sync":
            other = write_edited(beside, pair[name], "")
            files = sorted([path, other], key=lambda file: file.suffix)
            side = "urdf" if name.endswith("urdf") else "mjcf"
            return [*map(str, files), "--take", side, "--dry-run"]
        case "diff":
            return [str(write_edited(beside, name, "")), str(path)]
        case "convert":
            new = "new.xml" if name.endswith("urdf") else "new.urdf"
            return [str(path), "-o", str(folder / new)]
        case "contract":
            deployment = folder / "deploy.yaml"
            deployment.write_text(DEPLOYMENT)
            return [str(path), str(deployment), "--no-stand"]
        case "best":
            return [*OPTIONS["best"], str(path)]
        case "study":
            study = folder / "study.toml"
            study.write_text(STUDY.replace("{file}", name).replace("{limit}", str(PATIENCE)))
            return [str(study), "-o", str(folder / "designs"), "--workers", "1"]
        case "walk":
            pose = {"default_joint_pos": [0.0, 0.6, -1.2] * 4, "kp": 150.0, "kd": 5.0}
            policy = made.write_standing_policy(folder / "still.json", action_scale=0.1, **pose)
            return [str(path), "--policy", str(policy), "--command", "0,0,0", "--seconds", "3"]
    return [str(path), *OPTIONS.get(command, ())]


@pytest.fixture(scope="module")
def find_folder(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Callable[[dict[str, str]], Path]]:
    """Return the folder of a row's edit.

    The commands of ``ROBOT_COMMANDS`` share its robot and rollouts.
    """
    folders: dict[tuple[str, ...], Path] = {}

    def find(row: dict[str, str]) -> Path:
        key = row["attribute"], row["value"], row["file"], row["edit"]
        if row["command"] not in ROBOT_COMMANDS:
            return tmp_path_factory.mktemp("edit")
        if key not in folders:
            folders[key] = tmp_path_factory.mktemp("edit")
        return folders[key]

    with every_command.share_robots(), share_rollouts():
        yield find


@pytest.mark.slow
@pytest.mark.parametrize("row", rows())
def test_command_output_equals_the_row_of_the_table(
    row: dict[str, str],
    find_folder: Callable[[dict[str, str]], Path],
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Exit status, first word, code in JSON; an unknown limit gives neither a number nor "any
    mass".
    """
    command, folder = row["command"], find_folder(row)
    output = folder / f"{command}.json"
    asked = [] if command == "live" else ["--json", str(output)]
    status, out, err = run_command(capfd, command, *list_arguments(folder, row), *asked)
    assert status == int(row["exit status"]), out + err
    assert "unexpected" not in err
    lines = [line for line in out.splitlines() if not line.startswith(("note: ", "… "))]
    answer_text = "\n".join(lines)
    word = row["verdict"].split(":")[0].split(";")[0]
    if word in ("HOLDS", "FAILS", "FAILED", "UNKNOWN", "WALKS", "FALLS", "OUT OF BOUNDS"):
        assert answer_text.startswith(word), out
    if command == "audit":
        shown = {"error": "ERRORS", "warning": "WARNINGS"}.get(word, "OK")
        assert answer_text.startswith(shown + " "), out
    if word in ("AGREE", "DISAGREE", "DIFFER", "SAME", "DIFFERENT", "TRACKED"):
        assert answer_text.startswith(word + " "), out
    if "no friction" in row["verdict"] and command not in ("contract", "study"):
        assert "have no friction on the ground" in out + err
    if ": " in row["verdict"] and word == "DISAGREE":
        assert row["verdict"].partition(": ")[2] in out
    assert ("motors without torque" in out + err) is ("without torque" in row["verdict"])
    if command not in (*COMPARING, "study"):  # in these, a ratio to zero is infinite
        for word in ("any mass", "any force", "inf ", "inf%"):
            assert word not in out
    if command in ("study", "walk") and status < 2:
        check_metrics(row["verdict"], json.loads(output.read_text()))
    if row["code in JSON"]:
        result = json.loads(output.read_text())
        answer = result.get("payload", result) if command == "hold" else result
        answer = answer.get(row["file"], answer) if command == "push" else answer
        assert answer["code"] == row["code in JSON"]
        number = {"hold": "mass", "payload": "mass", "push": "impulse"}[command]
        assert (answer[number] is None) is (row["code in JSON"] == "unknown")


def check_metrics(verdict: str, result: dict[str, Any]) -> None:
    """Compare the JSON of `study` and `walk` with a row: an unknown limit gives no share of it."""
    if "verified" in result:
        assert result["verified"] == [float(verdict.split(";")[0].removeprefix("verified "))]
        for name in ("peak_utilisation", "rest_utilisation"):
            assert (name not in result) is (f"no {name}" in verdict), name
    else:
        at_limit = result["gaits"][0]["at_limit"]
        assert at_limit == [None] * 12 if "unknown" in verdict else None not in at_limit


def test_each_special_value_has_rows_for_the_commands_that_read_files() -> None:
    with TABLE.open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    commands = {
        value: {row["command"] for row in table if (row["attribute"], row["value"]) == value}
        for value in SPECIAL_VALUES
    }
    missing = {value: FILE_COMMANDS - found for value, found in commands.items()}
    assert not {value: lacking for value, lacking in missing.items() if lacking}


def test_each_special_value_has_rows_for_the_commands_about_standing_robots() -> None:
    with TABLE.open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    for value in ROBOT_VALUES:
        found = {
            row["command"]
            for row in table
            if (row["attribute"], row["value"], row["file"]) == value
        }
        assert found >= ROBOT_COMMANDS - LONG_CASES.get(value, set()), value


def test_each_command_has_rows() -> None:
    """Reference: the commands that ``pupper-analysis --help`` lists."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        found = {row["command"] for row in csv.DictReader(file)}
    assert found | COMMANDS_WITHOUT_ROWS == set(cli.COMMAND_NAMES)
    assert not found & COMMANDS_WITHOUT_ROWS


def test_an_arm_with_forces_clamped_to_zero_falls_in_mujoco() -> None:
    """The shoulder is beyond 1 rad after 1 s."""
    model = mujoco.MjModel.from_xml_string(ARM_MJCF)
    model.actuator_forcerange[:] = 0.0
    data = mujoco.MjData(model)
    data.qpos[0] = data.ctrl[0] = 0.3
    while data.time < 1.0:
        mujoco.mj_step(model, data)
    assert data.qpos[0] > 1.0
