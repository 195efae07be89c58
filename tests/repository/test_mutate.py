"""A small sample of the mutants that `make mutate` makes: the tests notice nearly all of them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.repository import ROOT

SAMPLE = 8
LEAST = 0.3
"""Of the sample, which is another one whenever the code changes: where three of four slips are
noticed, as the recorded score says, fewer than three of eight are so in one run of 200."""


@pytest.mark.longest
def test_most_of_a_few_slips_are_noticed(tmp_path: Path) -> None:
    """In the room that all else rests on, by its own quick tests alone."""
    pytest.importorskip("cosmic_ray")
    words = ["statics", "--sample", str(SAMPLE), "--seed", "7", "--least", str(LEAST)]
    done = subprocess.run(
        [sys.executable, ROOT / "tests/mutate.py", *words, "--tests", "tests/statics"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "MUTANTS": str(tmp_path)},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads((tmp_path / "mutants-statics.json").read_text())["outcomes"]
    assert len(found) == SAMPLE
    assert all(one["change"].startswith("-") and one["tests"] for one in found if one["killed"])
