"""A model that comes from standard input: it has a name, but no file.

What is relative in it, such as the files of meshes, is relative to the current folder.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError
from pupper_analysis.base.inputs import read_input

NAME: Final = Path("standard input")
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
    return NAME


def forget_input() -> None:
    """Lets go of what was held."""
    _held.clear()


def is_held(path: Path) -> bool:
    """Says whether a path is that of the model from standard input."""
    return path == NAME and bool(_held)


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
