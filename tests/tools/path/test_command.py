"""Command `path`: a goal that equals the start stance is refused."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from tests.support.commands import answer


@pytest.mark.slow
def test_path_without_a_goal_is_refused_with_a_height_that_moves(tmp_path: Path) -> None:
    """Reference: the proposed command, which moves the base to 90 % of its height."""
    found = answer("path", "v3", folder=tmp_path)
    assert found.returncode == 2
    assert found.stderr.splitlines()[0].startswith("error: v3: no goal, so nothing moves: ")
    (step,) = re.findall(r"next: pupper-analysis (.+)", found.stderr)
    assert step == "path v3 --height 118mm"
    moved = answer(*shlex.split(step), folder=tmp_path)
    assert moved.returncode == 0
    assert moved.stdout.startswith("TRACKED v3: joint error ")
