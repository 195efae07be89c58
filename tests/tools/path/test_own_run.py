"""The verdict of a path contains the simulation of the unmodified file."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.prepare.own_run import own_run
from pupper_analysis.present.verdict import split_verdict_lines
from pupper_analysis.simulation.verdict import Question, Verdict
from pupper_analysis.tools.path.tracking import study_path
from tests.prepare.test_imported import four_legs
from tests.prepare.test_own_run import codes, slipped


def judge_path(robot: pa.Robot) -> Verdict:
    """Return the verdict of a path of 1 s to a height of 0.33 m."""
    return study_path(robot, pa.StandTask(height=0.33), 1.0).verdict


@pytest.mark.slow
def test_verdict_of_a_tracked_path_reports_the_keyframe_run(tmp_path: Path) -> None:
    verdict = judge_path(slipped(tmp_path, lambda text: text + "\n"))
    assert verdict.question is Question.TRACKED
    assert verdict.passed
    assert codes(verdict)[-1] == "own-run"
    # The run supports the verdict, so it is a detail of the answer.
    _, details = split_verdict_lines(verdict)
    assert any("unmodified MJCF" in str(line) for line in details)


@pytest.mark.slow
def test_keyframe_run_of_a_path_equals_that_of_the_robot(tmp_path: Path) -> None:
    robot = pa.load_robot(four_legs(tmp_path))
    found = judge_path(robot)
    assert found.keyframe_run == own_run(robot)
    assert "own-run" in codes(found)
