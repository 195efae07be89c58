"""Evaluation of the designs of a study on an executor.

Rows are stored at intervals. If a design raises an error, exceeds the time limit or ends the worker
process, the row of the design contains the reason, and the run continues.
"""

from __future__ import annotations

import contextlib
import faulthandler
import io
import multiprocessing.context
import os
import pickle
import platform
import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
from functools import cache
from multiprocessing import parent_process, resource_tracker
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Final

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.drivers import no_mujoco_log
from pupper_analysis.base.errors import PupperAnalysisError, StudyError
from pupper_analysis.base.provenance import list_versions
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.study.design import (
    DesignBuilder,
    DesignRow,
    RobotSource,
    is_servo_variable,
    make_failure_columns,
    measure_design,
)
from pupper_analysis.tools.study.measures import Metric, MetricFunction, make_metric
from pupper_analysis.tools.study.store import Store, make_design_keys


@dataclass(frozen=True)
class WorkDefinition:
    """Data that all designs of a study share, as sent to the workers.

    Attributes:
        source: Source of the robots.
        metrics: Names of metrics, and functions.
        variables: Names of the variables.
        task: Stand task.
        point: Position of a payload: (x, y, z) [m] in the base frame, or (frame, x, y, z).
        versions: Package versions of the machine that started the run.
        process: Host name and process ID of the process that started the run.
        limit: Time limit per design [s], or None.
        motors: {code: motor} of the motor variables.
        present_motor: Motor whose mass the files include; None without motor variables.
    """

    source: RobotSource
    metrics: tuple[str | MetricFunction, ...]
    variables: tuple[str, ...]
    task: StandTask
    point: tuple[str | float, ...]
    versions: dict[str, str]
    process: tuple[str, int]
    limit: float | None
    motors: Mapping[float, Motor]
    present_motor: Motor | None


@dataclass(frozen=True)
class Chunk:
    """Designs of a study that a worker evaluates in a single call.

    Attributes:
        work: Pickled `WorkDefinition`.
        names: Hashes of the designs.
        numbers: Variable values of each design, in the order of ``WorkDefinition.variables``.
    """

    work: bytes
    names: tuple[str, ...]
    numbers: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class ChunkOutcome:
    """Table rows of the designs of a chunk, with the duration of the evaluation.

    Attributes:
        rows: A row per design.
        seconds: Elapsed time of the evaluation [s].
        processor_seconds: Processor time of the evaluation in the worker's thread [s].
    """

    rows: tuple[DesignRow, ...]
    seconds: float
    processor_seconds: float


class _WorkUnpickler(pickle.Unpickler):
    """Unpickler of a `WorkDefinition` that reports a function that a worker cannot import."""

    def find_class(self, module: str, name: str) -> Any:
        """Import an attribute of a module.

        Raises:
            StudyError: If the module has no such attribute.
        """
        try:
            return super().find_class(module, name)
        except AttributeError as error:
            code = "function-in-notebook" if module == "__main__" else "function-not-on-workers"
            raise StudyError("measure", diagnose(code, function=name, module=module)) from error


def load_definition(pickled: bytes) -> WorkDefinition:
    """Unpickle a `WorkDefinition`.

    Raises:
        StudyError: If this process cannot import the function of a metric from its module.
        ModuleNotFoundError: If the module does not exist.
    """
    definition: WorkDefinition = _WorkUnpickler(io.BytesIO(pickled)).load()
    return definition


class _ThreadCache(threading.local):
    """Cache per thread: builder of the designs, and metrics, of the study that is evaluated.

    Threads must not share PlaCo's robots.
    """

    def __init__(self) -> None:
        self.made: dict[bytes, tuple[WorkDefinition, DesignBuilder, tuple[Metric, ...]]] = {}

    def load_work(self, pickled: bytes) -> tuple[WorkDefinition, DesignBuilder, tuple[Metric, ...]]:
        """Return the definition, builder and metrics of a pickled `WorkDefinition`.

        Raises:
            StudyError: If package versions differ from the versions in the definition, or the
                function of a metric cannot be imported.
            ModuleNotFoundError: If the module of such a function does not exist.
        """
        if pickled not in self.made:
            self.made.clear()  # a thread works on one study at a time
            definition = load_definition(pickled)
            installed = list_versions()
            differing = {
                name: installed.get(name, "none")
                for name, version in definition.versions.items()
                if installed.get(name) != version
            }
            if differing:
                messages = [
                    diagnose(
                        "version-there", package=name, there=version, here=definition.versions[name]
                    )
                    for name, version in differing.items()
                ]
                problem = diagnose("worker-of-other-versions", versions=messages)
                raise StudyError(platform.node(), problem)
            if definition.process != (platform.node(), os.getpid()):
                disable_mujoco_log()
            maker = DesignBuilder(
                definition.source,
                definition.task,
                definition.point,
                definition.motors,
                definition.present_motor,
            )
            self.made[pickled] = definition, maker, tuple(map(make_metric, definition.metrics))
        return self.made[pickled]


