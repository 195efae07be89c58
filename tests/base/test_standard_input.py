"""A model from standard input equals the model of a file in the current folder."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import pytest

from pupper_analysis.base.inputs import STANDARD_INPUT, is_held
from tests.support.commands import run_command
from tests.support.robots import arm, mjcf_text, quadruped, urdf_text

MESH = """solid one
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid one
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def set_input(monkeypatch: pytest.MonkeyPatch):
    def give(data: str | bytes) -> None:
        raw = io.BytesIO(data.encode() if isinstance(data, str) else data)
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(raw))

    return give


def test_meshes_of_standard_input_are_read_from_the_current_folder(capfd, set_input) -> None:
    """The audit reports the mesh until the file exists in the current folder."""
    urdf = urdf_text(arm()).replace(
        "<inertial>",
        '<visual><geometry><mesh filename="one.stl"/></geometry></visual><inertial>',
        1,
    )
    set_input(urdf)
    _, output, _ = run_command(capfd, "audit", "-")
    assert "one.stl" in output
    Path("one.stl").write_text(MESH)
    set_input(urdf)
    _, output, _ = run_command(capfd, "audit", "-")
    assert "one.stl" not in output


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "standard input: the file is empty"),
        (b"<robot>\n<a>\n</robot>", "standard input:3: not well-formed XML"),
        (b"<robot/>", "standard input:1: the robot has no name"),
        (b"<robot name='a'>\n<link name='\xff'/></robot>", "standard input:2: byte 0xff"),
        (b"x" * 20_000_001, "standard input: the file has more than 20 MB"),
        (b"<mujoco>\n<nonsense/></mujoco>", "standard input:2: not a valid MJCF"),
    ],
)
def test_errors_name_standard_input(capfd, set_input, data: bytes, message: str) -> None:
    set_input(data)
    status, _, err = run_command(capfd, "audit", "-")
    assert status == 2
    assert message in err


def test_second_model_from_standard_input_is_refused(capfd, set_input) -> None:
    set_input(urdf_text(arm()))
    status, _, err = run_command(capfd, "crosscheck", "-", "-")
    assert status == 2
    assert "only one model can be read from standard input" in err
    assert not is_held(STANDARD_INPUT)


def test_missing_standard_input_is_refused(capfd, monkeypatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    status, _, err = run_command(capfd, "audit", "-")
    assert status == 2
    assert "standard input cannot be read" in err


def write_results(capfd: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Return exit status and JSON of a command, without the command line and the input files."""
    status, _, err = run_command(capfd, *arguments, "--json", "out.json", "--force")
    assert err == ""
    found = json.loads(Path("out.json").read_text())
    del found["provenance"]
    return status, json.dumps(found)


@pytest.mark.parametrize("suffix", ["urdf", "xml"])
def test_audit_of_standard_input_equals_that_of_the_file(capfd, set_input, suffix: str) -> None:
    text = (urdf_text if suffix == "urdf" else mjcf_text)(arm()).replace('"1.0"', '"0.0001"')
    path = Path(f"robot.{suffix}")
    path.write_text(text)
    of_file = write_results(capfd, "audit", str(path))
    set_input(text)
    of_input = write_results(capfd, "audit", "-")
    assert json.loads(of_input[1])["findings"]
    assert of_input == (of_file[0], of_file[1].replace(str(path), str(STANDARD_INPUT)))


@pytest.mark.parametrize("suffix", ["urdf", "xml"])
def test_crosscheck_of_standard_input_equals_that_of_the_files(
    capfd, set_input, suffix: str
) -> None:
    text = {"urdf": urdf_text(quadruped()), "xml": mjcf_text(quadruped())}
    text["xml"] = text["xml"].replace('mass="0.5"', 'mass="0.6"', 1)
    for name, content in text.items():
        Path(f"robot.{name}").write_text(content)
    names = ["robot.urdf", "robot.xml"]
    of_files = write_results(capfd, "crosscheck", *names)
    set_input(text[suffix])
    typed = ["-" if name.endswith(suffix) else name for name in names]
    status, of_input = write_results(capfd, "crosscheck", *typed)
    assert status == of_files[0]
    assert of_input == of_files[1].replace(f"robot.{suffix}", str(STANDARD_INPUT))


def test_include_of_standard_input_is_read_from_the_current_folder(capfd, set_input) -> None:
    Path("more.xml").write_text('<mujoco><option gravity="0 0 -1"/></mujoco>')
    set_input(mjcf_text(arm()).replace("<worldbody>", '<include file="more.xml"/><worldbody>', 1))
    _, output, err = run_command(capfd, "audit", "-", "-v")
    assert err == ""
    assert "gravity is (0, 0, -1)" in output
    assert "more.xml" in output


def test_file_called_standard_input_is_a_file(capfd) -> None:
    Path("standard input").write_text(urdf_text(arm()))
    status, _, _ = run_command(capfd, "audit", "standard input")
    assert status in (0, 1)


def test_conversion_of_standard_input_equals_that_of_the_file(capfd, set_input) -> None:
    text = urdf_text(arm())
    Path("robot.urdf").write_text(text)
    run_command(capfd, "convert", "robot.urdf", "-o", "one.xml")
    set_input(text)
    status, _, err = run_command(capfd, "convert", "-", "-o", "two.xml")
    assert status in (0, 1), err
    expected = Path("one.xml").read_text().replace("robot.urdf", str(STANDARD_INPUT))
    assert Path("two.xml").read_text() == expected
