"""Each example runs, is short, and shows what its docstring says that one sees."""

from __future__ import annotations

import ast
import csv
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from tests.support.repository import ROOT
from tests.support.variants import load, stand_of

EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(path.stem for path in EXAMPLES.glob("*.py"))


@pytest.fixture(autouse=True)
def elsewhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Examples may write into the folder in which they run."""
    monkeypatch.chdir(tmp_path)


class Shown:
    """Runs an example as its user does, and returns what it prints."""

    def __init__(self, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
        self._capsys, self._monkeypatch = capsys, monkeypatch
        self.status: object = None

    def __call__(self, name: str, *arguments: object) -> str:
        script = str(EXAMPLES / f"{name}.py")
        self._monkeypatch.setattr(sys, "argv", [script, *map(str, arguments)])
        try:
            runpy.run_path(script, run_name="__main__")
        except SystemExit as stop:
            self.status = stop.code
        return self._capsys.readouterr().out


@pytest.fixture
def shown(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Shown:
    return Shown(capsys, monkeypatch)


def number(pattern: str, text: str) -> float:
    """The number in a text that follows a pattern."""
    found = re.search(pattern + r"\s*(-?[\d.]+)", text)
    assert found is not None, f"no {pattern!r} in {text}"
    return float(found[1])


@pytest.mark.parametrize("name", SCRIPTS)
def test_is_short_and_tells_what_one_sees(name: str) -> None:
    text = (EXAMPLES / f"{name}.py").read_text()
    assert len(text.splitlines()) < 40
    assert "One sees" in (ast.get_docstring(ast.parse(text)) or "")


def test_every_example_is_run_here_and_in_the_list() -> None:
    run = set(re.findall(r"shown\(\"(\w+)\"", Path(__file__).read_text()))
    assert run == set(SCRIPTS)
    listed = re.findall(
        r"^\| \[(\w+)\.py\]\(\1\.py\) \|", (EXAMPLES / "README.md").read_text(), re.M
    )
    assert sorted(listed) == SCRIPTS


def test_example_own_robot_runs(shown: Shown) -> None:
    text = shown("own_robot")
    robot = pa.load_variant(pa.pupper.VariantSpec(base="v3", leg_scale=1.1))
    held = pa.stance.stand_statics(robot, pa.solve_stand(robot))
    assert number(f"{robot.name}:", text) == pytest.approx(robot.total_mass, abs=5e-4)
    for joint, torque in zip(robot.joint_names, held.joint_torques, strict=True):
        printed = re.search(rf"^{joint} +([+-][\d.]+) N m$", text, re.M)
        assert printed is not None
        assert float(printed[1]) == pytest.approx(torque, abs=6e-4)
    assert "holds in MuJoCo: True" in text


def test_example_compare_legs_runs(shown: Shown) -> None:
    rows = re.findall(r"^ +([\d.]+) +([\d.]+) +([\d.]+) +([\d.]+)%$", shown("compare_legs"), re.M)
    table = np.array(rows, dtype=float)
    np.testing.assert_allclose(table[:, 0], [0.8, 1.0, 1.2, 1.4, 1.6])
    of_v3 = pa.stance.stand_statics(load("v3"), pa.stance.solve_stand_as_simulated(load("v3")))
    expected = [1.0, load("v3").stand_height, abs(of_v3.joint_torques).max()]
    np.testing.assert_allclose(table[1, :3], expected, atol=6e-4)
    assert table[1, 3] == pytest.approx(100 * of_v3.motor_utilisation.max(), abs=0.06)
    rise, torque = (table[-1] / table[0])[1:3]  # what the docstring says
    assert rise == pytest.approx(1.82, abs=0.01)
    assert torque == pytest.approx(2.09, abs=0.01)


def test_example_push_runs(shown: Shown) -> None:
    text = shown("push")
    rows = re.findall(r"(\d+) deg: ([\d.]+) N s \(([\d.]+) if rigid\), then: \S", text)
    table = np.array(rows, dtype=float)
    np.testing.assert_array_equal(table[:, 0], [0, 90, 180, 270])
    # Left and right are each other's mirror image; found to the resolution asked for.
    assert table[1, 1] == pytest.approx(table[3, 1], abs=0.1)
    assert (table[:, 1] < table[:, 2]).all()
    assert number("weakest:", text) == table[:, 1].min()


def test_path_to_csv(shown: Shown, tmp_path: Path) -> None:
    text = shown("path_to_csv")
    with (tmp_path / "squat.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    joints = load("v3").joint_names
    assert header[0] == "time (s)"
    assert header[1:13] == [f"q {joint} (rad)" for joint in joints]
    assert header[13:] == [f"tau {joint} (N m)" for joint in joints]
    table = np.array(rows, dtype=float)
    assert len(table) == number("", text)
    assert table[-1, 0] == 2.0
    still = pa.stance.stand_statics(load("v3"), stand_of("v3"))
    np.testing.assert_allclose(table[0, 13:], still.joint_torques, atol=1e-6)
    used = abs(table[:, 13:]) / load("v3").effort_limits
    assert number("motors:", text) == pytest.approx(100 * used.max(), abs=0.06)
    # The least is where the robot is at rest, or nearly: the com is then above it.
    assert still.com_margin is not None
    assert 0 < number("zero-moment point:", text) <= 1e3 * still.com_margin + 0.1


def test_audit_in_ci(shown: Shown, tmp_path: Path) -> None:
    good = ROOT / "urdf" / "pupper_v3.urdf"
    text = shown("audit_in_ci", good)
    assert shown.status == 0
    assert f"{good}: passed" in text
    bad = tmp_path / "bad.urdf"
    lines = good.read_text().splitlines()
    line = next(i for i, line in enumerate(lines) if "<mass value=" in line)
    lines[line] = re.sub(r'value="[^"]*"', 'value="-1"', lines[line])
    bad.write_text("\n".join(lines))
    text = shown("audit_in_ci", good, bad)
    assert shown.status == 1
    assert re.search(rf"^::error file={bad},line=\d+::.*-1 kg", text, re.M)
    assert f"{bad}: FAILED" in text


def test_example_cross_check_runs(shown: Shown) -> None:
    text = shown("cross_check")
    assert "as written: agree = True" in text
    assert "with a slip: agree = False" in text
    assert re.search(r"mass 1\.6566 kg in the URDF, 1\.506 kg in the MJCF", text)
    assert re.search(r"heavier\.urdf:\d+ .*original\.xml:\d+$", text, re.M)
    assert text.count(" in the URDF, ") == 1
    assert "explained: 100%" in text


def test_example_contract_runs(shown: Shown) -> None:
    text = shown("contract")
    assert "default angle of joint leg_back_l_3: 0.52 rad in policy.json, 0.82 rad" in text
    assert number("0.25 N m s/rad in policy.json,", text) == 0.1  # the MJCF's kd
    assert number("policy.json: base", text) < number("walker: base", text)


def test_example_walk_runs(shown: Shown) -> None:
    text = shown("walk")
    assert re.search(r"commanded 0\.0 m/s: -?0\.00 m/s, tracks: True", text)
    assert re.search(r"commanded 0\.5 m/s: -?0\.0\d m/s, tracks: False", text)
    # A knee holds in a stand what statics say, to some per cent: the pose sags.
    held = pa.stance.stand_statics(load("v3"), stand_of("v3")).joint_torques
    assert number("leg_front_r_3:", text) == pytest.approx(abs(held[2]), rel=0.3)


def test_example_payload_runs(shown: Shown) -> None:
    text = shown("payload")
    robot, mass = load("v3"), number("limit", text)
    assert number("servos", text) == mass
    assert "by the servos" in text
    assert mass == pytest.approx(5.4, abs=0.05)  # what the docstring says, as the next one
    assert number("motors", text) == pytest.approx(16, abs=0.5)
    loaded = pa.robot.with_payload(robot, mass / 2, (0.0, 0.0, 0.08))
    used = pa.stance.stand_statics(
        loaded, pa.stance.solve_stand_as_simulated(loaded)
    ).motor_utilisation.max()
    assert number("half of it takes", text) == pytest.approx(100 * used, abs=0.6)


def test_slope_and_swing(shown: Shown) -> None:
    text = shown("slope_and_swing")
    carried = re.findall(r"^(\w+) carries +([\d.]+) N and uses (\d+)% of its friction$", text, re.M)
    assert {foot for foot, _, _ in carried} == {"FR", "RR", "RL"}
    weight = 9.81 * load("v3").total_mass
    assert sum(float(force) for _, force, _ in carried) == pytest.approx(weight, abs=0.02)
    # Forces straight up, on a slope: their tangential share is its slope, whatever the load.
    friction = load("v3").contacts["FR"].sliding_friction
    share = 100 * np.tan(np.radians(5)) / friction
    assert [int(used) for _, _, used in carried] == [round(share)] * 3
    assert number("the com is", text) >= 10
    assert re.search(r"out of reach; possible: .*roll 19\.\d", text)


def test_example_steady_state_runs(shown: Shown) -> None:
    text = shown("steady_state")
    commanded, predicted = number("commanded", text), number("predicted", text)
    lost = number("lost in the servos", text), number("lost in the ground", text)
    assert commanded == pytest.approx(1e3 * load("v3").stand_height, abs=6e-3)
    assert commanded - predicted == pytest.approx(sum(lost), abs=0.02)
    # What is between them is dry friction, which the prediction leaves out.
    assert number("simulated", text) == pytest.approx(predicted, abs=0.3)
    assert 0 < number("minimum stiffness", text) < 5
