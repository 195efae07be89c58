"""The verdict of a stance is never better than its simulations, and states the evidence."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace as Stub
from typing import Any

import pytest

from pupper_analysis.base.diagnostics import Quantity, Severity, Term, diagnose
from pupper_analysis.models.transmission import Drive, MadeServo
from pupper_analysis.present.verdict import (
    format_verdict,
    get_verdict_key,
    join_ground_touches,
    make_published_clauses,
    verdict_clauses,
    verdict_word,
)
from pupper_analysis.robot.as_published import (
    Cause,
    JointOff,
    OwnRun,
    Published,
    PublishedRun,
    ServoSource,
    ServosUsed,
)
from pupper_analysis.robot.fall import has_collapsed, is_lifted
from pupper_analysis.simulation.verdict import (
    Ending,
    Question,
    Verdict,
    VerdictCode,
    judge_stance,
    predict_verdict,
)


def run(loss: float = 0.001, *, passed: bool = True, stays: bool = False) -> Any:
    """Return a stub of a simulation whose stand of 0.2 m loses a height [m]."""
    return Stub(
        passed=passed,
        failures=() if passed else (diagnose("base-sags", height=Quantity(0.08, "m")),),
        duration=12.0,
        collapses=has_collapsed(0.0, loss, 0.0, 0.2),
        is_lifted=is_lifted(0.0, loss, 0.2),
        torque_error=1e-8,
        force_error=2e-8,
        stability=None,
        creep=None,
        notes=(),
        stays=stays,
    )


FILE = ServosUsed(ServoSource.FILE, (5.0, 5.0), (0.1, 0.1))


def make_added_servos(instead_of: Drive) -> ServosUsed:
    servo = MadeServo("knee", 40.0, 2.0, instead_of)
    return ServosUsed(ServoSource.ADDED, (40.0, 40.0), (2.0, 2.0), (servo,))


def make_published(torque: float, *, collapses: bool = False) -> Published:
    found = PublishedRun(True, 5.0, torque, -0.018, 0.01, collapses, True)
    return Published((found,), (Cause("exclude", ("foot and floor",), 17, 0.0),), True)


def make_own_run(*, collapses: bool) -> OwnRun:
    end = 0.04 if collapses else 0.28
    knee = JointOff("knee", 0.03, Drive.SERVO)
    return OwnRun(5.0, 0.285, end, 0.02, 0.0, False, keyframe="home", worst=knee)


def test_joint_of_a_published_run_has_the_unit_of_its_kind() -> None:
    """A deviation of 0.01 is 0.57 deg at a hinge, and 10 mm at a slide."""
    run = PublishedRun(True, 5.0, 0.65, -0.018, 0.01, False, True, joint_error_unit="m")
    for published, expected in ((run, "10 mm"), (replace(run, joint_error_unit="rad"), "0.57 deg")):
        (clause,) = make_published_clauses(Published((published,), (), True))
        assert f"a joint by {expected}, the height" in str(clause.message)


CASES: dict[str, tuple[dict[str, Any], VerdictCode, bool, str]] = {
    "all well": (
        {"keyframe_run": make_own_run(collapses=False)},
        VerdictCode.HOLDS,
        True,
        "HOLDS in MuJoCo for 12",
    ),
    "position commands alone": (
        {"alone": run(0.1, passed=False)},
        VerdictCode.HOLDS_WITH_FEEDFORWARD,
        True,
        "HOLDS with gravity feed-forward in MuJoCo for 12 s: torques within 0.0001 %, forces "
        "within 0.0001 % of the prediction (relative to the largest); COLLAPSES without "
        "gravity compensation: the base sags to 80 mm",
    ),
    "added": (
        {"servos": make_added_servos(Drive.MOTOR)},
        VerdictCode.HOLDS_ON_ADDED_SERVOS,
        True,
        "on servos that were added to 1 joints: knee (in the file: torque motor) (kp 40 N m/rad",
    ),
    "given": (
        {"servos": ServosUsed(ServoSource.GIVEN, (30.0, 50.0), (2.0, 2.0))},
        VerdictCode.HOLDS,
        True,
        "on servos as given (kp 30 to 50 N m/rad, kd 2 N m s/rad)",
    ),
    "wrong sign": (
        {"servos": make_added_servos(Drive.WRONG_SIGN)},
        VerdictCode.OWN_DRIVES_FAIL,
        False,
        "FAILS on the file's own servos, which cannot hold knee (a servo whose stiffness is neg",
    ),
    "own keyframe": (
        {"keyframe_run": make_own_run(collapses=True)},
        VerdictCode.OWN_DRIVES_FAIL,
        False,
        "unmodified MJCF, from keyframe home, 5 s: COLLAPSES, CoM height "
        "285 mm, finally 40 mm, tilt 1.1 deg; largest joint error 1.7 deg "
        "(knee, position servo); HOLDS in MuJoCo",
    ),
    "nearly as published": (
        {"published": make_published(0.016)},
        VerdictCode.HOLDS_ALTERED,
        True,
        "as published, torques are off by 1.6 %, a joint by 0.57 deg, the height by -18 mm; an "
        "<exclude> prevents contact of foot and floor (line 17)",
    ),
    "not as published": (
        {"published": make_published(0.65)},
        VerdictCode.DIFFERS_AS_PUBLISHED,
        False,
        "as published, torques are off by 65 %",
    ),
    "falls as published": (
        {"published": make_published(0.0, collapses=True)},
        VerdictCode.DIFFERS_AS_PUBLISHED,
        False,
        "COLLAPSES as published, from the computed stand",
    ),
    "three of four": (
        {
            "remarks": (
                diagnose(
                    "limb-without-foot",
                    subject=("body", "calf"),
                    feet=3,
                    alike=4,
                ),
            )
        },
        VerdictCode.LIMB_WITHOUT_FOOT,
        False,
        "calf has no foot, unlike 3 of 4 similar limbs",
    ),
    "tied": (
        {
            "remarks": (
                replace(
                    diagnose("base-tied", names=("rope",), line=3, falls=True),
                    severity=Severity.ERROR,
                ),
            )
        },
        VerdictCode.TIED,
        False,
        "the file ties the robot to the world: rope (line 3); without this tie the unmodified file"
        " does not stand from its keyframe",
    ),
    "on balls": (
        {"remarks": (diagnose("on-balls-for-soles", count=8),)},
        VerdictCode.HOLDS,
        True,
        "with 8 spheres in place of the soles",
    ),
    "stands otherwise": (
        {"fed": run(passed=False, stays=True)},
        VerdictCode.DISAGREES,
        False,
        "stands in MuJoCo, and not as predicted",
    ),
    "stands otherwise, file collapses": (
        {"fed": run(passed=False, stays=True), "keyframe_run": make_own_run(collapses=True)},
        VerdictCode.FAILS,
        False,
        "COLLAPSES",
    ),
    "stands otherwise, collapses as published": (
        {
            "fed": run(passed=False, stays=True),
            "published": make_published(0.0, collapses=True),
        },
        VerdictCode.FAILS,
        False,
        "COLLAPSES as published",
    ),
    "stands otherwise, on other gains than the file that collapses": (
        {
            "fed": run(passed=False, stays=True),
            "keyframe_run": make_own_run(collapses=True),
            "servos": ServosUsed(ServoSource.GIVEN, (30.0, 50.0), (2.0, 2.0)),
        },
        VerdictCode.DISAGREES,
        False,
        "stands in MuJoCo, and not as predicted",
    ),
    "too weak": ({"overloaded_motors": ("hip",)}, VerdictCode.OVERLOADED, False, "OVERLOADED"),
    "falls": ({"fed": run(0.1, passed=False)}, VerdictCode.FAILS, False, "COLLAPSES in MuJoCo"),
}


@pytest.mark.parametrize("case", CASES)
def test_verdict_is_never_better_than_its_evidence(case: str) -> None:
    """Reference: code, result and words of each combination of simulations, written by hand."""
    changes, code, passed, text = CASES[case]
    evidence: dict[str, Any] = {"fed": run(), "alone": run(), "servos": FILE, **changes}
    verdict = judge_stance(
        evidence.pop("fed"), evidence.pop("alone"), evidence.pop("servos"), **evidence
    )
    assert (verdict.code, verdict.passed) == (code, passed)
    assert text in format_verdict(verdict)
    if not passed:
        assert not format_verdict(verdict).startswith("HOLDS")


UNKNOWNS: dict[str, tuple[dict[str, Any], VerdictCode]] = {
    "limits": ({"unknown": True}, VerdictCode.LIMITS_UNKNOWN),
    "masses": ({"masses_unknown": True}, VerdictCode.MASSES_UNKNOWN),
}


def test_verdict_of_two_conditions_is_no_better_than_that_of_each() -> None:
    """Reference: the order of `VerdictCode`, from the best to the worst.

    Excluded are pairs of conditions with one argument in common, and gains of the user: the run
    from the keyframe is then not decisive.
    """
    order = list(VerdictCode)
    cases = {name: case[:2] for name, case in CASES.items() if name != "given"} | UNKNOWNS
    for (first, code), (second, other) in combinations(cases.values(), 2):
        if not first.keys() & second.keys():
            evidence: dict[str, Any] = {"fed": run(), "alone": run(), "servos": FILE}
            evidence |= first | second
            verdict = judge_stance(
                evidence.pop("fed"), evidence.pop("alone"), evidence.pop("servos"), **evidence
            )
            worst = max(order.index(code), order.index(other))
            assert order.index(verdict.code) >= worst, (code, other, verdict.code)


@pytest.mark.parametrize(
    ("given", "english", "chinese"),
    [
        ({"fed": run(passed=False, stays=True)}, "DISAGREES", "与预测不符"),
        ({"published": make_published(0.65)}, "DISAGREES", "与预测不符"),
        ({"published": make_published(0.0, collapses=True)}, "FAILS", "未能保持"),
        ({"fed": run(passed=False)}, "FAILS", "未能保持"),
    ],
)
def test_a_robot_that_stands_otherwise_than_predicted_disagrees(
    given: dict[str, Any], english: str, chinese: str
) -> None:
    """FAILS means that the robot does not stand."""
    verdict = judge_stance(given.get("fed", run()), run(), FILE, published=given.get("published"))
    assert not verdict.passed
    assert get_verdict_key(verdict) == english
    assert verdict_word(verdict).zh == chinese


@pytest.mark.parametrize(
    "given",
    [
        {"keyframe_run": make_own_run(collapses=True)},
        {"published": make_published(0.0, collapses=True)},
    ],
)
def test_a_file_that_collapses_is_stated_before_a_prepared_robot_that_stands(
    given: dict[str, Any],
) -> None:
    """The first statement explains the word FAILS."""
    verdict = judge_stance(run(passed=False, stays=True), run(), FILE, **given)
    assert get_verdict_key(verdict) == "FAILS"
    assert "COLLAPSES" in str(verdict_clauses(verdict)[0])


@pytest.mark.parametrize(("unit", "text"), [("rad", "0.29 deg (knee"), ("m", "5 mm (knee")])
def test_displacement_of_a_slide_is_in_mm(unit: str, text: str) -> None:
    """Reference: 0.005 rad and 0.005 m in the printed units."""
    joint = JointOff("knee", 0.005, Drive.SERVO, unit=unit)
    verdict = judge_stance(
        run(), run(), FILE, keyframe_run=replace(make_own_run(collapses=False), worst=joint)
    )
    assert text in format_verdict(verdict)


def test_the_worst_check_decides_the_verdict() -> None:
    """Several checks fail; the published file differs most."""
    verdict = judge_stance(
        run(),
        run(0.1, passed=False),
        make_added_servos(Drive.MOTOR),
        published=make_published(0.65),
    )
    assert verdict.code is VerdictCode.DIFFERS_AS_PUBLISHED
    assert verdict.commands_alone is Ending.COLLAPSES
    assert "were added" in format_verdict(verdict)


@pytest.mark.parametrize(
    ("shares", "doubling", "code"),
    [
        ((0.5, 0.9), None, VerdictCode.IN_BALANCE),
        ((0.5, 1.1), None, VerdictCode.OVERLOADED),
        ((0.5, 0.9), 0.3, VerdictCode.UNSTABLE),
        ((0.5, 1.1), 0.3, VerdictCode.OVERLOADED),
    ],
)
@pytest.mark.parametrize("known", [True, False])
def test_expected_verdict_without_simulation_never_passes(
    shares: tuple[float, float], doubling: float | None, code: VerdictCode, known: bool
) -> None:
    """From statics and the spectrum alone: overloaded motors, unstable modes, or neither."""
    if not known:
        code = VerdictCode.OVERLOADED if max(shares) > 1 else VerdictCode.IN_BALANCE
    statics: Any = Stub(joint_names=("hip", "knee"), motor_utilisation=shares)
    leaving = () if doubling is None else (Stub(doubling_time=doubling),)
    stability: Any = Stub(
        is_stable_for=lambda: not leaving, modes_growing_within=lambda: leaving, at_rest=True
    )
    verdict = predict_verdict(statics, FILE, stability if known else None)
    assert verdict.code is code
    assert not verdict.passed
    assert verdict.seconds == 0
    assert verdict.overloaded_motors == (("knee",) if max(shares) > 1 else ())
    assert verdict.doubling_time == (doubling if known and doubling else math.inf)


def test_bodies_that_touch_the_ground_are_one_failure_with_the_first_time() -> None:
    """Reference: the two failures of which the joined failure consists."""
    fall = diagnose("base-sags", height=Quantity(0.1, "m"))
    touches = [
        diagnose(
            "body-touches-ground", subject=("body", name), surface=None, time=Quantity(time, "s")
        )
        for name, time in (("shank", 2.5), ("thigh", 1.25))
    ]
    wall = diagnose("surface-of-contact", kind=Term("wall"), contact="hand")
    on_wall = diagnose("body-touches-ground", subject=("body", "arm"), surface=wall, time=None)
    joined = join_ground_touches((*touches, on_wall, fall))
    assert str(joined[0]) == "shank, thigh touch the ground, the first at 1.25 s"
    assert str(on_wall) == "arm touches the wall of hand"
    assert joined[1:] == (on_wall, fall)
    assert join_ground_touches((touches[0], fall)) == (touches[0], fall)


def test_two_robots_are_the_only_stated_reason_of_a_disagreement() -> None:
    """The deviating forces follow from the different masses; after a fall, each reason is stated.

    Reference: messages of the failures.
    """
    mass = Quantity(1.0, "kg")
    values = {"mjcf": mass, "urdf": mass, "residual": 9.0}
    two = diagnose("files-of-two-robots", **values)
    sags = diagnose("base-sags", height=Quantity(0.1, "m"))
    verdict = Verdict(
        code=VerdictCode.DISAGREES,
        question=Question.STANDS,
        passed=False,
        seconds=12.0,
        with_feedforward=Ending.DISAGREES,
        failures=(sags, two),
        overloaded_motors=(),
        servos=FILE,
        doubling_time=math.inf,
    )
    (stated,) = (str(clause) for clause in verdict_clauses(verdict))
    assert stated == f"stands in MuJoCo, and not as predicted: {two}"
    fallen = replace(verdict, code=VerdictCode.FAILS, with_feedforward=Ending.COLLAPSES)
    assert str(verdict_clauses(fallen)[0]) == f"COLLAPSES in MuJoCo: {sags}; {two}"
