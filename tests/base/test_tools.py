"""Search for entry points of other packages, compared with ``importlib.metadata``."""

from __future__ import annotations

import zipfile
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from pupper_analysis.base.tools import _find_plugins, _may_have_entry_points


def test_groups_of_installed_packages_are_found_in_their_files() -> None:
    """Reference: the groups that ``importlib.metadata`` returns."""
    groups = entry_points().groups
    assert "console_scripts" in groups
    assert all(map(_may_have_entry_points, groups))
    assert not _may_have_entry_points("group_that_no_package_has")


def test_packages_in_archives_are_left_to_importlib(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files in archives are not read, so they may contain any group."""
    archive = tmp_path / "packages.zip"
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("a-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: a\nVersion: 1.0\n")
        file.writestr("a-1.0.dist-info/entry_points.txt", "[group_of_an_archive]\na = a\n")
    monkeypatch.syspath_prepend(str(archive))
    assert _may_have_entry_points("group_of_an_archive")
    assert [point.name for point in entry_points(group="group_of_an_archive")] == ["a"]


def test_entry_point_of_a_missing_package_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``find_spec`` raises an error if the parent of a nested package is missing."""
    metadata = tmp_path / "a-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: a\nVersion: 1.0\n")
    points = "[group_of_missing_packages]\none = no_such_package\ntwo = no_such_package.tool\n"
    (metadata / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert _find_plugins("group_of_missing_packages", "command.py") == {}
