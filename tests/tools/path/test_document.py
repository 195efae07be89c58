"""The document of a path."""

from __future__ import annotations

from pupper_analysis.simulation.verdict import Question
from pupper_analysis.tools.path.document import path_document
from tests.support.printing import printed
from tests.support.stubs import ADDED_SERVOS_TEXT, judge_added_servos, make_path_result


def test_path_states_that_its_servos_were_added() -> None:
    result = make_path_result(verdict=judge_added_servos(Question.TRACKED))
    assert ADDED_SERVOS_TEXT in " ".join(printed(path_document(result), width=240).split())
