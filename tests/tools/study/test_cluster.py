"""Studies on Dask and Ray clusters: killed workers and schedulers lose no row.

The table is that of a serial run.
"""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ConfigurationError, StudyError
from pupper_analysis.tools.study.cluster import RayExecutor, connect_dask
from pupper_analysis.tools.study.running import Progress
from tests.support import study_metrics
from tests.support.commands import check_refusal


def make_study(number: int) -> Any:
    """Return a study of a number of servo gains, from kp of 4 to 10 N m/rad."""
    gains = [4.0 + 6.0 * k / number for k in range(number)]
    return pa.Study("v3", {"kp": gains}, ["peak_torque"])


STALL_SECONDS = 300.0
"""Elapsed time [s] without a finished design after which a test fails. Chosen, not tuned: on a free
core a design takes 25 ms, and the start of a worker a few seconds.
"""


def fail_if_stalled(
    report: Callable[[Progress], None] = lambda _: None, limit: float = STALL_SECONDS
) -> Callable[[Progress], None]:
    """Return a progress function that fails if no design finishes within a time limit [s].

    A run calls the function at least once per second, also while no worker answers.

    Args:
        report: Function that is called with the progress as well.
        limit: Elapsed time without a finished design [s].
    """
    last_done, last_time = -1, time.monotonic()

    def check(progress: Progress) -> None:
        nonlocal last_done, last_time
        if progress.done != last_done:
            last_done, last_time = progress.done, time.monotonic()
        if time.monotonic() - last_time > limit:
            pytest.fail(f"no design finished within {limit:g} s, after {last_done} designs")
        report(progress)

    return check


class _WithoutAnswer(ThreadPoolExecutor):
    """Workers that never return a result."""

    def submit(self, function: Any, /, *given: Any, **named: Any) -> Future[Any]:
        return Future()


def test_run_on_workers_without_answer_fails_at_the_deadline(tmp_path: Path) -> None:
    """The deadline of the tests of clusters works: no test waits forever."""
    with (
        _WithoutAnswer(1) as executor,
        pytest.raises(pytest.fail.Exception, match=r"no design finished within 0\.1 s, after 0"),
    ):
        make_study(24).run(tmp_path, executor=executor, progress=fail_if_stalled(limit=0.1))


