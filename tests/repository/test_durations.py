"""Which cases are slow follows from the record alone."""

from __future__ import annotations

from types import SimpleNamespace as Stub

import pytest

from tests.support import durations


def marked(count: int, seconds: float, monkeypatch: pytest.MonkeyPatch) -> list[set[str]]:
    record = {"tests/test_a.py": {"test_b": seconds}}
    monkeypatch.setattr(durations, "recorded", lambda: record)
    marks: list[set[str]] = [set() for _ in range(count)]
    items = [
        Stub(
            nodeid=f"tests/test_a.py::test_b[{index}::x]",
            get_closest_marker=lambda name: None,
            add_marker=lambda mark, own=own: own.add(mark.name),
        )
        for index, own in enumerate(marks)
    ]
    durations.mark(items)  # type: ignore[arg-type]
    return marks


def test_cases_are_quick_as_many_as_fit_and_spread(monkeypatch: pytest.MonkeyPatch) -> None:
    each = durations.SLOW / 2.5
    marks = marked(100, 100 * each, monkeypatch)
    quick = [index for index, own in enumerate(marks) if not own]
    assert len(quick) == 2
    assert max(quick) - min(quick) > 50
    assert sum("longest" not in own for own in marks) == int(durations.LONGEST / each)
    assert all("slow" in own for own in marks if "longest" in own)


def test_what_is_not_recorded_is_quick(monkeypatch: pytest.MonkeyPatch) -> None:
    assert marked(3, 0.0, monkeypatch) == [set(), set(), set()]


def test_the_first_case_is_longest_only_if_it_alone_takes_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert marked(1, durations.LONGEST + 1, monkeypatch) == [{"slow"}]
    assert marked(1, durations.ALONE + 1, monkeypatch) == [{"slow", "longest"}]
    several = marked(3, 3 * (durations.ALONE - 1), monkeypatch)
    assert sorted("longest" in own for own in several) == [False, True, True]


def test_of_many_cases_some_are_recorded_for_all() -> None:
    many = [
        Stub(
            nodeid=f"tests/test_a.py::test_b[{index}]",
            get_closest_marker=lambda name: None,
            stash=pytest.Stash(),
        )
        for index in range(10 * durations.SAMPLED)
    ]
    items = list(many)
    durations.sample(items)  # type: ignore[arg-type]
    assert len(items) == durations.SAMPLED
    recorder = durations.Recorder()
    for item in items:
        recorder.pytest_runtest_logreport(
            Stub(nodeid=item.nodeid, processor=2.0, fixtures={}, used=[], scale=10.0)
        )
        assert item.stash[durations._SCALE] == 10.0
    assert recorder.totals() == {("tests/test_a.py", "test_b"): 2.0 * len(many)}
