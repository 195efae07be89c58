"""Dask as a study's executor: a cluster of this machine, or one that is there."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import StudyError
from pupper_analysis.tools.study.store import require_library


@contextmanager
def open_cluster(scheduler: str | None, workers: int | None) -> Iterator[tuple[Executor, str]]:
    """Yields the executor of a Dask cluster, and the address of its dashboard.

    Args:
        scheduler: The address of a scheduler; None begins a cluster on this machine, which ends
            with the block.
        workers: Of that cluster: processes of one thread each; by default one per core.

    Raises:
        StudyError: If Dask is not installed, or the scheduler does not answer.
    """
    require_library("distributed")
    from distributed import Client

    try:
        if scheduler is not None:
            client = Client(scheduler, timeout="10s")
        else:
            # One thread each: the engines hold Python's lock most of the time.
            client = Client(
                n_workers=workers or os.cpu_count() or 1,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
            )
    except (OSError, ValueError) as error:
        told = diagnose("scheduler-silent", problem=str(error))
        raise StudyError(scheduler or "-", told) from error
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)  # what is lost is said in one line, by an error
    try:
        with client:
            yield client.get_executor(), str(client.dashboard_link or "")
    finally:
        logger.setLevel(before)
