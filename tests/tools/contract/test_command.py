"""The command ``contract``: exit status, lines of both sources for machines, and refusals in one
line.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.commands import Answer, answer
from tests.tools.contract.sources import ANGLES, JOINTS, MJCF, URDF, format_list, write_all

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

GYM = f"""
class Cfg(LeggedRobotCfg):
    class init_state(LeggedRobotCfg.init_state):
        default_joint_angles = {dict(zip(JOINTS, ANGLES, strict=True))}

    class control(LeggedRobotCfg.control):
        stiffness = {{"leg": 5.0}}
        damping = {{"leg": 0.25}}
        action_scale = 0.5
        decimation = 4
"""
"""Configuration of legged_gym with the default angles and gains of Pupper v3."""


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
        "  kd of leg_front_r_1 and 11 more: 0.25 in policy.json, 0.1 N m s/rad in pupper_v3.xml"
    )
    assert lines[2].startswith("  next: pupper-analysis walk ")
    assert lines[2].endswith(f" --policy {sources['policy.json']}")
    lines = run(tmp_path, "v3", sources["policy.json"]).stdout.splitlines()
    assert lines[1].endswith(": 0.25 in policy.json, 0.1 N m s/rad in v3")  # as typed
    other = tmp_path / "robot.urdf"
    other.write_text(URDF.read_text().replace('effort="3"', 'effort="4"', 1))
    lines = run(tmp_path, other, MJCF).stdout.splitlines()
    assert "effort of leg_front_r_1" in lines[1]
    assert lines[2] == f"  next: pupper-analysis crosscheck {other} {MJCF}"


def test_next_walk_gets_the_files_of_the_deployment(tmp_path: Path) -> None:
    """The policy states no observation: without the YAML, `walk` refuses it. A configuration that
    the user has selected stays selected.
    """
    sources = write_all(tmp_path)
    deploy, policy = tmp_path / "deploy.yaml", sources["policy.json"]
    deploy.write_text(f"joint_names: {format_list(JOINTS)}\nstiffness: {format_list([6.0] * 12)}\n")
    lines = run(tmp_path, "v3", deploy, policy).stdout.splitlines()
    assert lines[2] == f"  next: pupper-analysis walk v3 {deploy} --policy {policy}"
    trainer = tmp_path / "gym.py"
    trainer.write_text(GYM + GYM.replace("class Cfg", "class Other").replace("5.0", "6.0"))
    lines = run(tmp_path, "v3", f"{trainer}:Other", policy).stdout.splitlines()
    assert lines[2] == f"  next: pupper-analysis walk v3 {trainer}:Other --policy {policy}"


def test_no_walk_is_proposed_with_a_file_that_walk_refuses(tmp_path: Path) -> None:
    """`walk` takes every JSON for a policy."""
    sources = write_all(tmp_path)
    deploy = tmp_path / "deploy.json"
    deploy.write_text(json.dumps({"joint_names": JOINTS, "stiffness": [6.0] * 12}))
    lines = run(tmp_path, "v3", deploy, sources["policy.json"]).stdout.splitlines()
    assert lines[1].startswith("  kp of leg_front_r_1")
    assert lines[2] == "  next: pupper-analysis stand v3"


def test_name_that_matches_no_joint_is_incomplete_and_the_next_command_assigns_it(
    tmp_path: Path,
) -> None:
    """A renamed joint of the model leaves one name of the trainer and one joint without number."""
    trainer = tmp_path / "gym_cfg.py"
    trainer.write_text(GYM)
    model = tmp_path / "robot.urdf"
    model.write_text(URDF.read_text().replace('"leg_back_l_3"', '"rear_knee"'))
    result = run(tmp_path, model, trainer)
    lines = result.stdout.splitlines()
    assert result.returncode == 1
    assert lines[0] == (
        "INCOMPLETE robot.urdf and gym_cfg.py: "
        "leg_back_l_3 of gym_cfg.py:Cfg is probably joint rear_knee"
    )
    options = "--no-stand --map leg_back_l_3=rear_knee"
    assert lines[2] == f"  next: pupper-analysis contract {model} {trainer} {options}"
    result = run(tmp_path, model, trainer, "--map", "leg_back_l_3=rear_knee")
    assert "INCOMPLETE" not in result.stdout


def test_sources_without_a_common_quantity_are_not_compared(tmp_path: Path) -> None:
    """The trainer states default angles and gains only, and the URDF states limits."""
    trainer = tmp_path / "gym_cfg.py"
    trainer.write_text(GYM)
    result = run(tmp_path, URDF, trainer)
    assert result.returncode == 1
    assert result.stdout.startswith("NOT COMPARED pupper_v3.urdf and gym_cfg.py: no number in both")
    assert run(tmp_path, URDF, trainer, "--fail-on", "error").returncode == 0


def test_lists_without_joint_names_are_the_reason_for_no_comparison(tmp_path: Path) -> None:
    """Both sources state damping; the list of the second names no joints, so it is not read.

    The printed lines repair this: with both, the twelve numbers are compared.
    """
    lists = tmp_path / "identified.py"
    lists.write_text(f"Kp = 20.0\nviscous_friction = {[0.1] * 12}\n")
    lines = run(tmp_path, URDF, lists, "--no-stand").stdout.splitlines()
    assert lines[0] == "NOT COMPARED pupper_v3.urdf and identified.py: 1 list not read"
    line, entry = 'joint_names = ["leg_front_r_1", ...]', 'names = ["viscous_friction"]'
    assert lines[1] == f"  no joint names: add {line} to the .py, then map the keys (-v)"
    assert lines[2] == f"  next: pupper-analysis contract {URDF} {lists} --no-stand -v"
    lists.write_text(f"joint_names = {list(JOINTS)}\n{lists.read_text()}")
    lines = run(tmp_path, URDF, lists, "--no-stand").stdout.splitlines()
    added = f'quantity = "damping", {entry}'
    assert lines[1] == f"  pupper-analysis.toml: add a contract.key with {added}"
    config = tmp_path / "pupper-analysis.toml"
    config.write_text("\n".join(["[[contract.key]]", *added.split(", ")]))
    lines = run(tmp_path, URDF, lists, "--no-stand").stdout.splitlines()
    assert " 12 differences in 12 compared numbers from 2 sources" in lines[0]


def test_number_of_compared_numbers_excludes_numbers_of_one_source(tmp_path: Path) -> None:
    """Twelve efforts are stated twice; the URDF alone states limits and velocities."""
    limits = tmp_path / "limits.yaml"
    limits.write_text(
        f"joint_names: {format_list(JOINTS)}\ntorque_limits: {format_list([3] * 12)}\n"
    )
    line = run(tmp_path, URDF, limits).stdout.splitlines()[0]
    count = "0 differences in 12 compared numbers from 2 sources"
    assert line == f"AGREE pupper_v3.urdf and limits.yaml: {count}"


@pytest.mark.slow
def test_default_pose_that_falls_is_stated_beside_the_verdict(tmp_path: Path) -> None:
    """With kp 0.5 N m/rad the knee torques of Pupper v3 need more than 0.5 rad of deflection."""
    trainer = tmp_path / "gym_cfg.py"
    trainer.write_text(GYM.replace("5.0}", "0.5}"))
    completed = answer("contract", str(URDF), str(trainer), folder=tmp_path)
    lines = completed.stdout.splitlines()
    assert lines[1].startswith("  default pose of gym_cfg.py does not stay up with its gains")
    assert lines[2].startswith(f"  next: pupper-analysis gains {URDF} --kp 0.5 --kd 0.25")
