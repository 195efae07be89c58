"""Measurement of times: jobs run alternately, so that all meet the same load of the machine."""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from random import Random

PACKAGES = (
    *("mujoco", "pin", "placo", "clarabel", "numpy", "scipy", "coal", "matplotlib"),
    *("pin-pink", "mink", "quadprog", "daqp"),
)
"""Distributions whose versions are recorded."""


MAX_MEASURE_TIME = 10.0
"""Time [s] after which no further turn of a job begins. Chosen, not tuned."""

MUCH_SHORTER, MOST_IN_A_TURN = 5, 30
"""Ratio of the longest to a shorter time from which the shorter job is called several times per
turn, and the largest number of these calls: nearly all of 30 calls find warm caches."""


@dataclass(frozen=True)
class Accuracy:
    """Accuracy of a result.

    Attributes:
        value: Error; 0 is exact.
        limit: Largest permitted error, independent of the machine.
        what: Unit and name of the error.
    """

    value: float
    limit: float
    what: str

    def __str__(self) -> str:
        return f"{self.value:.0e} {self.what}"


@dataclass(frozen=True)
class Rival:
    """Alternative implementation of a job.

    Attributes:
        name: Name of the implementation.
        run: Function that does the job.
        accuracy: Function that returns the accuracy; None for the reference of our accuracy.
    """

    name: str
    run: Callable[[], object]
    accuracy: Callable[[], Accuracy] | None = None


@dataclass(frozen=True)
class Job:
    """Job that the package does.

    Attributes:
        name: Name of the job.
        ours: Function that does the job with this package.
        accuracy: Function that returns our accuracy.
        bare: Implementation with the engine alone, or another reference; None without one.
        goal: Largest permitted ratio of our time to that of ``bare``.
        peers: Other implementations.
        quick: Whether the smallest setting of the benchmark includes the job.
    """

    name: str
    ours: Callable[[], object]
    accuracy: Callable[[], Accuracy]
    bare: Rival | None = None
    goal: float | None = None
    peers: tuple[Rival, ...] = ()
    quick: bool = True


@dataclass
class Row:
    """Measured times of a job: medians [s].

    Attributes:
        name: Name of the job.
        ours: Our time.
        accuracy: Our accuracy as text.
        exact: Whether the error is within its limit.
        bare: Name and time of the reference; None without one.
        goal: See ``Job``.
        peers: {name of another implementation: (time, accuracy as text)}.
        calls: Number of our calls.
    """

    name: str
    ours: float
    accuracy: str
    exact: bool
    bare: tuple[str, float] | None
    goal: float | None
    peers: dict[str, tuple[float, str]] = field(default_factory=dict)
    calls: int = 0

    @property
    def ratio(self) -> float | None:
        """Our time divided by that of the reference; None without reference."""
        return None if self.bare is None else self.ours / self.bare[1]


def measure_job(job: Job, repeats: int, seconds: float) -> Row:
    """Measure a job; our function, the reference and the peers run alternately.

    Args:
        job: The job.
        repeats: Minimum number of calls.
        seconds: Minimum duration of the measurement [s].
    """
    rivals = [*([job.bare] if job.bare else []), *job.peers]
    times = take_turns([job.ours, *(rival.run for rival in rivals)], repeats, seconds)
    medians = [statistics.median(taken) for taken in times]
    accuracy = job.accuracy()
    row = Row(
        name=job.name,
        ours=medians[0],
        accuracy=str(accuracy),
        exact=accuracy.value <= accuracy.limit,
        bare=None,
        goal=job.goal,
        calls=len(times[0]),
    )
    for rival, taken in zip(rivals, medians[1:], strict=True):
        if rival is job.bare:
            row.bare = rival.name, taken
        else:
            row.peers[rival.name] = taken, str(rival.accuracy() if rival.accuracy else "")
    return row


def take_turns(
    jobs: list[Callable[[], object]],
    repeats: int,
    seconds: float = 1.0,
    clock: Callable[[], float] = time.perf_counter,
) -> list[list[float]]:
    """Return the times of each call [s] of several jobs, which run alternately.

    The measurement continues until both minima are reached, or `MAX_MEASURE_TIME` has passed. The
    order changes randomly in each turn: in a fixed order, a job would always find the caches that
    the same other job has left. A short job is called several times per turn, since otherwise each
    call would find caches filled by a long job.

    Args:
        jobs: Functions to call.
        repeats: Minimum number of calls of each job.
        seconds: Minimum duration of the measurement [s].
        clock: Function that returns the time [s].

    Returns:
        A list of times per job.
    """
    order, random = list(range(len(jobs))), Random(0)
    times: list[list[float]] = [[] for _ in jobs]
    alone = []
    for job in jobs:
        job()  # what is loaded or made on first use is not measured
        start = clock()
        job()
        alone.append(max(clock() - start, 1e-9))
    shorter = [max(alone) / took for took in alone]
    often = [1 if by < MUCH_SHORTER else min(round(by), MOST_IN_A_TURN) for by in shorter]
    begin = time.perf_counter()
    while not times[0] or (
        (min(map(len, times)) < repeats or time.perf_counter() < begin + seconds)
        and time.perf_counter() < begin + MAX_MEASURE_TIME
    ):
        random.shuffle(order)
        for index in order:
            for _ in range(often[index]):
                start = clock()
                jobs[index]()
                times[index].append(clock() - start)
    return times


def median_seconds(job: Callable[[], object], repeats: int) -> float:
    """Return the median time of a job [s]."""
    return statistics.median(take_turns([job], repeats, 0.0)[0])


def describe_machine() -> dict[str, object]:
    """Return versions, processor and load of the machine, and the date, for JSON."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return {
        "versions": versions,
        "machine": platform.machine(),
        "processor": processor_name(),
        "cores": os.cpu_count(),
        "load": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
        "system": platform.system(),
        "time": time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime()),
    }


def processor_name() -> str:
    """Return the name of the processor, if the system reports it."""
    message = Path("/proc/cpuinfo")
    lines = message.read_text().splitlines() if message.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
