"""The document of a path."""

from __future__ import annotations

from pupper_analysis.simulation.verdict import Question
from pupper_analysis.tools.path.document import path_document
from tests.support.printing import printed
from tests.support.stubs import ADDED_SERVOS_TEXT, judge_added_servos, make_path_result


def test_path_states_that_its_servos_were_added() -> None:
    result = make_path_result(verdict=judge_added_servos(Question.TRACKED))
    assert ADDED_SERVOS_TEXT in " ".join(printed(path_document(result), width=240).split())


def test_error_of_a_slide_is_a_length() -> None:
    """The stub deviates by 0.034 m; as an angle in rad, it would be 1.95 degrees."""
    result = make_path_result()
    result.tracking.joint_error_unit = "m"
    (row,) = [line for line in printed(path_document(result)).splitlines() if "34.0" in line]
    assert "mm" in row
