"""Both sides of a sync are written, or neither."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

import pupper_analysis as pa
from tests.base.test_files import contents, deny, fails_at
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
