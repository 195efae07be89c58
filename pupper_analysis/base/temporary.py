"""Files on their way: hidden beside their place until they are whole, and cleared if left there."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import secrets
import stat
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final


@cache
def _home() -> str:
    """Returns what this machine's processes are numbered in, as another's tell nothing here."""
    space = ""
    with suppress(OSError):
        space = Path("/proc/self/ns/pid").readlink().name
    return hashlib.sha256(f"{platform.node()} {space}".encode()).hexdigest()[:8]


def hidden_token() -> str:
    """Returns what the names of files on their way have: whose they are, and which."""
    return f"pupper-{_home()}-{os.getpid():x}-{secrets.token_hex(4)}"


_LEFT: Final = re.compile(r"\..*pupper-([0-9a-f]{8})-([0-9a-f]+)-[0-9a-f]{8}\.\w+")
"""Names of files on their way."""

_cleared: Final[set[tuple[int, Path]]] = set()
"""Folders that a process has cleared of what others left: once is enough."""


def hidden_beside(target: Path) -> Path:
    """Returns a name beside a file that nobody has taken, and that listings do not show.

    What processes left in that folder that were killed while they wrote is removed first.
    """
    clear_left(target.parent)
    return target.parent / f".{hidden_token()}.tmp"


def clear_left(folder: Path) -> None:
    """Removes files on their way whose process is no more."""
    if os.name != "posix" or (os.getpid(), folder) in _cleared:  # elsewhere, to ask is to kill
        return
    _cleared.add((os.getpid(), folder))
    with suppress(OSError):
        for entry in os.scandir(folder):
            found = _LEFT.fullmatch(entry.name)
            if found and found[1] == _home() and not _runs(int(found[2], 16)):
                with suppress(OSError):
                    Path(entry.path).unlink()


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True


def write_new(
    path: Path, data: bytes, *, like: os.stat_result | None = None, lasting: bool = True
) -> None:
    """Makes a file that is on the disk, and not on its way to it, when the call returns.

    A rename may reach the disk before what was renamed does: after a power failure the file of
    that name would be empty.

    Args:
        path: Where nothing is yet.
        data: Its content.
        like: The file whose owner and mode it takes; by default those of any new file.
        lasting: Wait for the disk; what is only tried needs none.

    Raises:
        OSError: If it cannot be made, or something is there.
    """
    # By hand, as tempfile ignores the umask.
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    with os.fdopen(handle, "wb") as file:
        file.write(data)
        if lasting:
            file.flush()
            os.fsync(file.fileno())
    if like is not None:
        with suppress(OSError):  # another's file; nor can all file systems do it
            os.chown(path, like.st_uid, like.st_gid)
        path.chmod(stat.S_IMODE(like.st_mode))
