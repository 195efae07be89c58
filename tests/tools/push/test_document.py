"""Documents of pushes in cases that no golden document contains."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.present.document import (
    MAX_ANSWER_WIDTH,
    Document,
    Name,
    NextStep,
    Table,
    Text,
    get_english,
    text,
)
from pupper_analysis.present.figures import drawing
from pupper_analysis.present.html.plots import BOTTOM_MARGIN, draw_svg
from pupper_analysis.present.plots import make_joint_title
from pupper_analysis.present.verdict import select_step_after_failure
from pupper_analysis.robot.as_published import Cause, Published
from pupper_analysis.simulation.verdict import Question, VerdictCode, judge_stance
from pupper_analysis.tools.push.document import push_document, push_plot
from pupper_analysis.tools.push.figures import push_figure
from tests.support import printing
from tests.support.stubs import (
    ADDED_SERVOS_TEXT,
    SERVOS,
    judge_added_servos,
    make_push_result,
    problem,
    pushes,
    run,
)


def print_words(shown: object) -> list[str]:
    return printing.printed(shown, width=240).split()


def test_push_limits_of_a_failing_stand_state_its_verdict() -> None:
    """A robot that stands, but not as predicted, has limits and FAILS; a robot that does not stand
    has no limits."""
    one = make_push_result("one", 0.0, 0.00311)
    one.verdict, one.passed = judge_stance(run(0.0, passed=False), None, SERVOS), False
    text = " ".join(print_words(push_document(one)))
    assert text.startswith("FAILS one: FAILS in MuJoCo: ")
    assert (
        "largest push in the weakest direction (240 deg; 0 deg: forward, 90 deg: left): 0.43 N s"
        in text
    )
    one.recovery.failures_without_push = (problem("the robot fell over"),)
    text = " ".join(print_words(push_document(one)))
    assert text.startswith("FAILS one: the robot does not stand, so it withstands no push ")
    assert " mass 2.15 kg " in text
    assert "weakest" not in text


def test_next_command_after_a_failure_compares_the_files_that_explain_it() -> None:
    """Two files of different robots are compared, one file is audited; else `stand` explains."""
    failures = (
        diagnose(
            "files-of-two-robots", mjcf=Quantity(2.0, "kg"), urdf=Quantity(3.0, "kg"), residual=9.0
        ),
    )
    fall = (problem("the robot fell over"),)
    pair = Published((), (Cause("pair", (), difference=fall[0]),), differs=True)
    for found, converted, published, command in (
        (failures, "", None, "crosscheck"),
        (failures, "urdf", None, "audit"),
        (fall, "", pair, "crosscheck"),
        (fall, "", None, "stand"),
    ):
        one = make_push_result("one", 0.0, 0.00311)
        outcome = run(0.0, passed=False)
        outcome.failures = found
        one.verdict = judge_stance(outcome, None, SERVOS, converted=converted, published=published)
        one.passed = False
        step = select_step_after_failure(one.verdict, NextStep("stand"))
        assert push_document(one).next_step == step
        assert step.command == command


def test_pushes_on_motors_with_unknown_limits_are_upper_bounds() -> None:
    one = make_push_result("one", 0.0, 0.00311)
    one.unknown_limits, one.peak_torques = ("knee",), np.array([9.0, 4.32])
    text = " ".join(print_words(push_document(one)))
    assert "largest push UNKNOWN without torque limits" in text
    assert "with unlimited motors 0.43 N s in the weakest direction (240 deg)" in text
    assert "up to 4.32 N m (knee)" in text
    assert "largest push in the weakest" not in text
    unknown = diagnose(
        "torque-limits-unknown",
        count=1,
        joints=["knee"],
        torque=Quantity(2.0, "N m"),
        hardest="knee",
    )
    code = VerdictCode.LIMITS_UNKNOWN
    one.verdict, one.passed = replace(one.verdict, code=code, remarks=(unknown,)), False
    first = push_document(one).failures[0]
    assert isinstance(first, Text)
    assert first.short == "0.43 N s (240 deg) with unlimited motors; the push needs 4.32 N m (knee)"


def test_limits_are_drawn_over_the_direction_once_around() -> None:
    limits, rigid = push_plot({"one": pushes(0.0)}, "one").series
    np.testing.assert_allclose(limits.x, [0.0, 120.0, 240.0, 360.0])
    np.testing.assert_allclose(limits.y, [0.51, 0.62, 0.43, 0.51])
    assert (limits.marked_index, rigid.reference) == (2, True)
    np.testing.assert_allclose(rigid.y, [0.84, 0.75, 0.96, 0.84])


def test_impulse_axis_begins_at_zero_and_the_title_states_the_duration() -> None:
    """The axis began at the smallest impulse, which exaggerated the differences."""
    plot = push_plot({"one": pushes(0.0)}, "one")
    assert get_english(plot.title).startswith("Largest push of 20 ms that the stand survives")
    drawn = draw_svg(plot)
    (zero,) = (
        mark
        for mark in drawn.marks
        if mark["tag"] == "text" and mark["anchor"] == "end" and get_english(mark["words"]) == "0"
    )
    assert zero["y"] - 4 == pytest.approx(drawn.height - BOTTOM_MARGIN)


def test_push_figure_is_written_with_white_edges(tmp_path: Path) -> None:
    path = tmp_path / "push.png"
    push_figure({"one": pushes(0.0), "two": pushes(0.1)}, path)
    pixels = imread(path)
    assert pixels.shape[1] == pytest.approx(drawing.PAGE_WIDTH * drawing.FIGURE_DPI, abs=1)
    for edge in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
        assert (edge[:, :3] == 1.0).all()  # nothing is cut off
    assert list(tmp_path.iterdir()) == [path]


def test_push_figure_is_titled_and_its_legend_rounds_limits_down() -> None:
    """Reference: a limit of 0.4384 N s, found to within 0.0004 N s, of a robot of 0.0032 kg."""
    recovery = pushes(0.0)
    recovery.weakest_impulse, recovery.resolution = 0.43849, 4e-4
    plot = push_plot({"tiny": recovery}, "tiny")
    assert str(plot.series[0].note) == str(Name("0.4384 N s"))
    documents = [
        Document(Name("Pushes"), Name(name), (), verdict=Name(verdict))
        for name, verdict in (("a", "FAILS"), ("b", "WITHSTANDS"))
    ]
    assert make_joint_title(documents[:1]) == Name("FAILS a: Pushes")
    assert make_joint_title(documents) == Name("FAILS a, WITHSTANDS b: Pushes")


def test_push_figure_of_no_robot_or_too_many_robots_is_refused(tmp_path: Path) -> None:
    with pytest.raises(pa.ConfigurationError, match="no robot"):
        push_figure({}, tmp_path / "push.png")
    with pytest.raises(pa.ConfigurationError, match="at most 6 robots"):
        push_figure({str(number): pushes(0.0) for number in range(8)}, tmp_path / "push.png")
    (tmp_path / "file").touch()
    with pytest.raises(pa.OutputError):
        push_figure({"one": pushes(0.0)}, tmp_path / "file" / "push.png")


def test_push_limit_states_that_its_servos_were_added() -> None:
    result = make_push_result("one", 0.0, 0.00311)
    result.verdict = judge_added_servos(Question.LASTS)
    assert ADDED_SERVOS_TEXT in " ".join(print_words(push_document(result)))


@pytest.mark.parametrize(
    ("resolution", "angle", "expected"),
    [
        (1.0, 90.0, "at least 90 N s, weakest to the left (90 deg), of 3 directions"),
        (0.02, 180.0, "at least 90.37 N s, weakest to the back (180 deg), of 3 directions"),
        (0.1, 240.0, "at least 90.3 N s, weakest to 240 deg, of 3 directions"),
    ],
)
def test_first_line_states_the_least_impulse_with_the_digits_of_its_resolution(
    resolution: float, angle: float, expected: str
) -> None:
    """'up to 90.31 N s' was read as the largest impulse, with hundredths at a resolution of 1 N s.

    Reference: 90.376 N s, rounded down, since a push of the printed size must not fail.
    """
    result = make_push_result("one", 0.0, 0.00311)
    result.recovery.weakest_impulse, result.recovery.weakest_direction = 90.376, np.radians(angle)
    result.recovery.resolution = resolution
    shown = printing.printed(push_document(result), width=200, everything=False)
    assert shown.splitlines()[0].endswith(expected)


def test_first_line_fits_with_a_long_name_of_a_robot() -> None:
    """Go2 from its URDF: the line had up to 117 characters."""
    values = {"rounded": "15.11", "direction": "180", "count": 12, "one": False}
    values |= {"impulse": "15.11", "speed": "0.94", "mass": "16.09"}
    values |= {side: side == "back" for side in ("front", "left", "back", "right")}
    line = text("weakest-at-directiondeg-impulse", **values).short
    assert line
    assert len(f"WITHSTANDS (URDF only) go2_description: {line}") <= MAX_ANSWER_WIDTH


def test_each_number_of_a_push_is_in_its_column() -> None:
    """References: the impulses, tipping estimates and velocity steps of the result."""
    recovery = make_push_result("one", 0.0, 0.00311).recovery
    (table,) = [
        block
        for block in push_document(make_push_result("one", 0.0, 0.00311)).blocks
        if isinstance(block, Table)
    ]
    columns = [get_english(column.name) for column in table.columns]
    assert columns == [
        "direction",
        "impulse",
        "step of velocity",
        "a rigid robot tips at",
        "failure",
    ]
    numbers = [[float(getattr(cell, "text", "nan")) for cell in row[:4]] for row in table.rows]
    expected = np.column_stack(
        [
            np.degrees(recovery.directions),
            recovery.impulses,
            recovery.velocity_steps,
            recovery.tipping_estimate,
        ]
    )
    assert numbers == [pytest.approx(row, abs=6e-3) for row in expected.tolist()]
    for first, second in combinations(range(4), 2):  # the stub distinguishes the columns
        assert np.abs(expected[:, first] - expected[:, second]).min() > 0.02