_thread_cache = _ThreadCache()
"""Definition, builder and metrics of the study that each thread evaluates."""


def measure_designs(chunk: Chunk) -> ChunkOutcome:
    """Evaluate the designs of a chunk in a worker, and return a table row per design.

    Raises:
        StudyError: If package versions differ from those on the machine that started the run.
    """
    start, processor_start = time.perf_counter(), time.thread_time()
    definition, builder, metrics = _thread_cache.load_work(chunk.work)
    rows = []
    for name, values in zip(chunk.names, chunk.numbers, strict=True):
        numbers = dict(zip(definition.variables, values, strict=True))
        with _time_limit(definition.limit):
            row = measure_design(builder, numbers, metrics)
        rows.append({"design": name, **numbers, **row})
    return ChunkOutcome(
        tuple(rows), time.perf_counter() - start, time.thread_time() - processor_start
    )


_time_limit_lock = threading.Lock()
"""Lock of the only timer of the process for time limits of designs (`faulthandler`)."""


@contextmanager
def _time_limit(limit: float | None) -> Iterator[None]:
    """End the process if the ``with`` block takes longer than a limit [s], even in native code.

    Applies only in child processes of ``multiprocessing``, and to a single thread at a time.
    """
    if limit is None or parent_process() is None or not _time_limit_lock.acquire(blocking=False):
        yield
        return
    try:
        with open(os.devnull, "w") as null_device:  # noqa: PTH123 - a device
            faulthandler.dump_traceback_later(limit, exit=True, file=null_device)
            try:
                yield
            finally:
                faulthandler.cancel_dump_traceback_later()
    finally:
        _time_limit_lock.release()


_worker_context: Final = contextlib.ExitStack()
"""Context managers that remain entered until the worker process ends."""


@cache
def disable_mujoco_log() -> None:
    """Disable MuJoCo's log file MUJOCO_LOG.TXT until this process ends."""
    _worker_context.enter_context(no_mujoco_log())


def initialise_worker() -> None:
    """Prepare a worker process: ignore Ctrl-C, write no MuJoCo log file, end with the parent."""
    disable_mujoco_log()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):  # the parent blocked it during the start
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    parent = parent_process()

    def follow() -> None:
        """End this worker process when the parent process ends."""
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def confirm_ready(work: bytes) -> bool:
    """Return True, to show that a worker process has started and can import all metrics.

    Raises:
        StudyError: If the process cannot import the function of a metric from its module.
        ModuleNotFoundError: If the module does not exist.
    """
    load_definition(work)
    return True


def has_main_file() -> bool:
    """Return True if a new process can import the main program, as the start method *spawn* does.

    False if the program is read from standard input: its name ``<stdin>`` is no file. True for a
    notebook: the notebook has no name and is not imported.
    """
    main = sys.modules["__main__"]
    file = getattr(main, "__file__", None)
    return getattr(main, "__spec__", None) is not None or file is None or Path(file).is_file()


def explain_worker_loss(error: BaseException) -> Diagnostic:
    """Return the message about an error that ends the run of a study: a failure of the workers.

    Errors of a single design are not passed to this function; the row of the design contains them.
    """
    if isinstance(error, ModuleNotFoundError):
        return diagnose("module-not-on-workers", module=str(error.name))
    return diagnose("workers-lost", error=type(error).__name__)


def split_chunks(
    work: bytes, names: Sequence[str], numbers: Sequence[tuple[float, ...]], size: int
) -> Iterator[Chunk]:
    """Split the designs of a study into chunks of at most ``size`` designs.

    ``names`` are the hashes of the designs, ``numbers`` the variable values of each design.
    """
    for start in range(0, len(names), size):
        part = slice(start, start + size)
        yield Chunk(work, tuple(names[part]), tuple(numbers[part]))


CHUNK_SECONDS = 0.5
"""Smallest intended processor time of a chunk of designs [s]. Chosen, not tuned."""

