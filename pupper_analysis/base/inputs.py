"""Reading of input files, with limits of file type and size.

Input files are read by ``read_input``, or checked by ``check_input`` if a library opens the file. A
rejected file raises an ``InputError``. Most readers of a file type convert this error to an error
of a more specific class.

A model may also come from standard input. Relative paths in such a model, for example of meshes,
are relative to the current folder.
"""

from __future__ import annotations

import difflib
import os
import re
import stat
import sys
import tomllib
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any, Final

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError
from pupper_analysis.base.files import describe_os_error
from pupper_analysis.base.runs import register_input

CONFIG_NAME: Final = "pupper-analysis.toml"
"""Name of the configuration file of a project: pairs and rules of `check`, keys of `contract`."""

GENERATED_FOLDERS: Final = ("node_modules", "site-packages", "build", "install", "log")
"""Names of folders with generated or installed files, which searches for files skip."""

MAX_TEXT_BYTES: Final = 20_000_000
"""Maximum size of a text file, such as a model or settings [bytes]. Chosen, not tuned."""

MAX_FILE_BYTES: Final = 500_000_000
"""Maximum size of an input file that is no text, such as a mesh or a texture [bytes]. Chosen, not
tuned."""

_CHUNK_BYTES: Final = 1 << 20
"""Number of bytes per read operation. Chosen, not tuned."""

_MAX_COMPARED_NAMES: Final = 2000
"""Maximum number of entries of a folder whose names are compared with the name of a missing file.
Chosen, not tuned."""

_MIN_SIMILARITY: Final = 0.75
"""Smallest similarity (ratio of `difflib.SequenceMatcher`, 0 to 1) between the name of a missing
file and a suggested file name. Chosen: permits one wrong letter of four.
"""

_MAX_KEY_LENGTH: Final = 500
"""Maximum number of characters of a TOML key. Error messages contain the key. Chosen, not tuned."""

_MAX_VALUE_LENGTH: Final = 4096
"""Maximum number of characters of a text in a TOML file. Error messages contain the text. Chosen:
PATH_MAX of Linux."""


def check_input(path: Path, most: int, *, rewritten: bool = False) -> None:
    """Check that a path is a regular file (links followed) of limited size, and register the input.

    The file is not opened: opening a pipe may block, and opening a device may trigger an action.

    Args:
        path: The file.
        most: Maximum size [bytes].
        rewritten: Whether the run (the current command) may also write this file. If False, the
            file is registered as an input, which the run must not write.

    Raises:
        InputError: If the file is missing, is no regular file, or is too large, for example.
        OutputError: If this run of the command line also writes this file, unless ``rewritten`` is
            set.
    """
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError) as error:  # ValueError: a zero byte
        raise InputError(path, describe_missing_file(path)) from error
    except OSError as error:
        raise InputError(
            path, diagnose("file-not-read", message=str(describe_os_error(error)))
        ) from error
    if stat.S_ISDIR(status.st_mode):
        raise InputError(path, diagnose("file-is-folder"))
    if not stat.S_ISREG(status.st_mode):
        raise InputError(path, diagnose("file-not-regular"))
    if status.st_size > most:
        raise InputError(path, diagnose("file-too-large", most=most / 1e6))
    if not rewritten:
        register_input(path)


def read_change_time(path: Path) -> int:
    """Return the modification time of a file [ns], for use in cache keys; -1 if not accessible."""
    try:
        return path.stat().st_mtime_ns
    except (OSError, ValueError):
        return -1


def describe_missing_file(path: Path) -> Diagnostic:
    """Return the message about a missing file, with similar names of files in its folder."""
    return diagnose("no-such-file", alike=[str(file) for file in find_similar_files(path)])


def find_similar_files(path: Path) -> list[Path]:
    """Return up to three files in the folder of a missing file that have similar names.

    The most similar name is the first.
    """
    names: list[str] = []
    with suppress(OSError, ValueError), os.scandir(path.parent) as entries:
        compared = islice(entries, _MAX_COMPARED_NAMES)
        names = [
            entry.name for entry in compared if not entry.name.startswith(".") and entry.is_file()
        ]
    similar = difflib.get_close_matches(path.name, names, cutoff=_MIN_SIMILARITY)
    return [path.parent / name for name in similar]


def name_files(first: str | Path, second: str | Path) -> tuple[str, str]:
    """Return the names of two files without their folders; the paths if the names are equal."""
    names = Path(first).name, Path(second).name
    return names if names[0] != names[1] else (str(first), str(second))


