"""Ties of an arm to the world in a study of gains: same verdict and words as `hold`."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.present.document import get_english
from pupper_analysis.tools.gains.document import gains_document
from pupper_analysis.tools.gains.gains import study_gains
from tests.support import arm


@pytest.mark.parametrize(
    ("offset", "servos", "word", "codes"),
    [
        (0.0, arm._SERVOS, "STABLE", ["link-tied"]),
        (0.2, arm._SERVOS, "DISAGREES", ["keyframe-violates-constraints", "link-tied"]),
        (0.0, arm.SOFT_SERVOS, "FAILS", ["link-tied"]),
    ],
    ids=["tied", "keyframe beside the tie", "soft servos"],
)
def test_tie_of_the_hand_is_named(
    tmp_path: Path, offset: float, servos: str, word: str, codes: list[str]
) -> None:
    """Reference: ``tests/tools/hold/test_ties.py`` compares the same arms with bare MuJoCo."""
    robot = arm.write_tied_arm(tmp_path, "weld", {"a_turn": offset}, servos, base_mass=1.0)
    task = pa.StandTask(contacts={"base": pa.Weld()})
    study = study_gains(robot, task)
    assert [tie.code for tie in study.ties] == codes
    assert study.passed is (word == "STABLE")
    document = gains_document(study)
    assert document.verdict is not None
    assert get_english(document.verdict) == word
    shown = document.findings[1] if study.passed else document.failures[0]
    assert "bolt" in shown.short
    assert "bolt" in shown.zh


def test_arm_without_a_tie_has_no_message(tmp_path: Path) -> None:
    robot = arm.write_tied_arm(tmp_path, "weld", {}, base_mass=1.0)
    path = tmp_path / "arm.xml"
    path.write_text(path.read_text().replace('name="bolt"', 'name="bolt" active="false"'))
    robot = pa.load_robot(path)
    task = pa.StandTask(contacts={"base": pa.Weld()})
    study = study_gains(robot, task)
    assert study.ties == ()
    assert study.passed
