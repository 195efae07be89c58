"""What CI leaves out is found, and what was skipped is said with how to have it."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace as Stub

import pytest

from tests.support import durations, ran

ALL = ["= tests/a.py::one[x y]", "= tests/a.py::two", "= tests/b.py::three"]


def checked(tmp_path: Path, *lines: str) -> int:
    file = tmp_path / "ran"
    file.write_text("\n".join([*ALL, *lines]))
    return ran.main(str(file))


def test_what_passed_in_no_run_fails_by_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    some = ["- tests/a.py::one[x y]\tno chromium", "+ tests/a.py::two"]
    assert checked(tmp_path, *some, "+ tests/a.py::one[x y]", "+ tests/b.py::three") == 0
    assert capsys.readouterr().out == "3 of 3 tests ran and passed at least once\n"
    assert checked(tmp_path, *some, "+ tests/a.py::one[x y]") == 1
    assert "NEVER RUN: tests/b.py::three: no stage has it" in capsys.readouterr().out
    assert ran.main(str(_empty(tmp_path))) == 1


def _empty(tmp_path: Path) -> Path:
    (tmp_path / "none").write_text("")
    return tmp_path / "none"


def test_what_the_machine_lacks_is_said_loudly_and_what_ci_could_have_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    passed = ["+ tests/a.py::two", "+ tests/b.py::three"]
    assert checked(tmp_path, *passed, "- tests/a.py::one[x y]\tno chromium") == 0
    assert "NOT RUN: 1 tests: no chromium; to have them: make browser" in capsys.readouterr().out
    assert checked(tmp_path, *passed, "- tests/a.py::one[x y]\tmjlab is not there") == 1
    assert "NEVER RUN: tests/a.py::one[x y]: mjlab is not there" in capsys.readouterr().out


def test_stages_write_what_they_collect_pass_and_skip(tmp_path: Path) -> None:
    file = tmp_path / "ran"
    one = ran.Ran(file, Stub(), everything=True)  # type: ignore[arg-type]
    marks = {"tests/a.py::two": "longest"}
    one.collected(
        [
            Stub(nodeid=name, get_closest_marker=lambda mark, name=name: marks.get(name) == mark)
            for name in ("tests/a.py::one", "tests/a.py::two")
        ]  # type: ignore[arg-type]
    )
    told = {"passed": False, "skipped": False, "nodeid": "tests/a.py::one", "when": "call"}
    skipped = Stub(**told | {"when": "setup", "skipped": True, "longrepr": ("f", 1, "Skipped: no")})
    one.pytest_runtest_logreport(skipped)
    one.pytest_runtest_logreport(Stub(**told))  # it failed
    assert ran.never_ran(file.read_text().splitlines()) == (1, {"tests/a.py::one": "no"})
    one.pytest_runtest_logreport(Stub(**told | {"passed": True}))
    assert ran.never_ran(file.read_text().splitlines()) == (1, {})


def test_what_was_skipped_is_counted_by_its_reason() -> None:
    reports = [Stub(longrepr=("f.py", 3, f"Skipped: {why}")) for why in ("no chromium", "no luck")]
    assert ran.summary_lines([*reports, reports[0]]) == [
        "2 skipped: no chromium; to have it: make browser",
        "1 skipped: no luck",
    ]


def test_what_is_not_recorded_and_takes_long_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(durations, "recorded", lambda: {"tests/a.py": {"known": 9.0}})

    def run(name: str, *marks: str, seconds: float = 0.1) -> object:
        call = durations.Limit(0.05).pytest_runtest_call(
            Stub(nodeid=f"tests/a.py::{name}[x]", get_closest_marker=lambda mark: mark in marks)  # type: ignore[arg-type]
        )
        next(call)
        end = time.process_time() + seconds
        while time.process_time() < end:
            pass
        with pytest.raises(StopIteration) as done:
            call.send("result")
        return done.value.value

    assert run("known") == run("new", "slow") == run("new", seconds=0.0) == "result"
    with pytest.raises(pytest.fail.Exception, match=r"--record-durations tests/a\.py::new"):
        run("new")
