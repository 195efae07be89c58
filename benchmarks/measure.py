"""What is measured, and how: jobs that take turns, so that all meet the same machine."""

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


PATIENCE = 10.0
"""s: no line of a table takes longer than that, and one more turn."""

MUCH_SHORTER, MOST_IN_A_TURN = 5, 30
"""From which share on a short job is called several times while a long one is called once, and how
often at most: of 30 calls all but a few find the caches warm."""


@dataclass(frozen=True)
class Accuracy:
    """How exact an answer is.

    Attributes:
        value: What it is off by; 0 is exact.
        limit: What it must not exceed: a bound that does not depend on the machine.
        what: Of what, with the unit.
    """

    value: float
    limit: float
    what: str

    def __str__(self) -> str:
        return f"{self.value:.0e} {self.what}"


@dataclass(frozen=True)
class Rival:
    """Somebody else who does a job.

    Attributes:
        name: Who.
        run: Does it.
        accuracy: How exact that is; None where it is what ours is compared with.
    """

    name: str
    run: Callable[[], object]
    accuracy: Callable[[], Accuracy] | None = None


@dataclass(frozen=True)
class Job:
    """A job that the package does.

    Attributes:
        name: What is done.
        ours: Does it.
        accuracy: How exact ours is.
        bare: The engine alone, or whatever ours is to be held against.
        goal: How many times as long as ``bare`` ours may take.
        peers: Others.
        quick: Whether the smallest setting has it.
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
    """What was measured of a job: times are medians (s).

    Attributes:
        name: The job's.
        ours: Our time.
        accuracy: How exact ours is, in words.
        exact: Whether that is within its limit.
        bare: By what it is held against, and its time.
        goal: See ``Job``.
        peers: {who: (time, how exact)}.
        calls: How often each was called.
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
        """Our time in times of the bare engine's."""
        return None if self.bare is None else self.ours / self.bare[1]


def measured(job: Job, repeats: int, seconds: float) -> Row:
    """Measures a job; ours, the bare engine and the peers take turns."""
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
    """Returns the times of each of some jobs (s), run by turns.

    They are run so often, and so long, or more; but no longer than ``PATIENCE``. Each turn has
    another order: in a fixed one each always comes after the same other, and finds in the caches
    what that has left there, which for a bare engine after ours is the engine itself. In a turn a
    short job is called until it has taken as long as the longest: else it alone would always find
    the caches as 0.1 s of the other's work, or the machine's other guests, have left them.
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
        and time.perf_counter() < begin + PATIENCE
    ):
        random.shuffle(order)
        for index in order:
            for _ in range(often[index]):
                start = clock()
                jobs[index]()
                times[index].append(clock() - start)
    return times


def median_seconds(job: Callable[[], object], repeats: int) -> float:
    """Returns the median time of a job (s)."""
    return statistics.median(take_turns([job], repeats, 0.0)[0])


def setting() -> dict[str, object]:
    """Returns versions and machine, which times belong to."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return {
        "versions": versions,
        "machine": platform.machine(),
        "processor": processor(),
        "cores": os.cpu_count(),
        "load": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
        "system": platform.system(),
        "time": time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime()),
    }


def processor() -> str:
    """Returns the processor's name, where the system tells it."""
    message = Path("/proc/cpuinfo")
    lines = message.read_text().splitlines() if message.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
