"""Random edits of five public robots' MJCFs: what `diff` reports, compared with bare MuJoCo."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.robots.test_real_robots import MJCF, file
from tests.support.random_edits import compute_answers

SEEDS = {
    "go2": range(4, 8),
    "aliengo": range(100, 110),
    "mini_cheetah": range(200, 210),
    "spot": range(304, 309),
    "hyqreal1": range(400, 410),
}
"""{robot: seeds of its edits}. The seed selects the kind of an edit, so each robot has its own
seeds: 39 edits are of 23 kinds. Edits of Go2 and Spot take six times as long as the others."""


@pytest.mark.slow
@pytest.mark.parametrize("name", SEEDS)
def test_random_edits_of_public_robots_are_reported(tmp_path: Path, name: str) -> None:
    """Reference: distance between two rollouts of bare MuJoCo, for each edit."""
    seeds = SEEDS[name]
    found = compute_answers(file(MJCF, f"{name}/{name}.xml"), len(seeds), seeds[0], tmp_path)
    assert len(found) == len(seeds)
    assert not [answer for answer in found if not answer.right]
