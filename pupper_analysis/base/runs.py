"""Record of the files that a run reads and writes, so that no run overwrites its own input.

A run is a command, or a call of a function that reads and writes. The record ends with the run: a
Python session may convert a file, inspect the result and convert the file again.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeAlias

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import OutputError

Identity: TypeAlias = tuple[int, int]
"""Device and inode number of a file, equal for all names, symbolic links and hard links of the
file."""


@dataclass
class RunFiles:
    """Files that a run (a command, or a call from Python) has read, has written and will write.

    Attributes:
        force: Whether existing files of other kinds than the output may be replaced. Input files
            are not replaced, unless edited in place by the run.
        inputs: {device and inode of a file: name under which the file was read, or was edited in
            place}.
        outputs: {device and inode of an existing file: name under which the file will be written}.
        written: Device and inode of files that the run has written (not edited in place); reading
            such files is permitted.
        command: Words of the command line; empty in Python.
        request: {option: value} of the command line or of a file of options.
        language: Language of the printed texts: ``"en"`` or ``"zh"``.
    """

    force: bool = False
    inputs: dict[Identity, str] = field(default_factory=dict)
    outputs: dict[Identity, Path] = field(default_factory=dict)
    written: set[Identity] = field(default_factory=set)
    command: tuple[str, ...] = ()
    request: dict[str, Any] = field(default_factory=dict)
    language: str = "en"

    def register_output(self, path: Path) -> None:
        """Register an existing file as an output of the run; a missing file is ignored.

        A later `register_input` of this file raises an error, unless the run has written the file.

        Raises:
            OutputError: If the file is an input of the run (`refuse_input`).
        """
        identity = identify_file(path)
        if identity is not None:
            self.refuse_input(path, identity)
            self.outputs[identity] = path

    def refuse_input(self, path: Path, identity: Identity) -> None:
        """Raise an error if a file is an input of the run, which the run must not overwrite.

        A file that the run itself has written is no input, unless edited in place.

        Raises:
            OutputError: If the file is such an input.
        """
        if identity in self.inputs and identity not in self.written:
            raise OutputError(path, diagnose("output-is-an-input", source=self.inputs[identity]))

    def register_written(self, path: Path, *, edited: bool = False) -> None:
        """Register a file that the run has written. A missing file is ignored.

        Args:
            path: The file.
            edited: Whether the run has edited the file in place. The file then counts as an input
                (`refuse_input`). Otherwise the run may read the file.
        """
        identity = identify_file(path)
        if identity is None:
            return
        if edited:
            self.inputs[identity] = str(path)
            self.written.discard(identity)
        else:
            self.written.add(identity)
        # The file system reuses the inode numbers of deleted files.
        self.outputs = {
            known: name for known, name in self.outputs.items() if identify_file(name) == known
        }


_current_run: Final[ContextVar[RunFiles | None]] = ContextVar("run", default=None)
"""Run that is active in the present context; None outside of a run."""


def current_run() -> RunFiles | None:
    """Return the file record of the command or Python call in progress; None if there is none."""
    return _current_run.get()


def is_command_line() -> bool:
    """Return True during a command of the command line, False in a Python program.

    Error messages use the result to write a remedy as an option, or as Python code. Threads that
    the command starts get False.
    """
    run = _current_run.get()
    return run is not None and bool(run.command)


def current_language() -> str:
    """Return the language of the printed texts: ``"zh"`` if the command selects it, else ``"en"``.

    Threads that the command starts get ``"en"``.
    """
    run = _current_run.get()
    return "en" if run is None else run.language


@contextmanager
def ensure_run() -> Iterator[RunFiles]:
    """Yield the file record of the current run; without a run, start one for the ``with`` block."""
    run = _current_run.get()
    if run is not None:
        yield run
        return
    token = _current_run.set(run := RunFiles())
    try:
        yield run
    finally:
        _current_run.reset(token)


def register_input(path: str | os.PathLike[str]) -> None:
    """Register a file as an input of the current run. Without a run, nothing is done.

    A missing file, and a file that the run itself has written, are ignored.

    Raises:
        OutputError: If this run of the command line also writes this file.
    """
    run = _current_run.get()
    if run is None:
        return
    identity = identify_file(Path(path))
    if identity is None or identity in run.written:
        return
    run.inputs.setdefault(identity, str(path))
    if identity in run.outputs:
        run.refuse_input(run.outputs[identity], identity)


def identify_file(path: Path) -> Identity | None:
    """Return device and inode number of a file, with links followed; None if not accessible."""
    with suppress(OSError, ValueError):
        status = path.stat()
        return status.st_dev, status.st_ino
    return None
