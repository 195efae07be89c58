"""Documents of payload limits."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.present.document import (
    MAX_ANSWER_WIDTH,
    BarPlot,
    Table,
    Text,
    get_english,
    text,
)
from pupper_analysis.robot.plane import Weld
from pupper_analysis.simulation.trial import Failure
from pupper_analysis.simulation.verdict import Question
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.payload.document import payload_document, payload_text
from tests.present.test_printed import print_words
from tests.support.printing import printed
from tests.support.stubs import (
    ADDED_SERVOS_TEXT,
    Stub,
    judge_added_servos,
    make_payload_result,
)


def test_motors_without_a_limit_are_named() -> None:
    document = payload_document(make_payload_result("hip", "knee"))
    text = " ".join(print_words(document))
    assert text.startswith("UNKNOWN stub")
    shorts = [
        line.short for line in document.failures + document.findings if isinstance(line, Text)
    ]
    assert "1.23 kg with unlimited motors" in shorts
    sentence = (
        "Motors without a torque limit in the files, which these bounds ignore: 2 (hip, knee)."
    )
    assert sentence in text
    assert "all other bounds allow 1.23 kg, which requires motor torques up to 2 N m (knee)" in text
    assert "Motors without a torque limit" not in " ".join(
        print_words(payload_document(make_payload_result()))
    )


def test_bars_and_table_round_the_payload_down_alike() -> None:
    """The bars were rounded to the nearest 0.01 kg: 1.239 kg was 1.24, above the limit."""
    blocks = payload_document(make_payload_result()).blocks
    (table,) = (block for block in blocks if isinstance(block, Table))
    (plot,) = (block for block in blocks if isinstance(block, BarPlot))
    masses = [get_english(row[1]) for row in table.rows]  # type: ignore[arg-type]
    labels = [get_english(bar.label) for bar in plot.bars if bar.label]
    assert labels == ["1.23 kg", "4.56 kg"]
    assert masses[: len(labels)] == labels
    assert get_english(table.title) != get_english(plot.title)


def test_payload_limit_states_that_its_servos_were_added() -> None:
    """No file states the servos of a robot without servos, nor what the robot can carry."""
    result = make_payload_result()
    result.verdict = judge_added_servos(Question.CARRIES)
    assert ADDED_SERVOS_TEXT in " ".join(print_words(payload_document(result)))


@pytest.mark.parametrize(
    ("carried", "mass"), [(0.0, "1.23kg"), (1.0, "2.23kg"), (10.06, "11.29kg")]
)
def test_next_command_simulates_the_payload_with_the_typed_one(carried: float, mass: str) -> None:
    """Reference: line 1 states 1.239 kg as 1.23 kg; no sum is rounded up."""
    result = make_payload_result()
    result.carried = carried
    step = payload_document(result).next_step
    assert step is not None
    assert (step.command, step.words) == ("gains", ("--payload", mass))


def test_next_command_follows_the_cause_if_a_nudge_lowers_the_limit_of_the_contacts() -> None:
    """The simulation sets the payload of Aliengo at 97 % of the contacts, by the same cause.

    The next command was ``push``, which does not raise the payload.
    """
    result = make_payload_result()
    result.failure = Failure.GROUND
    result.bounds = {
        "simulation": SimpleNamespace(
            mass=44.8, failure=Failure.GROUND, failing_parts=("FR_calf",)
        ),
        "stance": SimpleNamespace(mass=46.1, failure=Failure.GROUND, failing_parts=("FR_calf",)),
    }
    step = payload_document(result).next_step
    assert step is not None
    assert (step.command, step.words) == ("best", ("payload",))
    result.bounds["stance"].failure = Failure.TIPPING
    step = payload_document(result).next_step
    assert step is not None
    assert step.command == "push"


@pytest.mark.parametrize(
    ("unknown", "option"), [(("hip",), "hip=1"), (("knee",), "knee=2"), (("hip", "knee"), "*=2")]
)
def test_next_command_states_example_limits_of_motors_without_a_limit(
    unknown: tuple[str, ...], option: str
) -> None:
    """``audit`` was proposed, and found nothing. Reference: the torques 1 and -2 N m."""
    step = payload_document(make_payload_result(*unknown)).next_step
    assert step is not None
    assert (step.command, step.words) == ("payload", ("--effort", option))


@pytest.mark.parametrize(("carried", "command"), [(0.0, "stand"), (9.0, "payload")])
def test_next_command_of_a_failure_with_a_typed_payload_leaves_the_payload_out(
    carried: float, command: str
) -> None:
    result = make_payload_result()
    result.passed, result.carried = False, carried
    step = payload_document(result).next_step
    assert step is not None
    assert step.command == command
    assert ("--payload" in step.omitted) is (carried > 0)


def test_short_answer_states_the_mass_without_the_limit() -> None:
    """The next cause was cut. Reference: the knee exerts 2 N m at half of its limit."""
    findings = payload_document(make_payload_result()).findings
    short = [words.short for words in findings if isinstance(words, Text)]
    assert "motors at 50 % (knee)" in short
    assert all(";" not in words for words in short if words.startswith("limit: "))


def test_payload_beside_a_typed_payload_is_additional() -> None:
    """Reference: 2 kg typed, 1.23 kg more. The line "stub + 2 kg: 1.23 kg" seemed to be a total."""
    result = make_payload_result()
    for carried, expected in ((2.0, "1.23 kg more "), (0.0, "1.23 kg at ")):
        result.carried = carried
        line = payload_text(result)
        assert line.short.startswith(expected)
        assert ("largest additional payload 1.23 kg" in line.en) is (carried > 0)


@pytest.mark.parametrize("bolted", [True, False])
def test_payload_of_a_welded_base_is_the_payload_of_one_posture(*, bolted: bool) -> None:
    """`hold` states a smaller payload for the worst posture of the same arm."""
    result = make_payload_result()
    if bolted:
        task = StandTask(contacts={"base": Weld()})
        result.stand = Stub(**{**vars(result.stand), "task": task, "stance_feet": ()})
    line = payload_text(result)
    assert ("in this posture" in line.short) is bolted
    assert ("in this posture" in line.en) is bolted


def test_first_line_fits_with_a_long_name_of_a_robot() -> None:
    """Go2 from its URDF: the line had up to 117 characters."""
    values = {"mass": "66.89 kg", "place": "0, 0, 0", "link": "base", "ground": ""}
    line = text("payload-at-place", alone="39.54 kg", how="uncompensated", **values).short
    assert line
    result = make_payload_result()
    result.verdict = replace(result.verdict, converted="mjcf")
    verdict = payload_document(result).verdict
    assert isinstance(verdict, Text)
    assert verdict.short == "CARRIES (peak torque; URDF only)"
    assert len(f"{verdict.short} go2_description: {line}") <= MAX_ANSWER_WIDTH


@pytest.mark.parametrize(
    ("continuous", "conditions"),
    [
        ((), "for moments, at peak torque"),
        (("hip",), "for moments: 1 motor at peak torque"),
        (("hip", "knee"), "permanently, at continuous torque"),
    ],
)
def test_verdict_states_for_how_long_the_payload_is_carried(
    continuous: tuple[str, ...], conditions: str
) -> None:
    """The condition followed the mass without gravity compensation, and seemed to be its cause."""
    result = make_payload_result()
    result.continuous, result.point = continuous, np.zeros(3)
    verdict = payload_document(result).verdict
    assert isinstance(verdict, Text)
    assert verdict.short == f"CARRIES ({conditions})"
    assert verdict.en.startswith(f"CARRIES ({conditions}")


def test_answers_state_the_mass_with_and_without_gravity_compensation() -> None:
    """The answer with `-v` stated "only with gravity compensation", without the second mass."""
    result = make_payload_result()
    result.depends_on_feedforward = True
    result.mass_by_commands_alone = 0.5
    answer = payload_document(result)
    (mass,) = [
        words
        for words in answer.findings
        if isinstance(words, Text) and words.en.startswith("largest payload ")
    ]
    assert mass.en.startswith("largest payload 1.23 kg with gravity compensation, 0.50 kg without")
    assert ", 0.50 kg without gravity compensation" in mass.short
    assert "only with gravity compensation" not in " ".join(print_words(answer))
    (limit,) = [
        words
        for words in answer.findings
        if isinstance(words, Text) and words.en.startswith("limiting failure")
    ]
    assert limit.short.startswith("limit 1.23 kg at (11, -22, 83) mm: ")
    # Line 1 has no room for the place: 112 characters for ANYmal C.
    assert "mm" not in mass.short


def test_added_servos_fit_beside_a_part_that_touches_the_ground() -> None:
    """Go2: the same part limits both payloads; the motor nearest to its limit, the added servos.

    Reference: the knee exerts 2 N m at half of its limit.
    """
    result = make_payload_result()
    result.verdict = judge_added_servos(Question.CARRIES)
    result.upper_bound, result.mass_by_commands_alone = 66.899, 39.549
    result.failure, result.failing_parts = Failure.GROUND, ("RL_calf",)
    result.bounds = {"simulation": result.bounds["servos"]}
    result.bounds["simulation"].mass = result.mass
    result.point = np.zeros(3)
    result.failures_alone = (diagnose("body-touches-ground", subject=("body", "RL_calf")),)
    second = printed(payload_document(result), everything=False).splitlines()[1]
    limits = "  limit of both: RL_calf touches the ground; motors at 50 % (knee)"
    assert second == f"{limits}; added kp 320 N m/rad"
    assert len(second) <= MAX_ANSWER_WIDTH
    result.failures_alone = (diagnose("height-drifts", drift=Quantity(-1e-3, "m/s")),)
    second = printed(payload_document(result), everything=False).splitlines()[1]
    limits = "  limit 66.89 kg: RL_calf touches the ground"
    assert second == f"{limits}; limit 39.54 kg: height drifts by -1.00 mm/s"
