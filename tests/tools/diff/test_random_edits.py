"""Random edits of contacts, options, keyframes and pairs: reports of `diff` compared with bare
MuJoCo. Robots are random; public robots are in `tests/robots`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.random_edits import MAX_HARMLESS_DIFFERENCE, compute_answers
from tests.support.random_legged import draw_robot, write_robot
from tests.support.repository import ROOT


@pytest.mark.slow
def test_random_edits_of_v3_are_reported(tmp_path: Path) -> None:
    """Reference: distance between two rollouts of bare MuJoCo; at least one edit changes the
    motion.
    """
    found = compute_answers(ROOT / "mjcf/pupper_v3.xml", 8, 0, tmp_path)
    assert not [answer for answer in found if not answer.right]
    assert any(answer.truth > MAX_HARMLESS_DIFFERENCE for answer in found)


@pytest.mark.slow
def test_random_structural_edits_are_reported(tmp_path: Path) -> None:
    """Classes, the compiler, memory, keyframes, parts that are included, attached or repeated.

    Reference: distance between two rollouts of bare MuJoCo.
    """
    (tmp_path / "drawn").mkdir()
    source = write_robot(draw_robot(44), tmp_path / "drawn").mjcf
    found = compute_answers(source, 10, 0, tmp_path, structure=True)
    assert not [answer for answer in found if not answer.right]
    assert any(answer.truth > MAX_HARMLESS_DIFFERENCE for answer in found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [44, 46])
def test_random_edits_of_a_random_robot_are_reported(tmp_path: Path, seed: int) -> None:
    """Reference: distance between two rollouts of bare MuJoCo; at least one edit changes the
    motion.
    """
    (tmp_path / "drawn").mkdir()
    source = write_robot(draw_robot(seed), tmp_path / "drawn").mjcf
    found = compute_answers(source, 12, 1000 * seed, tmp_path)
    assert not [answer for answer in found if not answer.right]
    assert any(answer.truth > MAX_HARMLESS_DIFFERENCE for answer in found)