MAX_CHUNK_SLOWDOWN = 4.0
"""Largest intended elapsed time of a chunk, relative to the intended processor time, if other
processes use the machine or a metric waits. Chosen, not tuned.
"""

CHUNK_SECONDS_PER_WORKER = 0.01
"""Smallest intended processor time of a chunk, per worker of the cluster [s], so that at most about
100 chunks per second reach the scheduler. Measured with 1,000 workers: a chunk needs 5.7 ms of
processor time in Dask's scheduler, and 3.0 ms in this process (``benchmarks/studies.py
scheduler``).
"""

MAX_CHUNK_DESIGNS = 512
"""Largest number of designs per chunk. If a worker crashes, unfinished chunks are evaluated again;
the bound limits this work. Chosen, not tuned.
"""

SHARD_ROWS, SHARD_SECONDS = 4096, 5.0
"""Number of unwritten rows, and largest time [s] since the last shard (Parquet file), at which
results are written. Chosen, not tuned.
"""

FIRST_SHARD_SECONDS = 0.5
"""Initial time [s] between two shards (Parquet files) of results, which limits the loss if a run
ends early. Later the time grows up to `SHARD_SECONDS`, so that a long run has few shards. Chosen,
not tuned.
"""

MAX_CRASHES = 2
"""Number of worker crashes during the evaluation of a single design. After this number, the design
is recorded as crashed. A first crash may be due to the machine. Chosen, not tuned.
"""

DESIGNS_PER_PROCESS = 4000
"""Number of designs per worker after which all processes are replaced. This frees memory that the
engines do not release (PlaCo: 0.4 MB for each robot read from a file). Chosen, not tuned.
"""

WORKER_END_ERRORS = ("KilledWorker", "WorkerCrashedError", "EngineError", "WorkerLost")
"""Names of the errors of Dask, Ray, ipyparallel and Parsl if a worker ended; other workers
continue."""

EXIT_WAIT_SECONDS = 5.0
"""Maximum waiting time [s] for the end of a process of a broken pool, whose exit code is then read,
or of a process without a design to evaluate. Chosen, not tuned.
"""

TIME_LIMIT_EXIT_CODE = 1
"""Exit code of a process that `faulthandler` ended. A killed process has the negative number of the
signal."""


@dataclass
class Progress:
    """Progress of a run of a study: numbers of designs, and times.

    Attributes:
        total: Number of designs of the study. Repeated designs within a block are subtracted when
            the block is reached.
        num_stored: Number of designs that were stored before the run, or that repeat a design of an
            earlier block.
        done: Number of designs that this run has evaluated.
        failures: {failure kind: number of designs of this run}.
        seconds: Elapsed time [s].
        work: Elapsed time that workers spent on designs [s].
        processor_time: Processor time that workers spent on designs [s].
    """

    total: int
    num_stored: int = 0
    done: int = 0
    failures: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    work: float = 0.0
    processor_time: float = 0.0

    @property
    def rate(self) -> float:
        """Number of designs that a run evaluates per second; 0 before any time has elapsed."""
        return self.done / self.seconds if self.seconds > 0 else 0.0

    @property
    def remaining_time(self) -> float:
        """Estimated remaining time of a run [s], 0 if no design remains.

        Infinite if designs remain and none has been evaluated so far.
        """
        rest = self.total - self.num_stored - self.done
        return rest / self.rate if self.rate else (float("inf") if rest else 0.0)


class _RecordingContext(multiprocessing.context.SpawnContext):
    """Start method *spawn*, with a list of all created processes.

    The processes of an executor are not public. The list gives access to the exit codes, which
    distinguish a time limit from a crash.
    """

    def __init__(self) -> None:
        super().__init__()
        self.processes: list[BaseProcess] = []

    def Process(self, *arguments: Any, **named: Any) -> BaseProcess:  # type: ignore[override]  # noqa: N802
        """Create a process, as `multiprocessing.Process`, and append the process to the list."""
        process = super().Process(*arguments, **named)
        self.processes.append(process)
        return process


def choose_chunk_size(progress: Progress, num_workers: int) -> int:
    """Choose the number of designs per chunk, 1 to `MAX_CHUNK_DESIGNS`, from the measured times.

    Sizes from elapsed time alone would become small on a machine with other load, and the cost per
    design would increase.
    """
    if not progress.done:
        return 1
    seconds = max(progress.processor_time, progress.work / MAX_CHUNK_SLOWDOWN)
    seconds_per_design = max(seconds / progress.done, 1e-6)
    duration = max(CHUNK_SECONDS, CHUNK_SECONDS_PER_WORKER * num_workers)
    return int(np.clip(duration / seconds_per_design, 1, MAX_CHUNK_DESIGNS))


