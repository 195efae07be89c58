"""What a command needs of its process: output that gives no tracebacks, and signals that end it."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import signal
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from types import FrameType
from typing import Any

from pupper_analysis.base.files import ClosedOutput


class TolerantStream(io.RawIOBase):
    """A stream of bytes that remembers what failed and goes on, so that results are not lost.

    Attributes:
        failure: The first error in writing, but for a reader that has gone; None if there is none.
    """

    def __init__(self, below: io.RawIOBase) -> None:
        super().__init__()
        self._below = below
        self._gone = False
        self.failure: OSError | None = None

    def writable(self) -> bool:
        """Whether it takes bytes: it does."""
        return True

    def isatty(self) -> bool:
        """Whether the stream below is a terminal."""
        return self._below.isatty()

    def fileno(self) -> int:
        """Returns the number of the stream below."""
        return self._below.fileno()

    def write(self, data: Any) -> int:
        """Writes, or forgets what nobody takes."""
        if not self._gone:
            try:
                return self._below.write(data) or 0
            except OSError as error:
                self._gone = True
                # Windows says EINVAL of a pipe without a reader.
                if error.errno not in (errno.EPIPE, errno.EINVAL):
                    self.failure = error
        return memoryview(data).nbytes


@contextlib.contextmanager
def tolerate_output_errors() -> Iterator[list[TolerantStream]]:
    """Makes standard output and error take every letter, and go on without reader or room.

    What the encoding lacks is written as its number.
    """
    before = sys.stdout, sys.stderr
    _occupy_closed()
    streams = []
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        below = getattr(stream, "buffer", None)
        raw = getattr(below, "raw", below)  # it is the raw stream itself with python -u
        if stream is None:  # closed by who started the process
            setattr(sys, name, ClosedOutput())
        elif isinstance(raw, io.RawIOBase) and not isinstance(raw, TolerantStream):
            stream.flush()
            patient = TolerantStream(raw)
            streams.append(patient)
            text = io.TextIOWrapper(
                io.BufferedWriter(patient),
                encoding=stream.encoding,
                errors="backslashreplace",
                line_buffering=stream.line_buffering or below is raw,
            )
            setattr(sys, name, text)
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        yield streams
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        sys.stdout, sys.stderr = before


def _occupy_closed() -> None:
    """Opens what stands for nothing as those of the three standard streams that are closed.

    Otherwise the next file that is opened has such a stream's number, and gets what libraries
    print.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # as the lowest number that is free: this one


class ProcessEnded(BaseException):
    """A signal ends the process. No KeyboardInterrupt, of which click makes an empty line."""


@dataclass
class ProcessEnding:
    """Which signal has asked the process to end; 0: none.

    Attributes:
        signal: Its number.
        caught: Whether the exception `ProcessEnded` has reached the code that ends the process.
    """

    signal: int = 0
    caught: bool = False

    @property
    def status(self) -> int:
        """The exit status that shells know."""
        return 128 + self.signal

    def __str__(self) -> str:
        return "interrupted" if self.signal == signal.SIGINT else "terminated"


RAISE_INTERVAL = 0.3
"""Time [s] after which `ProcessEnded` is raised again if a callback has suppressed it. Chosen."""

_now: list[ProcessEnding] = []


def raise_if_ended() -> None:
    """Ends the command if a signal has asked for it, and a library has swallowed that.

    Raises:
        Ended: If so.
    """
    if _now and _now[-1].signal:
        raise ProcessEnded


@contextlib.contextmanager
def catch_ending_signals() -> Iterator[ProcessEnding]:
    """Turns the signals that end a process into an exception, and remembers them.

    What a library makes of the exception, or whether it swallows it, does not matter then. A second
    signal ends the process at once.
    """
    ending = ProcessEnding()
    _now.append(ending)

    def end(number: int, _frame: FrameType | None) -> None:
        if ending.signal:
            os._exit(128 + number)
        ending.signal = number
        if hasattr(signal, "setitimer") and signal.getsignal(signal.SIGALRM) is signal.SIG_DFL:
            before[signal.SIGALRM] = signal.signal(signal.SIGALRM, again)
            signal.setitimer(signal.ITIMER_REAL, RAISE_INTERVAL, RAISE_INTERVAL)
        raise ProcessEnded

    def again(_number: int, _frame: FrameType | None) -> None:
        """Raise `ProcessEnded` again, unless it is being handled or has been caught."""
        handled = sys.exc_info()[1]
        while handled is not None and not isinstance(handled, ProcessEnded):
            handled = handled.__context__
        if handled is None and not ending.caught:
            raise ProcessEnded

    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            # What is ignored, as nohup does it, stays so.
            usual = (signal.SIG_DFL, signal.default_int_handler)
            if number is not None and signal.getsignal(number) in usual:
                before[number] = signal.signal(number, end)
    try:
        yield ending
    finally:
        ending.caught = True
        if getattr(signal, "SIGALRM", None) in before:
            signal.setitimer(signal.ITIMER_REAL, 0)
        _now.pop()
        for number, handler in before.items():
            signal.signal(number, handler)
