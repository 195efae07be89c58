"""What the fuzzer has found stays mended, and the fuzzer finds what it looks for."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click
import pytest
from hypothesis import HealthCheck, given, settings

from pupper_analysis import cli
from tests import fuzz
from tests.support.robots import mjcf_text, quadruped, urdf_text

SEEDS = sorted((Path(fuzz.__file__).parent / "fuzz_seeds").glob("*.json"))


@pytest.mark.parametrize("path", SEEDS, ids=lambda path: path.stem)
def test_seeds_that_once_failed_pass(path: Path) -> None:
    assert fuzz.found_in(fuzz.Case.from_json(path.read_text())) == []


@settings(max_examples=15, suppress_health_check=list(HealthCheck))
@given(fuzz.on_files())
def test_spoilt_files_are_refused(case: fuzz.Case) -> None:
    assert fuzz.found_in(case) == []


def test_a_case_survives_writing() -> None:
    case = fuzz.Case(("audit", "\u202e"), {"robot.xml": b"\xff\x00<a/>", "robot.urdf": b"<r/>"})
    assert fuzz.Case.from_json(case.to_json()) == case


FILES = {
    "robot.urdf": urdf_text(quadruped()).encode(),
    "robot.xml": mjcf_text(quadruped()).encode(),
}


def _found(monkeypatch: pytest.MonkeyPatch, command: object, *arguments: str) -> str:
    """What the fuzzer says of a command that does something wrong."""
    assert callable(command)
    made = click.Command("audit", callback=command, params=[click.Argument(["words"], nargs=-1)])
    group = click.Group("x", commands={"audit": made})
    monkeypatch.setattr(cli, "group", group)
    return "; ".join(fuzz.found_in(fuzz.Case(("audit", *arguments), FILES)))


def test_the_fuzzer_finds_a_planted_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(words: object) -> None:
        raise KeyError("x")

    def acts(words: object) -> None:
        print("a\u009bb")

    def commands(words: object) -> None:
        print("  ::error::owned")

    def destroys(words: object) -> None:
        Path("robot.xml").write_text("")

    def halves(words: object) -> None:
        Path("out.json").write_text('{"a": ')

    def nan(words: object) -> None:
        Path("out.json").write_text(json.dumps({"a": float("nan")}))

    def leaves(words: object) -> None:
        Path(".x.tmp").write_text("")

    def traces(words: object) -> None:
        print("Traceback (most recent call last)", file=sys.stderr)

    for command, expected in (
        (fails, "exit status 3"),
        (acts, r"'\x9b' is shown as it is"),
        (commands, "a line that CI obeys"),
        (destroys, "robot.xml was written to"),
        (halves, "out.json is not whole"),
        (nan, "NaN is in it"),
        (leaves, ".x.tmp was left"),
        (traces, "a traceback"),
    ):
        assert expected in _found(monkeypatch, command)
    assert _found(monkeypatch, lambda words: None) == ""


def test_the_fuzzer_finds_what_mujoco_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    dangling = FILES["robot.xml"].replace(
        b"</worldbody>", b'</worldbody><sensor><gyro site="nowhere"/></sensor>'
    )
    monkeypatch.setitem(FILES, "robot.xml", dangling)
    found = _found(monkeypatch, lambda words: None, "robot.xml")
    assert "accepted, and MuJoCo refuses it" in found
    assert "nowhere" in found


def test_the_fuzzer_finds_what_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    def hangs(words: object) -> None:
        while True:
            pass

    monkeypatch.setattr(fuzz, "SECONDS", -0.8)
    assert "no end within" in _found(monkeypatch, hangs)
