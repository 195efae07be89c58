"""Which robot a command is about: its first argument."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from pupper_analysis.cli.robots import RobotOptions
from pupper_analysis.convert.files import RobotFiles
from pupper_analysis.errors import PupperAnalysisError
from pupper_analysis.pupper.variants import model_folder
from tests.support.commands import check_refusal, run_command

URDF, MJCF = model_folder("urdf") / "pupper_v3.urdf", model_folder("mjcf") / "pupper_v3.xml"
NOTHING = RobotOptions.taken_from({})


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ((), None),
        (("v3",), "v3"),
        (("a.urdf",), ("a.urdf",)),
        (("a.urdf", "b.xml"), ("a.urdf", "b.xml")),
        (("a.urdf+b.xml",), ("a.urdf", "b.xml")),
        (("robot_descriptions:go2_description",), ("robot_descriptions:go2_description",)),
        (("folder/robot",), ("folder/robot",)),
        (("v3", "v3"), "v3"),
    ],
)
def test_words_name_a_robot(words: tuple[str, ...], meant: object) -> None:
    found = NOTHING.one(words)
    assert (found.models if isinstance(found, RobotFiles) else found) == meant


def test_where_several_are_named_each_word_is_one() -> None:
    found = NOTHING.all(("a.urdf", "b.xml", "v3", "c.urdf+c.xml"))
    assert [str(robot) for robot in found] == ["a.urdf", "b.xml", "v3", "c.urdf+c.xml"]


@pytest.mark.parametrize(
    ("words", "options", "message"),
    [
        (("v3", "original"), {}, "are several robots"),
        (("a.urdf", "v3"), {}, "are several robots"),
        (("a.urdf", "b.xml", "c.xml"), {}, "are several robots"),
        (("spot",), {}, "name 'spot' is not valid; known variants"),
        (("v3",), {"base": "v3"}, "give the robot once"),
        (("a.urdf",), {"mjcf": Path("a.xml")}, "give the robot once"),
        (("v3",), {"keyframe": "home"}, "are for a robot of your own"),
        ((), {"take": "urdf"}, "are for a robot of your own"),
    ],
)
def test_what_names_no_robot_or_two_is_refused(
    words: tuple[str, ...], options: dict[str, object], message: str
) -> None:
    with pytest.raises(PupperAnalysisError, match=message):
        RobotOptions.taken_from(dict(options)).one(words)


@pytest.mark.slow
@pytest.mark.parametrize("file", [URDF, MJCF], ids=["urdf", "mjcf"])
def test_one_file_is_enough_to_stand(capfd: pytest.CaptureFixture[str], file: Path) -> None:
    status, out, _ = run_command(capfd, "stand", str(file))
    assert status == 0
    assert "HOLDS (from one file) in MuJoCo for 12 s" in out
    made = "MJCF" if file is URDF else "URDF"
    assert f"the {made} was made of {file.name} in memory" in out.replace("\n", " ")


@pytest.mark.slow
def test_robots_of_files_stand_beside_variants(capfd: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run_command(capfd, "analyze", str(MJCF), "original", "--no-figures")
    assert status == 0
    verdicts = [line for line in out.splitlines() if line.startswith("VERIFIED")]
    assert "(from one file)" in verdicts[0]
    assert "one file" not in verdicts[1]
    assert "2 of 2 verified" in out


@pytest.mark.parametrize("command", ["load", "view", "drop"])
def test_commands_that_had_variants_or_two_files_alone(
    capfd: pytest.CaptureFixture[str], command: str
) -> None:
    headless = [] if command == "load" else ["--headless"]
    status, out, _ = run_command(capfd, command, str(MJCF), *headless)
    assert status == 0
    assert {"load": "4 feet", "view": "nq=19", "drop": "stable)"}[command] in out


def test_standard_input_is_a_robot(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = io.BytesIO(URDF.read_bytes())
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(text))
    status, out, _ = run_command(capfd, "load", "-")
    assert status == 0
    assert "was made of standard input in memory" in out.replace("\n", " ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["load", "v3"], "give a robot of your own"),
        (["analyze", "a.urdf", "--write", "out"], "it writes variants"),
        (["stand", "nowhere.urdf"], "nowhere.urdf: there is no such file"),
        (["push", "a.xml", "--map", "noequals"], "NAME=VALUE"),
    ],
)
def test_bad_input_is_one_line_and_exit_status_2(
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    check_refusal(capfd, tmp_path, arguments, message)
