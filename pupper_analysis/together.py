"""Several files that are written together: all of them, or none."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import OutputError
from pupper_analysis.files import hidden_beside, is_replaceable, reason_of, target_of, write_new


@dataclass(frozen=True)
class Writing:
    """A file that is to be written.

    Attributes:
        path: The file; links are followed.
        content: What it shall hold.
        before: What it is known to hold; None: whatever it holds, or nothing.
    """

    path: Path
    content: bytes
    before: bytes | None = None


def write_together(writings: Sequence[Writing], *, backup: bool = False) -> tuple[Path, ...]:
    """Writes several files, or none of them.

    All new contents are on the disk, under other names, before the first file is replaced; so is
    what each file held, by a second name. Replacing is a rename per file then. If one of them
    fails, or the process is interrupted, those before it are put back. Killed at any moment, each
    file is the old one or the new one.

    Args:
        writings: The files. They keep their modes; new ones have what the umask gives, and their
            folders are made if need be.
        backup: Keep what is there as ``NAME.bak`` (``NAME.bak2``, if that is taken).

    Returns:
        The copies of the old files, if they were asked for.

    Raises:
        OutputError: If one cannot be written, is no regular file, or is not what it was known to
            be. It names the file as it was given.
    """
    files = [_File(writing) for writing in writings]
    kept: list[Path] = []
    done = False
    try:
        for file in files:
            file.stage()
        for file in files:
            file.keep()
            if backup and file.there is not None:
                kept.append(file.backed_up())
        for file in files:
            file.replace()
        done = True
    finally:
        try:
            if not done:
                _undo(files, kept)
        finally:
            for file in files:
                file.clear()
    _flush({file.target.parent for file in files})
    return tuple(kept)


@dataclass(eq=False)
class _File:
    """A file on its way.

    Attributes:
        writing: What is asked for.
        target: Where the path leads to.
        there: What is there; None: nothing.
        new: The new content, under another name.
        old: What was there, under another name.
        stuck: Whether the old one could not be put back, and is to stay where it is kept.
    """

    writing: Writing
    target: Path = field(init=False)
    there: os.stat_result | None = None
    new: Path | None = None
    old: Path | None = None
    stuck: bool = False

    def stage(self) -> None:
        """Writes the new content beside the file."""
        try:
            self.target, self.there = target_of(self.writing.path)
            if self.there is not None:
                self._check(self.there)
            self._compare()
            self.target.parent.mkdir(parents=True, exist_ok=True)
            self.new = hidden_beside(self.target)
            write_new(self.new, self.writing.content, like=self.there)
        except (OSError, ValueError) as error:
            raise self._error(reason_of(error)) from error

    def _check(self, there: os.stat_result) -> None:
        if not is_replaceable(there):
            raise self._error(diagnose("output-no-regular-file"))
        if not os.access(self.target, os.W_OK):
            raise self._error(diagnose("output-not-writable"))

    def _compare(self) -> None:
        before = self.writing.before
        if before is not None and self.target.read_bytes() != before:
            raise self._error(diagnose("output-changed-meanwhile"))

    def keep(self) -> None:
        """Gives what is there a second name, so that no room is needed to put it back."""
        if self.there is None:
            return
        self.old = hidden_beside(self.target)
        try:
            os.link(self.target, self.old)
        except OSError:  # not all file systems can
            try:
                write_new(self.old, self.target.read_bytes(), like=self.there)
            except OSError as error:
                raise self._error(reason_of(error)) from error

    def backed_up(self) -> Path:
        """Copies what is there to a name that is not taken, and returns that."""
        number = 1
        while True:
            path = self.target.with_name(f"{self.target.name}.bak{number if number > 1 else ''}")
            try:
                write_new(path, self.target.read_bytes(), like=self.there)
            except FileExistsError:
                number += 1
            except OSError as error:
                path.unlink(missing_ok=True)
                told = diagnose("copy-not-written", file=path.name, problem=reason_of(error))
                raise self._error(told) from error
            else:
                if self.there is not None:
                    os.utime(path, ns=(self.there.st_atime_ns, self.there.st_mtime_ns))
                return path

    def replace(self) -> None:
        """Puts the new content in the file's place."""
        assert self.new is not None
        try:
            self._compare()
            self.new.replace(self.target)
        except OSError as error:
            raise self._error(reason_of(error)) from error

    def put_back(self) -> None:
        """Puts what was there in its place again, if the new content has taken it."""
        if self.new is None or self.new.exists():  # an interrupt may come right after the rename
            return
        if self.old is None:
            self.target.unlink(missing_ok=True)
            return
        try:
            self.old.replace(self.target)
        except OSError:
            self.stuck = True

    def clear(self) -> None:
        """Removes what was written beside the file."""
        for path in (self.new, None if self.stuck else self.old):
            if path is not None:
                with suppress(OSError):
                    path.unlink(missing_ok=True)

    def _error(self, problem: object) -> OutputError:
        return OutputError(self.writing.path, problem)


def _undo(files: Sequence[_File], copies: Sequence[Path]) -> None:
    """Puts back what was replaced, and removes the copies that were made of it.

    Raises:
        OutputError: If that fails; it tells where the old files are.
    """
    for file in reversed(files):
        file.put_back()
    for path in copies:
        path.unlink(missing_ok=True)
    stuck = [file for file in files if file.stuck]
    if stuck:
        kept = [diagnose("file-kept", file=file.writing.path, copy=file.old) for file in stuck]
        raise OutputError(stuck[0].writing.path, diagnose("files-not-put-back", kept=kept))


def _flush(folders: set[Path]) -> None:
    """Puts renames on the disk, where the system knows of that."""
    for folder in folders:
        with suppress(OSError):
            handle = os.open(folder, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
