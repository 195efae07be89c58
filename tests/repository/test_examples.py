"""Each example runs, is short, and prints the lines that its docstring describes."""

from __future__ import annotations

import ast
import csv
import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from tests.support.repository import ROOT
from tests.support.variants import load, stand_of

EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(path.stem for path in EXAMPLES.glob("*.py"))
V3 = ROOT / "urdf" / "pupper_v3.urdf"

SEEN: dict[str, tuple[tuple[object, ...], object, tuple[str, ...]]] = {
    "audit_in_ci": ((V3,), 0, (f"{V3}: passed",)),
    "compare_legs": ((), None, (r"^ +0\.8", r"^ +1\.6")),
    "contract": (
        (),
        None,
        (
            r"default angle of joint leg_back_l_3: 0\.52 rad in policy\.json, 0\.82 rad",
            r"0\.25 N m s/rad in policy\.json, 0\.1 ",
        ),
    ),
    "cross_check": (
        (),
        None,
        (
            "as written: agree = True",
            "with a slip: agree = False",
            r"mass 1\.6566 kg in the URDF, 1\.506 kg in the MJCF",
            r"heavier\.urdf:\d+ .*original\.xml:\d+$",
            "explained: 100%",
        ),
    ),
    "hot_motors": (
        (),
        None,
        (
            r"payload 0 kg: all motors \d+\.\d W, leg_\w+_3 settles at \d+\.\d degC",
            r"payload 2 kg: all motors",
        ),
    ),
    "own_robot": ((), None, ("holds in MuJoCo: True",)),
    "path_to_csv": ((), None, ("zero-moment point:",)),
    "payload": (
        (),
        None,
        (
            r"^motors +16\.\d\d kg: a motor saturates$",
            r"^servos +6\.0\d kg: ",
            r"^limit +6\.0\d kg, by the servos$",
            r"^half of it takes 3\d% of the motors$",
        ),
    ),
    "pink_and_mink": ((), None, (r"^Pink: \de-(09|1\d) rad", r"^Mink: \de-(09|1\d) rad")),
    # Left and right are equal; the weakest is that of 180 deg.
    "push": (
        (),
        None,
        (
            r"^ +0 deg: 2\.\d\d N s \(2\.46 if rigid\), then: \S",
            r"^ +90 deg: (\S+) N s \((\S+) if rigid\)(.*\n)+ 270 deg: \1 N s \(\2 if rigid\)",
            r"^ 180 deg: (\S+) N s \(2\.46 if rigid\)(.*\n)+weakest: \1 N s$",
        ),
    ),
    "reach": (
        (),
        None,
        (
            r"^AxisAlignTask base_link +\de-(09|1\d) \de-(09|1\d)$",
            r"largest straight push of FR: 5\d\.\d N",
            r"the task PositionTask base_link misses its target by 0\.2\d* m; conflicting tasks: ",
        ),
    ),
    "reach_with_arm": (
        (),
        None,
        (r"^largest motor load 0\.\d\d N m, holds in MuJoCo: True$",),
    ),
    "slope_and_swing": ((), None, (r"out of reach; possible: .*roll 19\.\d",)),
    "steady_state": ((), None, (r"lost in the servos", "minimum stiffness")),
    "walk": (
        (),
        None,
        (
            r"commanded 0\.0 m/s: -?0\.00 m/s, tracks: True",
            r"commanded 0\.5 m/s: -?0\.0\d m/s, tracks: False",
        ),
    ),
}
"""{example: (arguments, exit status, printed lines)}."""


def find_number(pattern: str, text: str) -> float:
    """Return the number in a text that follows a pattern."""
    found = re.search(pattern + r"\s*(-?[\d.]+)", text)
    assert found is not None, f"no {pattern!r} in {text}"
    return float(found[1])


def check_legs(text: str) -> None:
    """Height and torque of v3, and their growth as the docstring states it."""
    rows = re.findall(r"^ +([\d.]+) +([\d.]+) +([\d.]+) +([\d.]+)%$", text, re.M)
    table, robot = np.array(rows, dtype=float), load("v3")
    np.testing.assert_allclose(table[:, 0], [0.8, 1.0, 1.2, 1.4, 1.6])
    statics = pa.stance.stand_statics(robot, pa.stance.solve_stand_as_simulated(robot))
    expected = [1.0, robot.stand_height, abs(statics.joint_torques).max()]
    np.testing.assert_allclose(table[1, :3], expected, atol=6e-4)
    assert table[1, 3] == pytest.approx(100 * statics.motor_utilisation.max(), abs=0.06)
    np.testing.assert_allclose((table[-1] / table[0])[1:3], [1.82, 2.09], atol=0.01)


def check_contract(text: str) -> None:
    assert find_number(r"0\.25 N m s/rad in policy\.json,", text) == 0.1  # kd of the MJCF
    assert find_number("policy.json: base", text) < find_number("walker: base", text)


