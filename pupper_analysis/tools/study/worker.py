"""What a worker does: it measures some designs, in a process of its own or in a thread."""

from __future__ import annotations

import faulthandler
import os
import pickle
import platform
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import parent_process

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import StudyError
from pupper_analysis.base.provenance import list_versions
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.study.design import Maker, RobotSource, Row, row_of
from pupper_analysis.tools.study.measures import Function, Metric, metric_of


@dataclass(frozen=True)
class Work:
    """What all designs of a study have in common, as it is sent to workers.

    Attributes:
        source: Of the robots.
        metrics: Names and functions.
        variables: The names of the numbers of a design.
        task: The stance.
        point: Of payloads (m); see ``robot.tool.find_place``.
        versions: Of the one who asks.
        limit: How long a design may take (s), where a worker can be ended; else None.
    """

    source: RobotSource
    metrics: tuple[str | Function, ...]
    variables: tuple[str, ...]
    task: StandTask
    point: tuple[str | float, ...]
    versions: dict[str, str]
    limit: float | None


@dataclass(frozen=True)
class Chunk:
    """Some designs for a worker.

    Attributes:
        work: A pickled ``Work``.
        names: Of the designs.
        numbers: Of each, in the order of ``Work.variables``.
    """

    work: bytes
    names: tuple[str, ...]
    numbers: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class ChunkOutcome:
    """What came of a chunk.

    Attributes:
        rows: One per design.
        seconds: How long they took.
    """

    rows: tuple[Row, ...]
    seconds: float


class _Ready(threading.local):
    """What a thread has made ready: robots in PlaCo are a thread's own."""

    def __init__(self) -> None:
        self.made: dict[bytes, tuple[Work, Maker, tuple[Metric, ...]]] = {}

    def of(self, pickled: bytes) -> tuple[Work, Maker, tuple[Metric, ...]]:
        if pickled not in self.made:
            self.made.clear()  # of one study after the other
            work: Work = pickle.loads(pickled)
            own = list_versions()
            other = {name: own.get(name, "none") for name, version in work.versions.items()
                     if own.get(name) != version}  # fmt: skip
            if other:
                told = [
                    diagnose("version-there", package=name, there=one, here=work.versions[name])
                    for name, one in other.items()
                ]
                problem = diagnose("worker-of-other-versions", versions=told)
                raise StudyError(platform.node(), problem)
            maker = Maker(work.source, work.task, work.point)
            self.made[pickled] = work, maker, tuple(map(metric_of, work.metrics))
        return self.made[pickled]


_ready = _Ready()


def measure_designs(chunk: Chunk) -> ChunkOutcome:
    """Measures some designs.

    Raises:
        StudyError: If this machine has other versions than the one that asks.
    """
    start = time.perf_counter()
    work, maker, metrics = _ready.of(chunk.work)
    rows = []
    for name, values in zip(chunk.names, chunk.numbers, strict=True):
        numbers = dict(zip(work.variables, values, strict=True))
        with _time_limit(work.limit):
            row = row_of(maker, numbers, metrics)
        rows.append({"design": name, **numbers, **row})
    return ChunkOutcome(tuple(rows), time.perf_counter() - start)


_alone = threading.Lock()


@contextmanager
def _time_limit(limit: float | None) -> Iterator[None]:
    """Ends the process if the block takes longer (s), even where it never comes back to Python.

    Only a process that was started to do work, and one thread of it at a time.
    """
    if limit is None or parent_process() is None or not _alone.acquire(blocking=False):
        yield
        return
    try:
        with open(os.devnull, "w") as nowhere:  # noqa: PTH123 - a device
            faulthandler.dump_traceback_later(limit, exit=True, file=nowhere)
            try:
                yield
            finally:
                faulthandler.cancel_dump_traceback_later()
    finally:
        _alone.release()


def begin_worker() -> None:
    """Makes a process ready to work: it ignores Ctrl-C, and ends when its parent has gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):  # it was kept back so far
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    parent = parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def answer_ready() -> bool:
    """Shows that a worker works."""
    return True


def split_chunks(
    work: bytes, names: Sequence[str], numbers: Sequence[tuple[float, ...]], size: int
) -> Iterator[Chunk]:
    """Yields designs in chunks of a size."""
    for start in range(0, len(names), size):
        part = slice(start, start + size)
        yield Chunk(work, tuple(names[part]), tuple(numbers[part]))
