"""Random edits of five robots of others, as MJCFs: what `diff` says of each beside bare MuJoCo."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.robots.test_real_robots import MJCF, file
from tests.support.random_edits import answers


@pytest.mark.slow
@pytest.mark.parametrize("name", ["go2", "aliengo", "mini_cheetah", "spot", "hyqreal1"])
def test_random_edits_of_public_robots_are_reported(tmp_path: Path, name: str) -> None:
    found = answers(file(MJCF, f"{name}/{name}.xml"), 20, 0, tmp_path)
    assert len(found) == 20
    assert not [one for one in found if not one.right]
