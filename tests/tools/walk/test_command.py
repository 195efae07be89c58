"""The command ``walk``: printed text, written files, exit status, and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.tools.walk import intervals
from tests.support import legged
from tests.support.commands import check_refusal, run_command
from tests.support.repository import ROOT
from tests.tools.walk import made


def test_walk_with_a_standing_policy_passes(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    policy = made.write_standing_policy(tmp_path / "still.json")
    path, page = tmp_path / "walk.json", tmp_path / "walk.html"
    status, out, err = run_command(
        capfd, "walk", "v3", "--policy", str(policy), "--command", "0,0,0", "--seconds", "3",
        "--json", str(path), "--report", str(page), "-v",
    )  # fmt: skip
    assert status == 0, err
    assert "WALKS v3 by still.json" in out
    gait = json.loads(path.read_text())["gaits"][0]
    assert f"{max(gait['torque_rms']):.2f}" in out
    shown = page.read_text(encoding="utf-8")
    assert "leg_back_r_3" in shown
    assert shown.count('class="scene"') == 1  # the run in three dimensions
    scene = json.loads(shown.partition('class="scene">')[2].partition("</script>")[0])
    assert len(scene["motions"][1]["time"]) == 75  # 3 s at 25 Hz


@pytest.mark.slow
@pytest.mark.parametrize(
    ("zero", "cause"),
    [
        (False, "no foot leaves the ground: the actions of the policy do not make the robot step"),
        (True, "all 12 actions are 0, so no foot leaves the ground: check the weights"),
    ],
    ids=["small actions", "no action"],
)
def test_walk_that_does_not_follow_its_command_gives_exit_status_1(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, *, zero: bool, cause: str
) -> None:
    """Commanded to walk at 0.5 m/s, one policy only counters tilt, and one does nothing."""
    policy = made.write_standing_policy(tmp_path / "still.json")
    if zero:
        network = json.loads(policy.read_text())
        weights, biases = network["layers"][0]["weights"]
        network["layers"][0]["weights"] = [[[0.0] * len(row) for row in weights], biases]
        policy.write_text(json.dumps(network))
    words = ("walk", "v3", "--policy", str(policy), "--command", "0.5,0,0", "--seconds", "3")
    status, out, err = run_command(capfd, *words)
    assert status == 1, err
    assert len(out.splitlines()[1]) <= 100
    assert "…" not in out.splitlines()[1]  # the cause was cut
    assert out.startswith("DOES NOT TRACK v3 by still.json")
    assert out.splitlines()[1].startswith(f"  {cause}")


def test_policy_on_a_fixed_base_is_refused_before_its_observations(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The observations of v3 do not fit to this arm either."""
    policy = made.write_standing_policy(tmp_path / "still.json")
    arm = tmp_path / "arm.xml"
    arm.write_text(
        '<mujoco><worldbody><body name="arm"><joint name="turn" axis="0 1 0"/>'
        '<inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>'
        '<actuator><position joint="turn" kp="5"/></actuator></mujoco>'
    )
    for options in (("--policy", str(policy)), ()):
        status, _, err = run_command(capfd, "walk", str(arm), *options)
        assert status == 2
        assert "has a fixed base" in err
        assert err.splitlines()[-1] == f"  next: pupper-analysis hold {arm}"


