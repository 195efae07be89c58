"""SARIF as the standard and code scanning have it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pupper_analysis.present.formats import Annotation, from_root, write_sarif
from tests.support.commands import answer
from tests.support.repository import ROOT


def checked_log(text: str) -> dict[str, Any]:
    """Checks what SARIF 2.1.0 says of the properties that are used; returns the one run.

    Sections 3.13 (log), 3.14 (run), 3.19 (driver), 3.27 (result), 3.29 (place), 3.49 (rule).
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


def test_a_finding_is_a_sarif_result() -> None:
    run = checked_log(write_sarif([finding(about="A mass", known=True)]))
    assert run["tool"]["driver"]["rules"] == [
        {"id": "audit/mass", "shortDescription": {"text": "A mass"}}
    ]
    (one,) = run["results"]
    assert one.pop("partialFingerprints").keys() == {"subject/v1"}
    assert one == {
        "ruleId": "audit/mass",
        "ruleIndex": 0,
        "level": "error",
        "message": {"text": "too heavy"},
        "locations": [
            {
                "physicalLocation": {
                    "artifactLocation": {"uri": "a.urdf"},
                    "region": {"startLine": 3},
                }
            }
        ],
        "baselineState": "unchanged",
    }


def test_nothing_found_is_a_log_all_the_same() -> None:
    """With it code scanning closes what it has shown before."""
    assert checked_log(write_sarif([]))["results"] == []


def test_levels_rules_and_states() -> None:
    run = checked_log(
        write_sarif(
            [
                finding(level="notice", known=False),
                finding(level="warning", rule="b", place="a.urdf"),
                finding(rule="b", title="hip", place=None),
            ]
        )
    )
    first, second, third = run["results"]
    assert [one["level"] for one in run["results"]] == ["note", "warning", "error"]
    assert [one["ruleIndex"] for one in run["results"]] == [0, 1, 1]
    assert first["baselineState"] == "new"
    assert "baselineState" not in second
    assert second["locations"][0]["physicalLocation"]["region"] == {"startLine": 1}
    assert "locations" not in third
    assert run["tool"]["driver"]["rules"][1]["shortDescription"]["text"] == "b"


def test_a_fingerprint_is_of_the_subject_not_of_its_line_or_numbers() -> None:
    def print_of(**values: Any) -> str:
        found = checked_log(write_sarif([finding(**values)]))["results"][0]
        return str(found["partialFingerprints"])

    assert print_of(place="a.urdf:9", message="too light", level="warning") == print_of()
    for other in ({"title": "hip"}, {"place": "b.urdf:3"}, {"rule": "audit/com"}):
        assert print_of(**other) != print_of()


TEXT = st.text(st.characters(codec="utf-8"), max_size=20)


@given(message=TEXT, subject=TEXT, name=st.text("ab:?#%ä ", min_size=1, max_size=8))
def test_names_of_files_are_quoted_and_read_back(message: str, subject: str, name: str) -> None:
    text = write_sarif([finding(message=message, title=subject, place=f"x/{name}.urdf:3")] * 2)
    run = checked_log(text)
    for one in run["results"]:
        assert one["message"]["text"] == message
        uri = one["locations"][0]["physicalLocation"]["artifactLocation"]["uri"]
        assert unquote(uri) == f"x/{name}.urdf"
        assert not set(uri) & set(":?# ")


def test_paths_are_relative_to_the_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inside = tmp_path / "models"
    inside.mkdir()
    monkeypatch.delenv("GITHUB_WORKSPACE", raising=False)
    monkeypatch.chdir(inside)
    assert from_root("a.urdf") == from_root(inside / "a.urdf") == "a.urdf"
    assert from_root("../b.urdf") == (tmp_path / "b.urdf").as_posix()
    monkeypatch.setenv("GITHUB_WORKSPACE", str(tmp_path))
    assert from_root("a.urdf") == "models/a.urdf"
    assert from_root("../b.urdf") == "b.urdf"
    # A link in the checkout is what GitHub shows, wherever it leads; so is a linked checkout.
    (tmp_path / "elsewhere").mkdir()
    (inside / "link.urdf").symlink_to(tmp_path / "elsewhere" / "a.urdf")
    assert from_root("link.urdf") == "models/link.urdf"
    (tmp_path / "linked").symlink_to(inside)
    monkeypatch.setenv("GITHUB_WORKSPACE", str(tmp_path / "linked"))
    assert from_root(inside / "a.urdf") == "a.urdf"


def test_of_the_commands(tmp_path: Path) -> None:
    text = (ROOT / "urdf" / "pupper_skeleton.urdf").read_text()
    text = text.replace('<mass value="1.506"/>', '<mass value="-1.506"/>')
    (tmp_path / "robot.urdf").write_text(text)
    line = text[: text.index('value="-1.506"')].count("\n") + 1
    mjcf = str(ROOT / "mjcf" / "pupper_skeleton.xml")
    audit = checked_log(answer("audit", "robot.urdf", "--format", "sarif", folder=tmp_path).stdout)
    (found,) = (one for one in audit["results"] if one["ruleId"] == "audit/mass-not-positive")
    place = found["locations"][0]["physicalLocation"]
    assert place == {"artifactLocation": {"uri": "robot.urdf"}, "region": {"startLine": line}}
    (tmp_path / "robot.urdf").write_text(text.replace("-1.506", "1.7"))
    shown = answer("crosscheck", "robot.urdf", mjcf, "--format", "sarif", folder=tmp_path)
    assert shown.returncode == 1
    (found,) = checked_log(shown.stdout)["results"]
    assert found["ruleId"] == "crosscheck/mass"
    assert found["level"] == "error"
    assert "mass 1.7 kg in the URDF, 1.506 kg in the MJCF" in found["message"]["text"]


def test_names_in_messages_are_no_links() -> None:
    """Source: SARIF 2.1.0, 3.11.6; in a viewer "[click](address)" would be one."""
    name = r"[click](javascript:alert(1)) a\b"
    log = checked_log(write_sarif([finding(message=f"joint {name}")]))
    text = log["results"][0]["message"]["text"]
    assert text == r"joint \[click\](javascript:alert(1)) a\\b"
