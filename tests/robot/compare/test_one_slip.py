"""Samples of two sweeps: one plausible slip in a valid file, and attributes at extreme values.

Complete sweeps: `benchmarks/one_slip.py` and `benchmarks/attributes.py`; results in
docs/data/slips.csv and attributes.csv.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from tests.support.repository import ROOT

sys.path.append(str(ROOT / "benchmarks"))

import attributes
import one_slip

OWN = [name for name in one_slip.BASES if name not in ("go1", "anymal", "hyq")]
"""Robots whose files require no optional package."""


@pytest.mark.slow
@pytest.mark.parametrize("name", OWN)
def test_findings_of_one_plausible_slip_are_true(name: str, tmp_path: Path) -> None:
    """Reference: `one_slip.is_wrong`, the criterion of the sweep: MuJoCo's behaviour against the
    findings. Five random slips per robot.
    """
    for number in range(5):  # none of those in docs/data/slips.csv, whose seed is 0
        result = one_slip.run_case((name, 1, number, str(tmp_path)))
        assert not one_slip.is_wrong(result), result


@pytest.mark.slow
def test_findings_of_extreme_attribute_values_are_true(tmp_path: Path) -> None:
    """Forty random cases of more than 5,000, judged by the criterion of the sweep."""
    cases = attributes.list_cases(str(tmp_path), ())
    assert len(cases) > 5000
    for index in np.random.default_rng(0).choice(len(cases), 40, replace=False):
        key, argument = cases[index]
        result = attributes.run_case(argument)
        assert not one_slip.is_wrong(result), (key, result)
