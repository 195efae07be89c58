"""Random legged robots in many published forms: the stand holds in MuJoCo, or the cause of the
failure is named.
"""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from tests.support import random_legged

SEEDS = (3, 7, 8, 12, 14, 21, 36, 39, *range(100, 120))
"""Seeds of one robot of each kind: springs, tails, hexapods, bipeds; free and held bases; a
foot that leans in the start pose; and 20 others. ``tests.explore`` draws new seeds."""


def outcome(seed: int, folder: Path) -> set[str]:
    """Return the codes of the causes for which a stand does not hold; an empty set if it holds."""
    drawn = random_legged.draw_robot(seed)
    pair = random_legged.write_robot(drawn, folder)
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    legs = {link.name for link in drawn.links if link.shape and link.joint != "wag"}
    assert len(robot.feet) == len(legs)
    efforts = {link.joint: link.effort for link in drawn.links}
    limits = dict(zip(robot.joint_names, robot.effort_limits, strict=True))
    for name, limit in limits.items():
        stated = efforts[name.removeprefix(drawn.prefix)]
        assert limit == pytest.approx(stated) or not stated
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    run = pa.verify_stand(robot, stand)
    if run.passed:
        assert run.torque_error < 1e-3
        return set()
    codes = {message.code for message in run.failures}
    assert codes
    return codes


def check_robot(seed: int, folder: Path) -> None:
    """Check that a random robot stands, or that servos of its file are the cause."""
    found, drawn = outcome(seed, folder), random_legged.draw_robot(seed)
    assert not found or drawn.motors == "position", (seed, drawn.said, found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_random_robot_stands_as_published_or_with_a_cause(seed: int, tmp_path: Path) -> None:
    check_robot(seed, tmp_path)


def test_seeds_draw_robots_of_all_kinds() -> None:
    """The seeds of the test above, or of a new draw, must not leave out a kind."""
    words = {word for seed in SEEDS for word in random_legged.draw_robot(seed).said}
    kinds = {"springs", "free", "held", "motor", "position", "none", "general"}
    kinds |= {"limits of motors", "limits of joints", "2 legs of 6", "4 legs of 3", "6 legs of 3"}
    assert kinds <= words
