"""Workers of a Dask or Ray cluster for the designs of a study.

`connect_dask` connects to a scheduler, or starts workers on this machine, and yields an executor
for `Study.run`. If a worker ends, Dask evaluates the designs of the worker again on another worker.
`RayExecutor` submits designs to a Ray cluster.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, MissingPackageError

LOCAL_PREFIX: Final = "local:"
"""Start of an address that requests workers on this machine: ``local:4``."""

_MAX_LOCAL_WORKERS: Final = 1024
"""Largest number of worker processes on this machine. Chosen, not tuned."""

_SCHEDULER_ADDRESS: Final = re.compile(
    r"(?:(?!https?:|inproc:)[a-z][a-z0-9+.-]*://)?"
    r"(?:\[[0-9a-f:.]+(?:%\w+)?\]|[^\s:/\[\]]+):([0-9]{1,5})(?:/\S*)?",
    re.ASCII | re.IGNORECASE,
)
"""Pattern of the address of a scheduler: optional protocol, host and port: ``tcp://host:8786``.

The group is the port. Addresses of web pages, and of schedulers within a process, are refused.
"""

_LOCAL_NUMBER: Final = re.compile(r"[0-9]{1,4}")
"""Pattern of a number of worker processes on this machine, up to the digits of
`_MAX_LOCAL_WORKERS`."""

_MAX_PORT: Final = 65535
"""Largest number of a TCP port."""

CONNECT_SECONDS: Final = 30.0
"""Maximum time to wait for the scheduler of a cluster, and then for a first worker [s]. Chosen, not
tuned."""


_LOCAL_DASK_SETTINGS: Final = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
}
"""Dask settings of a cluster on this machine: no statistical profiler, whose results only a
dashboard shows, and less frequent measurements of memory and load. Measured with two workers,
processor time per second of elapsed time: 2 ms instead of 25 ms in each worker, 9 ms instead of 32
ms in the scheduler and client.
"""


@contextmanager
def connect_dask(address: str) -> Iterator[tuple[Executor, int]]:
    """Connect to a Dask cluster in a ``with`` block, to evaluate designs on the workers.

    Args:
        address: Address of a scheduler, such as ``tcp://host:8786``, or ``local:N`` for N worker
            processes on this machine. Local workers end with the ``with`` block.

    Yields:
        Executor, and the total number of threads of the workers.

    Raises:
        ConfigurationError: If the address is not valid, or no scheduler or no worker answers.
        MissingPackageError: If dask.distributed is not installed.
    """
    try:
        dask_config: Any = import_module("dask.config")
        distributed: Any = import_module("distributed")
    except ImportError as error:
        raise MissingPackageError("distributed", "dask") from error
    cluster = None
    found = _SCHEDULER_ADDRESS.fullmatch(address)
    if not address.startswith(LOCAL_PREFIX) and (
        found is None or not 1 <= int(found[1]) <= _MAX_PORT
    ):
        raise ConfigurationError("dask", diagnose("no-cluster-address", given=address))
    if address.startswith(LOCAL_PREFIX):
        number = address.removeprefix(LOCAL_PREFIX)
        if not _LOCAL_NUMBER.fullmatch(number) or not 1 <= int(number) <= _MAX_LOCAL_WORKERS:
            raise ConfigurationError("dask", diagnose("no-cluster-address", given=address))
        # Port 0: any free port. Without an address Dask uses port 8787, and warns if another
        # cluster of this machine uses it.
        with dask_config.set(_LOCAL_DASK_SETTINGS):  # each worker gets a copy
            cluster = distributed.LocalCluster(
                n_workers=int(number),
                threads_per_worker=1,
                processes=True,
                dashboard_address="localhost:0",
                scheduler_kwargs={"dashboard": False},
            )
    try:
        try:
            client = distributed.Client(cluster or address, timeout=CONNECT_SECONDS)
            client.wait_for_workers(1, timeout=CONNECT_SECONDS)
        except Exception as error:  # for example TypeError, if TLS is not configured
            reason = " ".join(str(error).split()) or "no answer"
            problem = diagnose("no-cluster", address=address, problem=reason)
            raise ConfigurationError("dask", problem) from error
        with client:
            yield client.get_executor(), max(1, sum(client.nthreads().values()))
    finally:
        if cluster is not None:
            cluster.close()


class RayExecutor(Executor):
    """Executor that submits each call as a task to the Ray cluster of ``ray.init``.

    Ray does not repeat a task whose worker ended. In this case the study evaluates each design of
    the task again, separately.

    Raises:
        MissingPackageError: If Ray is not installed.
    """

    def __init__(self) -> None:
        try:
            self._ray: Any = import_module("ray")
        except ImportError as error:
            raise MissingPackageError("ray", "ray") from error
        self._remote_functions: dict[Callable[..., Any], Any] = {}  # Ray sends each function once

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """Submit a call ``function(*arguments, **named)``, and return the future result."""
        if function not in self._remote_functions:
            self._remote_functions[function] = self._ray.remote(max_retries=0)(function)
        task = self._remote_functions[function].remote(*arguments, **named)
        future: Future[Any] = task.future()
        return future
