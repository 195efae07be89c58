"""The audit's output, and its command."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from pupper_analysis import cli
from pupper_analysis.tools.audit.audit import RULES, audit_model
from tests.support.commands import Answer, answer
from tests.support.printing import printed
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


def test_a_sound_file(tmp_path: Path) -> None:
    report = tmp_path / "audit.json"
    result = run(
        str(ROOT / "mjcf" / "pupper_v3.xml"), "--fail-on", "warning", "--json", str(report)
    )
    assert result.returncode == 0, result.stdout
    assert result.stdout.startswith("OK pupper_v3.xml: 0 errors, ")
    assert result.stdout.splitlines()[-1] == f"written: {report}"
    content = json.loads(report.read_text())
    assert content["passed"] is True
    assert len(content["rules_run"]) > 30


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


def test_audit_writes_every_format(broken: Path) -> None:
    audit = audit_model(broken)
    github = run(str(broken), "--format", "github").stdout
    assert github.startswith(f"::error file={broken},line=")
    assert len(github.splitlines()) == len(audit.findings)


def test_what_to_do_is_said_once_for_the_findings_of_a_rule(tmp_path: Path) -> None:
    """Four calves of another mass each: four findings, and one remedy."""
    text = (ROOT / "urdf" / "pupper_v3.urdf").read_text()
    for number, leg in enumerate(("front_r", "front_l", "back_r", "back_l"), start=1):
        before, after = text.split(f'<link name="leg_{leg}_2">')
        after = re.sub(r'<mass value="[^"]*"/>', f'<mass value="-{number}"/>', after, count=1)
        text = f'{before}<link name="leg_{leg}_2">{after}'
    file = tmp_path / "robot.urdf"
    file.write_text(text)
    audit = audit_model(file)
    found = [finding for finding in audit.findings if finding.rule == "mass-not-positive"]
    assert len({finding.message for finding in found}) == 4
    shown = printed(audit, everything=False)
    assert all(finding.message in shown for finding in found)
    assert shown.count(found[0].todo) == 1


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
