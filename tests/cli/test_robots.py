"""Selection of the robot by the first arguments of a command."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest

from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.cli import robots
from pupper_analysis.cli.robots import RobotOptions, name_uniquely
from pupper_analysis.prepare.convert.files import RobotFiles
from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.pupper.variants import find_model_folder
from tests.support.commands import answer, check_refusal, run_command

URDF, MJCF = (
    find_model_folder("urdf") / "pupper_v3.urdf",
    find_model_folder("mjcf") / "pupper_v3.xml",
)
NOTHING = RobotOptions.pop_from({})


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
        (("a.urdf", "b.xml", "a.urdf", "b.xml"), ("a.urdf", "b.xml")),
        (("a.urdf+b.xml", "a.urdf", "b.xml"), ("a.urdf", "b.xml")),
    ],
)
def test_words_name_a_robot(words: tuple[str, ...], meant: object) -> None:
    found = NOTHING.select_robot(words)
    assert (found.models if isinstance(found, RobotFiles) else found) == meant


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("a.urdf a.xml", ["a.urdf+a.xml"]),
        ("a.xml a.urdf", ["a.urdf+a.xml"]),
        ("a.urdf a.xml b.urdf b.xml", ["a.urdf+a.xml", "b.urdf+b.xml"]),
        ("a.urdf b.urdf b.xml c.xml", ["a.urdf", "b.urdf+b.xml", "c.xml"]),
        ("a.xml b.urdf v3", ["a.xml", "b.urdf", "v3"]),
        ("v3 c.urdf+c.xml v3", ["v3", "c.urdf+c.xml"]),
        ("a.urdf a.xml b.urdf a.xml", ["a.urdf+a.xml", "b.urdf+a.xml"]),
    ],
)
def test_urdf_and_neighbouring_mjcf_are_one_robot(words: str, meant: list[str]) -> None:
    """Also for commands that accept one robot."""
    found = NOTHING.select_robots(tuple(words.split()))
    names = [
        sorted(selection.models) if isinstance(selection, RobotFiles) else [selection]
        for selection in found
    ]
    assert names == [sorted(name.split("+")) for name in meant]
    if len(meant) == 1:
        assert NOTHING.select_robot(tuple(words.split())) == found[0]


def test_xml_format_is_determined_by_the_content(tmp_path: Path) -> None:
    first, second = tmp_path / "a.xml", tmp_path / "b.xml"
    first.write_text('<?xml version="1.0"?><robot name="a"/>')
    second.write_text("<mujoco/>")
    assert len(NOTHING.select_robots((str(first), str(second)))) == 1
    assert len(NOTHING.select_robots((str(first), str(first.with_name("c.urdf")), "v3"))) == 3


def test_robots_with_equal_names_get_unique_names() -> None:
    robot = load_variant("v3")
    meant = [RobotFiles((name,), {}) for name in ("a.urdf", "b.xml", "b.xml")]
    names = [renamed.name for renamed in name_uniquely([*meant, "v3"], [robot] * 4)]
    assert names == ["a.urdf", "b.xml", "b.xml 2", "v3"]
    paths = ("x/y/a.urdf", "x/z/a.urdf", "b.xml")
    meant = [RobotFiles((path,), {}) for path in paths]
    named = [replace(robot, name=str(files)) for files in meant]
    assert [renamed.name for renamed in name_uniquely(meant, named)] == [
        "y/a.urdf",
        "z/a.urdf",
        "b.xml",
    ]


@pytest.mark.slow
def test_robot_keeps_the_typed_name_with_payload_and_contacts(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """The robot is rebuilt for a payload and for a wall; the files state the name pupper_v3."""
    options = ("--payload", "0.2kg", "--contact", "leg_front_r_3=weld", "-v")
    _, out, _ = run_command(capfd, "stand", str(MJCF), *options)
    assert f"{MJCF.name} + 0.2 kg: " in out.partition("\n")[0]


@pytest.mark.parametrize(
    ("words", "options", "message"),
    [
        (("v3", "original"), {}, "are several robots"),
        (("a.urdf", "v3"), {}, "are several robots"),
        (("a.urdf", "b.xml", "c.xml"), {}, "are several robots"),
        (("nobody",), {}, "name 'nobody' is not valid; known variants"),
        (("v3",), {"base": "v3"}, "the robot is specified more than once"),
        (("a.urdf",), {"mjcf": Path("a.xml")}, "the robot is specified more than once"),
        (("v3",), {"keyframe": "home"}, "--keyframe applies only to files"),
        ((), {"take": "urdf", "feet": ("FL",)}, "--take and --foot apply only to files"),
    ],
)
def test_none_or_two_robots_are_refused(
    words: tuple[str, ...], options: dict[str, object], message: str
) -> None:
    with pytest.raises(PupperAnalysisError, match=message):
        RobotOptions.pop_from(dict(options)).select_robot(words)


@pytest.mark.slow
@pytest.mark.parametrize("file", [URDF, MJCF], ids=["urdf", "mjcf"])
def test_stand_of_one_file_converts_the_other_in_memory(
    capfd: pytest.CaptureFixture[str], file: Path
) -> None:
    status, out, _ = run_command(capfd, "stand", str(file), "-v")
    assert status == 0
    given, made = ("URDF", "MJCF") if file is URDF else ("MJCF", "URDF")
    # The servos that are added to the URDF have more damping than a 500 Hz PD allows.
    servos = "; ideal servos" if file is URDF else ""
    assert out.startswith(f"HOLDS ({given} only{servos}) {file.name}: ")
    assert f"the {made} was converted from {file.name} in memory" in out.replace("\n", " ")


@pytest.mark.slow
def test_robot_is_read_from_standard_input(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(URDF.read_bytes())))
    status, out, err = run_command(capfd, "stand", "--explain", "-")
    assert status == 0, err
    assert "was converted from standard input in memory" in out.replace("\n", " ")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("stand --explain", "3.170 kg, free base, 12 joints, feet leg_front_r_3, leg_front_l_3"),
        ("live --mujoco --headless", "nq=19"),
        ("live --drop --headless", "(limit 5 mm)"),
    ],
)
def test_modes_without_a_stance_accept_one_file(
    capfd: pytest.CaptureFixture[str], line: str, text: str
) -> None:
    """Reference: mass [kg], feet and number of coordinates of v3."""
    status, out, err = run_command(capfd, *line.split(), str(MJCF))
    assert status == 0, err
    assert text in out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["analyze", "a.urdf", "--write", "out"], "only variants are written"),
        (["stand", "nowhere.urdf"], "nowhere.urdf: there is no such file"),
        (["payload", "a.xml", "--map", "noequals"], "URDF=MJCF"),
    ],
)
def test_invalid_input_is_refused_in_one_line(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], message: str
) -> None:
    check_refusal(capfd, tmp_path, arguments, message)


@pytest.mark.parametrize(
    "arguments",
    [
        ("stand",),
        ("gains",),
        ("heat", "--motor", "mit-mini-cheetah"),
        ("walk", "--policy", "policy.json"),
        ("analyze", "--no-figures"),
    ],
)
def test_visual_meshes_are_converted_only_if_the_robot_is_drawn(
    arguments: tuple[str, ...], tmp_path: Path
) -> None:
    """A conversion takes seconds of processor. The command ends when it loads the robot."""
    (tmp_path / "robot.urdf").write_text("<robot name='robot'/>")
    (tmp_path / "policy.json").write_text("{}")
    command, *options = arguments
    for more, is_drawn in (((), False), (("--report", "page.html"), True)):
        with mock.patch.object(robots, "load_files", side_effect=SystemExit(2)) as load:
            answer(command, "robot.urdf", *options, *more, folder=tmp_path)
        assert load.call_args.kwargs["visuals"] is is_drawn
