"""Changes since a revision, reported by `check` with line and effect."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Severity
from pupper_analysis.base.errors import ModelError
from tests.support.one_place_edits import FALLS, FELT, HARMLESS, copy_mjcf
from tests.support.repository import ROOT

CONFIG = """\
[[pair]]
name = "v3"
urdf = "urdf/pupper_v3.urdf"
mjcf = "mjcf/pupper_v3.xml"
"""


def git(folder: Path, *arguments: str) -> None:
    named = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    subprocess.run(["git", *named, *arguments], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a repository with v3 in it, committed."""
    copy_mjcf(tmp_path)
    (tmp_path / "urdf").mkdir()
    shutil.copy(ROOT / "urdf/pupper_v3.urdf", tmp_path / "urdf")
    (tmp_path / "pupper-analysis.toml").write_text(CONFIG)
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "-qm", "first")
    return tmp_path


def check(folder: Path, since: str | None = "HEAD") -> pa.guard.RepositoryCheck:
    """Return the check of the repository, with changes since a revision."""
    return pa.guard.check_repository(folder / "pupper-analysis.toml", since=since)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FELT, *HARMLESS])
def test_each_edit_is_reported_at_its_line_with_its_effect(folder: Path, name: str) -> None:
    """Reference: the lists FELT, HARMLESS and FALLS of edits, by their effect in bare MuJoCo."""
    edit = (FELT | HARMLESS)[name]
    edit.written(folder / "mjcf")
    result = check(folder)
    messages = [remark for remark in result.remarks if remark.check != "audit"]
    assert any(str(remark.place).endswith(f"{edit.file}:{edit.line}")
               or str(remark.other_place).endswith(f"{edit.file}:{edit.line}")
               for remark in messages)  # fmt: skip
    changes = [remark for remark in messages if remark.check == "diff"]
    assert changes
    worst = min(remark.severity.rank for remark in changes)
    felt = Severity.ERROR if name in FALLS else Severity.WARNING
    assert worst == (felt if name in FELT else Severity.NOTE).rank
    assert result.passed is not (name in FALLS or bool(edit.urdf))
    codes = {
        message.code for remark in changes for message in (remark.diagnostic, *remark.consequences)
    }
    assert ("simulation-changes" in codes) is (name in FELT)
    if not edit.urdf and name not in FALLS:
        assert check(folder, None).passed  # no file contradicts it: history alone does


@pytest.mark.slow
def test_change_since_a_revision_is_not_written_to_the_baseline(folder: Path) -> None:
    FELT["floor"].written(folder / "mjcf")
    config = folder / "pupper-analysis.toml"
    result = pa.guard.check_repository(config, update_baseline=True, since="HEAD")
    assert not result.passed
    assert '["diff"' not in (folder / "pupper-analysis-baseline.txt").read_text()
    assert not check(folder).passed
    git(folder, "commit", "-qam", "meant")
    assert check(folder).passed


@pytest.mark.slow
def test_new_file_or_unreadable_old_version_has_no_history(folder: Path) -> None:
    (folder / "mjcf/pupper_v3.xml").write_text("<mujoco>")
    git(folder, "commit", "-qam", "broken")
    shutil.copy(ROOT / "mjcf/pupper_v3.xml", folder / "mjcf")
    FELT["floor"].written(folder / "mjcf")
    assert not [remark for remark in check(folder).remarks if remark.check == "diff"]


@pytest.mark.slow
def test_unknown_revision_is_refused(folder: Path) -> None:
    for revision in ("no-such", "--output=x"):
        with pytest.raises(ModelError):
            check(folder, revision)
