"""Whether the speed is kept: ratios to the bare engines beside those that were recorded.

What ours and the bare engine take of the processor, by turns, on a machine that may do other things
meanwhile: a ratio is the least of three medians, and none is looked at again that is good.
"""

from __future__ import annotations

import csv
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from measure import Job, take_turns

SLOWER = 1.2
"""Times of the recorded ratio that are too many, on the processor of the record."""

ELSEWHERE = 2.0
"""On another one, of which Python's share of a call may be so much more: of the same commit,
statics took 1.7 times PlaCo's on a Xeon and 3.0 times on an EPYC."""

TRIES = 3

CALLS, SECONDS = 3, 0.7
"""How often, and how long, a job is measured at least in each try."""


class Compared(NamedTuple):
    """A ratio as it was and as it is.

    Attributes:
        job: The job's name.
        recorded: Its ratio in ``docs/data``.
        now: As measured here, the best of all tries.
        most: What it may be.
    """

    job: str
    recorded: float
    now: float
    most: float

    @property
    def kept(self) -> bool:
        """Whether it is no more than it may be."""
        return self.now <= self.most


def read_recorded(folder: Path) -> tuple[dict[str, float], str]:
    """Returns the recorded ratios, {job: ratio}, and the processor of the record."""
    with (folder / "benchmarks-calls.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["job"]: row["ratio"] for row in csv.DictReader(file)}
    with (folder / "benchmarks-setting.csv").open(encoding="utf-8", newline="") as file:
        setting = {row["what"]: row["value"] for row in csv.DictReader(file)}
    return {job: float(ratio) for job, ratio in rows.items() if ratio != "-"}, setting["processor"]


def measure_ratio(job: Job) -> float:
    """Returns how much more of the processor ours takes than the bare engine, by medians."""
    assert job.bare is not None
    ours, bare = take_turns([job.ours, job.bare.run], CALLS, SECONDS, time.process_time)
    return statistics.median(ours) / statistics.median(bare)


def compare(
    jobs: Sequence[Job],
    recorded: Mapping[str, float],
    slower: float,
    measure: Callable[[Job], float],
) -> list[Compared]:
    """Compares the jobs' ratios with the recorded ones.

    Args:
        jobs: Those with a bare engine.
        recorded: {job: ratio}; what has none is not measured.
        slower: How many times as much a ratio may be.
        measure: Measures a job's ratio once.
    """
    found = []
    for job in jobs:
        if job.name not in recorded:
            continue
        was, now = recorded[job.name], float("inf")
        for _ in range(TRIES):
            now = min(now, measure(job))
            if now <= slower * was:
                break
        found.append(Compared(job.name, was, now, slower * was))
    return found
