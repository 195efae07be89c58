"""The command `audit`: refusals of invalid input."""

from __future__ import annotations

import pytest

from pupper_analysis import cli
from tests.support.commands import answer
from tests.support.repository import ROOT


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give the URDF or MJCF"),
        (["nowhere.urdf"], "no such file"),
        ([str(ROOT)], "folder"),
        ([str(ROOT / "README.md")], "not well-formed"),
        ([str(ROOT / "urdf" / "pupper_v3.urdf"), "--disable", "frob"], "no rule 'frob'"),
        (
            [str(ROOT / "urdf" / "pupper_v3.urdf"), "--disable", "armature"],
            "no rule 'armature'; did you mean armature-zero? audit --list-rules lists all",
        ),
        ([str(ROOT / "urdf" / "pupper_v3.urdf"), "--package", "x"], "NAME=DIR"),
    ],
)
def test_invalid_input_is_refused_in_one_line(arguments: list[str], message: str) -> None:
    result = answer("audit", *arguments)
    assert result.returncode == cli.EXIT_BAD_INPUT
    assert message in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
