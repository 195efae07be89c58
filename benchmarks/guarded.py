"""Run cases in a separate process, which may crash, hang, or exceed its memory.

Results are lines of JSON in a file, a line per case. Cases with a result in the file are not run
again.
"""

from __future__ import annotations

import json
import multiprocessing as mp
import resource
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

MAX_ADDRESS_SPACE = 8 * 2**30
"""Maximum address space of the process [bytes]: engines map 2 GB, and a case needs some 10 MB."""

MAX_SILENT_TIME = 300.0
"""Time without a result [s] after which the process is stopped: a case takes one or two seconds,
and up to 20 on a busy machine."""

MAX_CASES_PER_PROCESS = 400
"""Number of cases per process: PlaCo leaks 0.4 MB per solved robot."""

Case = tuple[str, Any]


def run_cases(
    work: Callable[[Any], dict[str, Any]], cases: Sequence[Case], file: Path
) -> list[Any]:
    """Return the results of all cases, in the given order.

    Args:
        work: Importable function that computes the result of a case from its argument.
        cases: Pairs (key, argument).
        file: File of the results; created or extended.
    """
    known = read_results(file)
    waiting = [case for case in cases if case[0] not in known]
    while waiting:
        context = mp.get_context("spawn")
        process = context.Process(
            target=_run_in_process,
            args=(work, waiting[:MAX_CASES_PER_PROCESS], str(file)),
            daemon=True,
        )
        process.start()
        seen, since = -1, time.monotonic()
        while process.is_alive():
            process.join(0.2)
            size = file.stat().st_size if file.exists() else 0
            if size != seen:
                seen, since = size, time.monotonic()
            elif time.monotonic() - since > MAX_SILENT_TIME:
                process.kill()
                process.join()
        known = read_results(file)
        left = [case for case in waiting if case[0] not in known]
        if process.exitcode != 0 and left:  # it ended within the first that has no result
            hung = process.exitcode == -9
            said = "hangs" if hung else f"ends the process: {process.exitcode}"
            _append_result(file, left[0][0], {"crash": said})
            left = left[1:]
        waiting = left
    known = read_results(file)
    return [known[key] for key, _ in cases]


def read_results(file: Path) -> dict[str, Any]:
    """Return {key: result} of a file of results; empty if there is no file."""
    if not file.exists():
        return {}
    lines = (json.loads(line) for line in file.read_text().splitlines() if line.endswith("}"))
    return {line.pop("key"): line for line in lines}


def remove_results(file: Path, which: Callable[[dict[str, Any]], bool]) -> None:
    """Remove results from the file, so that their cases run again.

    Args:
        file: File of the results.
        which: Function that returns True for a result to remove.
    """
    kept = {key: result for key, result in read_results(file).items() if not which(result)}
    file.unlink(missing_ok=True)
    for key, result in kept.items():
        _append_result(file, key, result)


def _append_result(file: Path, key: str, result: dict[str, Any]) -> None:
    """Append the result of a case to the file."""
    with file.open("a") as out:
        out.write(json.dumps({"key": key, **result}) + "\n")


def _run_in_process(
    work: Callable[[Any], dict[str, Any]], cases: Sequence[Case], file: str
) -> None:
    """Run cases in this process, with limited memory, and append their results to the file."""
    resource.setrlimit(resource.RLIMIT_AS, (MAX_ADDRESS_SPACE, MAX_ADDRESS_SPACE))
    for key, argument in cases:
        _append_result(Path(file), key, work(argument))
