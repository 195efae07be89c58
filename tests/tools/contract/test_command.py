"""The command ``contract``: exit status, lines of both sources for machines, and refusals in one
line.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.commands import Answer, answer
from tests.tools.contract.sources import MJCF, URDF, format_list, write_all

BOMB = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 9)
)
BAD = {
    "cut.py": ("def f(:", "cut.py:1: invalid Python"),
    "alias.yaml": (BOMB, "the file contains more than 200000 values"),
    "self.yaml": ("a: &a [*a]\n", "the file is nested too deeply"),
    "deep.json": ("[" * 100_000, "nest"),
    "cut.yaml": ("a: [1\nb: 2", "invalid YAML"),
    "none.py": ("import os\nos.system('touch made')\n", "the file contains no number of joints"),
    "circle.py": ("from circle import A\nB = A\n", "the file contains no number of joints"),
    "big.yaml": ("#" * 20_000_001, "the file has more than 20 MB"),
    "cut.onnx": ("\x7f\x7f", "the file is not a readable ONNX model"),
    "text.txt": ("x", "unknown kind of file; valid endings: .json"),
    "other.py": ("C = ACfg(init_state=S(joint_pos={'knee': 1.0}), "
                 "actuators={'a': B(joint_names_expr=['knee'], stiffness=2.0)})\n",
                 "no joint name of the file matches a joint of pupper_v3.urdf"),
}  # fmt: skip


def run(folder: Path, *arguments: object) -> Answer:
    return answer("contract", "--no-stand", *map(str, arguments), folder=folder)


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
def test_invalid_source_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    """Among the files: a YAML of 9^9 values by aliases, endless nesting, and Python that would
    write a file if it were executed.
    """
    text, problem = BAD[name]
    (tmp_path / name).write_text(text)
    result = run(tmp_path, URDF, tmp_path / name)
    assert result.returncode == 2
    assert problem in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "made").exists()


def test_github_annotations_name_both_lines(tmp_path: Path) -> None:
    sources = write_all(tmp_path)
    text = sources["deploy.yaml"].read_text()
    sources["deploy.yaml"].write_text(
        text.replace(format_list([5.0] * 12), format_list([9.0] * 12))
    )
    completed = run(
        tmp_path, URDF, sources["gym_cfg.py"], sources["deploy.yaml"], "--format", "sarif"
    )
    assert completed.returncode == 1
    results = json.loads(completed.stdout)["runs"][0]["results"]
    places = [result["locations"][0]["physicalLocation"] for result in results]
    names = {place["artifactLocation"]["uri"].rpartition("/")[2] for place in places}
    assert names == {"gym_cfg.py", "deploy.yaml"}
    assert run(tmp_path, MJCF, URDF, sources["policy.json"], "--fail-on", "error").returncode == 1


def test_paths_are_shown_relative_to_the_working_folder(tmp_path: Path) -> None:
    """Also of imported modules. A line that contains both values is shown once."""
    sources = write_all(tmp_path)
    text = sources["deploy.yaml"].read_text()
    kd = format_list([0.25] * 12)
    sources["deploy.yaml"].write_text(text.replace(kd, format_list([0.1] * 11 + [0.2]), 1))
    result = run(tmp_path, URDF, "training/mjlab_cfg.py", "deploy.yaml")
    assert "   training/mjlab_cfg.py:11   deploy.yaml:5" in result.stdout.splitlines()
    assert "   deploy.yaml:5" in result.stdout.splitlines()
    assert str(tmp_path) not in result.stdout


def test_agreement_states_the_comparison_and_the_next_command(tmp_path: Path) -> None:
    """The second line was missing if no numbers differ."""
    lines = run(tmp_path, URDF, MJCF).stdout.splitlines()
    assert lines[0].startswith("AGREE ")
    assert lines[1].startswith("  compared: lower limit, upper limit, effort, ")
    assert lines[1].endswith("; nothing simulated (no default pose)")
    assert lines[2].startswith("  next: pupper-analysis stand ")


def test_next_command_is_crosscheck_if_urdf_and_mjcf_differ_else_walk(tmp_path: Path) -> None:
    """After a difference between policy and model, crosscheck of v3 has nothing to report."""
    sources = write_all(tmp_path)
    lines = run(tmp_path, URDF, MJCF, sources["policy.json"]).stdout.splitlines()
    assert lines[1] == (
        "  kd of joint leg_front_r_1 and 11 more: "
        "0.25 in policy.json, 0.1 N m s/rad in pupper_v3.xml"
    )
    assert lines[2].startswith("  next: pupper-analysis walk ")
    assert lines[2].endswith(f" --policy {sources['policy.json']}")
    other = tmp_path / "robot.urdf"
    other.write_text(URDF.read_text().replace('effort="3"', 'effort="4"', 1))
    lines = run(tmp_path, other, MJCF).stdout.splitlines()
    assert "effort of joint leg_front_r_1" in lines[1]
    assert lines[2] == f"  next: pupper-analysis crosscheck {other} {MJCF}"
