"""`check` of a repository: known remarks pass, and only new or changed remarks fail."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import (
    Severity,
    catalogue,
    diagnose,
    diagnostic,
)
from pupper_analysis.base.errors import OutputError
from pupper_analysis.cli import EXIT_BAD_INPUT
from pupper_analysis.tools.check.check import _get_change_severity
from pupper_analysis.tools.check.config import list_pair_entries, read_config
from pupper_analysis.tools.check.remarks import (
    BaselineEntry,
    Remark,
    mark_known_remarks,
    read_baseline,
    to_rounded_plain,
    values_agree,
    write_baseline,
)
from tests.support.commands import Answer, answer
from tests.support.repository import ROOT
from tests.support.robots import quadruped, write_parts

SAMPLE = ROOT / "examples" / "guarded"
BASELINE = "pupper-analysis-baseline.txt"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a copy of the sample repository."""
    monkeypatch.delenv("GITHUB_WORKSPACE", raising=False)
    shutil.copytree(SAMPLE, tmp_path / "repository")
    return tmp_path / "repository"


def run(folder: Path, *arguments: str) -> Answer:
    return answer("check", *arguments, folder=folder)


def change(path: Path, old: str, new: str) -> int:
    """Replace a text that occurs once in a file; return its line."""
    text = path.read_text()
    assert text.count(old) == 1, old
    path.write_text(text.replace(old, new))
    return text[: text.index(old)].count("\n") + 1


def test_sample_repository_passes_and_is_not_changed(folder: Path) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    result = run(folder)
    assert result.returncode == 0, result.stdout
    assert "PASSED pupper-analysis.toml: 0 to fix, 1 known" in result.stdout
    assert "0 to fix, 1 known" in run(folder, "--format", "github").stdout
    assert {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()} == before


def test_baseline_of_the_sample_equals_a_new_baseline(folder: Path) -> None:
    (folder / BASELINE).unlink()
    assert run(folder).returncode == 1
    result = run(folder, "--update-baseline")
    assert result.returncode == 0
    assert f"the baseline is written: {folder / BASELINE}" in result.stdout
    assert (folder / BASELINE).read_text() == (SAMPLE / BASELINE).read_text()


def test_new_difference_fails_with_the_lines_of_both_files(folder: Path) -> None:
    line = change(folder / "hopper.xml", 'range="-1.5 1.5"', 'range="-1.5 1.2"')
    urdf_line = (folder / "hopper.urdf").read_text().split('upper="1.5"')[0].count("\n") + 1
    result = run(folder)
    assert result.returncode == 1
    assert "1. error crosscheck upper limit joint hip: upper limit" in result.stdout
    assert f"   hopper.urdf:{urdf_line}   hopper.xml:{line}\n" in result.stdout
    assert "mass" not in result.stdout  # that one is known
    assert "FAILED pupper-analysis.toml: 1 to fix, 1 known" in result.stdout
    assert f"\n  first: hopper.urdf:{urdf_line}: " in result.stdout
    request = run(folder, "--format", "markdown").stdout
    new, _, rest = request.partition("<details>")
    assert "upper limit" in new
    known, _, _ = rest.partition("</details>")
    assert known.startswith("<summary>1 known</summary>")
    assert re.search(r"^- hopper\\?\.urdf:\W*\d+: .*mass", known, re.M)
    assert "upper limit" not in rest


def test_equal_difference_of_several_joints_is_one_remark(folder: Path) -> None:
    change(folder / "hopper.xml", 'damping="0.05"', 'damping="0.06"')
    shown = run(folder).stdout
    assert shown.count("error crosscheck damping") == 1
    # The knee first: what it carries is lighter, so that it is felt more.
    assert "joint knee: damping 0.05 N m s/rad in the URDF, 0.06 N m s/rad in the MJCF" in shown
    assert "   likewise on 1 more: hip" in shown
    assert "FAILED pupper-analysis.toml: 1 to fix" in shown


def test_moved_lines_are_no_change(folder: Path) -> None:
    for name in ("hopper.urdf", "hopper.xml"):
        text = (folder / name).read_text()
        (folder / name).write_text(text.replace(">\n", ">\n\n"))
    assert run(folder).returncode == 0