def check_own_robot(text: str) -> None:
    robot = pa.load_variant(pa.pupper.VariantSpec(base="v3", leg_scale=1.1))
    statics = pa.stance.stand_statics(robot, pa.solve_stand(robot))
    assert find_number(f"{robot.name}:", text) == pytest.approx(robot.total_mass, abs=5e-4)
    for joint, torque in zip(robot.joint_names, statics.joint_torques, strict=True):
        printed = re.search(rf"^{joint} +([+-][\d.]+) N m$", text, re.M)
        assert printed is not None
        assert float(printed[1]) == pytest.approx(torque, abs=6e-4)


def check_path(text: str) -> None:
    """Check that the path begins with the torques of the stand, and bound the ZMP margin."""
    robot = load("v3")
    with Path("squat.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    joints = robot.joint_names
    assert header == [
        "time (s)",
        *(f"q {joint} (rad)" for joint in joints),
        *(f"tau {joint} (N m)" for joint in joints),
    ]
    table = np.array(rows, dtype=float)
    assert len(table) == find_number("", text)
    assert table[-1, 0] == 2.0
    statics = pa.stance.stand_statics(robot, stand_of("v3"))
    np.testing.assert_allclose(table[0, 13:], statics.joint_torques, atol=1e-6)
    used = abs(table[:, 13:]) / robot.effort_limits
    assert find_number("motors:", text) == pytest.approx(100 * used.max(), abs=0.06)
    assert statics.com_margin is not None
    assert 0 < find_number("zero-moment point:", text) <= 1e3 * statics.com_margin + 0.1


def check_slope(text: str) -> None:
    """Check that three feet carry the weight; vertical forces use tan(5 deg) / mu of friction."""
    robot = load("v3")
    carried = re.findall(r"^(\w+) carries +([\d.]+) N and uses (\d+)% of its friction$", text, re.M)
    assert {foot for foot, _, _ in carried} == {"FR", "RR", "RL"}
    weight = 9.81 * robot.total_mass
    assert sum(float(force) for _, force, _ in carried) == pytest.approx(weight, abs=0.02)
    share = 100 * np.tan(np.radians(5)) / robot.contacts["FR"].sliding_friction
    assert [int(used) for _, _, used in carried] == [round(share)] * 3
    assert find_number("the com is", text) >= 10


def check_steady_state(text: str) -> None:
    """Check the sum of the losses; dry friction in the simulation is not in the prediction."""
    commanded, predicted = find_number("commanded", text), find_number("predicted", text)
    lost = find_number("lost in the servos", text) + find_number("lost in the ground", text)
    assert commanded == pytest.approx(1e3 * load("v3").stand_height, abs=6e-3)
    assert commanded - predicted == pytest.approx(lost, abs=0.02)
    assert find_number("simulated", text) == pytest.approx(predicted, abs=0.3)
    assert 0 < find_number("minimum stiffness", text) < 5


def check_walk(text: str) -> None:
    """Check that a knee torque equals the static torque within 30 %, because the stand sags."""
    torques = pa.stance.stand_statics(load("v3"), stand_of("v3")).joint_torques
    assert find_number("leg_front_r_3:", text) == pytest.approx(abs(torques[2]), rel=0.3)


CHECKS: dict[str, Callable[[str], None]] = {
    "compare_legs": check_legs,
    "contract": check_contract,
    "own_robot": check_own_robot,
    "path_to_csv": check_path,
    "slope_and_swing": check_slope,
    "steady_state": check_steady_state,
    "walk": check_walk,
}
"""{example: function that compares its printed numbers with those of the package}."""


class Shown:
    """Function that runs an example with arguments and returns the printed text."""

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
def shown(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Shown:
    monkeypatch.chdir(tmp_path)  # examples may write into the folder in which they run
    return Shown(capsys, monkeypatch)


def test_every_example_is_run_here_and_in_the_list() -> None:
    readme = (EXAMPLES / "README.md").read_text()
    listed = re.findall(r"^\| \[(\w+)\.py\]\(\1\.py\) \|", readme, re.M)
    assert sorted(listed) == sorted(SEEN) == SCRIPTS


@pytest.mark.slow
@pytest.mark.parametrize("name", SEEN)
def test_example_is_short_and_prints_the_stated_lines(name: str, shown: Shown) -> None:
    code = (EXAMPLES / f"{name}.py").read_text()
    assert len(code.splitlines()) < 40
    assert "The output shows" in (ast.get_docstring(ast.parse(code)) or "")
    if name == "pink_and_mink":
        pytest.importorskip("pink")
        pytest.importorskip("mink")
    arguments, status, lines = SEEN[name]
    text = shown(name, *arguments)
    assert shown.status == status
    for line in lines:
        assert re.search(line, text, re.M), (line, text)
    if name == "cross_check":
        assert text.count(" in the URDF, ") == 1
    if name in CHECKS:
        CHECKS[name](text)


def test_example_of_audit_in_ci_annotates_the_faulty_line(shown: Shown, tmp_path: Path) -> None:
    bad = tmp_path / "bad.urdf"
    bad.write_text(re.sub(r'(<mass value=)"[^"]*"', r'\1"-1"', V3.read_text(), count=1))
    text = shown("audit_in_ci", V3, bad)
    assert shown.status == 1
    assert re.search(rf"^::error file={bad},line=\d+::.*-1 kg", text, re.M)
