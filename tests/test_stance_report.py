"""``pupper-analysis stand``: what it prints and writes, its exit status, and bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import check_refusal, run_command
from matplotlib.image import imread
from rich.console import Console

from pupper_analysis import (
    Ground,
    StandTask,
    VariantSpec,
    base_workspace,
    load_variant,
    solve_stand,
    stand_statics,
    sunk_stand,
    write_variant,
)
from pupper_analysis.analysis.stance import study, way_to
from pupper_analysis.report import stance as stance_report
from pupper_analysis.report.figures.pose import pose_figure
from pupper_analysis.report.figures.workspace import workspace_figure


def test_three_legs_hold(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "all.json"
    arguments = ("v3", "--swing", "FL=0.02", "--com", "inside", "--com-margin", "0.01")
    figure = tmp_path / "stance.png"
    status, out, err = run_command(
        capfd, "stand", *arguments, "--figure", str(figure), "--json", str(path)
    )
    assert status == 0, err
    assert "FL lifted 20 mm" in out
    assert "HOLDS in MuJoCo" in out
    robot, task = load_variant("v3"), StandTask(swing={"FL": 0.02}, com="inside", com_margin=0.01)
    alike, held = tmp_path / "alike.png", stand_statics(robot, sunk_stand(robot, task))
    pose_figure(robot, solve_stand(robot, task), held, alike)
    np.testing.assert_array_equal(imread(figure), imread(alike))
    content = json.loads(path.read_text())
    forces = content["statics"]["contact_forces"]
    assert set(forces) == {"FR", "RR", "RL"}
    weight = 3.170 * 9.81
    assert sum(force[2] for force in forces.values()) == pytest.approx(weight, rel=1e-3)
    assert content["statics"]["com_margin"] > 0.01
    assert content["settled"]["base_height"] < content["stand"]["qpos"][2]
    assert set(content["sunk"]["depths"]) == {"FR", "RR", "RL"}
    assert content["verification"]["height_loss"] == pytest.approx(0, abs=1e-5)
    assert content["payload"]["mass"] > 0


def test_every_option_reaches_the_task(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "all.json"
    status, out, err = run_command(
        capfd,
        "stand",
        "v3-heavy",
        *("--height", "0.12", "--roll", "0.02", "--pitch", "-0.03", "--yaw", "0.04"),
        *("--com", "0.005,-0.004", "--com-margin", "0.02", "--joint-margin", "0.05"),
        *("--move", "RL=-0.01,0.02", "--step", "FR=0.01", "--slope", "0.02", "--uphill", "1.5"),
        *("--json", str(path)),
    )
    assert status == 0, err
    assert "HOLDS in MuJoCo" in out
    task = json.loads(path.read_text())["stand"]["task"]
    assert (task["height"], task["roll"], task["pitch"], task["yaw"]) == (0.12, 0.02, -0.03, 0.04)
    assert task["com"] == [0.005, -0.004]
    assert (task["com_margin"], task["joint_margin"]) == (0.02, 0.05)
    assert task["foot_offsets"] == {"RL": [-0.01, 0.02]}
    assert task["ground"] == {"slope": 0.02, "uphill": 1.5, "heights": {"FR": 0.01}}


def test_envelope_and_offset(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "all.json"
    status, out, err = run_command(
        capfd,
        "stand",
        "original",
        "--offset",
        "0.01,0",
        "--workspace",
        "--json",
        str(path),
    )
    assert status == 0, err
    assert "How far the base can go" in out
    content = json.loads(path.read_text())
    assert content["stand"]["task"]["offset"] == [0.01, 0.0]
    for direction, interval in content["workspace"]["intervals"].items():
        assert interval["low"] < interval["high"], direction
    shift = content["workspace"]["intervals"]["x"]
    assert shift["low"] < 0.01 < shift["high"]


def test_failure_in_simulation_is_exit_status_1(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from pupper_analysis.simulation import verify as simulation

    monkeypatch.setattr(simulation, "JOINT_TOLERANCE", 1e-12)
    status, out, _ = run_command(capfd, "stand", "original")
    assert status == 1
    assert "FAILS in MuJoCo: a joint is off by" in out


def test_sag_is_that_of_the_simulation() -> None:
    robot = load_variant("long-leg")
    result = study(robot, StandTask(yaw=0.1))
    assert result.settled is not None
    settled = result.settled
    loss = result.stand.qpos[2] - settled.base_height
    assert settled.servo_sag + settled.contact_sag == pytest.approx(loss)
    out = Console(width=120, record=True, quiet=False, file=None, highlight=False)
    with out.capture() as capture:
        stance_report.print_stance(out, result)
    assert f"settles at {settled.base_height:.5f} m" in capture.get()


def test_way_there(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    csv, npz = tmp_path / "way.csv", tmp_path / "way.npz"
    arguments = ("--swing", "RR=0.01", "--com", "inside", "--com-margin", "0.01", "--path", "3")
    status, out, err = run_command(
        capfd, "stand", "original", *arguments, "--csv", str(csv), "--npz", str(npz)
    )
    assert status == 0, err
    assert "TRACKED" in out
    assert "path of 3 s" in out
    rows = csv.read_text().splitlines()
    with np.load(npz) as file:
        arrays = dict(file)
    assert len(rows) > 100
    robot = load_variant("original")
    goal = solve_stand(robot, StandTask(swing={"RR": 0.01}, com="inside", com_margin=0.01))
    np.testing.assert_allclose(arrays["qpos"][-1][2:7], goal.qpos[2:7], atol=1e-9)
    np.testing.assert_allclose(arrays["qpos"][-1], goal.qpos, atol=0.05)  # its feet have rolled
    np.testing.assert_allclose(arrays["qpos"][0], solve_stand(robot).qpos, atol=1e-9)


def test_the_way_keeps_moved_feet_and_ground() -> None:
    robot = load_variant("v3")
    task = StandTask(0.12, foot_offsets={"FL": (0.01, 0.0)}, ground=Ground(0.05), com=(0.005, 0.0))
    way = way_to(robot, solve_stand(robot, task))
    assert len(way) == 2
    for stance in way:
        assert stance.ground == task.ground
        assert stance.foot_offsets == task.foot_offsets
    assert way[1].height == 0.12
    assert way[1].com == pytest.approx((0.005, 0.0), abs=1e-9)


def test_best_payload_and_servos(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "all.json"
    status, out, err = run_command(
        capfd,
        *(
            "stand",
            "original",
            "--best",
            "margin",
            "--payload-at",
            "0.01,0,0.08",
            "--minimum-stiffness",
        ),
        *("--kp", "80", "--kd", "1.5", "--self-clearance", "0.002", "--ground-clearance", "0.005"),
        *("--json", str(path)),
    )
    assert status == 0, err
    content = json.loads(path.read_text())
    assert content["best"]["objective"] == "margin"
    assert content["best"]["value"] > content["best"]["nominal_value"]
    # The statics are those of the sunk stance: longer legs move the com by a hundredth of that.
    value = content["best"]["value"]
    assert content["statics"]["com_margin"] == pytest.approx(value, abs=2e-4)
    assert content["point"] == [0.01, 0.0, 0.08]
    assert content["verification"]["kp"] == [80.0] * 12
    assert content["verification"]["kd"] == [1.5] * 12
    assert content["stand"]["self_clearance"]["distance"] > 0.002 - 1e-6
    assert content["stand"]["ground_clearance"]["distance"] > 0.005 - 1e-6
    assert 0.5 < content["minimum_stiffness"] < 20
    for text in ("best of", "payload at (10, 0, 80) mm", "softest servos", "nearest links"):
        assert text in out


@pytest.mark.slow
def test_envelope_figure_and_push(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    figure = tmp_path / "workspace.png"
    status, out, err = run_command(
        capfd, "stand", "heavy", "--workspace-figure", str(figure), "--push"
    )
    assert status == 0, err
    assert "Largest push" in out
    alike, robot = tmp_path / "alike.png", load_variant("heavy")
    workspace_figure(robot, base_workspace(robot), alike)
    np.testing.assert_array_equal(imread(figure), imread(alike))


def test_a_robot_of_ones_own(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    urdf, mjcf = write_variant("heavy", tmp_path)
    files = ["--urdf", str(urdf), "--mjcf", str(mjcf)]
    feet = [part for foot in ("FL", "FR", "RL", "RR") for part in ("--foot", f"{foot}={foot}_foot")]
    status, own, err = run_command(capfd, "stand", *files, *feet, "--height", "0.15")
    assert status == 0, err
    status, ours, _ = run_command(capfd, "stand", "heavy", "--height", "0.15")
    assert status == 0
    assert own.splitlines()[1:] == ours.splitlines()[1:]  # all but the name


def test_softest_servos_are_found_where_the_given_ones_are_too_soft() -> None:
    robot = load_variant("v3-long-leg")
    result = study(robot, StandTask(), kp=4.0, kd=0.1, softest=True)
    assert result.settled is None
    assert result.minimum_stiffness is not None
    assert 4.0 < result.minimum_stiffness < 6.0
    out = Console(width=120)
    with out.capture() as capture:
        stance_report.print_stance(out, result)
    assert f"softest servos that carry it: {result.minimum_stiffness:.2f} N m/rad" in capture.get()


def test_motors_too_weak_are_said_so() -> None:
    """Reached and in balance, but held by no motor of 3 N m."""
    robot = load_variant(VariantSpec(base="v3", torso_mass_scale=12.0))
    result = study(robot, StandTask(), seconds=2.0)
    assert not result.passed
    assert set(result.overloaded) == {name for name in robot.joint_names if name.endswith("_3")}
    assert result.tracking is not None
    assert any("of its limit" in failure for failure in result.tracking.failures)
    out = Console(width=120)
    with out.capture() as capture:
        stance_report.print_stance(out, result)
    assert "OVERLOADED" in capture.get()
    assert not study(load_variant("v3"), StandTask()).overloaded


BAD = {
    "path to nowhere": (["v3", "--csv", "a.csv"], "give --path too"),
    "name and files": (["v3", "--urdf", "a.urdf"], "give a variant's name, or"),
    "no feet": (["--urdf", "a.urdf", "--mjcf", "a.xml"], "needs all three"),
    "no such file": (["--urdf", "a.urdf", "--mjcf", "a.xml", "--foot", "a=b"], "a.urdf"),
    "no point": (["v3", "--payload-at", "1,2"], "not of the form X,Y,Z"),
    "no damping": (["v3", "--kp", "-3"], "kp"),
    "too near": (["v3", "--self-clearance", "0.05"], "Possible with all else as asked: self_"),
    "no such robot": (["spot"], "'spot'"),
    "too high": (["v3", "--height", "0.3"], "height 0.1919 m"),
    "too steep": (["v3", "--slope", "0.9"], "ground slope 34.7 deg"),
    "below the ground": (["v3", "--height", "-0.1"], "not above the ground"),
    "not finite": (["v3", "--roll", "nan"], "roll"),
    "no such foot": (["v3", "--swing", "XX=0.02"], "no foot 'XX'; there are: FR, FL, RR, RL"),
    "two lifted": (["v3", "--swing", "FL=0.02", "--swing", "FR=0.02"], "only 2 feet carry"),
    "no height": (["v3", "--swing", "FL"], "'FL' is not of the form NAME=VALUE"),
    "no number": (["v3", "--step", "FL=high"], "'high' in 'FL=high' is no length"),
    "no place": (["v3", "--com", "middle"], "'middle'"),
    "one coordinate": (["v3", "--move", "FL=0.01"], "not of the form X,Y"),
    "slides": (["v3", "--slope", "0.8", "--pitch", "-0.8"], "1.030 is needed"),
    "figure in a folder": (["v3", "--figure", "."], "it is a folder"),
    "JSON in a folder": (["v3", "--json", "."], "it is a folder"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_exit_status_2(
    case: str, capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments, message = BAD[case]
    monkeypatch.chdir(tmp_path)
    output = [] if "--json" in arguments else ["--json", "all.json"]
    check_refusal(capfd, tmp_path, ["stand", *arguments, *output], message)
