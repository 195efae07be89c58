"""Check that the speed has not decreased: ratios to the engines alone, compared with recorded
ratios.

Our function and the engine's run alternately, and their processor times are compared, since the
machine may do other work. The recorded ratio is the smallest of three ratios of medians. If a ratio
is too large, it is measured again after a pause. If it is still too large, the checkout that
recorded the ratio is measured alternately with this one: other processes slow Python more than an
engine (J, com, M, g took 1.67 times the engine's time in one hour and 2.1 in the next), and they
slow both checkouts equally.
"""

from __future__ import annotations

import csv
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from measure import Job, take_turns

MAX_SLOWDOWN = 1.2
"""Largest permitted ratio of a measured to the recorded ratio. Chosen, not tuned."""

FILE = "benchmarks-ratios.csv"
"""Name of the table of recorded ratios."""

TRIES = 3
"""Number of measurements of a ratio, of which the smallest counts."""

ROUNDS, PAUSE = 3, 10.0
"""Maximum number of measurements of a too large ratio, and pause before each but the first [s]."""

CALLS, SECONDS = 3, 0.7
"""Minimum number of calls, and minimum duration [s], of a measurement."""


class Compared(NamedTuple):
    """Recorded and measured ratio of a job.

    Attributes:
        job: Name of the job.
        recorded: Ratio in ``docs/data``, or the ratio of the checkout that recorded it,
            measured on this machine, if that was measured and is larger.
        now: Smallest measured ratio.
        most: Largest permitted ratio.
    """

    job: str
    recorded: float
    now: float
    most: float

    @property
    def is_kept(self) -> bool:
        """Whether the measured ratio is permitted."""
        return self.now <= self.most


Record = dict[str, dict[str, float]]
"""{family of processors: {job: ratio}}: Python's share of a call differs between them."""


def processor_family(processor: str) -> str:
    """Return maker and product line of a processor, for example ``Intel Xeon``.

    Args:
        processor: Name of the processor, such as ``Intel(R) Xeon(R) Platinum 8370C``.
    """
    words = re.sub(r"\([^)]*\)|\b\w*\d\w*\b|\bGen\b", " ", processor)
    return " ".join(re.findall("[A-Za-z]+", words)[:2])


def read_recorded(folder: Path) -> Record:
    """Return the recorded ratios; empty without a record.

    Args:
        folder: Folder of the record.
    """
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


def make_record_table(record: Record) -> list[tuple[str, ...]]:
    """Return a record as a table with header, a column per processor family."""
    jobs = dict.fromkeys(job for own in record.values() for job in own)
    return [
        ("job", *record),
        *(
            (job, *(f"{own[job]:.3g}" if job in own else "-" for own in record.values()))
            for job in jobs
        ),
    ]


def expected_ratios(record: Record, name: str) -> dict[str, float]:
    """Return {job: recorded ratio} of a processor family.

    For a job without a ratio of this family, the largest ratio of all families is returned.
    """
    largest: dict[str, float] = {}
    for own in record.values():
        for job, ratio in own.items():
            largest[job] = max(ratio, largest.get(job, 0.0))
    return largest | record.get(name, {})


def measure_ratio(job: Job) -> float:
    """Return the ratio of our median processor time to that of the engine alone.

    `measure_state` calls this function in older checkouts, so its name must not change.
    """
    assert job.bare is not None
    ours, bare = take_turns([job.ours, job.bare.run], CALLS, SECONDS, time.process_time)
    return statistics.median(ours) / statistics.median(bare)


def measure_smallest_ratios(
    jobs: Sequence[Job], measure: Callable[[Job], float]
) -> dict[str, float]:
    """Return {job: smallest ratio of all tries}, to be recorded."""
    return {job.name: min(measure(job) for _ in range(TRIES)) for job in jobs}


_MEASURE = """
import json, sys
sys.path[:0] = [sys.argv[1], sys.argv[1] + "/benchmarks"]
import bare, ratios
jobs = [job for job in bare.jobs(sys.argv[2]) if job.name in sys.argv[3:]]
print(json.dumps({job.name: ratios.measure_ratio(job) for job in jobs}))
"""
"""Code that prints the ratios of some jobs of a checkout as JSON."""


def measure_state(root: Path, variant: str, names: Sequence[str]) -> dict[str, float]:
    """Return {job: ratio} of a checkout, measured in a separate process.

    Args:
        root: Folder of the checkout.
        variant: Name of the robot.
        names: Names of the jobs.
    """
    command = [sys.executable, "-c", _MEASURE, str(root), variant, *names]
    free = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=root, env=free, check=True, capture_output=True, text=True)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def measure_both(
    root: Path, record: Path, variant: str, names: Sequence[str]
) -> tuple[dict[str, float], dict[str, float]]:
    """Measure this checkout and the one that wrote a record alternately.

    Args:
        root: Folder of this checkout.
        record: File of the record.
        variant: Name of the robot.
        names: Names of the jobs.

    Returns:
        {job: smallest ratio} of this checkout and of the other; empty without the history of
        Git.
    """
    now, then = dict[str, float](), dict[str, float]()

    def ask(*words: str) -> str:
        command = ["git", "-C", str(root), *words]
        return subprocess.run(command, check=False, capture_output=True, text=True).stdout.strip()

    commit = ask("log", "-1", "--format=%H", "--", str(record))
    if not commit or ask("rev-parse", "--is-shallow-repository") == "true":
        return now, then
    with tempfile.TemporaryDirectory() as folder:
        packed = Path(folder) / "state.zip"
        make = ["git", "-C", str(root), "archive", "-o", str(packed), commit]
        subprocess.run(make, check=True)
        with zipfile.ZipFile(packed) as archive:
            archive.extractall(Path(folder) / "state")
        for _ in range(TRIES):
            for state, found in ((root, now), (Path(folder) / "state", then)):
                for name, ratio in measure_state(state, variant, names).items():
                    found[name] = min(ratio, found.get(name, ratio))
    return now, then


def compare_ratios(
    jobs: Sequence[Job],
    recorded: Mapping[str, float],
    measure: Callable[[Job], float],
    both: Callable[[Sequence[str]], tuple[Mapping[str, float], Mapping[str, float]]],
    rest: Callable[[float], object] = time.sleep,
) -> list[Compared]:
    """Compare the ratios of jobs with the recorded ratios.

    Args:
        jobs: Jobs with an engine.
        recorded: {job: recorded ratio}; other jobs are not measured.
        measure: Function that measures the ratio of a job once.
        both: Function that measures too slow jobs in both checkouts; see ``measure_both``.
        rest: Function that waits [s].
    """
    now = {job.name: float("inf") for job in jobs if job.name in recorded}
    known = {job.name: job for job in jobs}

    def too_much(most: Mapping[str, float]) -> list[str]:
        return [name for name, ratio in now.items() if ratio > MAX_SLOWDOWN * most[name]]

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
        Compared(name, before[name], least, MAX_SLOWDOWN * before[name])
        for name, least in now.items()
    ]
