"""``pupper-analysis push``: what it prints and writes, its exit status, and bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

import pupper_analysis as pa
from pupper_analysis.tools.push.figures import push_figure
from tests.support.commands import check_refusal, run_command
from tests.support.variants import load

COARSE = ("--directions", "4", "--resolution", "0.3")


@pytest.mark.longest
def test_two_robots_are_pushed(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path, figure = tmp_path / "all.json", tmp_path / "push.png"
    output = ("--figure", str(figure), "--json", str(path))
    status, out, err = run_command(capfd, "push", "original", "heavy", "-v", *COARSE, *output)
    assert status == 0, err
    content = json.loads(path.read_text())
    assert list(content) == ["generator", "provenance", "original", "heavy"]
    assert content.pop("generator").startswith("pupper-analysis ")
    assert content.pop("provenance")["files"]
    for name, stance in content.items():
        result = stance["recovery"]
        weakest = f"{result['weakest_impulse']:.2f} N s, "
        assert f"WITHSTANDS {name}: weakest at " in out
        assert f"m/s of its {result['mass']:.2f} kg" in out
        assert weakest in out
        assert result["weakest_impulse"] == min(result["impulses"])
    for degrees in (0, 90, 180, 270):
        assert any(line.split()[:1] == [str(degrees)] for line in out.splitlines())
    # Pushed is the stand with its feet sunk in.
    results, deepest = {}, 0.0
    for name, stance in content.items():
        robot = load(name)
        stand = pa.stance.solve_stand_on_soft_ground(robot)
        results[name] = pa.push_recovery(robot, stand, directions=4, resolution=0.3)
        assert stance["recovery"] == json.loads(results[name].to_json())
        assert stance["stand"] == json.loads(stand.to_json())
        deepest = max(deepest, *stand.depths.values())
    assert f"compensated for contact penetration (at most {1e3 * deepest:.2f} mm)" in out
    push_figure(results, tmp_path / "alike.png")
    np.testing.assert_array_equal(imread(figure), imread(tmp_path / "alike.png"))


def test_a_stand_that_does_not_last_is_exit_status_1(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from pupper_analysis.robot import fall
    from pupper_analysis.simulation import monitor

    for module in (fall, monitor):
        monkeypatch.setattr(module, "FALLEN_TILT", -1.0)
    status, out, _ = run_command(capfd, "push", "original", *COARSE)
    assert status == 1
    assert "COLLAPSES in MuJoCo: it fell over" in out
    assert "it does not stand, so it withstands no push" in out


def test_any_robot_in_any_stance(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    urdf, mjcf = pa.pupper.write_variant("heavy", tmp_path / "robot")
    own = ("--urdf", str(urdf), "--mjcf", str(mjcf))
    feet = [part for foot in ("FL", "FR", "RL", "RR") for part in ("--foot", f"{foot}_foot")]
    stance = (
        "--swing",
        "FL_foot=1cm",
        "--com",
        "inside",
        "--com-margin",
        "1cm",
        "--height",
        "0.15",
    )
    file = tmp_path / "own.json"
    servos = ("--kp", "60", "--kd", "1")
    status, out, err = run_command(
        capfd, "push", *own, *feet, *stance, *servos, *COARSE, "--json", str(file)
    )
    assert status == 0, err
    generator, _, found = json.loads(file.read_text()).values()
    assert generator.startswith("pupper-analysis ")
    robot = load("heavy")
    task = pa.StandTask(height=0.15, swing={"FL": 0.01}, com="inside", com_margin=0.01)
    alike = pa.push_recovery(
        robot,
        pa.stance.solve_stand_on_soft_ground(robot, task),
        directions=4,
        resolution=0.3,
        kp=60.0,
        kd=1.0,
    )
    np.testing.assert_allclose(found["recovery"]["impulses"], alike.impulses, atol=1e-9)
    assert "FL_foot lifted 10 mm" in out


def test_a_variant_and_a_derived_one(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "all.json"
    arguments = ("original", "--leg-scale", "1.2", "--json", str(file))
    status, _, err = run_command(capfd, "push", *arguments, *COARSE)
    assert status == 0, err
    made = ["generator", "provenance", "original", "skeleton-leg1.2-torso1"]
    assert list(json.loads(file.read_text())) == made


BAD = {
    "name and files": (["v3", "--urdf", "a.urdf"], "a.urdf: there is no such file"),
    "no such robot": (["spot"], "'spot'"),
    "too high": (["v3", "--height", "0.3"], "height 191.9 mm"),
    "too few directions": (["v3", "--directions", "2"], "not between 3 and 360"),
    "no resolution": (["v3", "--resolution", "0"], "not positive"),
    "figure in a folder": (["v3", "--figure", "."], "it is a folder"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_exit_status_2(
    case: str, capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments, message = BAD[case]
    monkeypatch.chdir(tmp_path)
    check_refusal(capfd, tmp_path, ["push", *arguments, "--json", "all.json"], message)
