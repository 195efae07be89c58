"""The one module that writes files: whole or not at all, never over what must not be replaced.

Nothing is written over what the run reads (`runs`), by whatever name; and without ``force`` over
nothing but a result of the same kind (`kinds`). Files on their way are hidden beside their place
until they are whole, and cleared if left there. Scratch in the system's temporary folder is no
result, and does not go through here.
"""

from __future__ import annotations

import hashlib
import io
import os
import platform
import re
import secrets
import stat
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Final, TextIO

from pupper_analysis.base.diagnostics import Term, diagnose
from pupper_analysis.base.errors import OutputError
from pupper_analysis.base.kinds import Kind
from pupper_analysis.base.runs import current_run


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


STANDARD_OUTPUT: Final = Path("-")
"""Stands for standard output where a file is asked for; a file of that name needs its folder's."""


class ClosedOutput(io.StringIO):
    """Stands for an output that was closed by who started the process: no result may go there."""


_kept: list[TextIO] = []
"""Standard output, while it is kept for a result."""


@contextmanager
def whole_file(path: Path, kind: Kind, *, force: bool = False) -> Iterator[io.BytesIO]:
    """Yields a buffer that becomes the file's content if the block succeeds.

    A regular file is replaced in one step, its mode kept; a new one has the mode that the umask
    gives. Links are followed. What is no regular file (a pipe, a device), and the file that
    standard output goes to, is written to and stays what it is.

    Args:
        path: The file to write; its folder is made if need be. ``-`` is standard output.
        kind: What it is: without ``force`` it replaces nothing else.
        force: Replace whatever is there, but for what the run reads.

    Raises:
        OutputError: If it cannot be written, or must not be.
    """
    buffer = io.BytesIO()
    try:
        yield buffer
        try:
            _write(Writing(path, buffer.getvalue(), kind, force=force))
        except ValueError as error:  # of a path with a zero byte
            raise OutputError(path, error) from error
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError(path, reason_of(error)) from error


def check_writable(path: Path, kind: Kind, *, force: bool = False) -> None:
    """Finds out without writing that a file could not be written, or must not be.

    Args:
        path: The file; from here on the run may not read it, unless the kind is one to be edited.
        kind: What is to be written there.
        force: As in ``whole_file``.

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
        if there is not None:
            _refuse_loss(path, target, there, kind, force=force)
    except (OSError, ValueError) as error:
        raise OutputError(path, reason_of(error)) from error
    run = current_run()
    if run is not None and not kind.edits:
        run.expect(path)


def _refuse_loss(
    path: Path, target: Path, there: os.stat_result, kind: Kind, *, force: bool
) -> None:
    """Refuses to replace what the run reads, and what is no result of that kind.

    Args:
        path: The file as it was named.
        target: Where that leads to.
        there: What is there.
        kind: What is to be written.
        force: Whether files of other kinds may be replaced.

    Raises:
        OutputError: If it would.
    """
    run = current_run()
    if run is not None and not kind.edits:
        run.refuse_input(path, (there.st_dev, there.st_ino))
    if not (is_replaceable(there) and there.st_size):
        return
    force = force or (run is not None and run.force)
    with target.open("rb") as file:
        if kind.keeps(file):
            raise OutputError(path, diagnose("output-filled-in"))
        file.seek(0)
        if force:
            return
        if kind.owns is None:
            raise OutputError(path, diagnose("output-there"))
        if not kind.owns(file):
            raise OutputError(path, diagnose("output-of-another-kind", kind=Term(kind.name)))


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


def _write(writing: Writing) -> None:
    path, data = writing.path, writing.content
    if path == STANDARD_OUTPUT:
        _print(_standard_output(), data)
        return
    target, there = target_of(path)
    if there is None or is_replaceable(there):
        write_all([writing])
        return
    _refuse_loss(path, target, there, writing.kind, force=writing.force)
    number = _standard_stream(there)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    # Not O_CREAT: what has gone in the meantime is not made as a regular file.
    handle = os.dup(number) if number is not None else os.open(target, os.O_WRONLY)
    with os.fdopen(handle, "wb") as file:
        file.write(data)


def _standard_output() -> TextIO:
    """Returns where results go that are written to ``-``.

    Raises:
        OutputError: If it is closed.
    """
    stream: TextIO | None = _kept[-1] if _kept else sys.stdout
    if stream is None or isinstance(stream, ClosedOutput):
        raise OutputError(STANDARD_OUTPUT, diagnose("standard-output-closed"))
    return stream


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


@dataclass(frozen=True)
class Writing:
    """A file that is to be written.

    Attributes:
        path: The file; links are followed.
        content: What it shall hold.
        kind: What it is: without ``force`` it replaces nothing else.
        before: What it is known to hold; None: whatever it holds, or nothing.
        force: Replace whatever is there, but for what the run reads.
    """

    path: Path
    content: bytes
    kind: Kind
    before: bytes | None = None
    force: bool = False


def write_all(writings: Sequence[Writing], *, backup: bool = False) -> tuple[Path, ...]:
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
        OutputError: If one cannot be written or must not be, is no regular file, or is not what it
            was known to be. It names the file as it was given.
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
        run = current_run()
        if run is not None:
            for file in files:
                run.wrote(file.target, edited=file.writing.kind.edits)
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
        force = self.writing.force or self._holds(self.writing.content)
        _refuse_loss(self.writing.path, self.target, there, self.writing.kind, force=force)

    def _holds(self, content: bytes) -> bool:
        """Whether the file has that content, so that nothing is lost if it is written again."""
        there = self.there
        return (
            there is not None
            and there.st_size == len(content)
            and self.target.read_bytes() == content
        )

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
                message = diagnose("copy-not-written", file=path.name, problem=reason_of(error))
                raise self._error(message) from error
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
