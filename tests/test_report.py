"""Documents show the numbers of the analysis, and none is cut off."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
from printing import printed

import pupper_analysis as pa
from pupper_analysis.pupper import comparison
from pupper_analysis.report.document import Document, Name


@cache
def analysis(name: str) -> pa.Analysis:
    return pa.analyze_variant(pa.load_variant(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["original", "v3-heavy"])
@pytest.mark.parametrize("width", [80, 120])
def test_tables_fit_the_terminal(name: str, width: int) -> None:
    text = printed(analysis(name), width=width)
    rules = [line for line in text.splitlines() if line.startswith("─")]
    assert len(rules) >= 9
    assert max(map(len, rules)) <= width


def test_numbers_are_the_analysis_s() -> None:
    one = analysis("v3")
    text = printed(one)
    for number in (
        f"{one.total_mass:.3f} kg",
        f"{one.statics.joint_torques[2]:+.4f}",
        f"{one.statics.motor_utilisation.max():.1%}",
        f"{1e3 * one.sagging.height_loss:.3f}",
        f"{1e3 * one.sweep.height_deviation[-1, -1]:.4f}",
        "leg_*_1 turns about y",
    ):
        assert number in text, number


def test_a_failure_is_told_first() -> None:
    failed = replace(analysis("v3"), verified=False, failures=("it fell over",))
    assert printed(failed).startswith("FAILED v3: it fell over\n")


@pytest.mark.slow
def test_zeros_have_no_minus() -> None:
    assert "-0.0000" not in printed(analysis("original"))


@pytest.mark.slow
def test_ratios() -> None:
    base = pa.load_variant("original")
    one = analysis("original")
    reference = comparison.Reference(base.total_mass, one.thigh_length, one.thigh_shape_length)
    row = comparison.compare(analysis("heavy"), "skeleton", reference)
    assert row.mass_ratio == pytest.approx(4.216 / 2.710)
    assert f"{row.mass_ratio:.3f}" == "1.556"
    assert row.thigh_ratio == pytest.approx(1.0)
    assert row.verified
    table = comparison.comparison_table([row])
    assert "1.556" in printed(Document(Name(""), Name("all"), (table,)))
