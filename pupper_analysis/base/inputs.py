"""Input files: the one door by which what a user gives comes in, within limits.

Who reads a file by a library that opens it asks ``check_input`` before; all else comes through
``read_input``. What is refused is an ``InputError``, which readers raise as their own.
"""

from __future__ import annotations

import os
import re
import stat
import sys
import tomllib
from pathlib import Path
from typing import Any, Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError
from pupper_analysis.base.files import reason_of
from pupper_analysis.base.runs import note_input

MOST_TEXT: Final = 20_000_000
"""Bytes of a text that is read as a whole: a model, settings."""

MOST_FILE: Final = 500_000_000
"""Bytes of any other file that is: a mesh, a texture."""

_PART: Final = 1 << 20
_LONGEST_KEY: Final = 500


def check_input(path: Path, most: int, *, own: bool = False) -> None:
    """Refuses what is no regular file, links followed, or larger than what is read.

    Nothing is opened: who opens a pipe waits without end, and who opens a device may act on it.

    Args:
        path: The file.
        most: Bytes.
        own: Whether it is one that the run goes on with, and writes again: all else that is read is
            never written by the same run.

    Raises:
        InputError: If so.
        OutputError: If it is one that the run is to write.
    """
    try:
        there = path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError) as error:  # ValueError: a zero byte
        raise InputError(path, diagnose("no-such-file")) from error
    except OSError as error:
        raise InputError(path, diagnose("file-not-read", message=str(reason_of(error)))) from error
    if stat.S_ISDIR(there.st_mode):
        raise InputError(path, diagnose("file-is-folder"))
    if not stat.S_ISREG(there.st_mode):
        raise InputError(path, diagnose("file-not-regular"))
    if there.st_size > most:
        raise InputError(path, diagnose("file-too-large", most=most / 1e6))
    if not own:
        note_input(path)


def is_input(path: Path) -> bool:
    """Says whether there is a regular file; a name that no file can have is that of none."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, say
        return False


def read_input(path: Path, most: int, *, own: bool = False) -> bytes:
    """Returns the content of a file that a user gave.

    Args:
        path: The file.
        most: Bytes that are read at most.
        own: As in ``check_input``.

    Raises:
        InputError: If it is no regular file, larger, or cannot be read.
        OutputError: If it is one that the run is to write.
    """
    check_input(path, most, own=own)
    try:
        # Not blocking: a pipe may have taken its place.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        data = bytearray()
        with os.fdopen(handle, "rb") as file:
            # In parts: asked for as much as may come, Python takes that much memory; and the size
            # that was seen is none of files of the kernel's.
            while len(data) <= most and (part := file.read(_PART)):
                data += part
    except (OSError, ValueError) as error:
        raise InputError(path, diagnose("file-not-read", message=str(reason_of(error)))) from error
    if len(data) > most:
        raise InputError(path, diagnose("file-too-large", most=most / 1e6))
    return bytes(data)


def read_text(path: Path) -> str:
    """Returns a text that a user gave; see ``read_input`` and ``decode_input``."""
    return decode_input(path, read_input(path, MOST_TEXT))


def decode_input(path: Path, data: bytes) -> str:
    """Returns a file's content as text.

    Raises:
        InputError: If it is no UTF-8, with or without its mark; the error has the line.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(path, diagnose("encoded-in-utf-16"))
    if b"\0" in data:
        raise InputError(path, diagnose("file-is-binary"), _line(data, data.index(b"\0")))
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        problem = diagnose("not-utf-8", byte=data[error.start])
        raise InputError(path, problem, _line(data, error.start)) from error


def read_toml(path: Path) -> tuple[str, dict[str, Any]]:
    """Returns a TOML file's text, and its values.

    Raises:
        InputError: If it cannot be read, or is no TOML; the error has the line.
    """
    text = decode_input(path, read_input(path, MOST_TEXT))
    try:
        values = tomllib.loads(text)
    except (ValueError, OverflowError, RecursionError) as error:
        found = re.search(r"at line (\d+)", str(error))
        problem = diagnose("not-toml", problem=" ".join(str(error).split()))
        raise InputError(path, problem, int(found[1]) if found else None) from error
    tables: list[Any] = [values]
    for table in tables:  # which grows: who refuses a key names it
        if isinstance(table, dict):
            for key in table:
                if len(key) > _LONGEST_KEY:
                    message = diagnose("toml-key-too-long", begins=key[:40], most=_LONGEST_KEY)
                    raise InputError(path, message)
        if isinstance(table, dict | list):
            tables += table.values() if isinstance(table, dict) else table
    return text, values


def _line(data: bytes, at: int) -> int:
    return data.count(b"\n", 0, at) + 1


# A model that comes from standard input has a name, but no file: what is relative in it, such as
# the files of meshes, is relative to the current folder.

STANDARD_INPUT: Final = Path("standard input")
"""What it is called where a file's path would stand."""

_held: list[bytes] = []
"""What was read, while a command works on it: it can be read but once."""


def hold_input(most: int) -> Path:
    """Reads standard input, and keeps it under the name that is returned, until it is forgotten.

    Args:
        most: Bytes that are read at most.

    Raises:
        ConfigurationError: If it was read already, or cannot be.
    """
    if _held:
        raise ConfigurationError("-", diagnose("standard-input-twice"))
    stream = getattr(sys.stdin, "buffer", None)
    try:
        if stream is None:
            raise OSError("there is none")
        _held.append(stream.read(most))
    except (OSError, ValueError) as error:
        unread = diagnose("standard-input-unread", message=str(error))
        raise ConfigurationError("-", unread) from error
    return STANDARD_INPUT


def forget_input() -> None:
    """Lets go of what was held."""
    _held.clear()


def is_held(path: Path) -> bool:
    """Says whether a path is that of the model from standard input."""
    return path == STANDARD_INPUT and bool(_held)


def read_content(path: Path, most: int) -> bytes:
    """Returns the bytes of a file, or of the model from standard input.

    Raises:
        InputError: If it is no regular file, has more bytes than ``most``, or cannot be read.
    """
    if not is_held(path):
        return read_input(path, most)
    if len(_held[0]) > most:
        raise InputError(path, diagnose("file-too-large", most=most / 1e6))
    return _held[0]