class _WithoutCancel(ThreadPoolExecutor):
    """Workers without a result, whose futures refuse to be cancelled, as Parsl's do."""

    def submit(self, function: Any, /, *given: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.cancel = mock.Mock(side_effect=NotImplementedError)  # type: ignore[method-assign]
        return future


def test_error_ends_a_run_on_futures_that_cannot_be_cancelled(tmp_path: Path) -> None:
    """Ctrl-C raises KeyboardInterrupt, not the error of the futures."""

    def stop(_: Progress) -> None:
        raise KeyboardInterrupt

    with _WithoutCancel(1) as executor, pytest.raises(KeyboardInterrupt):
        make_study(24).run(tmp_path, executor=executor, progress=stop)


@contextmanager
def occupy_port(number: int) -> Iterator[None]:
    """Listen on a port of this machine, unless another process does."""
    with socket.socket() as listener:
        with suppress(OSError):
            listener.bind(("127.0.0.1", number))
            listener.listen()
        yield


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of Dask and its dependencies
def test_killed_worker_of_a_dask_cluster_loses_no_row(tmp_path: Path) -> None:
    """Reference: the serial run, to the last digit; each design is stored once. The default port
    of Dask is in use, as if another study ran. No profiler of Dask runs on the workers.
    """
    with ThreadPoolExecutor(1) as thread:
        serial = make_study(24).run(tmp_path / "serial", executor=thread)
    killed: list[int] = []
    warnings.filterwarnings("error", "Port")
    dask: Any = pytest.importorskip("dask")
    with occupy_port(8787), connect_dask("local:2") as (executor, workers):
        assert workers == 2
        client = executor._client  # type: ignore[attr-defined]
        profiled = client.run(dask.config.get, "distributed.worker.profile.enabled")
        assert set(profiled.values()) == {False}
        processes = client.run(os.getpid)
        assert len(processes) == 2
        assert os.getpid() not in processes.values()

        def kill_one(progress: Progress) -> None:
            if progress.done >= 4 and not killed:
                killed.append(next(iter(processes.values())))
                os.kill(killed[0], signal.SIGKILL)

        folder = tmp_path / "cluster"
        table = make_study(24).run(
            folder, executor=executor, workers=workers, progress=fail_if_stalled(kill_one)
        )
    assert killed
    assert len(table) == 24
    assert table["design"].is_unique
    assert len(pa.read_study(folder)) == 24
    assert table.equals(serial)


def find_free_port() -> int:
    """Return a free port below those that Linux assigns to sockets without a stated port.

    A worker of the cluster, or another test, could be assigned the port before the scheduler is.
    """
    for port in range(20_000 + os.getpid() % 10_000, 32_768):
        with socket.socket() as free, suppress(OSError):
            free.bind(("127.0.0.1", port))
            return port
    raise AssertionError("no free port")


@contextmanager
def run_cluster(port: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Start a scheduler and two workers, each a process of the command line; yield them."""
    address = f"tcp://127.0.0.1:{port}"
    commands = (
        ("scheduler", "--host", "127.0.0.1", "--port", str(port)),
        ("worker", address, "--nthreads", "1", "--no-nanny"),
        ("worker", address, "--nthreads", "1", "--no-nanny"),
    )
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{kind}", *words, "--no-dashboard"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for kind, *words in commands
    ]
    try:
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of Dask and its dependencies
def test_killed_worker_and_restarted_scheduler_lose_no_row(tmp_path: Path) -> None:
    """Reference: the serial run, to the last digit; each design is stored once.

    A worker is killed after 6 designs and the scheduler after 16, which ends the run. The same
    call continues on a new scheduler at the same address.
    """
    with ThreadPoolExecutor(1) as thread:
        serial = make_study(60).run(tmp_path / "serial", executor=thread)
    port = find_free_port()
    address, folder = f"tcp://127.0.0.1:{port}", tmp_path / "cluster"
    with run_cluster(port) as (scheduler, worker, _):

        def kill(progress: Progress) -> None:
            if progress.done >= 6:
                worker.kill()
            if progress.done >= 16:
                scheduler.kill()

        with (
            connect_dask(address) as (executor, workers),
            pytest.raises(StudyError, match="run the same command again"),
        ):
            make_study(60).run(
                folder, executor=executor, workers=workers, progress=fail_if_stalled(kill)
            )
    stored = len(pa.read_study(folder))
    assert 16 <= stored < 60
    resumed: list[int] = []
    with run_cluster(port), connect_dask(address) as (executor, workers):
        table = make_study(60).run(
            folder,
            executor=executor,
            workers=workers,
            progress=fail_if_stalled(lambda progress: resumed.append(progress.num_stored)),
        )
    assert resumed[-1] == stored
    assert len(table) == 60
    assert table["design"].is_unique
    assert table.equals(serial)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of Ray and its dependencies
def test_worker_of_ray_that_ends_loses_no_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A design that kills its worker once is evaluated again; one that kills each is a crash.

    Reference: the serial run, to the last digit. Ray's workers have niceness 15 by default: with
    ten other processes on two cores, a worker gets less than 1 % of a core.
    """
    ray = pytest.importorskip("ray")
    monkeypatch.setenv("STUDY_MARKER", str(tmp_path / "marker"))
    monkeypatch.setenv("RAY_worker_niceness", "0")
    vary = {"torso_mass_scale": [1.0, 1.2, 2.0, 1.4, 1.1]}  # one of these weighs more than 4 kg
    with ThreadPoolExecutor(1) as thread:
        serial = pa.Study("v3", vary, ["peak_torque"]).run(tmp_path / "serial", executor=thread)
    tables = []
    ray.init(num_cpus=2, include_dashboard=False, logging_level="error", log_to_driver=False)
    try:
        for metric in (study_metrics.crashes_once, study_metrics.crashes):
            made = pa.Study("v3", vary, ["peak_torque", metric])
            folder = tmp_path / metric.__name__
            tables.append(
                made.run(folder, executor=RayExecutor(), workers=2, progress=fail_if_stalled())
            )
    finally:
        ray.shutdown()
    once, always = tables
    assert (tmp_path / "marker").exists()
    assert once["failure"].isna().all()
    assert once["peak_torque"].equals(serial["peak_torque"])
    assert always["design"].is_unique
    assert list(always["failure"].isna()) == [True, True, False, True, True]
    assert always["failure"][2] == "crashed"
    sound = always.index != 2
    assert always["peak_torque"][sound].equals(serial["peak_torque"][sound])


class _RemoteError(Exception):
    """Error of a worker as ipyparallel raises it: with the name of the remote error."""

    ename = "EngineError"


class WorkerLost(Exception):  # noqa: N818 - the name in Parsl
    """Error of Parsl if a worker ended during a task."""


class _LosesFirstTask(ThreadPoolExecutor):
    """Workers of which one ends during the first task; the other continues."""

    def __init__(self, error: Exception) -> None:
        super().__init__(1)
        self.error: Exception | None = error

    def submit(self, function: Any, /, *given: Any, **named: Any) -> Future[Any]:
        if self.error is None:
            return super().submit(function, *given, **named)
        future: Future[Any] = Future()
        future.set_exception(self.error)
        self.error = None
        return future


@pytest.mark.parametrize("error", [_RemoteError(), WorkerLost()], ids=["ipyparallel", "parsl"])
def test_task_of_a_lost_worker_is_evaluated_again(tmp_path: Path, error: Exception) -> None:
    with _LosesFirstTask(error) as executor:
        table = make_study(3).run(tmp_path, executor=executor)
    assert len(table) == 3
    assert table["failure"].isna().all()


class _WithoutModule(ThreadPoolExecutor):
    """Workers on which a module is missing, as on another machine."""

    def submit(self, function: Any, /, *given: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_exception(ModuleNotFoundError("No module named 'ours'", name="ours"))
        return future


def test_module_that_workers_lack_is_named_with_a_remedy(tmp_path: Path) -> None:
    with (
        _WithoutModule(1) as executor,
        pytest.raises(StudyError, match=r'module ours of a metric.*upload_file\("ours.py"\)'),
    ):
        make_study(24).run(tmp_path, executor=executor)


@pytest.mark.parametrize(
    "address",
    [
        *(
            "local:0",
            "local:two",
            "local:",
            "local:1025",
            "",
            "host",
            "tls://",
            "tcp://",
            "tcp://host",
        ),
        *("tcp://:8786", "tcp://host:x", "tcp://host:0", "tcp://host:65536", "tcp://a b:1"),
        *("inproc://", "http://host:80", "scheduler.json", "HTTPS://host:80", "inproc://host:1"),
        *(f"local:{'1' * 5000}", f"tcp://host:{'1' * 5000}", "tcp://[fe80::1%]:8786"),
    ],
)
def test_invalid_address_of_workers_is_refused(address: str) -> None:
    """Nothing is contacted: Dask would wait for an answer, or raise exceptions of its own."""
    with (
        pytest.raises(ConfigurationError, match=r"local:4.*tcp://host:8786"),
        connect_dask(address),
    ):
        pass


@pytest.mark.parametrize(
    "address",
    [
        *("host:8786", "tcp://host:8786", "TCP://host:8786", "ucxx://host:8786"),
        *("gateway://host:8786/c", "tcp://[::1]:8786", "tcp://[fe80::1%eth0]:8786"),
    ],
)
def test_address_of_a_scheduler_is_passed_to_dask(
    monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    def refuse(given: str, **_: Any) -> None:
        raise OSError(f"contacted {given}")

    monkeypatch.setattr("distributed.Client", refuse)
    with (
        pytest.raises(ConfigurationError, match=re.escape(f"contacted {address}")),
        connect_dask(address),
    ):
        pass


def test_scheduler_with_tls_is_refused_without_a_certificate() -> None:
    """Dask raises TypeError before it connects."""
    with pytest.raises(ConfigurationError, match="TLS"), connect_dask("tls://localhost:1"):
        pass


def test_workers_and_dask_exclude_each_other(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "s.toml"
    path.write_text('robot = "v3"\nmeasure = ["stands"]\n[vary]\nkp = { values = [5.0] }\n')
    words = ("study", str(path), "-o", str(tmp_path / "o"), "--dask", "local:2", "--workers", "2")
    check_refusal(capfd, tmp_path, words, "omit --workers with --dask")
