"""Documents of stances: servo gains with their bounds, and the next command."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.present.document import MAX_ANSWER_WIDTH, Text, get_english
from pupper_analysis.present.documents.loads import format_share
from pupper_analysis.present.documents.servos import (
    describe_servo_gains,
    exceeds_explicit_damping,
    round_bound,
)
from pupper_analysis.robot.as_published import ServoSource
from pupper_analysis.simulation.servo_bounds import SoftServos
from pupper_analysis.simulation.verdict import VerdictCode, judge_stance
from pupper_analysis.tools.stand.document import stance_document
from tests.present.test_printed import print_words
from tests.support.stubs import SERVO_BOUNDS, SERVOS, Stub, run, stance


def hold_stance(largest_kd_factor: float) -> object:
    """Return a stance that holds with kd 16, and a bound of kd of an explicit controller."""
    classes = tuple(replace(joint_class, kp=320.0, kd=16.0) for joint_class in SERVO_BOUNDS.classes)
    bounds = replace(
        SERVO_BOUNDS,
        classes=classes,
        least_kp_factor=0.0875,
        largest_kd_factor=largest_kd_factor,
        timestep=0.002,
    )
    verdict = judge_stance(run(0.0, passed=True), None, SERVOS)
    assert verdict.code is VerdictCode.HOLDS
    return stance(servos=bounds, verdict=verdict, passed=True, minimum_stiffness=None, settled=None)


@pytest.mark.parametrize(
    ("factor", "verdict", "command", "damping"),
    [
        (0.56, "(ideal servos)", "gains", "kd 16 N m s/rad (unstable on a 500 Hz PD: max 8.96)"),
        (1.5, "", "payload", "kd 16 N m s/rad (max 24)"),
    ],
)
def test_damping_beyond_an_explicit_controller_leads_to_the_gains(
    factor: float, verdict: str, command: str, damping: str
) -> None:
    """Reference: 16 N m s/rad times the factor. `gains` reports UNSTABLE for such a damping."""
    document = stance_document(hold_stance(factor))
    assert document.verdict is not None
    assert get_english(document.verdict) == f"HOLDS {verdict}".strip()
    assert document.next_step is not None
    assert document.next_step.command == command
    (line,) = [line for line in document.findings if getattr(line, "short", "").startswith("kp ")]
    assert line.short == f"kp 320 N m/rad (min 28), {damping}"
    assert len(f"  added servos: {line.short}") <= MAX_ANSWER_WIDTH


@pytest.mark.parametrize(
    ("factor", "exceeds"), [(None, False), (math.inf, False), (1.0, False), (0.99, True), (0, True)]
)
def test_a_bound_of_zero_damping_is_exceeded(factor: float | None, exceeds: bool) -> None:
    bounds = replace(SERVO_BOUNDS, largest_kd_factor=factor)
    assert exceeds_explicit_damping(bounds) is exceeds


@pytest.mark.parametrize(
    ("least", "largest", "integrator", "shown"),
    [
        (0.5, 1.5, "implicitfast", "kp 320 N m/rad (min 160), kd 16 N m s/rad (max 24)"),
        (2.0, 1.5, "implicitfast", "kp 320 N m/rad (below min 640), kd 16 N m s/rad (max 24)"),
        (1.0, 1.5, "implicitfast", "kp 320 N m/rad (barely sufficient), kd 16 N m s/rad (max 24)"),
        (
            0.5,
            0.5,
            "Euler",
            "kp 320 N m/rad (min 160), kd 16 N m s/rad (unstable on a 270.3 Hz PD: max 8)",
        ),
    ],
)
def test_gain_beyond_its_bound_is_stated_as_such(
    least: float, largest: float, integrator: str, shown: str
) -> None:
    """Reference: the gains times the factors of the bounds."""
    classes = tuple(replace(joint_class, kp=320.0, kd=16.0) for joint_class in SERVO_BOUNDS.classes)
    bounds = replace(
        SERVO_BOUNDS,
        classes=classes,
        least_kp_factor=least,
        largest_kd_factor=largest,
        integrator=integrator,
    )
    (line,) = describe_servo_gains(bounds, SERVOS)
    assert isinstance(line, Text)
    assert line.short == shown


@pytest.mark.parametrize("least", [None, 0.5, 2.0])
@pytest.mark.parametrize("largest", [None, 0.5, 1.5])
def test_bounds_of_different_gains_are_separated(
    least: float | None, largest: float | None
) -> None:
    """Romeo: "kp may fall to 0.47 times kd must fall to 0.0032 times"; H1: "gains:; kd at most"."""
    stiff = [replace(SERVO_BOUNDS.classes[0], kp=320.0), *SERVO_BOUNDS.classes]
    bounds = replace(
        SERVO_BOUNDS, classes=tuple(stiff), least_kp_factor=least, largest_kd_factor=largest
    )
    (line,) = describe_servo_gains(bounds, SERVOS)
    assert isinstance(line, Text)
    for clause in (line.en, str(line.short)):
        assert clause.count(",") >= (least is not None) + (largest is not None)
        assert not re.search(r"[:,;]\s*([:,;]|$)", clause)
        assert all(re.search(f", {gain}", clause) for gain in ("kp", "kd") if gain in clause)


@pytest.mark.parametrize(
    ("bound", "gain", "upper", "displayed"),
    [
        (28.08, 320, False, 28.1),
        (1.699, 1.7, True, 1.69),
        (1.70012, 1.7, True, 1.7001),
        (1.69988, 1.7, False, 1.6999),
        (5.0276, 5, False, 5.03),
        (5.021, 5, False, 5.03),
        (5, 5, False, 5),
        (2.6, 2.6, True, 2.6),
        (2.439, 5, False, 2.44),
        (2.431, 5, False, 2.44),
    ],
)
def test_rounded_bound_stays_on_its_side_of_the_gain(
    bound: float, gain: float, displayed: float, *, upper: bool
) -> None:
    """Solo12: the line stated kd 1.7 and a bound of 1.7 that kd exceeds.

    The printed bound fulfils the exact one: v3 stated "min 2.4" for a kp of 2.44.
    """
    assert round_bound(bound, gain, upper=upper) == displayed
    assert displayed <= bound if upper else displayed >= bound
    assert (displayed > gain) - (displayed < gain) == (bound > gain) - (bound < gain)


def test_table_has_a_bound_below_the_gain() -> None:
    classes = tuple(
        replace(joint_class, kd=1.7, largest_kd=1.699) for joint_class in SERVO_BOUNDS.classes
    )
    bounds = replace(SERVO_BOUNDS, classes=classes, largest_kd_factor=0.9994)
    assert "1.69 " in " ".join(print_words(stance_document(stance(servos=bounds))))


def test_small_utilisation_is_not_zero() -> None:
    """Solo12 states effort limits of 1000 N m: the load was "0 % of the limit"."""
    assert format_share(0.000688) == "0.0688"
    assert format_share(0.157) == "15.7"
    assert format_share(1.27) == "127"
    assert format_share(float("nan")) == ""


def test_reason_for_a_qualified_verdict_precedes_the_servos() -> None:
    """G1 with --kp 408 --kd 0.221: line 2 named the given servos, and omitted the reason."""
    verdict = judge_stance(
        run(0.0, passed=True),
        run(0.0, passed=False),
        replace(SERVOS, source=ServoSource.GIVEN),
    )
    assert verdict.code is VerdictCode.HOLDS_WITH_FEEDFORWARD
    bounds = replace(SERVO_BOUNDS, least_kp_factor=0.5)
    document = stance_document(
        stance(verdict=verdict, passed=True, minimum_stiffness=None, servos=bounds)
    )
    second, third = document.findings[1:3]
    assert get_english(second).startswith("FAILS without gravity compensation: ")
    assert get_english(third).startswith("servos: kp ")


def test_given_servos_are_stated_once() -> None:
    """`stand v3 --kd 0.141` printed kp twice, and therefore neither height nor height loss."""
    given = replace(SERVOS, source=ServoSource.GIVEN)
    verdict = judge_stance(run(0.0, passed=True), run(0.0, passed=True), given)
    for uniform in (True, False):
        bounds = replace(SERVO_BOUNDS, least_kp_factor=0.5)
        if not uniform:
            first = bounds.classes[0]
            bounds = replace(bounds, classes=(first, replace(first, kp=2 * first.kp)))
        assert bounds.uniform is uniform
        document = stance_document(stance(verdict=verdict, passed=True, servos=bounds))
        kept = [get_english(line) for line in document.findings]
        details = [get_english(line) for line in document.details]
        assert any(line.startswith("on servos as given ") for line in kept) is not uniform
        assert any(line.startswith("on servos as given ") for line in details) is uniform


def test_too_soft_servos_are_stated_with_stiffness_and_factor() -> None:
    """Reference: kp 30 N m/rad and the factor 16 of the result, each in its place."""
    soft = SoftServos("ankle_*", ("ankle_l", "ankle_r"), 30.0, 16.0)
    document = stance_document(stance(soft_servos=soft))
    lines = [line for line in document.failures + document.findings if isinstance(line, Text)]
    (line,) = [line for line in lines if line.short.startswith("ankle_*")]
    assert line.short == "ankle_* too soft (kp 30 N m/rad): stands with 16 times these gains"
    assert "(kp 30 N m/rad): with 16 times their gains" in line.en


@pytest.mark.parametrize(
    ("code", "effect", "part"),
    [
        ("base-tied", "falls", "ties the robot to the world"),
        ("link-tied", "leaves", "ties a moving link to the world"),
    ],
)
def test_tie_to_the_world_precedes_too_soft_servos(code: str, effect: str, part: str) -> None:
    """A <weld> lifts the robot, or holds the tip of an arm: no stiffness changes that."""
    tied = diagnose(code, names=("weld",), line=3, **{effect: False})
    verdict = judge_stance(run(-0.4, passed=False), None, SERVOS, remarks=(tied,))
    assert verdict.code is VerdictCode.FAILS
    soft = SoftServos("ankle_*", ("ankle_l", "ankle_r"), 30.0, 16.0)
    document = stance_document(stance(verdict=verdict, passed=False, soft_servos=soft))
    lines = [get_english(line) for line in document.failures + document.findings]
    tie, servos = (
        next(place for place, line in enumerate(lines) if words in line)
        for words in (part, "with 16 times their gains")
    )
    assert tie < servos
    assert document.next_step is not None
    assert document.next_step.command == "audit"


@pytest.mark.parametrize("rolling_feet", [(), ("FR",)])
def test_height_replaces_in_line_2_a_sag_that_does_not_fit(rolling_feet: tuple[str, ...]) -> None:
    """Go2 with --height 20cm: neither height nor sag were in line 2. Width: 100 characters."""
    settled = Stub(
        height_loss=0.0083,
        servo_sag=0.0,
        contact_sag=0.0,
        rolling_feet=rolling_feet,
        failures=(),
        release_margin=2.0,
    )
    standing = stance(
        settled=settled,
        passed=True,
        minimum_stiffness=None,
        servos=replace(SERVO_BOUNDS, least_kp_factor=0.5),
        verdict=judge_stance(run(0.0, passed=True), None, SERVOS),
    )
    findings = stance_document(standing).findings
    gains, second = [line.short for line in findings if isinstance(line, Text)][1:3]
    (sag,) = [
        line.short
        for line in findings
        if isinstance(line, Text) and line.short.startswith("sinks ")
    ]
    assert gains.startswith("kp ")
    fits = len(f"  {gains}; {sag}") <= MAX_ANSWER_WIDTH
    assert second == (sag if fits else "height 104.4 mm")
    assert fits is (not rolling_feet)
