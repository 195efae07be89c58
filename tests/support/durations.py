"""How long each test takes, as it was recorded, and which cases are slow or longest because of it.

`make durations` runs some cases of every test and writes ``tests/durations.json``: seconds of
processor of each test function, scaled to all its cases, with what they start. A fixture that
several share is paid by the first; what nobody has recorded is quick. Nobody marks a test as slow
by hand.

Of a function's cases as many are quick as fit into `SLOW` seconds together, spread over all; the
first one is among the longest only if it alone takes more than `ALONE`, a further one if it and
those before it take more than `LONGEST`. So nearly every function has a case that CI runs.
"""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

FILE = Path(__file__).resolve().parents[1] / "durations.json"

SLOW = 0.05
"""Seconds of processor of a function's quick cases: all take a minute of two cores together, half
of it for collecting them."""

LONGEST = 0.2
"""Seconds of its cases that are not among the longest, so that CI's clone is done in fifteen
minutes."""

ALONE = 1.5
"""Seconds of its first case that is not among the longest: what CI runs of a long proof."""

SAMPLED = 4
"""How many cases of a function are recorded: those of one function hardly differ."""

LEAST = 0.05
"""What takes less is not written down: it changes from run to run."""

UNRECORDED = 12.0
"""Seconds of processor that a quick case may take of which nothing is recorded: the first case of
a process pays for loading engines and matplotlib, 4 s where nothing is compiled yet, and another
processor takes up to three times as long. It finds what was forgotten, and measures nothing."""

_SPENT = pytest.StashKey[float]()
_SCALE = pytest.StashKey[float]()


def processor() -> float:
    """The processor time of this process, its threads, and the children that have ended (s)."""
    return sum(os.times()[:4])


def function_of(nodeid: str) -> tuple[str, str]:
    """The file and the name of the function of a test."""
    file, _, name = nodeid.partition("::")
    return file, name.partition("[")[0]


def recorded() -> dict[str, dict[str, float]]:
    return json.loads(FILE.read_text()) if FILE.exists() else {}


def _order(count: int) -> list[int]:
    """Cases in an order whose beginning is spread over all, by the golden ratio."""
    return sorted(range(count), key=lambda place: place * (5**0.5 - 1) / 2 % 1)


def _cases(items: list[pytest.Item]) -> dict[tuple[str, str], list[pytest.Item]]:
    """The cases of each function, in the order in which they are chosen."""
    functions: dict[tuple[str, str], list[pytest.Item]] = defaultdict(list)
    for item in items:
        if not item.get_closest_marker("longest"):
            functions[function_of(item.nodeid)].append(item)
    return {
        function: [cases[place] for place in _order(len(cases))]
        for function, cases in functions.items()
    }


def mark(items: list[pytest.Item]) -> None:
    """Marks what is slow, or among the longest, by the record; the longest are slow, too."""
    seconds = recorded()
    for item in items:
        if item.get_closest_marker("longest"):
            item.add_marker(pytest.mark.slow)
    for (file, name), cases in _cases(items).items():
        each = seconds.get(file, {}).get(name, 0.0) / len(cases)
        for rank, case in enumerate(cases, 1):
            if rank * each > SLOW:
                case.add_marker(pytest.mark.slow)
            if rank * each > (ALONE if rank == 1 else LONGEST):
                case.add_marker(pytest.mark.longest)


def sample(items: list[pytest.Item]) -> None:
    """Leaves only the cases that are recorded, which is all that the longest are not marked for."""
    kept: set[str] = set()
    for cases in _cases(items).values():
        for case in cases[:SAMPLED]:
            case.stash[_SCALE] = len(cases) / len(cases[:SAMPLED])
            kept.add(case.nodeid)
    items[:] = [item for item in items if item.nodeid in kept]


class Limit:
    """Fails what nobody has recorded, and takes long among the quick ones."""

    def __init__(self, most: float = UNRECORDED) -> None:
        self._recorded, self._most = recorded(), most

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[Any]:
        begin = processor()
        result = yield
        file, name = function_of(item.nodeid)
        known = item.get_closest_marker("slow") or name in self._recorded.get(file, {})
        if not known and (took := processor() - begin) > self._most:
            pytest.fail(
                f"{took:.1f} s of processor, and none is recorded, so it counts as quick: make it "
                f"quicker, or run python -m pytest -n 0 --record-durations {file}::{name}",
                pytrace=False,
            )
        return result


class Recorder:
    """Measures in the process that runs the tests, and adds up in the one that reports them."""

    def __init__(self) -> None:
        self.own: dict[tuple[str, str], float] = defaultdict(float)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[Any]:
        item.stash[_SPENT] = processor()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Iterator[Any]:
        report = yield
        now = processor()
        report.processor = now - item.stash[_SPENT]
        report.used = list(getattr(item, "fixturenames", ()))
        report.scale = item.stash.get(_SCALE, 1.0)
        item.stash[_SPENT] = now
        return report

    def pytest_runtest_logreport(self, report: Any) -> None:
        if "browser" in report.used:  # its time is known when it ends: all would be the last test's
            return
        self.own[function_of(report.nodeid)] += report.processor * report.scale

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if hasattr(session.config, "workerinput"):
            return
        found = recorded()
        kept = {
            file: {
                name: seconds for name, seconds in functions.items() if (file, name) not in self.own
            }
            for file, functions in found.items()
            if (FILE.parents[1] / file).exists()
        }
        for (file, name), seconds in self.own.items():
            if seconds >= LEAST:
                kept.setdefault(file, {})[name] = round(seconds, 2)
        lines = {file: dict(sorted(kept[file].items())) for file in sorted(kept) if kept[file]}
        FILE.write_text(json.dumps(lines, indent=1) + "\n")
