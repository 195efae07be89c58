"""Random edits of five public robots' MJCFs: what `diff` reports, compared with bare MuJoCo."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.robots.test_real_robots import MJCF, file
from tests.support.random_edits import answers

EDITS = 8
"""Number of edits per robot. The seed selects the kind of an edit, so each robot has its own seeds:
40 seeds cover more kinds than the same 20 seeds for every robot."""

ROBOTS = ("go2", "aliengo", "mini_cheetah", "spot", "hyqreal1")


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_random_edits_of_public_robots_are_reported(tmp_path: Path, name: str) -> None:
    """The reference is the distance between two rollouts of bare MuJoCo."""
    first = 100 * ROBOTS.index(name)
    found = answers(file(MJCF, f"{name}/{name}.xml"), EDITS, first, tmp_path)
    assert len(found) == EDITS
    assert not [answer for answer in found if not answer.right]
