"""Printed documents in cases that no golden document contains."""

from __future__ import annotations

from types import SimpleNamespace as Stub

import pytest

from pupper_analysis.present.document import Document
from pupper_analysis.simulation.verdict import judge_stance
from pupper_analysis.tools.analyze import document as comparison
from pupper_analysis.tools.stand.document import stance_document
from tests.support import printing
from tests.support.stubs import ANALYSIS, SERVOS, STAND, problem, run, stance


def print_words(shown: Document) -> list[str]:
    """The words that are printed, without rules and bars."""
    text = printing.printed(shown, width=240)
    return [word for word in text.split() if word.strip("─█▏▎▍▌▋▊▉")]


def test_comparison_row_fields_come_from_the_analysis() -> None:
    """Reference: a stub with distinct values, so exchanged fields and inverted ratios are found."""
    stub = Stub(**{**vars(ANALYSIS), "stand": Stub(task=Stub(height=0.1234))})
    found = vars(comparison.compare_with_base(stub, "v3", 1.5, 0.05))
    words = {"name": "stub", "base": "v3", "stands_without": False, "verified": False}
    numbers = {
        **{"total_mass": 3.171, "mass_ratio": 2.114, "thigh_ratio": 1.622},
        **{"height": 0.1234, "peak_torque": 0.2222},
        **{"peak_utilisation": 0.952, "servo_sag": 0.011555},
    }
    assert {key: found[key] for key in found if key not in numbers} == {**words, "converted": ""}
    assert {key: found[key] for key in numbers} == pytest.approx(numbers)


def test_stance_document_states_why_a_stance_fails() -> None:
    failing = stance(
        passed=False,
        verification=run(0.0, passed=False),
        stand=STAND,
        settled=None,
        unsettled=problem("why"),
        verdict=judge_stance(run(0.0, passed=False), None, SERVOS),
        minimum_stiffness=None,
        presses=(),
    )
    text = " ".join(print_words(stance_document(failing)))
    assert text.startswith(
        "FAILS stub: FAILS in MuJoCo: it sank "
        "largest motor load 0.22 N m = 95 % of the limit (knee), base height 104.4 mm on rigid"
    )
    assert "without feed-forward, no sag is predicted: why" in text
    assert (
        "compensated for contact penetration it would be out of reach: simulated with joints"
        in text
    )
    assert "HOLDS" not in text
