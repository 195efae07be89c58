"""Each example runs, is short, and prints the lines that its docstring describes."""

from __future__ import annotations

import ast
import re
import runpy
import sys
from pathlib import Path

import pytest

from tests.support.repository import ROOT

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
            r"the task PositionTask base_link misses its target by 0\.2\d* m$",
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


def test_example_of_audit_in_ci_annotates_the_faulty_line(shown: Shown, tmp_path: Path) -> None:
    bad = tmp_path / "bad.urdf"
    bad.write_text(re.sub(r'(<mass value=)"[^"]*"', r'\1"-1"', V3.read_text(), count=1))
    text = shown("audit_in_ci", V3, bad)
    assert shown.status == 1
    assert re.search(rf"^::error file={bad},line=\d+::.*-1 kg", text, re.M)
