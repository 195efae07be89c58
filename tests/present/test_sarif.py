"""SARIF 2.1.0, as the standard and GitHub's code scanning require."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pupper_analysis.present.formats import Annotation, relative_to_checkout, write_sarif
from tests.support.commands import answer
from tests.support.repository import ROOT


def checked_log(text: str) -> dict[str, Any]:
    """Check the used properties by SARIF 2.1.0, and return the single run.

    Sections 3.13 (log), 3.14 (run), 3.19 (driver), 3.27 (result), 3.29 (location), 3.49 (rule).
    """
    log = json.loads(text)
    assert log.keys() == {"$schema", "version", "runs"}
    assert log["version"] == "2.1.0"
    (run,) = log["runs"]
    assert run.keys() == {"tool", "columnKind", "results"}
    assert run["columnKind"] in ("utf16CodeUnits", "unicodeCodePoints")
    driver = run["tool"]["driver"]
    assert driver.keys() == {"name", "version", "rules"}
    ids = [rule["id"] for rule in driver["rules"]]
    assert len(set(ids)) == len(ids)
    assert all(rule["shortDescription"]["text"] for rule in driver["rules"])
    allowed = {"ruleId", "ruleIndex", "level", "message", "locations", "partialFingerprints"}
    for result in run["results"]:
        assert result.keys() <= allowed | {"baselineState", "properties"}
        assert ids[result["ruleIndex"]] == result["ruleId"]
        assert result["level"] in ("none", "note", "warning", "error")
        assert isinstance(result["message"]["text"], str)
        assert result.get("baselineState", "new") in ("new", "unchanged", "updated", "absent")
        assert all(isinstance(v, str) for v in result["partialFingerprints"].values())
        for location in result.get("locations", []):
            place = location["physicalLocation"]
            assert place["region"]["startLine"] >= 1
            assert place["artifactLocation"]["uri"].isascii()
    prints = [json.dumps(result["partialFingerprints"]) for result in run["results"]]
    assert len(set(prints)) == len(prints)
    return dict(run)


def finding(**values: Any) -> Annotation:
    usual = {"rule": "audit/mass", "level": "error", "message": "too heavy", "title": "base"}
    return Annotation(**{"place": "a.urdf:3", **usual, **values})


def test_finding_becomes_a_sarif_result() -> None:
    run = checked_log(write_sarif([finding(about="A mass", known=True)]))
    assert run["tool"]["driver"]["rules"] == [
        {"id": "audit/mass", "shortDescription": {"text": "A mass"}}
    ]
    (one,) = run["results"]
    assert one.pop("partialFingerprints").keys() == {"subject/v1"}
    place = {"artifactLocation": {"uri": "a.urdf"}, "region": {"startLine": 3}}
    assert one == {
        **{"ruleId": "audit/mass", "ruleIndex": 0, "level": "error"},
        "message": {"text": "too heavy"},
        "locations": [{"physicalLocation": place}],
        "baselineState": "unchanged",
    }


def test_sarif_has_levels_rules_and_baseline_states() -> None:
    findings = [
        finding(level="notice", known=False),
        finding(level="warning", rule="b", place="a.urdf"),
        finding(rule="b", title="hip", place=None),
    ]
    run = checked_log(write_sarif(findings))
    first, second, third = run["results"]
    assert [result["level"] for result in run["results"]] == ["note", "warning", "error"]
    assert [result["ruleIndex"] for result in run["results"]] == [0, 1, 1]
    assert first["baselineState"] == "new"
    assert "baselineState" not in second
    assert second["locations"][0]["physicalLocation"]["region"] == {"startLine": 1}
    assert "locations" not in third
    assert run["tool"]["driver"]["rules"][1]["shortDescription"]["text"] == "b"


def test_fingerprint_is_independent_of_line_and_numbers() -> None:
    def print_of(**values: Any) -> str:
        found = checked_log(write_sarif([finding(**values)]))["results"][0]
        return str(found["partialFingerprints"])

    assert print_of(place="a.urdf:9", message="too light", level="warning") == print_of()
    for changed in ({"title": "hip"}, {"place": "b.urdf:3"}, {"rule": "audit/com"}):
        assert print_of(**changed) != print_of()


def test_commands_write_sarif(tmp_path: Path) -> None:
    """Reference: the line of the edited mass in the file."""
    text = (ROOT / "urdf" / "pupper_skeleton.urdf").read_text()
    text = text.replace('<mass value="1.506"/>', '<mass value="-1.506"/>')
    (tmp_path / "robot.urdf").write_text(text)
    line = text[: text.index('value="-1.506"')].count("\n") + 1
    mjcf = str(ROOT / "mjcf" / "pupper_skeleton.xml")
    audit = checked_log(answer("audit", "robot.urdf", "--format", "sarif", folder=tmp_path).stdout)
    (found,) = (
        result for result in audit["results"] if result["ruleId"] == "audit/mass-not-positive"
    )
    place = found["locations"][0]["physicalLocation"]
    assert place == {"artifactLocation": {"uri": "robot.urdf"}, "region": {"startLine": line}}
    (tmp_path / "robot.urdf").write_text(text.replace("-1.506", "1.7"))
    shown = answer("crosscheck", "robot.urdf", mjcf, "--format", "sarif", folder=tmp_path)
    assert shown.returncode == 1
    (found,) = checked_log(shown.stdout)["results"]
    assert found["ruleId"] == "crosscheck/mass"
    assert found["level"] == "error"
    assert "mass 1.7 kg in the URDF, 1.506 kg in the MJCF" in found["message"]["text"]


def test_log_without_findings_is_valid() -> None:
    """Code scanning closes the earlier findings with it."""
    assert checked_log(write_sarif([]))["results"] == []


@given(name=st.text("ab#?%ä ", min_size=1, max_size=8))
def test_file_names_are_quoted_and_restored(name: str) -> None:
    run = checked_log(write_sarif([finding(place=f"x/{name}.urdf:3")]))
    (one,) = run["results"]
    uri = one["locations"][0]["physicalLocation"]["artifactLocation"]["uri"]
    assert unquote(uri) == f"x/{name}.urdf"
    assert not set(uri) & set("?# ")


def test_paths_are_relative_to_the_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A link in the checkout is shown as such, whatever it points to."""
    inside = tmp_path / "models"
    inside.mkdir()
    monkeypatch.delenv("GITHUB_WORKSPACE", raising=False)
    monkeypatch.chdir(inside)
    assert relative_to_checkout("a.urdf") == relative_to_checkout(inside / "a.urdf") == "a.urdf"
    assert relative_to_checkout("../b.urdf") == (tmp_path / "b.urdf").as_posix()
    monkeypatch.setenv("GITHUB_WORKSPACE", str(tmp_path))
    assert relative_to_checkout("a.urdf") == "models/a.urdf"
    assert relative_to_checkout("../b.urdf") == "b.urdf"
    (tmp_path / "elsewhere").mkdir()
    (inside / "link.urdf").symlink_to(tmp_path / "elsewhere" / "a.urdf")
    assert relative_to_checkout("link.urdf") == "models/link.urdf"
    (tmp_path / "linked").symlink_to(inside)
    monkeypatch.setenv("GITHUB_WORKSPACE", str(tmp_path / "linked"))
    assert relative_to_checkout(inside / "a.urdf") == "a.urdf"


def test_file_outside_the_checkout_has_an_absolute_uri(tmp_path: Path) -> None:
    run = checked_log(write_sarif([finding(place=f"{tmp_path / 'a b.urdf'}:3")]))
    uri = run["results"][0]["locations"][0]["physicalLocation"]["artifactLocation"]["uri"]
    assert uri == (tmp_path / "a b.urdf").as_uri()


def test_links_in_messages_are_escaped() -> None:
    """SARIF 2.1.0, 3.11.6: a viewer would show "[click](address)" as a link."""
    name = r"[click](javascript:alert(1)) a\b"
    log = checked_log(write_sarif([finding(message=f"joint {name}")]))
    text = log["results"][0]["message"]["text"]
    assert text == r"joint \[click\](javascript:alert(1)) a\\b"
