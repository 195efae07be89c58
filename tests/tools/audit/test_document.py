"""The audit's output, and its command."""

from __future__ import annotations

from pathlib import Path

import pytest

from pupper_analysis import cli
from pupper_analysis.tools.audit.audit import RULES
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


def test_prints_place_rule_reason_and_remedy(broken: Path) -> None:
    result = run(str(broken))
    assert result.returncode == 1
    line = broken.read_text().splitlines().index('      <mass value="-1.506"/>') + 1
    assert "1. error mass-not-positive link 'base_link': its mass" in result.stdout
    assert f"   {broken}:{line}\n" in result.stdout
    assert RULES["mass-not-positive"].todo in result.stdout
    assert "mirror-limits" in result.stdout
    assert result.stdout.startswith("ERRORS broken.urdf: 1 error, ")


def test_what_has_warnings_is_not_called_sound(broken: Path) -> None:
    result = run(str(broken), "--disable", "mass-not-positive")
    assert result.returncode == 0
    verdict = result.stdout.splitlines()[0]
    assert verdict.startswith("WARNINGS ")
    assert "0 errors" in verdict
    assert "warning" in verdict


def test_disabled_rules_and_the_least_severity_that_fails(broken: Path) -> None:
    assert run(str(broken), "--disable", "mass-not-positive").returncode == 0
    warned = run(str(broken), "--disable", "mass-not-positive", "--fail-on", "warning")
    assert warned.returncode == 1
    assert "mass-not-positive" not in warned.stdout


def test_audit_lists_its_rules() -> None:
    result = run("--list-rules")
    assert result.returncode == 0
    lines = result.stdout.splitlines()
    assert lines[1] == f"{len(RULES)} rules; --disable RULE skips one"
    assert [line.split()[0] for line in lines[4:] if line[0] != " "] == list(RULES)


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
