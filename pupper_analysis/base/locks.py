"""Locks: a single run at a time writes to a folder, or adds rows to a file.

`lock_file` holds a POSIX lock on a lock file (``lockf``) while a context is active. The system
refuses the lock to other processes; a set of held files refuses the lock to other contexts of the
process.
"""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

_guard: Final = threading.Lock()
"""Lock of the threads of this process: a single thread at a time reads or changes `_held`."""

_held: Final[set[str]] = set()
"""Resolved paths of the lock files that this process holds. The system itself would grant a second
lock to the same process.
"""


@contextmanager
def lock_file(path: Path, *, temporary: bool = False) -> Iterator[bool]:
    """Hold an exclusive lock on a file; yield False if another context or process holds the lock.

    The system releases the lock when the process ends. On systems without POSIX locks, only other
    contexts of this process are locked out.

    Args:
        path: The lock file. Created if needed.
        temporary: Whether to remove the lock file at the end, if this context held the lock.

    Raises:
        OSError: If the file cannot be opened, or the file system has no locks.
    """
    place = os.path.realpath(path)
    with _guard:
        # Not opened if it is held: closing a second handle would release the lock.
        handle = None if place in _held else _open_locked(place)
        if handle is not None:
            _held.add(place)
    if handle is None:
        yield False
        return
    try:
        yield True
    finally:
        with _guard:
            if temporary:
                with suppress(OSError):
                    Path(place).unlink()
            os.close(handle)
            _held.discard(place)


def _open_locked(place: str) -> int | None:
    """Open and lock a file, and return its descriptor; None if another process holds the lock."""
    while True:
        handle = os.open(place, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if not _lock_file(handle):
                os.close(handle)
                return None
            # The process that held the lock may have removed the file since it was opened.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), Path(place).stat()):
                    return handle
        except OSError:
            os.close(handle)
            raise
        os.close(handle)


def _lock_file(handle: int) -> bool:
    """Lock an open file (descriptor ``handle``); return False if another process holds the lock.

    On systems without POSIX locks, nothing is locked and the result is True.
    """
    try:
        import fcntl
    except ImportError:  # not POSIX
        return True
    try:
        # Not flock: forked workers inherit such a lock, and hold it when the parent has died.
        fcntl.lockf(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EAGAIN):
            return False
        raise
    return True