@pytest.mark.slow
def test_walk_reports_audit_errors(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """As all commands with a verdict."""
    text = (ROOT / "urdf/pupper_v3.urdf").read_text(encoding="utf-8")
    text = text.replace("../mjcf/", f"{ROOT}/mjcf/").replace('ixx="7.4e-05"', 'ixx="7.4e-03"', 1)
    urdf, policy = tmp_path / "robot.urdf", made.write_standing_policy(tmp_path / "still.json")
    urdf.write_text(text, encoding="utf-8")
    words = ("walk", str(urdf), "--policy", str(policy), "--command", "0,0,0", "--seconds", "3")
    for more in ((), ("--vary", "strength", "--seeds", "1")):
        _, out, err = run_command(capfd, *words, *more, "-v")
        expected = "files with defects (audit lists them): the inertia of link 'leg_front_r_1'"
        assert expected in out, err


def test_invalid_input_is_refused_in_one_line(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    policy = made.write_standing_policy(tmp_path / "still.json")
    words = ("walk", "v3", "--policy")
    for more, message in (
        ((str(tmp_path / "none.json"),), "none.json"),
        ((str(policy), "--command", "fast"), "fast"),
        ((str(policy), "--seconds", "nan"), "seconds"),
        ((str(policy), "--vary", "mass,moon"), "moon"),
        ((str(policy), "--vary", "mass", "--fit", str(policy)), "not the JSON of a fit"),
        ((str(policy), "--vary", "mass", "--seeds", "0"), "seeds"),
        ((str(policy), "--contract", str(policy)), "TOML"),
    ):
        check_refusal(capfd, tmp_path, (*words, *more), message)


@pytest.mark.slow
def test_error_is_one_line_if_servos_or_joints_of_the_policy_are_missing(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    values = json.loads(made.write_standing_policy(tmp_path / "still.json").read_text())
    without = {key: value for key, value in values.items() if key not in ("kp", "kd")}
    bare = tmp_path / "bare.json"
    bare.write_text(json.dumps(without))
    (tmp_path / "motors").mkdir()
    made_of = legged.quadruped(tmp_path / "motors", floor=True, actuators="motor")
    status, _, err = run_command(capfd, "walk", str(made_of.mjcf), "--policy", str(bare))
    assert (status, len(err.splitlines())) == (2, 1)
    assert "state servo gains" in err
    named = tmp_path / "named.json"
    named.write_text(json.dumps(values))
    named.with_suffix(".toml").write_text(f"joints = {[f'j{k}' for k in range(12)]}")
    check_refusal(capfd, tmp_path, ("walk", "v3", "--policy", str(named)), "j0")
    few = made.write_standing_policy(tmp_path / "few.json", default_joint_pos=[0.0] * 11)
    check_refusal(capfd, tmp_path, ("walk", "v3", "--policy", str(few)), "default")
    large = tmp_path / "large.onnx"
    tensor = made.tensor("W", [1.0], dims=(40_000, 25_000))
    ends = [made.value("obs", 1, 2)], [made.value("y", 1, 3)]
    large.write_bytes(made.onnx([made.node("MatMul", ("obs", "W"), ("y",))], [tensor], *ends))
    check_refusal(capfd, tmp_path, ("walk", "v3", "--policy", str(large)), "1000000000 weights")


@pytest.mark.slow
def test_payload_and_pushes_are_printed_in_kilograms_and_newton_seconds(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: the ends of the intervals in the JSON, times the mass of the robot."""
    policy = str(made.write_standing_policy(tmp_path / "still.json"))
    path = tmp_path / "walk.json"
    status, out, err = run_command(
        capfd, "walk", "v3", "--vary", "push-forward,push-left,payload", "--policy", policy,
        "--command", "0,0,0", "--seconds", "3", "--seeds", "1", "--json", str(path), "-v",
    )  # fmt: skip
    assert status == 0, err
    found = json.loads(path.read_text())
    forward, left, payload = (
        interval["common"][1] * found["mass"] for interval in found["intervals"]
    )
    assert f"{forward:.3g} N s forward" in out
    assert f"{left:.3g} N s to the left" in out
    assert f"base: {payload:.3g} kg" in " ".join(out.split())


def test_vary_all_varies_every_quantity(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The search for intervals is replaced; `test_changes` simulates each quantity."""
    varied: list[str] = []

    def refuse(*_: object, quantities: tuple[str, ...], **__: object) -> None:
        varied.extend(quantities)
        raise pa.ConfigurationError("vary", diagnose("no-array", problem="stopped here"))

    monkeypatch.setattr(intervals, "tracked_intervals", refuse)
    policy = str(made.write_standing_policy(tmp_path / "still.json"))
    words = ("walk", "v3", "--vary", "all", "--policy", policy, "--command", "0,0,0")
    status, _, err = run_command(capfd, *words)
    assert status == 2
    assert "stopped here" in err
    assert varied == list(intervals.VARIED_QUANTITIES)


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("live", "v3", "--command", "0,0,0"), "--command"),
    ],
    ids=str,
)
def test_option_without_effect_on_a_policy_is_refused(
    words: tuple[str, ...], option: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    policy = str(made.write_standing_policy(tmp_path / "still.json"))
    typed = tuple(policy if word == "still.json" else word for word in words)
    check_refusal(capfd, tmp_path, typed, f"{option}: the option has no effect")


def test_missing_key_names_the_base_class_and_the_template(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The refusal asked for the configuration of the trainer, which was given, in 200 columns."""
    policy, config = tmp_path / "policy.onnx", tmp_path / "walk_config.py"
    policy.write_bytes(made.dense_onnx([(np.zeros((48, 12)), np.zeros(12))], "Elu"))
    config.write_text(
        "from legged_gym.envs.base.legged_robot_config import LeggedRobotCfg\n"
        "class Cfg(LeggedRobotCfg):\n    class control(LeggedRobotCfg.control):\n"
        "        stiffness = {'leg': 5.0}\n        damping = {'leg': 0.25}\n"
        "        action_scale = 0.5\n        decimation = 4\n"
    )
    words = ("walk", "v3", str(config), str(policy))
    status, _, err = run_command(capfd, *words, "--command", "0.5,0,0")  # --init refuses it
    fault, step = err.splitlines()[-2:]
    assert status == 2
    assert fault.startswith(f"error: {policy}: no file states ")
    assert fault.endswith("; the file of the base class LeggedRobotCfg was not found")
    assert step == f"  next: pupper-analysis walk v3 {config} {policy} --init"
    status, out, _ = run_command(capfd, *words, "--init")
    assert status == 0
    assert out.splitlines()[-1] == f"  next: pupper-analysis walk v3 {config} {policy}"
    _, _, err = run_command(capfd, *words)
    assert err.splitlines()[-1].endswith(f"; complete {policy.with_suffix('.toml')}")


def test_policy_for_fewer_joints_without_names_proposes_a_template_that_can_be_written(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The robot has a 13th motor, in the head; ``--init`` refuses the typed ``--command``."""
    policy = made.write_standing_policy(tmp_path / "still.json")
    mjcf = legged.quadruped(tmp_path, actuators="position", floor=True, head=True).mjcf
    words = ("walk", str(mjcf), str(policy))
    status, _, err = run_command(capfd, *words, "--command", "0,0,0", "--seeds", "2")
    fault, step = err.splitlines()[-2:]
    assert status == 2
    assert fault.endswith("commands 12 joints without names, but the robot has 13 joints")
    assert step == f"  next: pupper-analysis {' '.join(words)} --init"
    status, _, err = run_command(capfd, *words, "--init")
    assert status == 0, err
    names = [line for line in policy.with_suffix(".toml").read_text().splitlines()
             if line.startswith("# joints = ")]  # fmt: skip
    assert len(names) == 1
    assert names[0].count(", ") == 12  # the names of all joints, to choose from
    _, _, err = run_command(capfd, *words)
    assert "next:" not in err  # the template exists


def test_policy_with_an_unknown_joint_proposes_no_template(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A template adds names to a policy without names; this policy has names."""
    mjcf = str(legged.quadruped(tmp_path, actuators="position", floor=True, head=True).mjcf)
    names = [*pa.load_robot(mjcf).joint_names[:11], "tail"]
    policy = made.write_standing_policy(tmp_path / "still.json", joint_names=names)
    status, _, err = run_command(capfd, "walk", mjcf, str(policy))
    assert status == 2
    assert "no joint 'tail'" in err
    assert "--init" not in err


def test_policy_for_more_joints_proposes_no_command(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """No file can make a policy with 12 outputs drive a robot with 8 joints."""
    policy = made.write_standing_policy(tmp_path / "still.json")
    robot = legged.fix_hinges(legged.quadruped(tmp_path, actuators="position"), "_knee").mjcf
    status, _, err = run_command(capfd, "walk", str(robot), str(policy))
    assert status == 2
    assert "commands 12 joints without names, but the robot has 8 joints" in err
    assert "next:" not in err