def test_check_runs_in_a_folder_below_and_by_the_path_of_the_configuration(folder: Path) -> None:
    below = folder / "src"
    below.mkdir()
    change(folder / "hopper.xml", 'mass="0.22"', 'mass="0.25"')
    assert "::error file=" in run(below, "--format", "github").stdout
    config = "repository/pupper-analysis.toml"
    shown = run(folder.parent, "--config", config, "--format", "github").stdout
    assert re.search(r"::error file=repository/hopper\.(xml|urdf),line=\d+,title=mass of", shown)


def test_invalid_configuration_and_baseline_are_refused_in_one_line(
    folder: Path, tmp_path: Path
) -> None:
    """The line of the unknown key, and of the line that is no entry."""
    result = run(tmp_path)
    assert result.returncode == EXIT_BAD_INPUT
    assert "no pupper-analysis.toml in" in result.stderr
    assert run(folder, "--config", "none.toml").returncode == EXIT_BAD_INPUT
    baseline = folder / BASELINE
    lines = baseline.read_text().splitlines()
    baseline.write_text("\n".join([*lines, "no entry"]))
    result = run(folder)
    assert (result.returncode, result.stdout) == (EXIT_BAD_INPUT, "")
    assert f"{BASELINE}:{len(lines) + 1}: " in result.stderr
    change(folder / "pupper-analysis.toml", "feet", "feat")
    result = run(folder)
    assert re.search(r"pupper-analysis\.toml:\d+: no key 'feat' in pair; valid: ", result.stderr)
    assert len(result.stderr.splitlines()) == 1


def test_baseline_that_cannot_be_written_is_refused(folder: Path) -> None:
    (folder / BASELINE).unlink()
    config = folder / "pupper-analysis.toml"
    config.write_text(f'baseline = "hopper.xml/no"\n{config.read_text()}')
    result = run(folder, "--update-baseline")
    assert result.returncode == EXIT_BAD_INPUT
    assert "cannot write" in result.stderr


def test_each_pair_has_its_own_verdict(folder: Path) -> None:
    with (folder / "pupper-analysis.toml").open("a") as file:
        file.write('[[pair]]\nname = "alone"\nurdf = "hopper.urdf"\n')
    change(folder / "hopper.xml", 'mass="0.22"', 'mass="0.3"')
    check = pa.guard.check_repository(folder / "pupper-analysis.toml")
    assert [(pair.failures, pair.known) for pair in check.pairs] == [(1, 0), (0, 0)]
    rows = [line.split() for line in run(folder, "-v").stdout.splitlines()]
    assert any(row[:3] == ["hopper", "FAILED", "1"] for row in rows)
    assert any(row[:3] == ["alone", "OK", "0"] for row in rows)


def test_known_remark_with_another_value_fails_and_its_entry_is_stale(folder: Path) -> None:
    """The difference grows or shrinks; the entry has 0.22 kg."""
    for mass in ("0.25", "0.21"):
        shutil.copy(SAMPLE / "hopper.xml", folder)
        change(folder / "hopper.xml", 'mass="0.22"', f'mass="{mass}"')
        check = pa.guard.check_repository(folder / "pupper-analysis.toml")
        assert not check.passed
        (remark,) = check.remarks
        assert not remark.known
        assert remark.values == {"urdf": 0.2, "mjcf": float(mass)}
        (entry,) = check.stale
        assert entry.values == {"urdf": 0.2, "mjcf": 0.22}


