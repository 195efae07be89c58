"""Runs a study's designs on an executor, and loses nothing: not by failures, crashes or kills."""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import os
import pickle
import platform
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import parent_process, resource_tracker
from multiprocessing.process import BaseProcess
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.drivers import no_mujoco_log
from pupper_analysis.base.errors import PupperAnalysisError, StudyError
from pupper_analysis.base.provenance import list_versions
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.study.design import (
    DesignBuilder,
    RobotSource,
    Row,
    is_servo_variable,
    make_failure_columns,
    measure_design,
)
from pupper_analysis.tools.study.measures import Metric, MetricFunction, make_metric
from pupper_analysis.tools.study.store import Store, make_design_keys

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WorkDefinition:
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
    metrics: tuple[str | MetricFunction, ...]
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
    """The results of a chunk.

    Attributes:
        rows: One per design.
        seconds: How long they took.
    """

    rows: tuple[Row, ...]
    seconds: float


class _Ready(threading.local):
    """What a thread has made ready: robots in PlaCo are a thread's own."""

    def __init__(self) -> None:
        self.made: dict[bytes, tuple[WorkDefinition, DesignBuilder, tuple[Metric, ...]]] = {}

    def of(self, pickled: bytes) -> tuple[WorkDefinition, DesignBuilder, tuple[Metric, ...]]:
        if pickled not in self.made:
            self.made.clear()  # of one study after the other
            work: WorkDefinition = pickle.loads(pickled)
            own = list_versions()
            other = {name: own.get(name, "none") for name, version in work.versions.items()
                     if own.get(name) != version}  # fmt: skip
            if other:
                finding = [
                    diagnose("version-there", package=name, there=one, here=work.versions[name])
                    for name, one in other.items()
                ]
                problem = diagnose("worker-of-other-versions", versions=finding)
                raise StudyError(platform.node(), problem)
            maker = DesignBuilder(work.source, work.task, work.point)
            self.made[pickled] = work, maker, tuple(map(make_metric, work.metrics))
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
            row = measure_design(maker, numbers, metrics)
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


_worker_context: Final = contextlib.ExitStack()
"""Holds what lasts as long as a worker process."""


def initialise_worker() -> None:
    """Makes a process ready to work: it ignores Ctrl-C, and ends when its parent has gone.

    MuJoCo writes no log file in it.
    """
    _worker_context.enter_context(no_mujoco_log())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):  # it was kept back so far
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    parent = parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def confirm_ready() -> bool:
    """Shows that a worker works."""
    return True


def split_chunks(
    work: bytes, names: Sequence[str], numbers: Sequence[tuple[float, ...]], size: int
) -> Iterator[Chunk]:
    """Yields designs in chunks of a size."""
    for start in range(0, len(names), size):
        part = slice(start, start + size)
        yield Chunk(work, tuple(names[part]), tuple(numbers[part]))


CHUNK_SECONDS = 0.5
"""s: so long a chunk of designs should take; what it costs to send one is a part in a hundred."""

MAX_CHUNK_DESIGNS = 256
"""Designs in a chunk: rows that are lost if a worker is."""

SHARD_ROWS, SHARD_SECONDS = 4096, 5.0
"""A shard is written when there are so many rows, or when so much time has passed."""

FIRST_SHARD_SECONDS = 0.5
"""s after which the first is written, so that a kill soon after the start loses little. Later ones
come after a fifth of the time that has passed, so that a long run has few."""

MAX_CRASHES = 2
"""A design that ends its worker, alone in it, is tried so often, as the machine may be to blame."""

DESIGNS_PER_PROCESS = 4000
"""Designs after which a process is begun anew: engines keep memory (PlaCo 0.4 MB of each robot that
it reads from a file), which goes with the process; its start takes as long as fifty designs."""

EXIT_WAIT_SECONDS = 5.0
"""s in which a process that has ended must be gone."""

TIME_LIMIT_EXIT_CODE = 1
"""What ``faulthandler`` ends a process with; one that is killed has the signal, negative."""


@dataclass
class Progress:
    """How far a run has come.

    Attributes:
        total: Designs of the study.
        there: Of these, how many were there when it began.
        done: How many this run has added.
        failures: {kind: how many of these failed}.
        seconds: Since it began.
        work: s that workers have spent on designs.
    """

    total: int
    there: int = 0
    done: int = 0
    failures: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    work: float = 0.0

    @property
    def rate(self) -> float:
        """Designs per second."""
        return self.done / self.seconds if self.seconds > 0 else 0.0

    @property
    def left(self) -> float:
        """How long it will go on (s); infinite while nothing is done."""
        rest = self.total - self.there - self.done
        return rest / self.rate if self.rate else (float("inf") if rest else 0.0)