def is_input(path: Path) -> bool:
    """Return True if a path is an existing regular file; False for an invalid path, too."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # for example a name that is too long
        return False


def path_exists(path: Path | str) -> bool:
    """Return True if a path exists; False for an invalid path, such as one that is too long.

    ``Path.exists`` raises an OSError for a path that is too long.
    """
    return os.path.exists(path)  # noqa: PTH110


def is_folder(path: Path | str) -> bool:
    """Return True if a path is an existing folder; False for an invalid path, too."""
    return os.path.isdir(path)  # noqa: PTH112


def read_input(path: Path, most: int, *, rewritten: bool = False) -> bytes:
    """Read an input file of limited size, and register the file as an input of the run (`runs`).

    Args:
        path: The file.
        most: Maximum size [bytes].
        rewritten: Whether the run may also write this file, for example a file in the folder of
            earlier results. Other files are registered as inputs, which the run must not write.

    Raises:
        InputError: If the file is missing, is no regular file, is too large, or cannot be read.
        OutputError: If this run of the command line also writes this file, unless ``rewritten`` is
            set.
    """
    check_input(path, most, rewritten=rewritten)
    try:
        # Non-blocking, because a pipe may have replaced the file since the check.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        data = bytearray()
        with os.fdopen(handle, "rb") as file:
            # In chunks: read(most) allocates the memory in advance, and the size reported for
            # files of the kernel (/proc) is zero.
            while len(data) <= most and (chunk := file.read(_CHUNK_BYTES)):
                data += chunk
    except (OSError, ValueError) as error:
        raise InputError(
            path, diagnose("file-not-read", message=str(describe_os_error(error)))
        ) from error
    if len(data) > most:
        raise InputError(path, diagnose("file-too-large", most=most / 1e6))
    return bytes(data)


def read_text(path: Path) -> str:
    """Read a UTF-8 text file of limited size, and register the file as an input of the run.

    The size limit is `MAX_TEXT_BYTES`.

    Raises:
        InputError: If the file cannot be read, is too large, or is not UTF-8 text.
        OutputError: If this run of the command line also writes this file.
    """
    return decode_input(path, read_input(path, MAX_TEXT_BYTES))


def decode_input(path: Path, data: bytes) -> str:
    """Decode the content of a file as UTF-8, with or without byte order mark.

    Zero bytes after a final ``>`` are removed: C programs write the end of a string.

    Raises:
        InputError: If the content is not UTF-8, or contains other zero bytes.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(path, diagnose("encoded-in-utf-16"))
    if data.endswith(b"\0") and data.rstrip(b"\0").rstrip().endswith(b">"):
        data = data.rstrip(b"\0")
    if b"\0" in data:
        raise InputError(path, diagnose("file-is-binary"), _line_number(data, data.index(b"\0")))
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        problem = diagnose("not-utf-8", byte=data[error.start])
        raise InputError(path, problem, _line_number(data, error.start)) from error


def read_toml(path: Path) -> tuple[str, dict[str, Any]]:
    """Read a TOML file, and return both the text and the parsed values.

    Returns:
        Text of the file; {key: value} of the top level.

    Raises:
        InputError: If the file cannot be read, is no valid TOML, or contains too long a key or
            text, for example.
        OutputError: If this run of the command line also writes this file.
    """
    text = decode_input(path, read_input(path, MAX_TEXT_BYTES))
    try:
        values = tomllib.loads(text)
    except (ValueError, OverflowError, RecursionError) as error:
        match = re.search(r"at line (\d+)", str(error))
        problem = diagnose("not-toml", problem=" ".join(str(error).split()))
        raise InputError(path, problem, int(match[1]) if match else None) from error
    tables: list[Any] = [values]
    for table in tables:  # the loop body appends nested values; error messages contain the key
        if isinstance(table, dict):
            for key in table:
                if len(key) > _MAX_KEY_LENGTH:
                    message = diagnose("toml-key-too-long", begins=key[:40], most=_MAX_KEY_LENGTH)
                    raise InputError(path, message)
        elif isinstance(table, str) and len(table) > _MAX_VALUE_LENGTH:
            message = diagnose("toml-text-too-long", begins=table[:40], most=_MAX_VALUE_LENGTH)
            raise InputError(path, message)
        if isinstance(table, dict | list):
            tables += table.values() if isinstance(table, dict) else table
    return text, values


def _line_number(data: bytes, index: int) -> int:
    """Return the line number, from 1, of the byte at an index."""
    return data.count(b"\n", 0, index) + 1


STANDARD_INPUT: Final = Path("standard input")
"""Path that represents standard input."""

_held_content: list[bytes] = []
"""Content of standard input (one element), or an empty list. The content is kept during a command,
because standard input can be read only once."""


def read_standard_input(most: int) -> Path:
    """Read standard input, and keep the content in memory until ``discard_standard_input``.

    Args:
        most: Maximum number of bytes to read. Further bytes are ignored without an error.

    Returns:
        ``STANDARD_INPUT``, the path for ``read_content``.

    Raises:
        ConfigurationError: If standard input is already held, or cannot be read.
    """
    if _held_content:
        raise ConfigurationError("-", diagnose("standard-input-twice"))
    stream = getattr(sys.stdin, "buffer", None)
    try:
        if stream is None:
            raise OSError("there is none")
        _held_content.append(stream.read(most))
    except (OSError, ValueError) as error:
        unread = diagnose("standard-input-unread", message=str(error))
        raise ConfigurationError("-", unread) from error
    return STANDARD_INPUT


def discard_standard_input() -> None:
    """Discard the content of standard input that ``read_standard_input`` has kept."""
    _held_content.clear()


def is_held(path: Path) -> bool:
    """Return True if a path represents standard input whose content is kept in memory."""
    return path == STANDARD_INPUT and bool(_held_content)


def read_content(path: Path, most: int) -> bytes:
    """Return the content of a file, or of standard input if ``read_standard_input`` has read it.

    Raises:
        InputError: If the file is missing, is no regular file, has more than ``most`` bytes, or
            cannot be read.
        OutputError: If this run of the command line also writes this file.
    """
    if not is_held(path):
        return read_input(path, most)
    if len(_held_content[0]) > most:
        raise InputError(path, diagnose("file-too-large", most=most / 1e6))
    return _held_content[0]
