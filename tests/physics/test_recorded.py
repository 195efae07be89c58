"""Results equal those of an earlier version, in tests/data/recorded.json; see `recorded.py`."""

from __future__ import annotations

import tomllib
from functools import cache
from typing import Any

import numpy as np
import orjson
import pytest

from tests.recorded import (
    ENGINES,
    FIELD_RTOL,
    JOBS,
    RECORD_FILE,
    compute_numbers,
    compute_products,
    read_setting,
)
from tests.support.repository import ROOT
from tests.support.variants import NAMES

QUICK_JOBS = [name for name, job in JOBS.items() if not job.slow]
SLOW_JOBS = [name for name, job in JOBS.items() if job.slow]


@cache
def read_recorded() -> dict[str, Any]:
    content: dict[str, Any] = orjson.loads(RECORD_FILE.read_bytes())
    return content


def list_tolerances(where: str) -> list[float]:
    return [0.0, *(limit for field, limit in FIELD_RTOL.items() if where.endswith(field))]


def changes(found: dict[str, Any], expected: dict[str, Any], tolerance: float) -> list[str]:
    """Return texts of the numbers that differ from the recorded numbers."""
    messages = [f"{where} is new" for where in found.keys() - expected.keys()]
    for where, old in expected.items():
        if where not in found:
            messages.append(f"{where} is gone")
            continue
        first, second = np.atleast_1d(np.array(found[where])), np.atleast_1d(np.array(old))
        scale = max(1.0, float(np.abs(second).max()))
        if first.shape != second.shape:
            messages.append(f"{where} had {second.shape} numbers, and has {first.shape}")
        elif not np.abs(first - second).max() <= max(tolerance, *list_tolerances(where)) * scale:
            messages.append(f"{where} was {old}, and is {found[where]}")
    return messages


def test_changed_numbers_are_found() -> None:
    """Control of the comparison: changed, exchanged, missing, new and undefined numbers."""
    before = {"a": 1.0, "b": [1.0, 2.0], "c": 3.0}
    assert changes(dict(before), before, 1e-12) == []
    assert changes(before | {"a": 1.0 + 1e-11}, before, 1e-12)
    assert changes(before | {"b": [2.0, 1.0]}, before, 1e-12)
    assert changes(before | {"b": [1.0]}, before, 1e-12)
    assert changes(before | {"c": float("nan")}, before, 1e-12)
    assert changes({"a": 1.0, "b": [1.0, 2.0]}, before, 1e-12) == ["c is gone"]
    assert changes(before | {"d": 1.0}, before, 1e-12) == ["d is new"]


def test_products_of_an_array_depend_on_each_element() -> None:
    """Two elements change by 1e-9 in opposite directions."""
    values = np.random.default_rng(0).normal(size=19)
    for first in range(19):
        for second in range(first):
            changed = values.copy()
            changed[first] += 1e-9
            changed[second] -= 1e-9
            after, before = ({"qpos": compute_products(array)} for array in (changed, values))
            assert changes(after, before, 1e-12), (first, second)


def check(name: str, job: str) -> None:
    """Compare the numbers of a job with the recorded numbers."""
    wanted, now = JOBS[job], read_setting()
    then = read_recorded()["setting"]
    if wanted.same_engines and now != then:
        other = ", ".join(
            f"{key} {then[key]}, now {now[key]}" for key in now if now[key] != then[key]
        )
        pytest.skip(f"{wanted.why}; recorded with {other}")
    found = compute_numbers(name, job)
    assert found, "nothing was computed"
    assert changes(found, read_recorded()["results"][name][job], wanted.tolerance) == []


@pytest.mark.parametrize("job", QUICK_JOBS)
@pytest.mark.parametrize("name", NAMES)
def test_numbers_are_unchanged(name: str, job: str) -> None:
    """Reference: results of an earlier version, in tests/data/recorded.json."""
    check(name, job)


@pytest.mark.slow
@pytest.mark.parametrize("job", SLOW_JOBS)
@pytest.mark.parametrize("name", NAMES)
def test_numbers_of_long_searches_and_simulations_are_unchanged(name: str, job: str) -> None:
    """Reference: results of an earlier version, in tests/data/recorded.json."""
    check(name, job)


def test_all_jobs_of_all_variants_are_recorded() -> None:
    """Reference: the variants and the jobs of `recorded.py`, in their order."""
    assert list(read_recorded()["results"]) == list(NAMES)
    for results in read_recorded()["results"].values():
        assert list(results) == list(JOBS)


def test_the_group_recorded_installs_the_recorded_engines() -> None:
    """``make setup-quick`` installs this group; with other engines, tests of recorded values may
    be skipped."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    then = read_recorded()["setting"]
    pinned = [f"{name}=={then[name]}" for name in ENGINES]
    assert project["dependency-groups"]["recorded"] == pinned
