"""An analysis of a real robot: its document shows its numbers, and none is cut off."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

import pupper_analysis as pa
from tests.support.printing import printed
from tests.support.stubs import problem


@cache
def analysis() -> pa.analysis.Analysis:
    return pa.analyze_variant(pa.load_variant("v3"))


@pytest.mark.parametrize("width", [80, 120])
def test_tables_fit_the_terminal(width: int) -> None:
    text = printed(analysis(), width=width)
    rules = [line for line in text.splitlines() if line.startswith("─")]
    assert len(rules) >= 9
    assert max(map(len, rules)) <= width


def test_a_failure_is_told_first() -> None:
    failed = replace(analysis(), verified=False, failures=(problem("it fell over"),))
    assert printed(failed).startswith("FAILED v3: it fell over\n")
