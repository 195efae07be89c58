"""Runs cases in a process of their own, which may crash, hang, or ask for too much memory.

The results are lines of JSON in a file, one per case; what is there already is not run again.
"""

from __future__ import annotations

import json
import multiprocessing as mp
import resource
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

MEMORY = 8 * 2**30
"""Bytes of address space: engines map some 2 GB, and a case of ours takes tens of MB."""

SILENT = 300.0
"""s without a result: a case takes a second or two, on a busy machine twenty."""

RECYCLED = 400
"""Cases per process: PlaCo leaks 0.4 MB per robot that is solved."""

Case = tuple[str, Any]


def run(work: Callable[[Any], dict[str, Any]], cases: Sequence[Case], file: Path) -> list[Any]:
    """Returns the results of all cases, in their order.

    Args:
        work: Makes a case's result of its argument; importable, for it runs elsewhere.
        cases: {key: argument}, in pairs.
        file: Has the results.
    """
    known = read(file)
    waiting = [case for case in cases if case[0] not in known]
    while waiting:
        context = mp.get_context("spawn")
        process = context.Process(
            target=_work, args=(work, waiting[:RECYCLED], str(file)), daemon=True
        )
        process.start()
        seen, since = -1, time.monotonic()
        while process.is_alive():
            process.join(0.2)
            size = file.stat().st_size if file.exists() else 0
            if size != seen:
                seen, since = size, time.monotonic()
            elif time.monotonic() - since > SILENT:
                process.kill()
                process.join()
        known = read(file)
        left = [case for case in waiting if case[0] not in known]
        if process.exitcode != 0 and left:  # it ended within the first that has no result
            hung = process.exitcode == -9
            said = "hangs" if hung else f"ends the process: {process.exitcode}"
            _write(file, left[0][0], {"crash": said})
            left = left[1:]
        waiting = left
    known = read(file)
    return [known[key] for key, _ in cases]


def read(file: Path) -> dict[str, Any]:
    """Returns the results so far, by key."""
    if not file.exists():
        return {}
    lines = (json.loads(line) for line in file.read_text().splitlines() if line.endswith("}"))
    return {line.pop("key"): line for line in lines}


def forget(file: Path, which: Callable[[dict[str, Any]], bool]) -> None:
    """Takes results out of the file, so that their cases are run again."""
    kept = {key: result for key, result in read(file).items() if not which(result)}
    file.unlink(missing_ok=True)
    for key, result in kept.items():
        _write(file, key, result)


def _write(file: Path, key: str, result: dict[str, Any]) -> None:
    with file.open("a") as out:
        out.write(json.dumps({"key": key, **result}) + "\n")


def _work(work: Callable[[Any], dict[str, Any]], cases: Sequence[Case], file: str) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    for key, argument in cases:
        _write(Path(file), key, work(argument))