def test_known_remark_is_recognised_with_another_message(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A baseline contains codes and values; a later version may word its messages otherwise."""
    config = folder / "pupper-analysis.toml"
    config.write_text(re.sub("start-outside-limits = .*", "", config.read_text()))
    change(folder / "hopper.urdf", '<mass value="0.4"/>', '<mass value="-0.4"/>')
    pa.guard.check_repository(config, update_baseline=True)
    before = {remark.message for remark in pa.guard.check_repository(config).remarks}
    words = {"en": "put otherwise", "zh": "换了说法"}
    monkeypatch.setattr(
        diagnostic, "entry", lambda code: replace(catalogue.entry(code), templates=words)
    )
    check = pa.guard.check_repository(config)
    assert not before & {remark.message for remark in check.remarks}
    assert all(remark.known for remark in check.remarks)


def test_known_remark_is_recognised_despite_rounding(folder: Path) -> None:
    change(folder / "hopper.xml", 'mass="0.22"', 'mass="0.22000000001"')
    assert run(folder).returncode == 0
    change(folder / "hopper.xml", 'mass="0.22000000001"', 'mass="0.220001"')
    assert run(folder).returncode == 1


def test_resolved_remark_is_stale_until_the_baseline_is_updated(folder: Path) -> None:
    change(folder / "hopper.xml", 'mass="0.22"', 'mass="0.2"')
    result = run(folder)
    assert result.returncode == 0
    message = "stale\ncrosscheck of hopper: mass of knee: no longer occurs"
    assert f"{message}; --update-baseline removes this entry" in result.stdout
    assert "::notice file=" in run(folder, "--format", "github").stdout
    result = run(folder, "--update-baseline")
    assert f"{message}; removed from the baseline" in result.stdout
    assert read_baseline(folder / BASELINE).entries == ()
    assert "stale" not in run(folder).stdout


def test_unreadable_file_fails_and_other_remarks_are_reported(folder: Path) -> None:
    """The baseline is not written, because its entries for the unreadable file are unknown."""
    before = (folder / BASELINE).read_bytes()
    line = change(folder / "hopper.urdf", '<mass value="0.4"/>', '<mass value="heavy"/>')
    check = pa.guard.check_repository(folder / "pupper-analysis.toml", update_baseline=True)
    first = check.remarks[0]
    assert (first.check, first.pair, first.kind) == ("audit", "hopper", "refused")
    assert (first.known, first.fails) == (False, True)
    assert first.place == f"{folder / 'hopper.urdf'}:{line}"
    assert (check.stale, check.updated, check.passed) == ((), False, False)
    assert (folder / BASELINE).read_bytes() == before
    shutil.copy(SAMPLE / "hopper.urdf", folder)
    assert pa.guard.check_repository(folder / "pupper-analysis.toml").passed


def test_unreadable_file_cannot_be_accepted_by_the_baseline(folder: Path) -> None:
    change(folder / "hopper.urdf", '<mass value="0.4"/>', '<mass value="heavy"/>')
    config = folder / "pupper-analysis.toml"
    (remark,) = (r for r in pa.guard.check_repository(config).remarks if r.kind == "refused")
    before = read_baseline(folder / BASELINE)
    entries = [*before.entries, BaselineEntry(remark.identity, remark.values)]
    write_baseline(folder / BASELINE, before, entries)
    check = pa.guard.check_repository(config)
    assert not check.passed
    assert [r.known for r in check.remarks if r.kind == "refused"] == [False]


COMMENTS = "# agreed with the supplier: part ordered"


def baseline_with(folder: Path, *lines: str) -> list[str]:
    """Write the sample's baseline with lines before (``^``) and after its first entry."""
    head, entry = (SAMPLE / BASELINE).read_text().split("\n\n")
    above = [line.removeprefix("^") for line in lines if line.startswith("^")]
    below = [line for line in lines if not line.startswith("^")]
    (folder / BASELINE).write_text("\n".join([head, *above, entry.rstrip("\n"), *below, ""]))
    return [*above, *below]


def test_update_baseline_keeps_the_lines_that_a_person_wrote(folder: Path) -> None:
    """A comment stays above its entry if entries are sorted, and at the end after the last
    entry."""
    baseline_with(folder, "^# of the project", "^", f"^{COMMENTS}", "# looked at on Monday")
    change(folder / "hopper.xml", 'damping="0.05"', 'damping="0.06"')  # two more entries
    assert run(folder, "--update-baseline").returncode == 0
    written = (folder / BASELINE).read_text()
    lines = written.splitlines()
    own = [line for line in lines if line.startswith("[")]
    assert len(own) == 3
    assert '"mass"' in lines[lines.index(COMMENTS) + 1]
    assert own.index(lines[lines.index(COMMENTS) + 1]) > 0  # no longer the first
    assert lines[lines.index(own[0]) - 2 :][:2] == ["# of the project", ""]
    assert lines[-1] == "# looked at on Monday"
    assert run(folder, "--update-baseline").returncode == 0
    assert (folder / BASELINE).read_text() == written


def test_comments_of_the_baseline_are_kept_on_update(folder: Path) -> None:
    baseline_with(folder, "^", f"^{COMMENTS}")
    change(folder / "hopper.xml", 'mass="0.22"', 'mass="0.21"')
    assert run(folder, "--update-baseline").returncode == 0
    lines = (folder / BASELINE).read_text().splitlines()
    assert lines[-2] == COMMENTS
    assert '"mass"' in lines[-1]
    assert "0.21" in lines[-1]
    change(folder / "hopper.xml", 'mass="0.21"', 'mass="0.2"')
    assert run(folder, "--update-baseline").returncode == 0
    lines = (folder / BASELINE).read_text().splitlines()
    assert lines[-1] == COMMENTS
    assert not [line for line in lines if line.startswith("[")]


@pytest.mark.parametrize(
    "content", ["# my project\n\n## Use\n", "#!/bin/sh\n# nothing yet\n"], ids=["README", "script"]
)
@pytest.mark.parametrize("options", [(), ("--force",)], ids=["", "force"])
def test_update_baseline_refuses_a_file_that_is_no_baseline(
    folder: Path, content: str, options: tuple[str, ...]
) -> None:
    (folder / BASELINE).write_text(content)
    result = run(folder, "--update-baseline", *options)
    assert result.returncode == 2
    assert "an input of this run; give another name" in result.stderr
    assert (folder / BASELINE).read_text() == content
    with pytest.raises(OutputError, match="an input of this run"):
        pa.guard.check_repository(folder / "pupper-analysis.toml", update_baseline=True)


def test_a_baseline_edited_during_the_check_is_not_replaced(folder: Path) -> None:
    path = folder / BASELINE
    before = read_baseline(path)
    with path.open("a") as file:
        file.write(f"{COMMENTS}\n")
    with pytest.raises(OutputError, match="changed meanwhile"):
        write_baseline(path, before, before.entries)
    assert path.read_text().endswith(f"{COMMENTS}\n")


def test_joint_in_one_file_only_fails_the_check(folder: Path) -> None:
    text = (folder / "hopper.xml").read_text()
    text = text.replace('<joint name="knee" range="-2.4 -0.1"/>', "")
    (folder / "hopper.xml").write_text(
        text.replace('<position name="knee" joint="knee" kp="40"', "<!-- ").replace(
            'kv="1"/>\n  </act', "-->\n  </act"
        )
    )
    check = pa.guard.check_repository(folder / "pupper-analysis.toml")
    assert ("joint", "knee") in [(r.kind, r.element) for r in check.remarks if r.fails]


@pytest.mark.slow
def test_remarks_fail_from_the_severity_of_fail_on(folder: Path) -> None:
    change(folder / "pupper-analysis.toml", "start-outside-limits", "gravity-unusual")
    result = run(folder)
    assert result.returncode == 0
    assert "PASSED pupper-analysis.toml: 0 errors, 0 warnings, 2 notes, 1 known\n" in result.stdout
    assert "start-outside-limits" not in result.stdout
    shown = run(folder, "--all").stdout
    assert "note audit start-outside-limits" in shown
    assert "   hopper.urdf:4\n" in shown
    text = (folder / "pupper-analysis.toml").read_text()
    (folder / "pupper-analysis.toml").write_text(f'fail-on = "info"\n{text}')
    assert run(folder).returncode == 1
    assert run(folder, "--format", "github").stdout.count("::error ") == 2
    assert run(folder, "--update-baseline").returncode == 0
    assert run(folder).returncode == 0


def test_a_file_of_several_pairs_is_audited_once(folder: Path) -> None:
    with (folder / "pupper-analysis.toml").open("a") as file:
        file.write('[[pair]]\nname = "alone"\nurdf = "hopper.urdf"\n')
    check = pa.guard.check_repository(folder / "pupper-analysis.toml")
    audited = [remark for remark in check.remarks if remark.check == "audit"]
    assert [(r.pair, r.kind, r.file) for r in audited] == [
        ("", "start-outside-limits", "hopper.urdf")
    ]
    assert [(pair.name, pair.agree) for pair in check.pairs] == [("hopper", False), ("alone", None)]


def test_patterns_select_models_and_pair_them_by_name(folder: Path) -> None:
    for kind, suffix in (("urdf", "urdf"), ("mjcf", "xml")):
        (folder / kind).mkdir()
        for name in ("one", "two"):
            text = (folder / f"hopper.{suffix}").read_text()
            (folder / kind / f"{name}.{suffix}").write_text(text)
    (folder / "mjcf" / "part.xml").write_text("<mujocoinclude/>")
    (folder / "urdf" / "three.urdf").write_text((folder / "hopper.urdf").read_text())
    config = folder / "pupper-analysis.toml"
    config.write_text('[[pair]]\nname = "all"\nurdf = "urdf/*.urdf"\nmjcf = "mjcf/*.xml"\n')
    check = pa.guard.check_repository(config)
    assert {(pair.name, pair.agree) for pair in check.pairs} == {
        ("all/one", False), ("all/two", False), ("all/three", None)
    }  # fmt: skip
    config.write_text('[[pair]]\nname = "all"\nurdf = "**/*.urdf"\n')
    names = [pair.name for pair in pa.guard.check_repository(config).pairs]
    assert names == ["all/hopper.urdf", *(f"all/urdf/{n}.urdf" for n in ("one", "three", "two"))]
    for wrong in ('urdf = "no/*.urdf"', 'urdf = "urdf/*.urdf"\nmjcf = "mjcf/?.xml"', 'urdf = "/*"'):
        config.write_text(f'[[pair]]\nname = "all"\n{wrong}\n')
        with pytest.raises(pa.ModelError, match=r"pupper-analysis\.toml:3: "):
            pa.guard.check_repository(config)


def test_init_lists_all_models_and_refuses_an_existing_file(folder: Path) -> None:
    config = folder / "pupper-analysis.toml"
    refused = run(folder, "--init").stderr
    assert "already exists" in refused
    assert re.search(r"^  next: pupper-analysis check\b", refused, re.M)
    config.unlink()
    (folder / BASELINE).unlink()
    (folder / "scene.xml").write_text('<mujoco><include file="hopper.xml"/><worldbody/></mujoco>')
    (folder / "package.xml").write_text("<package/>")
    (folder / ".hidden").mkdir()
    (folder / ".hidden" / "old.urdf").write_text("<robot/>")
    shown = run(folder, "--init")
    assert shown.returncode == 0, shown.stderr
    assert shown.stdout.splitlines()[0].endswith(": 1 model, 1 paired")
    assert shown.stdout.splitlines()[1] == "  paired: hopper"
    (pair,) = read_config(config).pairs
    assert (pair.name, pair.urdf, pair.mjcf) == (
        "hopper", folder / "hopper.urdf", folder / "hopper.xml"
    )  # fmt: skip
    assert run(folder, "--update-baseline").returncode == 0
    assert run(folder).returncode == 0
    (folder / "mj").mkdir()
    (folder / "mj" / "hopper.xml").write_text((folder / "hopper.xml").read_text())
    assert list_pair_entries(folder) == [  # another copy elsewhere parts no pair of one folder
        {"name": "hopper", "urdf": "hopper.urdf", "mjcf": "hopper.xml"},
        {"name": "mj/hopper", "mjcf": "mj/hopper.xml"},
    ]
    empty = folder / "empty"
    empty.mkdir()
    assert "no URDF and no MJCF" in run(empty, "--init").stderr


def test_check_takes_a_folder_and_names_the_command_that_writes_a_configuration(
    folder: Path,
) -> None:
    """Reference: the same check, run in the folder."""
    within = run(folder)
    above = run(folder.parent, folder.name)
    assert (above.returncode, above.stdout.splitlines()[0]) == (
        within.returncode,
        within.stdout.splitlines()[0],
    )
    assert "audit checks a single file" in run(folder, "hopper.urdf").stderr
    both = run(folder.parent, folder.name, "--config", str(folder / "pupper-analysis.toml"))
    assert "not both" in both.stderr
    (folder / "pupper-analysis.toml").unlink()
    missing = run(folder.parent, folder.name)
    assert missing.returncode == 2
    assert f"next: pupper-analysis check {folder.name} --init" in missing.stderr
    assert run(folder.parent, folder.name, "--init").returncode == 0
    assert (folder / "pupper-analysis.toml").is_file()


def test_annotation_paths_are_relative_to_the_checkout(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever folder the job works in."""
    monkeypatch.setenv("GITHUB_WORKSPACE", str(folder.parent))
    change(folder / "hopper.xml", 'mass="0.22"', 'mass="0.25"')
    shown = run(folder, "--format", "github").stdout
    assert "::error file=repository/hopper.xml,line=16," in shown
    log = json.loads(run(folder, "--format", "sarif").stdout)
    place = log["runs"][0]["results"][0]["locations"][0]["physicalLocation"]
    assert place["artifactLocation"]["uri"] == "repository/hopper.urdf"


def test_check_writes_sarif_and_json(folder: Path) -> None:
    change(folder / "hopper.xml", 'range="-1.5 1.5"', 'range="-1.5 1.2"')
    log = json.loads(run(folder, "--format", "sarif").stdout)
    states = {r["ruleId"]: r["baselineState"] for r in log["runs"][0]["results"]}
    assert states == {"crosscheck/upper limit": "new", "crosscheck/mass": "unchanged"}
    result = run(folder, "--json", "-")
    content = json.loads(result.stdout)
    assert content["passed"] is False
    assert content["failures"] == 1
    assert [(r["kind"], r["known"]) for r in content["remarks"]] == [
        ("upper limit", False),
        ("mass", True),
    ]


# ------------------------------------------------------------------------------------- baseline


def make_remark(element: str, value: object, kind: str = "mass", file: str = "a.urdf") -> Remark:
    """Return a remark of `crosscheck` on an element with one value."""
    values = {"urdf": value}
    message = diagnose("problem", problem="text")
    return Remark("crosscheck", "a", kind, element, file, values, Severity.ERROR, message, None)


def make_baseline_entry(
    element: str, value: object, kind: str = "mass", file: str = "a.urdf"
) -> BaselineEntry:
    """Return the baseline entry of a remark from `make_remark`."""
    return BaselineEntry(("crosscheck", "a", file, kind, element), {"urdf": value})


def test_remark_is_known_only_if_all_parts_of_its_identity_match() -> None:
    known = make_baseline_entry("base", 1.0)
    for remark in (
        make_remark("hip", 1.0),
        make_remark("base", 1.0, kind="com"),
        make_remark("base", 1.0, file="b.urdf"),
    ):
        ((judged_one,), stale) = mark_known_remarks([remark], [known])
        assert not judged_one.known
        assert stale == (known,)
    assert mark_known_remarks([make_remark("base", 1.0)], [known])[0][0].known


def test_each_baseline_entry_matches_one_remark_of_equal_value() -> None:
    """A second remark with the same value is new; an entry without a remark is stale."""
    remarks = [make_remark("base", value) for value in (1.0, 2.0, 3.0, 2.0)]
    found, stale = mark_known_remarks(
        remarks, [make_baseline_entry("base", value) for value in (2.0, 5.0, 3.0)]
    )
    assert [remark.known for remark in found] == [False, True, True, False]
    assert stale == (make_baseline_entry("base", 5.0),)


@pytest.mark.parametrize(
    ("one", "two", "expected"),
    [
        (1.0, 1.0 + 1e-9, True),
        (1.0, 1.0 + 1e-5, False),
        (1.0, -1.0, False),
        ([[1.0, 0.0], [0.0, 1e-9]], [[1.0, 0.0], [0.0, 0.0]], True),
        ([1.0, 2.0], [1.0, 2.0, 3.0], False),
        ([1.0, 2.0], [2.0, 1.0], False),
        (["leader", 1.0, 0.0], ["other", 1.0, 0.0], False),
        (["leader", 1e6, 1.0], ["leader", 1e6, 1.1], False),
        ([{"values": [1.0]}], [{"values": [1.0 + 1e-9]}], True),
        ({"urdf": 4.4}, {"urdf": 4.4 * (1 + 1e-15)}, True),
        ({"stiffness": 1.0}, {"stiffness": 2.0}, False),
        ({"urdf": 4.4}, {"urdf": [4.4, 1.0]}, False),
        ({"urdf": 4.4}, {"urdf": "4.4"}, False),
        (float("inf"), float("inf"), True),
        (float("inf"), 1e300, False),
        (float("nan"), float("nan"), True),
        (True, 1.0, False),
        (0.0, 1e-12, False),
    ],
)
def test_values_agree_within_rounding(one: object, two: object, expected: bool) -> None:
    """Cases by hand: numbers within a relative 1e-6, nested values, infinities and NaN."""
    assert values_agree(one, two) is expected
    assert values_agree(two, one) is expected


def test_baseline_is_sorted_and_describes_its_entries(folder: Path) -> None:
    change(folder / "hopper.xml", 'range="-1.5 1.5"', 'range="-1.5 1.2"')
    change(folder / "hopper.xml", 'range="-2.4 -0.1"', 'range="-2.4 -0.2"')
    run(folder, "--update-baseline")
    text = (folder / BASELINE).read_text()
    assert text.split("\n\n")[1].splitlines() == [
        '["crosscheck", "hopper", "hopper.urdf", "mass", "knee", {"urdf": 0.2, "mjcf": 0.22}]',
        '["crosscheck", "hopper", "hopper.urdf", "upper limit", "hip", {"urdf": 1.5, "mjcf": 1.2}]',
        '["crosscheck", "hopper", "hopper.urdf", "upper limit", "knee", '
        '{"urdf": -0.1, "mjcf": -0.2}]',
    ]
    run(folder, "--update-baseline")
    assert (folder / BASELINE).read_text() == text


@pytest.mark.parametrize(
    ("code", "values", "severity"),
    [
        ("simulation-changed", {"falls": True}, Severity.ERROR),
        ("simulation-changed", {"diverges": True}, Severity.ERROR),
        ("simulation-changed", {"falls": False}, Severity.WARNING),
        ("simulation-unchanged", {"falls": True}, Severity.NOTE),
    ],
)
def test_a_change_is_an_error_if_the_new_version_falls_or_diverges(
    code: str, values: dict[str, bool], severity: Severity
) -> None:
    """A message that the simulation is unchanged does not count."""
    message: Any = SimpleNamespace(code=code, values=values)
    assert _get_change_severity((message,)) is severity


NAMES = st.text(st.characters(codec="utf-8"), max_size=12)
ENTRIES = st.lists(
    st.builds(
        BaselineEntry,
        st.tuples(NAMES, NAMES, NAMES, NAMES, NAMES),
        st.dictionaries(
            st.sampled_from(["urdf", "mjcf", "code"]),
            st.floats(allow_nan=False) | NAMES | st.lists(st.floats(allow_nan=False), max_size=3),
        ),
    ),
    max_size=6,
)


@pytest.mark.slow
@settings(max_examples=30)
@given(entries=ENTRIES)
def test_baseline_is_read_as_it_was_written(
    entries: list[BaselineEntry], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Names and texts contain any characters, also ends of lines and comment signs."""

    def listed(entries: Iterable[BaselineEntry]) -> list[str]:
        return sorted(str((entry.identity, dict(entry.values))) for entry in entries)

    path = tmp_path_factory.getbasetemp() / "known.txt"
    path.unlink(missing_ok=True)
    write_baseline(path, read_baseline(path), entries)
    back = read_baseline(path)
    assert listed(back.entries) == listed(entries)
    write_baseline(path, back, reversed(back.entries))
    assert read_baseline(path).entries == back.entries


def test_baseline_values_have_no_digits_of_rounding() -> None:
    assert to_rounded_plain(np.float64(0.1 + 0.2)) == 0.3
    assert to_rounded_plain(np.array([1.0, 1e-17, -0.0])) == [1.0, 0.0, 0.0]
    assert to_rounded_plain((np.int64(3), "x", None, -0.0)) == [3, "x", None, 0.0]
    assert to_rounded_plain({"rest": np.array([1 / 3])}) == {"rest": [0.333333333]}


@pytest.mark.parametrize("other", [[4.4, 1.0], [], {"a": 4.4}, "4.4", True])
def test_number_does_not_agree_with_a_value_of_another_kind(other: object) -> None:
    """A person may write such a value into a baseline."""
    assert not values_agree({"urdf": 4.4}, {"urdf": other})
    assert not values_agree({"urdf": other}, {"urdf": 4.4})
    assert values_agree({"urdf": 4.4}, {"urdf": 4.4 * (1 + 1e-15)})


def test_robot_in_memory_is_refused_in_place_of_a_configuration() -> None:
    text = (ROOT / "mjcf" / "pupper_v3.xml").read_text()
    with pytest.raises(pa.ConfigurationError, match="config: this robot in memory"):
        pa.guard.check_repository(text)


def test_first_configuration_names_the_models_that_fit_into_the_line(tmp_path: Path) -> None:
    names = [f"robot_number_{number}" for number in range(9)]
    for name in names:
        (tmp_path / f"{name}.urdf").write_text('<robot name="a"><link name="a"/></robot>')
    first, second, third = run(tmp_path, "--init").stdout.splitlines()
    assert first == "WRITTEN pupper-analysis.toml: 9 models, no pair of a URDF and an MJCF"
    assert second == f"  URDF without an MJCF of the same name: {', '.join(names[:3])} and 6 more"
    assert len(second) <= 100
    assert third == "  next: pupper-analysis check"


def test_answer_names_the_cause_once_and_the_repair(tmp_path: Path) -> None:
    """A refused file has its place once; exchanged limits precede the resulting differences."""
    (tmp_path / "none.urdf").write_text(
        '<?xml version="1.0"?>\n<robot>\n<link name="a"/>\n</robot>'
    )
    assert (
        run(tmp_path, "--init").stdout.splitlines()[1]
        == "  URDF without an MJCF of the same name: none"
    )
    lines = run(tmp_path).stdout.splitlines()
    assert lines[1].startswith("  first: none.urdf:2: the robot has no name")
    (tmp_path / "none.urdf").unlink()
    (tmp_path / "pupper-analysis.toml").unlink()
    files = write_parts(tmp_path, quadruped(), quadruped())
    text = files.urdf.read_text()
    start = text.index("<limit", text.index('<joint name="hip1"'))
    line = text[: text.index("lower=", start)].count("\n") + 1
    limit = text[start : text.index("/>", start)]
    exchanged = limit.replace("lower", "low").replace("upper", "lower").replace("low=", "upper=")
    files.urdf.write_text(text.replace(limit, exchanged, 1))
    assert run(tmp_path, "--init").stdout.splitlines()[1] == "  paired: robot"
    lines = run(tmp_path).stdout.splitlines()
    assert lines[1].startswith(f"  first: robot.urdf:{line}: hip1: lower limit is ")
    assert lines[2] == "  next: pupper-analysis audit robot.urdf --fix"
    answer("audit", "robot.urdf", "--fix", "--yes", folder=tmp_path)
    assert run(tmp_path).returncode == 0


def test_passed_check_names_the_model_that_is_paired_with_no_urdf(tmp_path: Path) -> None:
    """A URDF and an MJCF with other names are not compared."""
    files = write_parts(tmp_path, quadruped(), quadruped())
    files.mjcf.rename(tmp_path / "scene.xml")
    run(tmp_path, "--init")
    lines = run(tmp_path).stdout.splitlines()
    counts = "0 errors, 2 warnings, 2 notes"
    remark = "no pair in 2 files: nothing compared"
    assert lines[0] == f"PASSED pupper-analysis.toml: {counts}; {remark}"
    assert lines[1].startswith("  first: robot.urdf:129: foot0: no <inertial>: ")
    write_parts(tmp_path, quadruped(), quadruped())
    (tmp_path / "pupper-analysis.toml").unlink()
    run(tmp_path, "--init")
    lines = run(tmp_path).stdout.splitlines()
    assert lines[1].endswith("; paired with no URDF, so not compared: scene.xml")


def test_next_command_has_the_packages_of_the_configuration_and_the_language(
    tmp_path: Path,
) -> None:
    """The proposed audit of a file finds the meshes that `check` finds."""
    text = (ROOT / "urdf" / "pupper_v3.urdf").read_text()
    text = re.sub(r"<(visual).*?</visual>", "", text, flags=re.DOTALL)
    mesh = '<visual><geometry><mesh filename="package://dog/foot.stl"/></geometry></visual></link>'
    lost = mesh.replace("package://dog/foot.stl", "none.stl")
    for shape in (mesh, lost):
        text = text.replace("</link>", shape, 1)
    (tmp_path / "robot.urdf").write_text(text)
    folder = tmp_path / "some folder"
    folder.mkdir()
    (folder / "foot.stl").write_text("")
    lines = run(tmp_path, "--init", "--language", "zh").stdout.splitlines()
    assert lines[2] == "  下一步：pupper-analysis check --language zh"
    config = tmp_path / "pupper-analysis.toml"
    config.write_text(f'{config.read_text()}packages = {{ dog = "some folder" }}\n')
    lines = run(tmp_path).stdout.splitlines()
    step = "audit robot.urdf --package 'dog=some folder'"
    assert lines[2] == f"  next: pupper-analysis {step}"
    found = answer(*shlex.split(step), folder=tmp_path).stdout
    assert "none.stl" in found
    assert "--package dog=DIR" not in found


def test_next_command_after_warnings_is_audit_of_the_file(tmp_path: Path) -> None:
    """`stand` was proposed for a URDF whose missing meshes are a warning, and was refused.

    The URDF of v3 without its visual meshes has no finding.
    """
    text = (ROOT / "urdf" / "pupper_v3.urdf").read_text()
    text = re.sub(r"<(visual).*?</visual>", "", text, flags=re.DOTALL)
    mesh = '<visual><geometry><mesh filename="none.stl"/></geometry></visual></link>'
    file = tmp_path / "robot.urdf"
    for written, step in ((text, "stand"), (text.replace("</link>", mesh, 1), "audit")):
        file.write_text(written)
        run(tmp_path, "--init")
        lines = run(tmp_path).stdout.splitlines()
        assert lines[0].startswith("PASSED")
        assert lines[2] == f"  next: pupper-analysis {step} robot.urdf"
        (tmp_path / "pupper-analysis.toml").unlink()