class WorkerPool:
    """The workers: an executor that was given, or processes that are begun anew when one is lost.

    Args:
        executor: The given one.
        workers: How many processes, or how many the given executor has.
    """

    def __init__(self, executor: Executor | None, workers: int | None) -> None:
        self._given = executor
        self.workers = workers or _size(executor) or os.cpu_count() or 1
        self._executor = executor
        self._taken = 0

    @property
    def renewable(self) -> bool:
        """Whether lost processes can be replaced."""
        return self._given is None

    @property
    def worn(self) -> bool:
        """Whether the processes have done so much that new ones shall go on."""
        return self.renewable and self._taken >= DESIGNS_PER_PROCESS * self.workers

    def renew(self) -> None:
        """Ends the processes, which do nothing, and begins others."""
        self.end()
        self.check()  # that the time of the next design is not that of its worker's start

    def submit(self, chunk: Chunk) -> Future[ChunkOutcome]:
        """Hands a chunk over."""
        self._taken += len(chunk.names)
        with self._beginning():
            return self._now().submit(measure_designs, chunk)

    def check(self) -> None:
        """Finds out whether processes can be begun at all.

        Raises:
            StudyError: If not.
        """
        if self._given is None:
            try:
                with self._beginning():
                    begun = self._now().submit(confirm_ready)
                begun.result()
            except BrokenExecutor as error:
                raise StudyError("-", diagnose("workers-end-as-they-begin")) from error

    def _now(self) -> Executor:
        if self._executor is None:
            # Spawned: a fork would copy locks that other threads of the parent hold.
            context = multiprocessing.get_context("spawn")
            self._executor = ProcessPoolExecutor(
                self.workers, context, initializer=initialise_worker
            )
        return self._executor

    @contextlib.contextmanager
    def _beginning(self) -> Iterator[None]:
        """Keeps Ctrl-C from processes that are begun, until they ignore it: see `begin`."""
        if self._given is not None or not hasattr(signal, "pthread_sigmask"):
            yield
            return
        resource_tracker.ensure_running()  # which, as it begins, lets signals through again
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def _processes(self) -> list[BaseProcess]:
        return list((getattr(self._executor, "_processes", None) or {}).values())

    def gave_up(self) -> bool:
        """Whether a process that was begun here has ended itself, as the time limit does it."""
        if self._given is not None:
            return False
        for process in self._processes():
            process.join(EXIT_WAIT_SECONDS)
        return any(process.exitcode == TIME_LIMIT_EXIT_CODE for process in self._processes())

    def end(self) -> None:
        """Ends the processes that were begun here."""
        if self._given is None and self._executor is not None:
            pool, processes = self._executor, self._processes()
            pool.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.terminate()
            for process in processes:
                process.join()
            self._executor, self._taken = None, 0


def _size(executor: Executor | None) -> int | None:
    """Returns how many workers an executor has, if it says so."""
    size = getattr(executor, "_max_workers", None)
    return size if isinstance(size, int) else None


