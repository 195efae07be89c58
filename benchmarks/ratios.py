"""Whether the speed is kept: ratios to the bare engines beside those that were recorded.

What ours and the bare engine take of the processor, by turns, on a machine that may do other things
meanwhile. What is recorded is the least of three medians. What is too much is looked at again after
a while: a guest on the same core slows Python by a third and an engine by a fifth, for minutes.
"""

from __future__ import annotations

import csv
import re
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from measure import Job, take_turns

SLOWER = 1.2
"""Times of the recorded ratio that are too many."""

FILE = "benchmarks-ratios.csv"

TRIES = 3

ROUNDS, PAUSE = 10, 10.0
"""How often what is too much is measured, at most, and s of rest before each but the first."""

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


Record = dict[str, dict[str, float]]
"""{family of processors: {job: ratio}}: Python's share of a call differs between them."""


def family(processor: str) -> str:
    """Returns maker and line of a processor's name, by which ratios are recorded.

    Of ``Intel(R) Xeon(R) Platinum 8370C`` that is ``Intel Xeon``.
    """
    words = re.sub(r"\([^)]*\)|\b\w*\d\w*\b|\bGen\b", " ", processor)
    return " ".join(re.findall("[A-Za-z]+", words)[:2])


def read_recorded(folder: Path) -> Record:
    """Returns the recorded ratios; none if there is no record."""
    path, record = folder / FILE, Record()
    if not path.exists():
        return record
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            job = row.pop("job")
            for name, ratio in row.items():
                if ratio != "-":
                    record.setdefault(name, {})[job] = float(ratio)
    return record


def record_rows(record: Record) -> list[tuple[str, ...]]:
    """Returns a record as a table, a column for each family."""
    jobs = dict.fromkeys(job for own in record.values() for job in own)
    return [
        ("job", *record),
        *(
            (job, *(f"{own[job]:.3g}" if job in own else "-" for own in record.values()))
            for job in jobs
        ),
    ]


def expected(record: Record, name: str) -> dict[str, float]:
    """Returns {job: ratio} of a family; of what it lacks the largest of all families'."""
    largest: dict[str, float] = {}
    for own in record.values():
        for job, ratio in own.items():
            largest[job] = max(ratio, largest.get(job, 0.0))
    return largest | record.get(name, {})


def measure_ratio(job: Job) -> float:
    """Returns how much more of the processor ours takes than the bare engine, by medians."""
    assert job.bare is not None
    ours, bare = take_turns([job.ours, job.bare.run], CALLS, SECONDS, time.process_time)
    return statistics.median(ours) / statistics.median(bare)


def best(jobs: Sequence[Job], measure: Callable[[Job], float]) -> dict[str, float]:
    """Returns {job: ratio}, the least of all tries: what is recorded, as it is compared later."""
    return {job.name: min(measure(job) for _ in range(TRIES)) for job in jobs}


def compare(
    jobs: Sequence[Job],
    recorded: Mapping[str, float],
    measure: Callable[[Job], float],
    rest: Callable[[float], object] = time.sleep,
) -> list[Compared]:
    """Compares the jobs' ratios with the recorded ones.

    Args:
        jobs: Those with a bare engine.
        recorded: {job: ratio}; what has none is not measured.
        measure: Measures a job's ratio once.
        rest: Waits for some seconds.
    """
    now = {job: float("inf") for job in jobs if job.name in recorded}
    for number in range(ROUNDS):
        left = [job for job in now if now[job] > SLOWER * recorded[job.name]]
        if number and left:
            rest(PAUSE)
        for job in left:
            now[job] = min(now[job], measure(job))
    return [
        Compared(job.name, was := recorded[job.name], least, SLOWER * was)
        for job, least in now.items()
    ]
