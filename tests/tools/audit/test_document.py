"""The audit's output, and its command."""

from __future__ import annotations

from pathlib import Path

import pytest

from pupper_analysis import cli
from tests.support.commands import Answer, answer
from tests.support.repository import ROOT


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Our URDF with a mass that no body can have, and a limit of one leg that is off."""
    text = (ROOT / "urdf" / "pupper_skeleton.urdf").read_text()
    text = text.replace('<mass value="1.506"/>', '<mass value="-1.506"/>')
    text = text.replace('lower="-2.6"', 'lower="-1.9"', 1)
    path = tmp_path_factory.mktemp("audit") / "broken.urdf"
    path.write_text(text)
    return path


def run(*arguments: str) -> Answer:
    return answer("audit", *arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give the URDF or MJCF"),
        (["nowhere.urdf"], "no such file"),
        ([str(ROOT)], "folder"),
        ([str(ROOT / "README.md")], "not well-formed"),
        ([str(ROOT / "urdf" / "pupper_v3.urdf"), "--disable", "frob"], "no rule 'frob'"),
        ([str(ROOT / "urdf" / "pupper_v3.urdf"), "--package", "x"], "NAME=VALUE"),
    ],
)
def test_bad_input_is_one_line(arguments: list[str], message: str) -> None:
    result = run(*arguments)
    assert result.returncode == cli.BAD_INPUT
    assert message in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