class StudyRun:
    """One run of a study.

    Args:
        work: A pickled ``Work``.
        variables: The names of the numbers of a design.
        limit: How long a design may take (s).
        store: Where results go.
        total: How many designs there are.
        tell: Called with the progress.
    """

    def __init__(
        self,
        work: bytes,
        variables: tuple[str, ...],
        limit: float | None,
        store: Store,
        total: int,
        tell: Callable[[Progress], None],
    ) -> None:
        self.work, self.variables, self.limit = work, variables, limit
        self.store, self.tell = store, tell
        self.progress = Progress(total)
        self._rows: list[Row] = []
        self._begun = self._written = time.monotonic()
        self._tries: Counter[str] = Counter()
        self._suspects: deque[Chunk] = deque()
        self._flying: dict[Future[ChunkOutcome], tuple[Chunk, float]] = {}

    def all(
        self,
        blocks: Iterable[tuple[list[str], Array]],
        executor: Executor | None,
        workers: int | None,
    ) -> Progress:
        """Measures all designs that are not there."""
        crew = WorkerPool(executor, workers)
        source = self._chunks(self._missing(blocks))
        try:
            first = next(source, None)
            if first is not None:
                crew.check()
                self._fly(crew, first, source)
        finally:
            try:
                self._flush()
            finally:
                for future in self._flying:
                    future.cancel()
                crew.end()
        self.tell(self._timed())
        return self.progress

    def _missing(
        self, blocks: Iterable[tuple[list[str], Array]]
    ) -> Iterator[tuple[list[str], Array]]:
        """Yields what is not there, block by block, designs of one robot beside each other."""
        done = self.store.designs()
        for names, numbers in blocks:
            own = make_design_keys(names)
            _, first = np.unique(own, return_index=True)
            once = np.zeros(len(own), bool)
            once[first] = True  # a list's values may come together more than once
            there = np.isin(own, done)
            self.progress.there += int(there.sum())
            self.progress.total -= int((~once & ~there).sum())
            new = np.flatnonzero(once & ~there)
            done = np.union1d(done, own)
            rank = [index for index, name in enumerate(self.variables)
                    if not is_servo_variable(name)]  # fmt: skip
            if len(new) and rank:
                new = new[np.lexsort(numbers[new][:, rank[::-1]].T)]
            if len(new):
                yield [names[index] for index in new], numbers[new]

    def _chunks(self, blocks: Iterable[tuple[list[str], Array]]) -> Iterator[Chunk]:
        for names, numbers in blocks:
            start = 0
            while start < len(names):
                part = slice(start, start + self._size())
                start = part.stop
                rows = tuple(map(tuple, numbers[part].tolist()))
                yield Chunk(self.work, tuple(names[part]), rows)

    def _size(self) -> int:
        """Returns how many designs make a chunk of about ``TASK`` seconds."""
        if not self.progress.done:
            return 1
        each = self.progress.work / self.progress.done
        return int(np.clip(CHUNK_SECONDS / max(each, 1e-6), 1, MAX_CHUNK_DESIGNS))

    def _fly(self, crew: WorkerPool, first: Chunk, source: Iterator[Chunk]) -> None:
        """Keeps the workers busy until all is done."""
        waiting: Chunk | None = first
        while waiting is not None or self._flying or self._suspects:
            if self._suspects:  # one at a time, so that it is known who ends a worker
                if not self._flying:
                    self._submit(crew, self._suspects.popleft())
            elif waiting is not None and crew.worn:
                if not self._flying:
                    crew.renew()
                    continue
            else:
                while waiting is not None and len(self._flying) < 2 * crew.workers + 1:
                    self._submit(crew, waiting)
                    waiting = next(source, None)
            finished, _ = wait(self._flying, timeout=1.0, return_when=FIRST_COMPLETED)
            for future in finished:
                if future in self._flying:
                    self._land(crew, future)
            self.tell(self._timed())
            now = time.monotonic()
            every = min(SHARD_SECONDS, max(FIRST_SHARD_SECONDS, (now - self._begun) / 5))
            if len(self._rows) >= SHARD_ROWS or now - self._written >= every:
                self._flush()

    def _submit(self, crew: WorkerPool, chunk: Chunk) -> None:
        try:
            self._flying[crew.submit(chunk)] = chunk, time.monotonic()
        except BrokenExecutor:
            self._suspects.append(chunk)
            self._lost(crew, None)

    def _land(self, crew: WorkerPool, future: Future[ChunkOutcome]) -> None:
        chunk, begun = self._flying.pop(future)
        try:
            found = future.result()
        except PupperAnalysisError:
            raise
        except (Exception, CancelledError) as error:
            if isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker":
                self._blame(crew, chunk, time.monotonic() - begun)
                if isinstance(error, BrokenExecutor):
                    self._lost(crew, error)
                return
            finding = diagnose("workers-lost", error=type(error).__name__)
            raise StudyError(self.store.folder, finding) from error
        self.progress.work += found.seconds
        self._keep(found.rows)

    def _lost(self, crew: WorkerPool, error: BaseException | None) -> None:
        """Begins processes anew; what was in flight is tried again, design by design."""
        for chunk, _ in self._flying.values():
            self._suspects.extend(_singly(chunk))
        self._flying.clear()
        if not crew.renewable:
            raise StudyError(self.store.folder, diagnose("executor-broken")) from error
        crew.renew()

    def _blame(self, crew: WorkerPool, chunk: Chunk, seconds: float) -> None:
        """Tries the designs of a chunk whose worker ended again, alone; or marks the one it was."""
        (name, *others) = chunk.names
        alone = not others and not self._flying
        if not alone:
            self._suspects.extend(_singly(chunk))
            return
        self._tries[name] += 1
        limit = self.limit
        # Of a given executor it is not known how long the worker had been at it, nor how it ended.
        slow = limit is not None and seconds >= limit and crew.gave_up()
        if self._tries[name] < MAX_CRASHES and not slow:
            self._suspects.append(chunk)
            return
        values = dict(zip(self.variables, chunk.numbers[0], strict=True))
        if slow:
            failed = make_failure_columns("timed out", diagnose("design-took-longer", limit=limit))
        else:
            failed = make_failure_columns("crashed", diagnose("design-ended-its-worker"))
        self._keep(({"design": name, **values, **failed},))

    def _keep(self, rows: Iterable[Row]) -> None:
        for row in rows:
            self._rows.append(row)
            self.progress.done += 1
            if row["failure"] is not None:
                self.progress.failures[row["failure"]] += 1

    def _flush(self) -> None:
        self.store.write(self._rows)
        self._rows, self._written = [], time.monotonic()

    def _timed(self) -> Progress:
        self.progress.seconds = time.monotonic() - self._begun
        return self.progress


def _singly(chunk: Chunk) -> Iterator[Chunk]:
    return split_chunks(chunk.work, chunk.names, chunk.numbers, 1)
