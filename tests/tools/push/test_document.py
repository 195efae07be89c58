"""Documents of pushes in cases that no golden document contains."""

from __future__ import annotations

import numpy as np

from pupper_analysis.simulation.verdict import judge_stance
from pupper_analysis.tools.push.document import push_document, push_plot
from tests.support import printing
from tests.support.stubs import SERVOS, make_push_result, problem, pushes, run


def print_words(shown: object) -> list[str]:
    return printing.printed(shown, width=240).split()


def test_push_limits_of_a_failing_stand_state_its_verdict() -> None:
    """A robot that stands, but not as predicted, has limits and FAILS; a robot that does not stand
    has no limits."""
    one = make_push_result("one", 0.0, 0.00311)
    one.verdict, one.passed = judge_stance(run(0.0, passed=False), None, SERVOS), False
    text = " ".join(print_words(push_document(one)))
    assert text.startswith("FAILS one: FAILS in MuJoCo: ")
    assert "largest push in the weakest direction (240 deg): 0.43 N s" in text
    one.recovery.failures_without_push = (problem("it fell over"),)
    text = " ".join(print_words(push_document(one)))
    assert "it does not stand, so it withstands no push of 2.15 kg" in text
    assert "weakest" not in text


def test_pushes_on_motors_with_unknown_limits_are_upper_bounds() -> None:
    one = make_push_result("one", 0.0, 0.00311)
    one.unknown_limits, one.peak_torques = ("knee",), np.array([9.0, 4.32])
    text = " ".join(print_words(push_document(one)))
    assert "largest push UNKNOWN without torque limits" in text
    assert "withstands 0.43 N s at 240°, its weakest direction" in text
    assert "up to 4.32 N m (knee)" in text
    assert "largest push in the weakest" not in text


def test_limits_are_drawn_over_the_direction_once_around() -> None:
    limits, rigid = push_plot({"one": pushes(0.0)}, "one").series
    np.testing.assert_allclose(limits.x, [0.0, 120.0, 240.0, 360.0])
    np.testing.assert_allclose(limits.y, [0.51, 0.62, 0.43, 0.51])
    assert (limits.marked_index, rigid.reference) == (2, True)
    np.testing.assert_allclose(rigid.y, [0.84, 0.75, 0.96, 0.84])