class WorkerPool:
    """Executor of the caller, or worker processes that are replaced after an unexpected end.

    Args:
        executor: Executor of the caller, or None.
        workers: Number of processes, or of workers of the executor; None for the number that the
            executor reports, or a process per core.
        work: Pickled `WorkDefinition`, which the processes must be able to load.
    """

    def __init__(self, executor: Executor | None, workers: int | None, work: bytes) -> None:
        self._given_executor, self._work = executor, work
        self.workers = workers or _count_workers(executor) or os.cpu_count() or 1
        self._executor = executor
        self._processes: list[BaseProcess] = []
        self._num_submitted = 0

    @property
    def owns_processes(self) -> bool:
        """Whether the pool has started the processes itself, and can renew them."""
        return self._given_executor is None

    @property
    def needs_renewal(self) -> bool:
        """Whether the worker processes must be replaced, to free memory (`DESIGNS_PER_PROCESS`)."""
        return self.owns_processes and self._num_submitted >= DESIGNS_PER_PROCESS * self.workers

    def renew(self) -> None:
        """End all worker processes; wait until a first new process is ready.

        The other processes start on demand.
        """
        self.end_processes()
        self.check_startup()  # wait for the start, so that it does not count for the next design

    def submit(self, chunk: Chunk) -> Future[ChunkOutcome]:
        """Submit the evaluation of a chunk of designs to a worker; return the future result."""
        self._num_submitted += len(chunk.names)
        with self._block_interrupts():
            return self._get_executor().submit(measure_designs, chunk)

    def check_startup(self) -> None:
        """Check that worker processes can start and import all metrics.

        An executor of the caller is not checked.

        Raises:
            StudyError: If a process ends during startup, or cannot import a metric or the main
                program.
        """
        if self._given_executor is None:
            if not has_main_file():
                raise StudyError("-", diagnose("main-program-is-no-file"))
            try:
                with self._block_interrupts():
                    ready = self._get_executor().submit(confirm_ready, self._work)
                ready.result()
            except BrokenExecutor as error:
                raise StudyError("-", diagnose("workers-end-as-they-begin")) from error
            except ModuleNotFoundError as error:
                raise StudyError("measure", explain_worker_loss(error)) from error

    def _get_executor(self) -> Executor:
        """Return the executor that evaluates designs; create the processes if there are none."""
        if self._executor is None:
            # Spawn, because a fork copies locks that other threads of the parent hold.
            context = _RecordingContext()
            self._processes = context.processes
            self._executor = ProcessPoolExecutor(
                self.workers, context, initializer=initialise_worker
            )
        return self._executor

    @contextlib.contextmanager
    def _block_interrupts(self) -> Iterator[None]:
        """Block Ctrl-C in processes that start in a context, until `initialise_worker` has run."""
        if self._given_executor is not None or not hasattr(signal, "pthread_sigmask"):
            yield
            return
        resource_tracker.ensure_running()  # its start unblocks signals
        old_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, old_mask)

    def exceeded_time_limit(self) -> bool:
        """Return True if a process of the pool has ended because of the time limit.

        Waits for processes that are ending. False for an executor of the caller.
        """
        if self._given_executor is not None:
            return False
        for process in self._processes:
            process.join(EXIT_WAIT_SECONDS)
        return any(process.exitcode == TIME_LIMIT_EXIT_CODE for process in self._processes)

    def end_processes(self, *, idle: bool = False) -> None:
        """End the worker processes. Workers of an executor of the caller keep running.

        A process that the system could not start is skipped.

        Args:
            idle: True if no design is being evaluated. The processes then end by themselves, within
                `EXIT_WAIT_SECONDS`: if a process ends while MuJoCo is imported, a child process
                of GLFW prints a traceback.
        """
        if self._given_executor is None and self._executor is not None:
            self._executor.shutdown(wait=False, cancel_futures=True)
            started = [process for process in self._processes if process.pid is not None]
            deadline = time.monotonic() + (EXIT_WAIT_SECONDS if idle else 0.0)
            for process in started:
                process.join(max(0.0, deadline - time.monotonic()))
                process.terminate()
            for process in started:
                process.join()
            self._executor, self._num_submitted = None, 0


