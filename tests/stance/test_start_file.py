"""Initial guesses read from files: formats, assignment by name, refusals, and the IK branch."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance.start_file import read_start
from tests.support.commands import run_command
from tests.support.legged import quadruped


@pytest.fixture(scope="module")
def two_branches(tmp_path_factory: pytest.TempPathFactory) -> pa.Robot:
    """Quadruped whose knees bend to both sides."""
    pair = quadruped(tmp_path_factory.mktemp("two"), keyframe="")
    for path, old, new in (
        (pair.urdf, 'lower="-2.6" upper="-0.4"', 'lower="-2.6" upper="2.6"'),
        (pair.mjcf, 'range="-2.6 -0.4"', 'range="-2.6 2.6"'),
    ):
        text = path.read_text()
        assert text.count(old) == 4, path
        path.write_text(text.replace(old, new))
    return pa.load_robot(pair.urdf, pair.mjcf)


def write_formats(robot: pa.Robot, qpos: np.ndarray, folder: Path) -> dict[str, str]:
    """Return {name of a file: text} with the same joint positions in each format."""
    joints = qpos[robot.nq - robot.nu :].tolist()
    named = dict(zip(robot.joint_names, joints, strict=True))
    rows = "".join(f"{name},{value!r},1.0\n" for name, value in named.items())
    return {
        "result.json": json.dumps(
            {"a": {"joint_positions": joints, "statics": {"joint_names": [*named]}}}
        ),
        "stand.json": json.dumps({"qpos": qpos.tolist(), "robot": robot.fingerprint}),
        "both.json": json.dumps(
            {"qpos": qpos.tolist(), "joint_positions": joints, "joint_names": [*named]}
        ),
        "names.json": json.dumps(dict(reversed(named.items()))),
        "numbers.json": json.dumps(qpos.tolist()),
        "table.csv": f"joint,position (rad),torque (N m)\n{rows}",
        "row.csv": ",".join(map(repr, joints)) + "\n",
        "column.csv": "\n".join(map(repr, joints)) + "\n",
    }


def test_each_format_contains_the_same_joint_positions(
    two_branches: pa.Robot, tmp_path: Path
) -> None:
    """Reference: the written numbers, exactly, in the order of the joint names."""
    robot = two_branches
    qpos = robot.home + np.linspace(0, 0.1, robot.nq)
    for name, text in write_formats(robot, qpos, tmp_path).items():
        path = tmp_path / name
        path.write_text(text)
        read = read_start(path, robot)
        np.testing.assert_array_equal(read[7:], qpos[7:], err_msg=name)


@pytest.mark.slow
def test_start_of_a_file_selects_the_branch_of_the_knees(
    two_branches: pa.Robot, tmp_path: Path
) -> None:
    """Reference: a knee angle and its negative reach the same height (equal segments).

    Control: the opposite start gives the opposite branch.
    """
    robot = two_branches
    knees = [robot.joint_names.index(f"{leg}_knee") for leg in ("FL", "FR", "RL", "RR")]
    pitches = [robot.joint_names.index(f"{leg}_pitch") for leg in ("FL", "FR", "RL", "RR")]
    found = {}
    for side in (-1.0, 1.0):
        start = {f"{leg}_knee": side * 1.2 for leg in ("FL", "FR", "RL", "RR")}
        start |= {f"{leg}_pitch": side * -0.6 for leg in ("FL", "FR", "RL", "RR")}
        path = tmp_path / "start.json"
        path.write_text(json.dumps(start))
        task = pa.StandTask(height=0.33, com="inside")
        stand = pa.solve_stand(robot, task, start=read_start(path, robot))
        found[side] = stand.joint_positions(robot)
        assert (np.sign(found[side][knees]) == side).all()
    np.testing.assert_allclose(np.abs(found[-1.0][knees]), np.abs(found[1.0][knees]), atol=0.3)
    assert (np.sign(found[-1.0][pitches]) != np.sign(found[1.0][pitches])).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1, 2, 3]", "3 numbers, but the robot has 19"),
        ('{"qpos": [1, NaN]}', "no joint positions"),
        ("not a table\n", "no joint positions"),
        ("1,2\n3,4\n", "no joint positions"),
        ('{"FL_kne": 0.1}', "FL_knee"),
        ('{"passed": true}', "no joint positions"),
        ("", "no joint positions"),
        (",".join(["inf"] * 19), "not finite"),
        (json.dumps({"qpos": [0.0] * 19, "robot": "other 0123"}), "another robot"),
        (json.dumps({"qpos": [0.0] * 19, "joint_positions": [0.1] * 12}), "qpos differ"),
        (
            json.dumps({"qpos": [0.0] * 19, "joint_positions": [0.1], "joint_names": ["FL_knee"]}),
            "qpos differ",
        ),
    ],
)
def test_other_contents_are_refused_with_the_accepted_forms(
    two_branches: pa.Robot, tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "start.txt"
    path.write_text(text)
    with pytest.raises(pa.PupperAnalysisError, match=message):
        read_start(path, two_branches)


@pytest.mark.slow
def test_command_starts_from_its_own_results(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: the joint positions of the first run, from JSON and from CSV, to 1e-9 rad."""
    first, table = tmp_path / "first.json", tmp_path / "first.csv"
    status, _, err = run_command(capfd, "stand", "v3", "--json", str(first), "--csv", str(table))
    assert status == 0, err
    expected = json.loads(first.read_text())["joint_positions"]
    second = tmp_path / "second.json"
    for start in (first, table):
        status, _, err = run_command(
            capfd, "stand", "v3", "--start", str(start), "--json", str(second)
        )
        assert status == 0, err
        content = json.loads(second.read_text())
        np.testing.assert_allclose(content["joint_positions"], expected, atol=1e-9)
        assert str(start) in "".join(content["provenance"]["files"])
