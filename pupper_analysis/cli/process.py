"""Handle output errors and signals of a command-line process: no tracebacks, no lost results.

`tolerate_output_errors` replaces standard output and standard error by streams that record the
first output error and discard later data. The command can then still write its files.
`catch_ending_signals` turns SIGINT, SIGTERM and SIGHUP into the exception `ProcessEnded`, so that
context managers release their resources.
"""

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
    """Stream of bytes that records the first output error, and discards all data after it.

    Attributes:
        failure: First output error; None without an error, or if the first error is a closed pipe.
    """

    def __init__(self, below: io.RawIOBase) -> None:
        super().__init__()
        self._below = below
        self._gone = False
        self.failure: OSError | None = None

    def writable(self) -> bool:
        """Return True, because this stream accepts output."""
        return True

    def isatty(self) -> bool:
        """Return True if the wrapped stream is a terminal."""
        return self._below.isatty()

    def fileno(self) -> int:
        """Return the file descriptor of the wrapped stream."""
        return self._below.fileno()

    def write(self, data: Any) -> int:
        """Write data to the stream, and return the number of written bytes.

        After the first output error, data are discarded; their size is returned nevertheless.
        """
        if not self._gone:
            try:
                return self._below.write(data) or 0
            except OSError as error:
                self._gone = True
                # Windows reports EINVAL for a pipe without a reader.
                if error.errno not in (errno.EPIPE, errno.EINVAL):
                    self.failure = error
        return memoryview(data).nbytes


@contextlib.contextmanager
def tolerate_output_errors() -> Iterator[list[TolerantStream]]:
    """Prevent output errors of standard output and error from being raised, within a context.

    Output errors are recorded, and later output is discarded. A character that the encoding lacks
    is written as a backslash escape. At the end, the original streams are restored.

    Yields:
        Streams that replace standard output and error; without streams that are not replaced, for
        example because they are closed.
    """
    before = sys.stdout, sys.stderr
    _reopen_closed_streams()
    streams = []
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        below = getattr(stream, "buffer", None)
        raw = getattr(below, "raw", below)  # with python -u the buffer is the raw stream
        if stream is None:  # closed by the parent process
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


def _reopen_closed_streams() -> None:
    """Open the null device in place of closed standard streams.

    The next opened file would get the descriptor of a closed stream, and output of libraries to
    this stream would be written to the file.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, which is this one


class ProcessEnded(BaseException):
    """Exception that ends the process after a signal, such as Ctrl-C.

    The class is not derived from KeyboardInterrupt, for which click prints an empty line.
    """


@dataclass
class ProcessEnding:
    """Record of the signal that ends a process.

    Attributes:
        signal: Number of the signal; 0 without a signal.
        caught: True if an exception, such as `ProcessEnded`, has reached the code that ends the
            process. Also True if the context of `catch_ending_signals` has ended. If True, the
            timer does not raise `ProcessEnded` again.
    """

    signal: int = 0
    caught: bool = False

    @property
    def status(self) -> int:
        """Exit status of the process as shells report it, 128 + number of the signal."""
        return 128 + self.signal

    def __str__(self) -> str:
        return "interrupted" if self.signal == signal.SIGINT else "terminated"


RAISE_INTERVAL = 0.3
"""Interval [s] of the timer that raises `ProcessEnded` again if a library has suppressed the
exception. Chosen, not tuned."""

_active_endings: list[ProcessEnding] = []
"""Records of the signals in the active contexts of `catch_ending_signals`, the innermost last."""


def raise_if_ended() -> None:
    """Raise `ProcessEnded` again if a signal has arrived: libraries may suppress exceptions.

    Raises:
        ProcessEnded: If a signal has arrived in the innermost context of `catch_ending_signals`.
    """
    if _active_endings and _active_endings[-1].signal:
        raise ProcessEnded


@contextlib.contextmanager
def catch_ending_signals() -> Iterator[ProcessEnding]:
    """Convert signals that end the process to the exception `ProcessEnded`, within a context.

    The signals are SIGINT, SIGTERM and SIGHUP, if they have the default handler. Outside of the
    main thread, no signal is caught. A second signal ends the process at once. If a library
    suppresses the exception, a timer raises it again, if the platform has one.

    Yields:
        Record of the signal.
    """
    ending = ProcessEnding()
    _active_endings.append(ending)

    def end(number: int, _frame: FrameType | None) -> None:
        """Handle a signal: the first raises `ProcessEnded`, the second ends the process."""
        if ending.signal:
            os._exit(128 + number)
        ending.signal = number
        if hasattr(signal, "setitimer") and signal.getsignal(signal.SIGALRM) is signal.SIG_DFL:
            previous[signal.SIGALRM] = signal.signal(signal.SIGALRM, raise_again)
            signal.setitimer(signal.ITIMER_REAL, RAISE_INTERVAL, RAISE_INTERVAL)
        raise ProcessEnded

    def raise_again(_number: int, _frame: FrameType | None) -> None:
        """Raise `ProcessEnded` again if a library has suppressed it; called by the timer."""
        handled = sys.exc_info()[1]
        while handled is not None and not isinstance(handled, ProcessEnded):
            handled = handled.__context__
        if handled is None and not ending.caught:
            raise ProcessEnded

    previous: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            # Ignored signals remain ignored, for example under nohup.
            default_handlers = (signal.SIG_DFL, signal.default_int_handler)
            if number is not None and signal.getsignal(number) in default_handlers:
                previous[number] = signal.signal(number, end)
    try:
        yield ending
    finally:
        ending.caught = True
        if getattr(signal, "SIGALRM", None) in previous:
            signal.setitimer(signal.ITIMER_REAL, 0)
        _active_endings.pop()
        for number, handler in previous.items():
            signal.signal(number, handler)
