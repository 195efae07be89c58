"""The document of an analysis: reasons of a bad verdict."""

from __future__ import annotations

from pupper_analysis.present.document import Text, get_english
from pupper_analysis.tools.analyze.document import analysis_document
from tests.support.stubs import ANALYSIS, SERVO_BOUNDS, SERVOS, Stub, judge_stance, run


def test_verdict_names_servos_with_too_much_damping() -> None:
    """`gains` reports UNSTABLE for these servos. Reference: a damping of twice its bound."""
    verdict = judge_stance(run(0.0, passed=True), None, SERVOS)
    for factor, ideal in ((2.0, False), (0.5, True)):
        bounds = Stub(**{**vars(SERVO_BOUNDS), "largest_kd_factor": factor, "uniform": True})
        bounds.units = SERVO_BOUNDS.units
        values = {**vars(ANALYSIS), "verdict": verdict, "verified": True, "servos": bounds}
        document = analysis_document(Stub(**values))
        assert document.verdict is not None
        assert get_english(document.verdict).endswith("(ideal servos)") is ideal
        (load,) = [line for line in document.findings if getattr(line, "short", "")[:5] == "load "]
        assert isinstance(load, Text)
        assert load.short.endswith(", as simulated") is not ideal  # the answer of Go2 was cut
        assert load.short_zh.startswith("负载 ")


def test_bad_verdict_on_the_stand_is_the_reason_without_other_failures() -> None:
    """Spot: FAILED was followed by the load and the gains. Reference: the failure of the run."""
    verdict = judge_stance(run(0.0, passed=False), None, SERVOS)
    assert not verdict.passed
    quantities = ANALYSIS.check.quantities
    agreeing = tuple(Stub(**{**vars(quantity), "passed": True}) for quantity in quantities)
    check = Stub(**{**vars(ANALYSIS.check), "quantities": agreeing})
    values = {**vars(ANALYSIS), "verdict": verdict, "verified": False, "check": check}
    values["failures"] = ()
    failures = analysis_document(Stub(**values)).failures
    assert any("it sank" in get_english(line) for line in failures)
    other = {**values, "failures": ANALYSIS.failures}
    assert ANALYSIS.failures
    assert "it sank" not in get_english(analysis_document(Stub(**other)).failures[0])
