"""Whether the speed is kept: ratios to the bare engines beside those that were recorded.

What ours and the bare engine take of the processor, by turns, on a machine that may do other things
meanwhile. What is recorded is the least of three medians. What is too much is looked at again after
a while. If it still is, the state of the record is measured, too, by turns with this one: other
guests slow Python more than an engine (of one and the same code J, com, M, g took 1.67 times the
engine's time at one hour and 2.1 at the next), and both states alike.
"""

from __future__ import annotations

import csv
import json
import os
import re
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from measure import Job, take_turns

SLOWER = 1.2
"""Times of the recorded ratio that are too many."""

FILE = "benchmarks-ratios.csv"

TRIES = 3

ROUNDS, PAUSE = 3, 10.0
"""How often what is too much is measured, at most, and s of rest before each but the first."""

CALLS, SECONDS = 3, 0.7
"""How often, and how long, a job is measured at least in each try."""


class Compared(NamedTuple):
    """A ratio as it was and as it is.

    Attributes:
        job: The job's name.
        recorded: Its ratio in ``docs/data``; if that was too little, of the state that wrote that,
            measured here, if that is more.
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


_MEASURE = """
import json, sys
sys.path[:0] = [sys.argv[1], sys.argv[1] + "/benchmarks"]
import bare, ratios
jobs = [job for job in bare.jobs(sys.argv[2]) if job.name in sys.argv[3:]]
print(json.dumps({job.name: ratios.measure_ratio(job) for job in jobs}))
"""


def measure_state(root: Path, variant: str, names: Sequence[str]) -> dict[str, float]:
    """Returns {job: ratio} of a checkout, in a process of its own."""
    command = [sys.executable, "-c", _MEASURE, str(root), variant, *names]
    free = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=root, env=free, check=True, capture_output=True, text=True)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def measure_both(
    root: Path, record: Path, variant: str, names: Sequence[str]
) -> tuple[dict[str, float], dict[str, float]]:
    """Measures this state and the one that wrote a record, by turns: the least ratios of both.

    Args:
        root: The checkout.
        record: The record's file.
        variant: The robot.
        names: Of jobs.

    Returns:
        {job: ratio} of this state and of that; empty without the repository's history.
    """
    now, then = dict[str, float](), dict[str, float]()

    def ask(*words: str) -> str:
        command = ["git", "-C", str(root), *words]
        return subprocess.run(command, check=False, capture_output=True, text=True).stdout.strip()

    commit = ask("log", "-1", "--format=%H", "--", str(record))
    if not commit or ask("rev-parse", "--is-shallow-repository") == "true":
        return now, then
    with tempfile.TemporaryDirectory() as folder:
        packed = Path(folder) / "state.tar"
        make = ["git", "-C", str(root), "archive", "-o", str(packed), commit]
        subprocess.run(make, check=True)
        with tarfile.open(packed) as archive:
            archive.extractall(Path(folder) / "state", filter="data")
        for _ in range(TRIES):
            for state, found in ((root, now), (Path(folder) / "state", then)):
                for name, ratio in measure_state(state, variant, names).items():
                    found[name] = min(ratio, found.get(name, ratio))
    return now, then


def compare(
    jobs: Sequence[Job],
    recorded: Mapping[str, float],
    measure: Callable[[Job], float],
    both: Callable[[Sequence[str]], tuple[Mapping[str, float], Mapping[str, float]]],
    rest: Callable[[float], object] = time.sleep,
) -> list[Compared]:
    """Compares the jobs' ratios with the recorded ones.

    Args:
        jobs: Those with a bare engine.
        recorded: {job: ratio}; what has none is not measured.
        measure: Measures a job's ratio once.
        both: See ``measure_both``, of jobs that take too much.
        rest: Waits for some seconds.
    """
    now = {job.name: float("inf") for job in jobs if job.name in recorded}
    known = {job.name: job for job in jobs}

    def too_much(most: Mapping[str, float]) -> list[str]:
        return [name for name, ratio in now.items() if ratio > SLOWER * most[name]]

    for number in range(ROUNDS):
        if number and too_much(recorded):
            rest(PAUSE)
        for name in too_much(recorded):
            now[name] = min(now[name], measure(known[name]))
    before = dict(recorded)
    if left := too_much(recorded):
        here, then = both(left)
        for name in here.keys() & then.keys():
            now[name], before[name] = here[name], max(then[name], recorded[name])
    return [
        Compared(name, before[name], least, SLOWER * before[name]) for name, least in now.items()
    ]
