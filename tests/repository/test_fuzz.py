"""Inputs at which the fuzzer once found a defect pass, and the fuzzer detects defects."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings

from tests import fuzz

SEEDS = sorted((Path(fuzz.__file__).parent / "fuzz_seeds").glob("*.json"))


@pytest.mark.slow
@pytest.mark.parametrize("path", SEEDS, ids=lambda path: path.stem)
def test_seeds_that_once_failed_pass(path: Path) -> None:
    assert fuzz.run_case(fuzz.Case.from_json(path.read_text())) == []


@pytest.mark.slow
@settings(max_examples=15, suppress_health_check=list(HealthCheck))
@given(fuzz.on_files())
def test_randomly_damaged_files_have_no_defect(case: fuzz.Case) -> None:
    assert fuzz.run_case(case) == []


def test_case_is_restored_from_json() -> None:
    case = fuzz.Case(("audit", "\u202e"), {"robot.xml": b"\xff\x00<a/>", "robot.urdf": b"<r/>"})
    assert fuzz.Case.from_json(case.to_json()) == case
