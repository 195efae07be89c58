"""A model from standard input equals the model of a file in the current folder."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from pupper_analysis.base.inputs import STANDARD_INPUT, is_held
from tests.support.commands import run_command
from tests.support.robots import arm, urdf_text

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
def given(monkeypatch: pytest.MonkeyPatch):
    def give(data: str | bytes) -> None:
        raw = io.BytesIO(data.encode() if isinstance(data, str) else data)
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(raw))

    return give


def test_meshes_of_standard_input_are_read_from_the_current_folder(capfd, given) -> None:
    """The audit reports the mesh until the file exists in the current folder."""
    urdf = urdf_text(arm()).replace(
        "<inertial>",
        '<visual><geometry><mesh filename="one.stl"/></geometry></visual><inertial>',
        1,
    )
    given(urdf)
    _, said, _ = run_command(capfd, "audit", "-")
    assert "one.stl" in said
    Path("one.stl").write_text(MESH)
    given(urdf)
    _, said, _ = run_command(capfd, "audit", "-")
    assert "one.stl" not in said


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "standard input: it is empty"),
        (b"<robot>\n<a>\n</robot>", "standard input:3: not well-formed XML"),
        (b"<robot/>", "standard input:1: the robot has no name"),
        (b"<robot name='a'>\n<link name='\xff'/></robot>", "standard input:2: byte 0xff"),
        (b"x" * 20_000_001, "standard input: it has more than 20 MB"),
        (b"<mujoco>\n<nonsense/></mujoco>", "standard input:2: not a valid MJCF"),
    ],
)
def test_errors_name_standard_input(capfd, given, data: bytes, message: str) -> None:
    given(data)
    status, _, err = run_command(capfd, "audit", "-")
    assert status == 2
    assert message in err


def test_second_model_from_standard_input_is_refused(capfd, given) -> None:
    given(urdf_text(arm()))
    status, _, err = run_command(capfd, "crosscheck", "-", "-")
    assert status == 2
    assert "one model alone can come from standard input" in err
    assert not is_held(STANDARD_INPUT)


def test_missing_standard_input_is_refused(capfd, monkeypatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    status, _, err = run_command(capfd, "audit", "-")
    assert status == 2
    assert "standard input cannot be read" in err
