"""What the fuzzer has found stays mended, and the fuzzer finds what it looks for."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings

from tests import fuzz

SEEDS = sorted((Path(fuzz.__file__).parent / "fuzz_seeds").glob("*.json"))


@pytest.mark.slow
@pytest.mark.parametrize("path", SEEDS, ids=lambda path: path.stem)
def test_seeds_that_once_failed_pass(path: Path) -> None:
    assert fuzz.found_in(fuzz.Case.from_json(path.read_text())) == []


@pytest.mark.slow
@settings(max_examples=15, suppress_health_check=list(HealthCheck))
@given(fuzz.on_files())
def test_spoilt_files_are_refused(case: fuzz.Case) -> None:
    assert fuzz.found_in(case) == []
