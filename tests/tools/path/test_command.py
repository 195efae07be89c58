"""Command `path`: a goal that equals the start stance is refused."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from unittest import mock

import pytest

from pupper_analysis.tools.path import tracking
from tests.support.commands import answer


@pytest.mark.slow
def test_path_without_a_goal_is_refused_with_a_height_that_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: the proposed command, which moves the base to 90 % of its height.

    The refusal needs no simulation of the path, which takes 5 s.
    """
    with monkeypatch.context() as patch:
        patch.setattr(tracking, "track_path", mock.Mock(side_effect=AssertionError))
        found = answer("path", "v3", folder=tmp_path)
    assert found.returncode == 2
    assert found.stderr.splitlines()[0].startswith("error: v3: no goal, so nothing moves: ")
    (step,) = re.findall(r"next: pupper-analysis (.+)", found.stderr)
    assert step == "path v3 --height 118mm"
    moved = answer(*shlex.split(step), folder=tmp_path)
    assert moved.returncode == 0
    assert moved.stdout.startswith("TRACKED v3: joint error ")
