"""No two commands disagree: a sample of ``tests.support.agreement``, which tries more robots."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import agreement


@pytest.mark.parametrize("seed", [None, 910, 903])
def test_what_one_command_prints_others_confirm(seed: int | None, tmp_path: Path) -> None:
    """Of a variant, of a random pair, and of a random URDF alone, which is converted, too."""
    name, files = "v3", ("v3",)
    if seed is not None:
        [(name, files)] = agreement.random_robots(seed, 1, tmp_path)
    place = tmp_path / "answers"
    place.mkdir()
    found = agreement.of_robot(name, place, *files)
    assert not found.disagreements, found.codes
    stood = found.codes["stand"]
    assert not stood.startswith("exit"), stood  # a robot that is refused proves nothing
    assert ("converted, 8deg" in found.codes) is (len(files) == 1 and seed is not None)
