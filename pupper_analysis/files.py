"""Output files that are there whole, or not at all, and never destroy what they are written to."""

from __future__ import annotations

import io
import os
import secrets
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Final, TextIO

from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import OutputError

STANDARD_OUTPUT: Final = Path("-")
"""Stands for standard output where a file is asked for; a file of that name needs its folder's."""


class ClosedOutput(io.StringIO):
    """Stands for an output that was closed by who started the process: no result may go there."""


_kept: list[TextIO] = []
"""Standard output, while it is kept for a result."""


@contextmanager
def whole_file(path: Path) -> Iterator[io.BytesIO]:
    """Yields a buffer that becomes the file's content if the block succeeds.

    A regular file is replaced in one step, its mode kept; a new one has the mode that the umask
    gives. Links are followed. What is no regular file (a pipe, a device), and the file that
    standard output goes to, is written to and stays what it is.

    Args:
        path: The file to write; its folder is made if need be. ``-`` is standard output.

    Raises:
        OutputError: If it cannot be written.
    """
    buffer = io.BytesIO()
    try:
        yield buffer
        try:
            _write(path, buffer.getvalue())
        except ValueError as error:  # of a path with a zero byte
            raise OutputError(path, error) from error
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError(path, reason_of(error)) from error


def check_writable(path: Path) -> None:
    """Finds out without writing that a file could not be written.

    Raises:
        OutputError: If so.
    """
    if path == STANDARD_OUTPUT:
        _standard_output()
        return
    try:
        target, there = target_of(path)
        if there is not None and stat.S_ISDIR(there.st_mode):
            raise OutputError(path, diagnose("output-is-a-folder"))
        if there is not None and not os.access(target, os.W_OK):
            raise OutputError(path, diagnose("output-not-writable"))
        if there is None or is_replaceable(there):
            check_folder(target.parent)
    except (OSError, ValueError) as error:
        raise OutputError(path, reason_of(error)) from error


def check_folder(folder: Path) -> None:
    """Finds out without writing that files could not be made in a folder, nor the folder itself.

    Raises:
        OutputError: If so.
    """
    try:
        existing = _nearest(folder)
    except (OSError, ValueError) as error:
        raise OutputError(folder, reason_of(error)) from error
    if not existing.is_dir():
        raise OutputError(folder, diagnose("no-folder", folder=existing))
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(folder, diagnose("folder-not-writable", folder=existing))


def is_replaceable(there: os.stat_result) -> bool:
    """Whether a file is one to be replaced: regular, and not where standard output goes to."""
    if not stat.S_ISREG(there.st_mode):
        return False
    return _standard_stream(there) is None


@contextmanager
def open_as_path(content: bytes) -> Iterator[Path]:
    """Yields the path of a file with this content, for libraries that read nothing but files.

    On Linux it is in memory: nothing is left behind, whenever the process is killed.
    """
    memory = getattr(os, "memfd_create", None)
    if memory is None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "content"
            file.write_bytes(content)
            yield file
        return
    handle = memory("content")
    with os.fdopen(handle, "wb") as stream:
        stream.write(content)
        stream.flush()
        yield Path(f"/proc/self/fd/{handle}")


@contextmanager
def results_on_standard_output() -> Iterator[None]:
    """Keeps standard output for what is written to ``-``; all else goes to standard error."""
    _kept.append(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _kept.pop()


def _nearest(folder: Path) -> Path:
    """Returns the innermost folder of a path that exists."""
    for parent in (folder.absolute(), *folder.absolute().parents):
        with suppress(FileNotFoundError, NotADirectoryError):
            parent.stat()
            return parent
    raise FileNotFoundError("there is no such folder")


def target_of(path: Path) -> tuple[Path, os.stat_result | None]:
    """Returns where a path leads to when its links are followed, and what is there."""
    target = Path(os.path.realpath(path))
    try:
        return target, target.stat()
    except (FileNotFoundError, NotADirectoryError):
        return target, None


def _standard_stream(there: os.stat_result) -> int | None:
    """Returns the number of the standard stream that goes to this file."""
    for number in (1, 2):
        with suppress(OSError):
            if os.path.samestat(there, os.fstat(number)):
                return number
    return None


def _write(path: Path, data: bytes) -> None:
    if path == STANDARD_OUTPUT:
        _print(_standard_output(), data)
        return
    target, there = target_of(path)
    if there is not None and not is_replaceable(there):
        number = _standard_stream(there)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        # Not O_CREAT: what has gone in the meantime is not made as a regular file.
        handle = os.dup(number) if number is not None else os.open(target, os.O_WRONLY)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        return
    if there is not None and not os.access(target, os.W_OK):
        raise OutputError(path, diagnose("output-not-writable"))
    target.parent.mkdir(parents=True, exist_ok=True)
    _replace(target, there, data)


def _replace(target: Path, there: os.stat_result | None, data: bytes) -> None:
    temporary = hidden_beside(target)
    try:
        write_new(temporary, data, like=there)
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def _standard_output() -> TextIO:
    """Returns where results go that are written to ``-``.

    Raises:
        OutputError: If it is closed.
    """
    stream: TextIO | None = _kept[-1] if _kept else sys.stdout
    if stream is None or isinstance(stream, ClosedOutput):
        raise OutputError(STANDARD_OUTPUT, diagnose("standard-output-closed"))
    return stream


def hidden_beside(target: Path) -> Path:
    """Returns a name beside a file that nobody has taken, and that listings do not show."""
    return target.parent / f".{secrets.token_hex(8)}.tmp"


def write_new(path: Path, data: bytes, *, like: os.stat_result | None = None) -> None:
    """Makes a file that is on the disk, and not on its way to it, when the call returns.

    A rename may reach the disk before what was renamed does: after a power failure the file of
    that name would be empty.

    Args:
        path: Where nothing is yet.
        data: Its content.
        like: The file whose owner and mode it takes; by default those of any new file.

    Raises:
        OSError: If it cannot be made, or something is there.
    """
    # By hand, as tempfile ignores the umask.
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    with os.fdopen(handle, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    if like is not None:
        with suppress(OSError):  # another's file; nor can all file systems do it
            os.chown(path, like.st_uid, like.st_gid)
        path.chmod(stat.S_IMODE(like.st_mode))


def _print(stream: TextIO, data: bytes) -> None:
    """Writes bytes to a stream of text, past its encoding where it has bytes below."""
    stream.flush()
    below = getattr(stream, "buffer", None)
    if below is None:
        stream.write(data.decode())
    else:
        below.write(data)
    stream.flush()


def reason_of(error: Exception) -> object:
    """Returns what an error of the operating system says, without its number and path."""
    return getattr(error, "strerror", None) or error