def _count_workers(executor: Executor | None) -> int | None:
    """Return the number of workers that an executor reports, or None."""
    size = getattr(executor, "_max_workers", None)
    return size if isinstance(size, int) else None


class StudyRun:
    """Run of a study: distributes designs to workers, and stores the results.

    Args:
        work: Pickled `WorkDefinition`.
        variables: Names of the variables.
        limit: Time limit per design [s], or None.
        store: Folder of the results.
        total: Number of designs.
        report: Function that is called with the progress.
    """

    def __init__(
        self,
        work: bytes,
        variables: tuple[str, ...],
        limit: float | None,
        store: Store,
        total: int,
        report: Callable[[Progress], None],
    ) -> None:
        self.work, self.variables, self.limit = work, variables, limit
        self.store, self.report = store, report
        self.progress = Progress(total)
        self._rows: list[DesignRow] = []
        self._start_time = self._last_write_time = time.monotonic()
        self._crashes: Counter[str] = Counter()
        self._suspects: deque[Chunk] = deque()
        self._in_flight: dict[Future[ChunkOutcome], tuple[Chunk, float]] = {}

    def measure_missing(
        self,
        blocks: Iterable[tuple[list[str], Array]],
        executor: Executor | None,
        workers: int | None,
    ) -> Progress:
        """Evaluate and store all designs of a study that are not stored yet; return the progress.

        ``blocks`` contain hashes and variable values, shape (n, variables), of designs.

        Raises:
            StudyError: If stored results cannot be read, or the workers are lost, for example.
            OutputError: If the results cannot be written.
        """
        pool = WorkerPool(executor, workers, self.work)
        source = self._make_chunks(self._find_missing(blocks), pool.workers)
        try:
            first = next(source, None)
            if first is not None:
                pool.check_startup()
                self._run_chunks(pool, first, source)
        finally:
            try:
                self._write_shard()
            finally:
                for future in self._in_flight:
                    with contextlib.suppress(NotImplementedError):  # futures of Parsl
                        future.cancel()
                pool.end_processes(idle=all(future.done() for future in self._in_flight))
        self.report(self._update_progress())
        return self.progress

    def _find_missing(
        self, blocks: Iterable[tuple[list[str], Array]]
    ) -> Iterator[tuple[list[str], Array]]:
        """Yield the designs of each block without a stored result: hashes and variable values.

        The designs are sorted, so that neighbours can share a robot. Variable values have the shape
        (n, variables).
        """
        stored_keys = self.store.designs()
        for names, numbers in blocks:
            keys = make_design_keys(names)
            _, first = np.unique(keys, return_index=True)
            is_first = np.zeros(len(keys), bool)
            is_first[first] = True  # a design may occur more than once
            is_stored = np.isin(keys, stored_keys)
            self.progress.num_stored += int(is_stored.sum())
            self.progress.total -= int((~is_first & ~is_stored).sum())
            new = np.flatnonzero(is_first & ~is_stored)
            stored_keys = np.union1d(stored_keys, keys)
            robot_columns = [index for index, name in enumerate(self.variables)
                    if not is_servo_variable(name)]  # fmt: skip
            if len(new) and robot_columns:
                new = new[np.lexsort(numbers[new][:, robot_columns[::-1]].T)]
            if len(new):
                yield [names[index] for index in new], numbers[new]

    def _make_chunks(
        self, blocks: Iterable[tuple[list[str], Array]], num_workers: int
    ) -> Iterator[Chunk]:
        """Yield the designs in chunks, each for a single worker, sized by the measured times.

        A block consists of the hashes of n designs and the variable values, shape (n, variables).
        """
        for names, numbers in blocks:
            start = 0
            while start < len(names):
                part = slice(start, start + choose_chunk_size(self.progress, num_workers))
                start = part.stop
                rows = tuple(map(tuple, numbers[part].tolist()))
                yield Chunk(self.work, tuple(names[part]), rows)

    def _run_chunks(self, pool: WorkerPool, first: Chunk, source: Iterator[Chunk]) -> None:
        """Evaluate ``first`` and the chunks of ``source`` in workers of ``pool``; store rows."""
        waiting: Chunk | None = first
        while waiting is not None or self._in_flight or self._suspects:
            if self._suspects:  # one at a time, to find the design that ends a worker
                if not self._in_flight:
                    self._submit_chunk(pool, self._suspects.popleft())
            elif waiting is not None and pool.needs_renewal:
                if not self._in_flight:
                    pool.renew()
                    continue
            else:
                while waiting is not None and len(self._in_flight) < 2 * pool.workers + 1:
                    self._submit_chunk(pool, waiting)
                    waiting = next(source, None)
            finished, _ = wait(self._in_flight, timeout=1.0, return_when=FIRST_COMPLETED)
            for future in finished:
                if future in self._in_flight:
                    self._collect_chunk(pool, future)
            self.report(self._update_progress())
            now = time.monotonic()
            period = min(SHARD_SECONDS, max(FIRST_SHARD_SECONDS, (now - self._start_time) / 5))
            if len(self._rows) >= SHARD_ROWS or now - self._last_write_time >= period:
                self._write_shard()

    def _submit_chunk(self, pool: WorkerPool, chunk: Chunk) -> None:
        """Submit a chunk of designs to the workers; restart broken workers."""
        try:
            self._in_flight[pool.submit(chunk)] = chunk, time.monotonic()
        except BrokenExecutor:
            self._suspects.append(chunk)
            self._restart_workers(pool, None)

    def _collect_chunk(self, pool: WorkerPool, future: Future[ChunkOutcome]) -> None:
        """Store the rows of a finished chunk, or schedule the designs again if the worker ended."""
        chunk, start = self._in_flight.pop(future)
        try:
            outcome = future.result()
        except PupperAnalysisError:
            raise
        except (Exception, CancelledError) as error:
            name = getattr(error, "ename", type(error).__name__)  # RemoteError of ipyparallel
            if isinstance(error, BrokenExecutor) or name in WORKER_END_ERRORS:
                self._retry_alone(pool, chunk, time.monotonic() - start)
                if isinstance(error, BrokenExecutor):
                    self._restart_workers(pool, error)
                return
            raise StudyError(self.store.folder, explain_worker_loss(error)) from error
        self.progress.work += outcome.seconds
        self.progress.processor_time += outcome.processor_seconds
        self._store_rows(outcome.rows)

    def _restart_workers(self, pool: WorkerPool, error: BaseException | None) -> None:
        """Restart the workers, or raise a StudyError for an executor of the caller.

        The submitted designs are scheduled again, separately.
        """
        for chunk, _ in self._in_flight.values():
            self._suspects.extend(_split_singly(chunk))
        self._in_flight.clear()
        if not pool.owns_processes:
            raise StudyError(self.store.folder, diagnose("executor-broken")) from error
        pool.renew()

    def _retry_alone(self, pool: WorkerPool, chunk: Chunk, seconds: float) -> None:
        """Schedule the designs of a chunk separately after the worker ended unexpectedly.

        A design that ends workers repeatedly is recorded as failed. ``seconds`` have passed since
        the chunk was submitted.
        """
        (name, *other_names) = chunk.names
        is_alone = not other_names and not self._in_flight
        if not is_alone:
            self._suspects.extend(_split_singly(chunk))
            return
        self._crashes[name] += 1
        limit = self.limit
        # A given executor reports neither the run time of the worker nor its exit code.
        timed_out = limit is not None and seconds >= limit and pool.exceeded_time_limit()
        if self._crashes[name] < MAX_CRASHES and not timed_out:
            self._suspects.append(chunk)
            return
        values = dict(zip(self.variables, chunk.numbers[0], strict=True))
        if timed_out:
            columns = make_failure_columns("timed out", diagnose("design-took-longer", limit=limit))
        else:
            columns = make_failure_columns("crashed", diagnose("design-ended-its-worker"))
        self._store_rows(({"design": name, **values, **columns},))

    def _store_rows(self, rows: Iterable[DesignRow]) -> None:
        """Collect the result rows of designs until the next shard is written; count failures."""
        for row in rows:
            self._rows.append(row)
            self.progress.done += 1
            if row["failure"] is not None:
                self.progress.failures[row["failure"]] += 1

    def _write_shard(self) -> None:
        """Write the collected table rows to the study folder as a shard (Parquet file)."""
        self.store.write(self._rows)
        self._rows, self._last_write_time = [], time.monotonic()

    def _update_progress(self) -> Progress:
        """Return the progress with the elapsed time."""
        self.progress.seconds = time.monotonic() - self._start_time
        return self.progress


def _split_singly(chunk: Chunk) -> Iterator[Chunk]:
    """Yield the designs of a chunk as chunks of a single design."""
    return split_chunks(chunk.work, chunk.names, chunk.numbers, 1)
