"""Random legged robots, published in all kinds of ways: they stand, or it is said why not."""

from __future__ import annotations

from pathlib import Path

import pytest
import random_legged

import pupper_analysis as pa

QUICK = (3, 7, 8, 12, 14, 21, 36, 39, 104)
"""Seeds of one robot of each kind: springs, tails, hexapods, bipeds; free, held and fused bases; a
foot that leans in the start pose."""


def outcome(seed: int, folder: Path) -> str:
    """Returns ``holds``, or why not; what the files are, is told by the seed."""
    drawn = random_legged.drawn(seed)
    pair = random_legged.written(drawn, folder)
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    legs = {link.name for link in drawn.links if link.shape and link.joint != "wag"}
    assert len(robot.soles) == len(legs)
    run = pa.verify_stand(robot, pa.sunk_stand(robot))
    if run.passed:
        assert run.torque_error < 1e-3
        return "holds"
    return " ".join(map(str, [*run.failures, *robot.notes]))


def check(seed: int, folder: Path) -> None:
    found, drawn = outcome(seed, folder), random_legged.drawn(seed)
    if drawn.motors == "position" and found != "holds":
        assert "own servos" in found
        assert "--kp" in found
    else:
        assert found == "holds", (seed, drawn.said)


@pytest.mark.slow
@pytest.mark.parametrize("seed", QUICK)
def test_a_random_robot_stands_as_published_or_says_why_not(seed: int, tmp_path: Path) -> None:
    check(seed, tmp_path)


def test_the_quick_ones_are_of_all_kinds() -> None:
    said = {word for seed in QUICK for word in random_legged.drawn(seed).said}
    kinds = {"springs", "free", "held", "fused", "motor", "position", "none", "general"}
    legs = {"2 legs of 6", "4 legs of 3", "4 legs of 4", "4 legs of 6", "6 legs of 3"}
    assert kinds | legs <= said


@pytest.mark.longest
@pytest.mark.parametrize("start", range(100, 140, 10))
def test_random_robots_stand_as_published_or_say_why_not(start: int, tmp_path: Path) -> None:
    for seed in range(start, start + 10):
        folder = tmp_path / str(seed)
        folder.mkdir()
        check(seed, folder)
