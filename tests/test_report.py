"""Tables show the numbers of the analysis, and none is cut off."""

from __future__ import annotations

import io
from dataclasses import replace
from functools import cache

import pytest
from rich.console import Console

import pupper_analysis as pa
from pupper_analysis.pupper import comparison
from pupper_analysis.report.analysis import print_analysis
from pupper_analysis.report.console import WIDTH


@cache
def analysis(name: str) -> pa.Analysis:
    return pa.analyze_variant(pa.load_variant(name))


def printed(*analyses: pa.Analysis) -> str:
    out = Console(file=io.StringIO(), width=WIDTH, highlight=False)
    for item in analyses:
        print_analysis(out, item)
    assert isinstance(out.file, io.StringIO)
    return out.file.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["original", "v3-heavy"])
def test_nothing_is_cut_off(name: str) -> None:
    for line in printed(analysis(name)).splitlines():
        # rich marks what it cuts with an ellipsis at the cell's end; ours stands alone.
        assert "…" not in line.replace(" … ", " ").replace("…)", ")"), line


def test_numbers_are_the_analysis_s() -> None:
    one = analysis("v3")
    text = printed(one)
    for number in (
        f"{one.total_mass:.3f} kg",
        f"{one.statics.joint_torques[2]:+.4f}",
        f"{one.statics.motor_utilisation.max():.1%}",
        f"{1e3 * one.sagging.height_loss:.3f} mm",
        f"{1e3 * one.sweep.height_deviation[-1, -1]:.4f}",
        "leg_*_1 turns about y",
    ):
        assert number in text, number


def test_a_failure_is_told_in_words() -> None:
    failed = replace(analysis("v3"), verified=False, failures=("it fell over",))
    assert "FAILED v3: it fell over" in printed(failed)


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
    out = Console(file=io.StringIO(), width=WIDTH)
    comparison.print_comparison(out, [row])
    assert isinstance(out.file, io.StringIO)
    assert "1.556" in out.file.getvalue()
