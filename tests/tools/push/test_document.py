"""What the page of pushes says in cases that no golden document has."""

from __future__ import annotations

import numpy as np
import pytest

from pupper_analysis.present import document as doc
from pupper_analysis.present.html.plots import draw_svg
from pupper_analysis.simulation.verdict import judge_stance
from pupper_analysis.tools.push.document import DirectionPlot, push_document
from tests.support import printing
from tests.support.stubs import SERVOS, problem, pushed, run


def printed(shown: object) -> list[str]:
    return printing.printed(shown, width=240).split()


def test_pushes_of_what_fails_are_told_with_its_verdict() -> None:
    """It stands, and not as predicted: limits are told, and so is that `stand` fails."""
    one = pushed("one", 0.0, 0.00311)
    one.verdict, one.passed = judge_stance(run(0.0, passed=False), None, SERVOS), False
    text = " ".join(printed(push_document(one)))
    assert text.startswith("FAILS one: FAILS in MuJoCo: ")
    assert "weakest at 240°, on the simulated ground: 0.43 N s" in text
    one.recovery.unpushed = (problem("it fell over"),)
    text = " ".join(printed(push_document(one)))
    assert "it does not stand, so it withstands no push of 2.15 kg" in text
    assert "weakest" not in text


def test_directions_are_as_seen_from_above() -> None:
    """Forward is up, left is left."""
    around = doc.Series(
        doc.Name("a"), np.radians([0.0, 90.0, 180.0, 270.0]), [1.11, 2.22, 3.33, 4.44]
    )
    drawing = draw_svg(
        DirectionPlot(doc.Name("t"), doc.Axis(doc.Name("impulse"), "N s", ".2f"), [around])
    )
    drawn = next(mark for mark in drawing.marks if mark["tag"] == "polygon" and "labels" in mark)
    ahead, left, back, right = drawn["points"]
    assert ahead[1] < left[1] == pytest.approx(right[1])
    assert back[1] > right[1]
    assert left[0] < ahead[0] == pytest.approx(back[0])
    assert right[0] > back[0]
