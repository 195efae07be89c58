"""The command `audit`: printed findings, exit status, and refusals of invalid input."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from pupper_analysis import cli
from pupper_analysis.tools.audit.audit import RULES, audit_model
from pupper_analysis.tools.audit.document import audit_document
from tests.support.commands import answer
from tests.support.printing import printed
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
            "no rule 'armature'; did you mean armature-zero or armature-implausible? audit",
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


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write our URDF with a negative mass, and with one limit that differs from its mirror."""
    text = (ROOT / "urdf" / "pupper_skeleton.urdf").read_text()
    text = text.replace('<mass value="1.506"/>', '<mass value="-1.506"/>')
    text = text.replace('lower="-2.6"', 'lower="-1.9"', 1)
    path = tmp_path_factory.mktemp("audit") / "broken.urdf"
    path.write_text(text)
    return path


def test_audit_prints_rule_place_reason_and_remedy(broken: Path) -> None:
    result = answer("audit", str(broken), "-v")
    assert result.returncode == 1
    line = broken.read_text().splitlines().index('      <mass value="-1.506"/>') + 1
    assert result.stdout.startswith("ERRORS broken.urdf: 1 error, ")
    assert "error mass-not-positive link 'base_link': mass is -1.506 kg" in result.stdout
    assert f"{broken}:{line}\n" in result.stdout
    assert RULES["mass-not-positive"].todo in result.stdout
    assert "mirror-limits" in result.stdout


def test_audit_of_a_sound_file_passes(tmp_path: Path) -> None:
    report, file = tmp_path / "audit.json", str(ROOT / "mjcf" / "pupper_v3.xml")
    result = answer("audit", file, "--fail-on", "warning", "--json", str(report))
    assert result.returncode == 0, result.stdout
    assert result.stdout.startswith("OK pupper_v3.xml: 0 errors, ")
    assert result.stdout.splitlines()[-1] == f"written: {report}"
    content = json.loads(report.read_text())
    assert content["passed"] is True
    assert len(content["rules_run"]) > 30


def test_disabled_rule_is_not_reported_and_warnings_fail_on_request(broken: Path) -> None:
    words = ("audit", str(broken), "--disable", "mass-not-positive")
    result = answer(*words)
    assert result.returncode == 0
    verdict = result.stdout.splitlines()[0]
    assert verdict.startswith("WARNINGS ")
    assert "0 errors" in verdict
    warned = answer(*words, "--fail-on", "warning")
    assert warned.returncode == 1
    assert "mass-not-positive" not in warned.stdout


def test_audit_lists_its_rules() -> None:
    result = answer("audit", "--list-rules")
    assert result.returncode == 0
    assert f"{len(RULES)} rules; --disable RULE skips one" in result.stdout
    assert all(rule in result.stdout for rule in RULES)


def test_each_finding_is_an_annotation_and_a_failed_test_case(
    broken: Path,
) -> None:
    audit = audit_model(broken)
    github = answer("audit", str(broken), "--format", "github").stdout
    assert github.startswith(f"::error file={broken},line=")
    assert len(github.splitlines()) == len(audit.findings)
    junit = answer("audit", str(broken), "--format", "junit").stdout
    root = ElementTree.fromstring(junit.encode())
    rules = [failure.get("type") for failure in root.iter("failure")]
    assert int(root.get("tests", "0")) == len(rules)
    assert sorted(rules) == sorted(finding.rule for finding in audit.findings)


def test_remedy_is_printed_once_for_the_findings_of_a_rule(tmp_path: Path) -> None:
    """Four links with different negative masses: four findings, and one remedy."""
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
    shown = printed(audit, everything=True)
    # The answer repeats the most severe finding.
    assert [shown.count(finding.message) for finding in found] == [2, 1, 1, 1]
    assert shown.count(found[0].todo) == 1


def test_answer_about_a_start_names_the_configuration_instead_of_a_link(tmp_path: Path) -> None:
    """Reference: v3 at zero angles, if a knee must be bent by at least 0.5 rad."""
    text = (ROOT / "urdf/pupper_v3.urdf").read_text()
    bent = tmp_path / "bent.urdf"
    place = re.search(r'(?s)<joint name="leg_front_r_3".*?lower="[^"]*"', text)
    assert place is not None
    lower = re.sub(r'lower="[^"]*"$', 'lower="0.5"', place.group())
    bent.write_text(text.replace(place.group(), lower))
    (found,) = [
        finding for finding in audit_model(bent).findings if finding.rule == "start-outside-limits"
    ]
    audit = replace(audit_model(bent), findings=(found,))
    second = printed(audit_document(audit), everything=False).splitlines()[1]
    assert second.startswith("  first: the zero configuration: leg_front_r_3 at 0 deg, limits 28.6")
