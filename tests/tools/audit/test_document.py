"""The command `audit`: printed findings, exit status, and refusals of invalid input."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from pupper_analysis import cli
from pupper_analysis.tools.audit.audit import RULES, audit_model
from pupper_analysis.tools.audit.document import audit_document, describe_counts
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


def test_counts_of_findings_have_a_measure_word_in_chinese() -> None:
    """English has a plural; Chinese has the same noun for each count."""
    counts = describe_counts({"error": 0, "warning": 2, "note": 1})
    assert counts.en == "0 errors, 2 warnings, 1 note"
    assert counts.zh == "0 个错误、2 个警告、1 个提示"


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


LEGS = """<robot name="legs"><link name="base"><inertial><mass value="5"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>{legs}</robot>"""
LEG = """<link name="{side}_shank">{shank}</link>
<joint name="{side}_knee" type="revolute"><parent link="base"/><child link="{side}_shank"/>
<origin xyz="0 {y} 0"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/>
</joint><link name="{side}_cover">{cover}</link>
<joint name="{side}_fixed" type="fixed"><parent link="{side}_shank"/><child link="{side}_cover"/>
</joint>"""
INERTIAL = """<inertial><mass value="{mass}"/><inertia ixx="{moment}" iyy="{moment}" izz="{moment}"
ixy="0" ixz="0" iyz="0"/></inertial>"""


def write_legs(path: Path, masses: Mapping[str, tuple[float, float]], moment: float = 1e-3) -> Path:
    """Write a URDF with two legs: {side: masses of the shank and of a cover fixed to it}."""
    legs = "".join(
        LEG.format(
            side=side,
            y=0.1 if side == "left" else -0.1,
            shank=INERTIAL.format(mass=shank, moment=1e-3) if shank else "",
            cover=INERTIAL.format(mass=cover, moment=moment) if cover else "",
        )
        for side, (shank, cover) in masses.items()
    )
    path.write_text(LEGS.format(legs=legs))
    return path


def test_mass_of_a_fixed_link_may_belong_to_the_parent_on_one_side(tmp_path: Path) -> None:
    """Both legs have 0.3384 kg at equal places, so the bodies that move are mirror images.

    With another total mass, the difference of the pair is an error (ratio above 10).
    """
    merged = write_legs(tmp_path / "a.urdf", {"left": (0.001, 0.3374), "right": (0.3384, 0.0)})
    rules = {finding.rule for finding in audit_model(merged).findings}
    assert not rules & {"mirror-mass", "mirror-com", "mirror-inertia"}
    wrong = write_legs(tmp_path / "b.urdf", {"left": (0.001, 0.3374), "right": (0.5, 0.0)})
    found = [finding for finding in audit_model(wrong).findings if finding.rule == "mirror-mass"]
    assert found[0].severity == "error"


def test_zero_inertia_of_the_heaviest_fixed_link_is_a_warning(tmp_path: Path) -> None:
    """The moments of a moving group are those of this link, which has 0.3374 of 0.3384 kg."""
    masses = {"left": (0.001, 0.3374), "right": (0.001, 0.3374)}
    audit = audit_model(write_legs(tmp_path / "a.urdf", masses, moment=0.0))
    rule = "inertia-not-positive-definite"
    found = [
        (finding.element, finding.severity) for finding in audit.findings if finding.rule == rule
    ]
    assert found == [("link 'left_cover'", "warning"), ("link 'right_cover'", "warning")]


def test_answer_names_the_exchanged_limits_first_and_counts_equal_findings(tmp_path: Path) -> None:
    """Four links violate the triangle inequality by (0.02 - 0.002) / 0.02 = 90 %."""
    path = write_legs(tmp_path / "a.urdf", {"left": (0.5, 0.1), "right": (0.5, 0.1)})
    text = path.read_text().replace('izz="0.001"', 'izz="0.02"')
    path.write_text(text)
    lines = answer("audit", "a.urdf", folder=tmp_path).stdout.splitlines()
    assert (
        lines[1]
        == "  first: left_shank and 3 more: inertia violates the triangle inequality by 90 %"
    )
    lines = answer("audit", "a.urdf", "--language", "zh", folder=tmp_path).stdout.splitlines()
    assert lines[1] == "  首先：left_shank（另有 3 个）：惯量违反三角不等式，相差 90 %"
    path.write_text(text.replace('lower="-1" upper="1"', 'lower="1" upper="-0.5"', 1))
    lines = answer("audit", "a.urdf", folder=tmp_path).stdout.splitlines()
    assert lines[1].startswith("  first: left_knee: lower limit is 57.2958")
    assert lines[2] == "  next: pupper-analysis audit a.urdf --fix"
    lines = answer("audit", "a.urdf", "--fix", folder=tmp_path).stdout.splitlines()
    assert lines[2] == "  next: pupper-analysis audit a.urdf --fix --yes"
    lines = answer("audit", "a.urdf", "--fix", "--yes", folder=tmp_path).stdout.splitlines()
    assert lines[2] == "  next: pupper-analysis audit a.urdf"
    assert 'lower="-0.5" upper="1"' in path.read_text()


def test_fix_answers_with_the_patch_and_does_not_repeat_the_findings(tmp_path: Path) -> None:
    """`--fix` printed the answer of `audit` again. Both lower limits exceed the upper limits.

    The patch exchanges them; the effort of 1e9 N m has no repair.
    """
    path = write_legs(tmp_path / "a.urdf", {"left": (0.5, 0.1), "right": (0.5, 0.1)})
    text = path.read_text().replace('lower="-1" upper="1"', 'lower="1" upper="-0.5"')
    path.write_text(text.replace('effort="9"', 'effort="1e9"'))
    audit = audit_model(path)
    exchanged = [finding for finding in audit.findings if len(finding.repairs) == 1]
    others = [finding for finding in audit.findings if len(finding.repairs) != 1]
    assert len(exchanged) == 2
    assert others
    printed = answer("audit", "a.urdf", "--fix", folder=tmp_path).stdout
    lines = printed.splitlines()
    total = len(audit.findings)
    assert lines[0] == f"ERRORS a.urdf: patch of 2 repairs for 2 of {total} findings"
    assert lines[1].startswith("  not in the patch: ")
    assert others[0].diagnostic.subject is not None
    assert others[0].diagnostic.subject.name in lines[1]
    assert "--- a/a.urdf\n+++ b/a.urdf\n@@ " in printed
    assert "\n1. error" not in printed  # `audit` prints the findings
    assert "\n1. error" in answer("audit", "a.urdf", "--fix", "-v", folder=tmp_path).stdout
    answer("audit", "a.urdf", "--fix", "--yes", folder=tmp_path)
    lines = answer("audit", "a.urdf", "--fix", folder=tmp_path).stdout.splitlines()
    assert f"no patch: none of {len(others)} finding" in lines[0]
    assert lines[1].startswith("  first: ")
    assert "--fix" not in lines[2]
