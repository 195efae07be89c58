"""Both sides of a sync are written, or neither."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.tools.sync.models import as_given, stage_files
from pupper_analysis.tools.sync.xml_bytes import read_document
from tests.base.test_files_at_once import contents, deny, fails_at
from tests.support.robots import changed, quadruped, write_parts


@pytest.mark.parametrize("problem", ["read-only", "full"])
def test_sync_of_both_sides_is_all_or_nothing(
    problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The URDF was rewritten already when the MJCF could not be."""
    robot = quadruped()
    other = changed(changed(robot, "base", mass=7.0), "thigh1", damping=0.3)
    files = write_parts(tmp_path, robot, other)
    before = contents(tmp_path)
    if problem == "read-only":
        monkeypatch.setattr(os, "access", deny(files.mjcf.resolve()))
    else:
        fails_at(files.mjcf.name, monkeypatch, OSError(errno.ENOSPC, "No space left on device"))
    take = ["mjcf:link base: mass", "urdf:damping"]
    with pytest.raises(pa.OutputError) as raised:
        pa.sync_models(files.urdf, files.mjcf, take=take)
    assert str(files.mjcf) in str(raised.value)
    assert contents(tmp_path) == before


def test_what_cannot_be_tried_is_said_of_the_file_that_was_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = write_parts(tmp_path, quadruped(), changed(quadruped(), "base", mass=7.0))

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("pupper_analysis.tools.sync.models.write_new", full)
    with pytest.raises(pa.OutputError) as raised:
        pa.sync_models(files.urdf, files.mjcf, take="urdf", dry_run=True)
    assert raised.value.path == files.mjcf
    assert f".{files.mjcf.stem}-" not in str(raised.value)


def test_hidden_trial_files_are_called_by_the_names_that_were_given(tmp_path: Path) -> None:
    files = write_parts(tmp_path, quadruped(), changed(quadruped(), "base", mass=7.0))
    document = read_document(files.mjcf)
    document.root.set("model", "another")
    with stage_files({files.mjcf: document}) as (trial,):
        assert trial != files.mjcf
        assert as_given(f"{trial}:3: no such body") == f"{files.mjcf}:3: no such body"
        assert as_given(f"Error opening '{trial.name}'") == f"Error opening '{files.mjcf.name}'"
