"""What a run reads: none of it is ever written over by what the same run writes.

A run is a command, or one call of a function that reads and writes. What a Python session has read
before does not count: there the same file is converted, looked at and converted again on purpose.
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
"""Device and number of a file: the same of all its names, links and hard links alike."""


@dataclass
class Run:
    """What a run has read and is to write.

    Attributes:
        force: Whether files that are no results may be replaced; those that are read never are.
        inputs: {file: the name by which it was read}.
        outputs: {file that is there: the name by which it was named as an output}.
        written: Files that the run has made; to read them again is no loss.
        command: The words of the command that it is; none in Python.
        asked: {option: its value}, of what was typed, or is in a file of options.
    """

    force: bool = False
    inputs: dict[Identity, str] = field(default_factory=dict)
    outputs: dict[Identity, Path] = field(default_factory=dict)
    written: set[Identity] = field(default_factory=set)
    command: tuple[str, ...] = ()
    asked: dict[str, Any] = field(default_factory=dict)

    def expect(self, path: Path) -> None:
        """Remembers that a file is to be written, so that reading it ends the run.

        Raises:
            OutputError: If it was read already.
        """
        there = identity_of(path)
        if there is not None:
            self.refuse_input(path, there)
            self.outputs[there] = path

    def refuse_input(self, path: Path, there: Identity) -> None:
        """Refuses to write to a file that was read.

        Raises:
            OutputError: If it was.
        """
        if there in self.inputs and there not in self.written:
            raise OutputError(path, diagnose("output-is-an-input", source=self.inputs[there]))

    def wrote(self, path: Path, *, edited: bool = False) -> None:
        """Remembers a file that the run has made, or edited: then it stays one that is read."""
        there = identity_of(path)
        if there is None:
            return
        if edited:
            self.inputs[there] = str(path)
            self.written.discard(there)
        else:
            self.written.add(there)
        # Numbers of files that are gone are given to others.
        self.outputs = {
            known: name for known, name in self.outputs.items() if identity_of(name) == known
        }


_now: Final[ContextVar[Run | None]] = ContextVar("run", default=None)


def current_run() -> Run | None:
    """Returns the run that is going on; None outside of any."""
    return _now.get()


@contextmanager
def running() -> Iterator[Run]:
    """Yields the run that is going on, or begins one."""
    run = _now.get()
    if run is not None:
        yield run
        return
    token = _now.set(run := Run())
    try:
        yield run
    finally:
        _now.reset(token)


def note_input(path: str | os.PathLike[str]) -> None:
    """Tells the run that a file is read; every reader does.

    Raises:
        OutputError: If it is one that the run is to write: before any work, and not after it.
    """
    run = _now.get()
    if run is None:
        return
    there = identity_of(Path(path))
    if there is None or there in run.written:
        return
    run.inputs.setdefault(there, str(path))
    if there in run.outputs:
        run.refuse_input(run.outputs[there], there)


def identity_of(path: Path) -> Identity | None:
    """Returns what a file is known by, whatever its name; None if there is none."""
    with suppress(OSError, ValueError):
        there = path.stat()
        return there.st_dev, there.st_ino
    return None
