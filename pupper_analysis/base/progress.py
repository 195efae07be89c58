"""Progress of a long computation: counted parts, elapsed time and estimated remaining time.

A computation reports its parts with `report_progress`. Nothing is computed or printed unless a
command observes the progress with `observe_progress`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

MIN_REPORTED_TIME = 2.0
"""Elapsed time from which a progress message contains a time [s]. Chosen, not tuned: shorter waits
need no explanation."""


class ProgressClock:
    """Elapsed time of a computation, and an estimate of the remaining time of its current stage.

    The estimate assumes that the remaining parts of the stage take as long as the mean of the
    completed parts.

    Args:
        clock: Function that returns the time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._start = clock, clock()
        self._stage, self._stage_start, self._updated = "", self._start, self._start
        self.done, self.total = 0, 0

    def update(self, stage: str, done: int, total: int) -> None:
        """Record the number of completed parts of a stage.

        Args:
            stage: Name of the stage. A new name, or a smaller ``done``, begins a new stage.
            done: Number of completed parts.
            total: Number of parts, as far as known.
        """
        now = self._clock()
        if stage != self._stage or done < self.done:
            self._stage, self._stage_start = stage, now if done == 0 else self._updated
        self.done, self.total, self._updated = done, total, now

    @property
    def elapsed(self) -> float:
        """Time since the creation of this clock [s]."""
        return self._clock() - self._start

    @property
    def remaining(self) -> float | None:
        """Estimated remaining time of the stage [s]; None if no part or each part is completed."""
        if not 0 < self.done < self.total:
            return None
        part_duration = (self._updated - self._stage_start) / self.done
        expected = part_duration * (self.total - self.done)
        return max(expected - (self._clock() - self._updated), 0.0)


_clocks: list[ProgressClock] = []
"""Clocks of the active `observe_progress` contexts, the innermost last."""


@contextmanager
def observe_progress() -> Iterator[ProgressClock]:
    """Yield a clock that receives the reports of computations while the context is active.

    In nested contexts, only the clock of the innermost context receives reports.
    """
    clock = ProgressClock()
    _clocks.append(clock)
    try:
        yield clock
    finally:
        _clocks.remove(clock)


def report_progress(stage: str, done: int, total: int) -> None:
    """Report the number of completed parts of a stage of a computation.

    Nothing is done if no command observes the progress (`observe_progress`).

    Args:
        stage: Name of the stage.
        done: Number of completed parts.
        total: Number of parts, as far as known.
    """
    if _clocks:
        _clocks[-1].update(stage, done, total)
