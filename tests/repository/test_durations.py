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
    assert marked(1, durations.LONGEST + 1, monkeypatch) == [{"slow", "longest"}]
