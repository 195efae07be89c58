"""Atomic writing of output files, with protection of inputs and of other existing files.

New contents are written to hidden temporary files in the same folder, which then replace the files
by renames. `write_atomically` lists the exceptions, such as pipes. A run does not overwrite an
input of the same run (`runs`), unless the run edits the file in place. Without ``force``, the kind
of the output (`kinds`) determines which existing files may be replaced. Temporary files of killed
processes are removed later on POSIX systems.
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
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Final, TextIO

from pupper_analysis.base.diagnostics import Term, diagnose
from pupper_analysis.base.errors import OutputError
from pupper_analysis.base.kinds import OutputKind
from pupper_analysis.base.runs import current_run, is_command_line


@cache
def _compute_machine_hash() -> str:
    """Return a hash of the host name and the process-ID namespace (eight hexadecimal digits).

    A process ID is unique only on one host and in one namespace.
    """
    space = ""
    with suppress(OSError):
        space = Path("/proc/self/ns/pid").readlink().name
    return hashlib.sha256(f"{platform.node()} {space}".encode()).hexdigest()[:8]


def hidden_token() -> str:
    """Return the unique part of a temporary file name: machine, process and random number."""
    return f"pupper-{_compute_machine_hash()}-{os.getpid():x}-{secrets.token_hex(4)}"


_TEMPORARY_NAME: Final = re.compile(r"\..*pupper-([0-9a-f]{8})-([0-9a-f]+)-[0-9a-f]{8}\.\w+")
"""Pattern of the names of temporary files."""

_cleaned_folders: Final[set[tuple[int, Path]]] = set()
"""Pairs (process ID, folder) of the folders that `remove_stale_files` has searched in a process."""


def hidden_beside(target: Path) -> Path:
    """Return a random path for a hidden temporary file in the folder of a file.

    Old temporary files in the folder are removed (`remove_stale_files`).
    """
    remove_stale_files(target.parent)
    return target.parent / f".{hidden_token()}.tmp"


MAX_TEMPORARY_AGE: Final = 86_400.0
"""Age [s] after which `remove_stale_files` removes a temporary file, even if the process that wrote
the file seems to run: process IDs are reused. Chosen: one day, longer than any write.
"""


def remove_stale_files(folder: Path) -> None:
    """Remove old temporary files of this package from a folder; only on POSIX systems.

    On other systems, ``os.kill(pid, 0)``, the test whether a process has ended, may end the
    process. In each process, only the first call for a folder has an effect.
    """
    if os.name != "posix" or (os.getpid(), folder) in _cleaned_folders:
        return
    _cleaned_folders.add((os.getpid(), folder))
    with suppress(OSError):
        for entry in os.scandir(folder):
            match = _TEMPORARY_NAME.fullmatch(entry.name)
            if match is None:
                continue
            with suppress(OSError):
                ended = match[1] == _compute_machine_hash() and not _is_running(int(match[2], 16))
                # Not the modification time: a second name of an old file has that of the file.
                changed = entry.stat(follow_symlinks=False).st_ctime
                if ended or time.time() - changed > MAX_TEMPORARY_AGE:
                    Path(entry.path).unlink()


def _is_running(process: int) -> bool:
    """Return True if a process with an ID exists on this machine, in the same namespace."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True


def write_new(path: Path, data: bytes, *, like: os.stat_result | None = None) -> None:
    """Create a file with a content, and return after the content has reached the disk (``fsync``).

    A later rename may reach the disk before unsynchronised content: after a power failure the
    renamed file would be empty.

    Args:
        path: Path of the new file; must not exist.
        data: Content.
        like: Status of an existing file, whose mode and (if permitted) owner are copied. By
            default, the operating system sets mode and owner.

    Raises:
        OSError: If the file exists, or cannot be created or written.
    """
    # tempfile would ignore the umask.
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    with os.fdopen(handle, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    if like is not None:
        with suppress(OSError):  # no permission, or not supported by the file system
            os.chown(path, like.st_uid, like.st_gid)
        path.chmod(stat.S_IMODE(like.st_mode))


STANDARD_OUTPUT: Final = Path("-")
"""Path that represents standard output. A file that is named ``-`` must be given with its folder
(``./-``)."""


class ClosedOutput(io.StringIO):
    """Replacement for a standard output that the parent process has closed.

    Writing a result to ``-`` then raises ``OutputError``; other texts are discarded.
    """


_result_streams: list[TextIO] = []
"""Stack of streams that receive results while ``results_on_standard_output`` is active."""


@contextmanager
def write_atomically(path: Path, kind: OutputKind, *, force: bool = False) -> Iterator[io.BytesIO]:
    """Yield a buffer whose content is written to a file if the ``with`` block succeeds.

    A regular file is replaced atomically, and keeps its mode. Links are followed. Pipes, devices
    and redirected standard streams are written in place.

    Args:
        path: Output file; missing folders are created. ``-`` is standard output.
        kind: Kind of the output; see ``OutputKind`` for the existing files that may be replaced.
        force: Whether to replace files of other kinds, except inputs of the run and files with
            measurements (``OutputKind.keeps``).

    Raises:
        OutputError: If the file cannot be written, or must not be replaced, or the block raises an
            ``OSError`` other than ``BrokenPipeError``.
        BrokenPipeError: If the reader of a pipe has ended, for example.
    """
    buffer = io.BytesIO()
    try:
        yield buffer
        try:
            _write_output(Writing(path, buffer.getvalue(), kind, force=force))
        except ValueError as error:  # path with a zero byte
            raise OutputError(path, error) from error
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError(path, describe_os_error(error)) from error


def check_writable(path: Path, kind: OutputKind, *, force: bool = False) -> None:
    """Check that a file may be written, and register it as an output of the run (`current_run`).

    The function does not write the file, but may remove old temporary files in its folder
    (`remove_stale_files`). Kinds that are edited in place are not registered.

    Args:
        path: Output file; ``-`` is standard output.
        kind: Kind of the output.
        force: Whether to replace files of other kinds, except inputs of the run and files with
            measurements (``OutputKind.keeps``).

    Raises:
        OutputError: If the file cannot be written, or must not be replaced.
    """
    if path == STANDARD_OUTPUT:
        _result_stream()
        return
    try:
        target, status = resolve_target(path)
        if status is not None and stat.S_ISDIR(status.st_mode):
            raise OutputError(path, diagnose("output-is-a-folder"))
        if status is not None and not os.access(target, os.W_OK):
            raise OutputError(path, diagnose("output-not-writable"))
        if status is None or is_replaceable(status):
            check_folder(target.parent)
            remove_stale_files(target.parent)
        if status is not None:
            _check_replaceable(path, target, status, kind, force=force)
    except (OSError, ValueError) as error:
        raise OutputError(path, describe_os_error(error)) from error
    run = current_run()
    if run is not None and not kind.edits:
        run.register_output(path)


def _check_replaceable(
    path: Path, target: Path, status: os.stat_result, kind: OutputKind, *, force: bool
) -> None:
    """Raise an OutputError if the existing file ``target`` must not be replaced.

    ``force`` permits to replace files of other kinds; ``path`` is the file as named by the user.
    """
    run = current_run()
    regular = is_replaceable(status) and status.st_size > 0
    if run is not None and not (kind.edits and (not regular or _is_of_kind(target, kind))):
        run.refuse_input(path, (status.st_dev, status.st_ino))
    if not regular:
        return
    force = force or (run is not None and run.force)
    with target.open("rb") as file:
        if kind.keeps(file):
            raise OutputError(path, diagnose("output-filled-in"))
        file.seek(0)
        if force:
            return
        if kind.owns is None:
            raise OutputError(path, diagnose("output-there", option=is_command_line()))
        if not kind.owns(file):
            raise OutputError(path, diagnose("output-of-another-kind", kind=Term(kind.name)))


def _is_of_kind(target: Path, kind: OutputKind) -> bool:
    """Return True if the content of a file is recognised as a kind of output."""
    with target.open("rb") as file:
        return kind.owns is not None and kind.owns(file)


def check_folder(folder: Path) -> None:
    """Check that files can be written to a folder, and remove old temporary files from the folder.

    Raises:
        OutputError: If the folder is not writable, or does not exist and cannot be created.
    """
    try:
        existing = _nearest_existing(folder)
    except (OSError, ValueError) as error:
        raise OutputError(folder, describe_os_error(error)) from error
    if not existing.is_dir():
        raise OutputError(folder, diagnose("no-folder", folder=existing))
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(folder, diagnose("folder-not-writable", folder=existing))
    remove_stale_files(folder)


def is_replaceable(status: os.stat_result) -> bool:
    """Return True if a rename may replace a file: regular, and not standard output or error."""
    if not stat.S_ISREG(status.st_mode):
        return False
    return _find_standard_stream(status) is None


@contextmanager
def results_on_standard_output() -> Iterator[None]:
    """Reserve standard output for results written to ``-``; other output goes to standard error."""
    _result_streams.append(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _result_streams.pop()


def _nearest_existing(folder: Path) -> Path:
    """Return the absolute path of a folder if it exists, else its innermost existing parent."""
    for parent in (folder.absolute(), *folder.absolute().parents):
        with suppress(FileNotFoundError, NotADirectoryError):
            parent.stat()
            return parent
    raise FileNotFoundError("there is no such folder")


def resolve_target(path: Path) -> tuple[Path, os.stat_result | None]:
    """Resolve the links of a path, and read the status of the file there.

    Returns:
        Path of the file behind all links; status of this file, None if it does not exist.

    Raises:
        OSError: If the status cannot be read, for example without permission.
        ValueError: If the path contains a zero byte.
    """
    target = Path(os.path.realpath(path))
    try:
        return target, target.stat()
    except (FileNotFoundError, NotADirectoryError):
        return target, None


def _find_standard_stream(status: os.stat_result) -> int | None:
    """Return the standard stream that is redirected to a file: 1 (output), 2 (error) or None.

    ``status`` is the status of the file.
    """
    for number in (1, 2):
        with suppress(OSError):
            if os.path.samestat(status, os.fstat(number)):
                return number
    return None


def _write_output(writing: Writing) -> None:
    """Write a content to standard output, to a file in place, or by atomic replacement.

    Files that `is_replaceable` accepts are replaced.
    """
    path, data = writing.path, writing.content
    if path == STANDARD_OUTPUT:
        _write_bytes(_result_stream(), data)
        return
    target, status = resolve_target(path)
    if status is None or is_replaceable(status):
        write_all([writing])
        return
    _check_replaceable(path, target, status, writing.kind, force=writing.force)
    number = _find_standard_stream(status)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    # Without O_CREAT: a device or pipe that was removed meanwhile must not become a regular file.
    handle = os.dup(number) if number is not None else os.open(target, os.O_WRONLY)
    with os.fdopen(handle, "wb") as file:
        file.write(data)


def _result_stream() -> TextIO:
    """Return the stream for results written to ``-``; raise an OutputError if it is closed."""
    stream: TextIO | None = _result_streams[-1] if _result_streams else sys.stdout
    if stream is None or isinstance(stream, ClosedOutput):
        raise OutputError(STANDARD_OUTPUT, diagnose("standard-output-closed"))
    return stream


def _write_bytes(stream: TextIO, data: bytes) -> None:
    """Write bytes to the buffer of a text stream; as UTF-8 text if the stream has no buffer."""
    stream.flush()
    buffer = getattr(stream, "buffer", None)
    if buffer is None:
        stream.write(data.decode())
    else:
        buffer.write(data)
    stream.flush()


def describe_os_error(error: Exception) -> object:
    """Return the text of an operating system error without number and path, or the error itself."""
    return getattr(error, "strerror", None) or error


@dataclass(frozen=True)
class Writing:
    """Request to write a file.

    Attributes:
        path: Output file; links are followed.
        content: New content.
        kind: Kind of the output; see ``OutputKind`` for the existing files that may be replaced.
        before: Expected current content; None if any content, or no file, is accepted.
        force: Whether to replace files of other kinds, except inputs of the run and files with
            measurements (``OutputKind.keeps``).
    """

    path: Path
    content: bytes
    kind: OutputKind
    before: bytes | None = None
    force: bool = False


def write_all(writings: Sequence[Writing], *, backup: bool = False) -> tuple[Path, ...]:
    """Write several files completely, or change none of the files.

    If a replacement fails or is interrupted, the earlier replacements are undone. If the process is
    killed, each file has either the old or the new content.

    Args:
        writings: Files to write. Existing files keep the mode, and the owner if permitted. Missing
            folders are created.
        backup: Whether to copy each existing file to ``NAME.bak`` (``NAME.bak2`` etc. if the name
            is taken).

    Returns:
        Paths of the backup copies.

    Raises:
        OutputError: For example if a file cannot be written, must not be replaced, or differs from
            the content that the caller expects (`Writing.before`).
    """
    files = [_StagedFile(writing) for writing in writings]
    copies: list[Path] = []
    is_complete = False
    try:
        for file in files:
            file.stage()
        for file in files:
            file.link_existing()
            if backup and file.existing is not None:
                copies.append(file.copy_existing())
        for file in files:
            file.replace()
        is_complete = True
        run = current_run()
        if run is not None:
            for file in files:
                run.register_written(file.target, edited=file.writing.kind.edits)
    finally:
        try:
            if not is_complete:
                _undo_replacements(files, copies)
        finally:
            for file in files:
                file.clear()
    _sync_folders({file.target.parent for file in files})
    return tuple(copies)


@dataclass(eq=False)
class _StagedFile:
    """File that ``write_all`` writes, with its temporary file and the old file for a restoration.

    Attributes:
        writing: Path, content and kind of the file to write.
        target: Path with links resolved.
        existing: Status of the existing file; None if there is none.
        new: Temporary file with the new content; None before `stage`.
        old: Hard link to, or copy of, the existing file; None before `link_existing`, or without an
            existing file.
        stuck: Whether restoring the old file failed, so that ``old`` must be kept.
    """

    writing: Writing
    target: Path = field(init=False)
    existing: os.stat_result | None = None
    new: Path | None = None
    old: Path | None = None
    stuck: bool = False

    def stage(self) -> None:
        """Check the output path, and write the new content to a temporary file in the same folder.

        Raises:
            OutputError: If a check fails, or the temporary file cannot be written.
        """
        try:
            self.target, self.existing = resolve_target(self.writing.path)
            if self.existing is not None:
                self._check_replacement(self.existing)
            self._check_unchanged()
            self.target.parent.mkdir(parents=True, exist_ok=True)
            self.new = hidden_beside(self.target)
            write_new(self.new, self.writing.content, like=self.existing)
        except (OSError, ValueError) as error:
            raise self._make_error(describe_os_error(error)) from error

    def _check_replacement(self, existing: os.stat_result) -> None:
        """Raise OutputError if the file with this status cannot or must not be replaced."""
        if not is_replaceable(existing):
            raise self._make_error(diagnose("output-no-regular-file"))
        if not os.access(self.target, os.W_OK):
            raise self._make_error(diagnose("output-not-writable"))
        force = self.writing.force or self._has_content(self.writing.content)
        _check_replaceable(self.writing.path, self.target, existing, self.writing.kind, force=force)

    def _has_content(self, content: bytes) -> bool:
        """Return True if the existing file already has this content, so that no data is lost."""
        existing = self.existing
        return (
            existing is not None
            and existing.st_size == len(content)
            and self.target.read_bytes() == content
        )

    def _check_unchanged(self) -> None:
        """Raise an OutputError if the file's content is not `Writing.before` (if given)."""
        before = self.writing.before
        if before is not None and self.target.read_bytes() != before:
            raise self._make_error(diagnose("output-changed-meanwhile"))

    def link_existing(self) -> None:
        """Give the existing file a second name (or copy), so that restoring needs no disk space.

        Raises:
            OutputError: If the file can be neither linked nor copied.
        """
        if self.existing is None:
            return
        self.old = hidden_beside(self.target)
        try:
            os.link(self.target, self.old)
        except OSError:  # no hard links
            try:
                write_new(self.old, self.target.read_bytes(), like=self.existing)
            except OSError as error:
                raise self._make_error(describe_os_error(error)) from error

    def copy_existing(self) -> Path:
        """Copy the file that will be replaced to an unused backup name, and return its path.

        Backup names have the suffix ``.bak``, ``.bak2``, ``.bak3`` ...

        Raises:
            OutputError: If the file cannot be read, or the copy cannot be written.
        """
        number = 1
        try:
            content = self.target.read_bytes()
        except OSError as error:
            raise self._make_error(describe_os_error(error)) from error
        while True:
            path = self.target.with_name(f"{self.target.name}.bak{number if number > 1 else ''}")
            try:
                write_new(path, content, like=self.existing)
            except FileExistsError:
                number += 1
            except OSError as error:
                with suppress(OSError):  # for example, the name of the copy is too long
                    path.unlink(missing_ok=True)
                message = diagnose(
                    "copy-not-written", file=path.name, problem=describe_os_error(error)
                )
                raise self._make_error(message) from error
            else:
                if self.existing is not None:
                    with suppress(OSError):  # not supported by the file system
                        os.utime(path, ns=(self.existing.st_atime_ns, self.existing.st_mtime_ns))
                return path

    def replace(self) -> None:
        """Rename the temporary file with the new content to the target.

        Raises:
            OutputError: If the rename fails, or the target has an unexpected content.
        """
        assert self.new is not None
        try:
            self._check_unchanged()
            self.new.replace(self.target)
        except OSError as error:
            raise self._make_error(describe_os_error(error)) from error

    def restore(self) -> None:
        """Undo a replacement of the file; set ``stuck`` if the old file cannot be restored."""
        if self.new is None or self.new.exists():  # an interrupt may come right after the rename
            return
        if self.old is None:
            self.target.unlink(missing_ok=True)
            return
        try:
            self.old.replace(self.target)
        except OSError:
            self.stuck = True
            self._unhide_old_file()

    def _unhide_old_file(self) -> None:
        """Rename the hidden old file to ``NAME.oldN``, so that no later run removes it."""
        assert self.old is not None
        number = 1
        while os.path.lexists(kept := self.target.with_name(f"{self.target.name}.old{number}")):
            number += 1
        with suppress(OSError):
            self.old = self.old.rename(kept)

    def clear(self) -> None:
        """Remove the temporary files, except an old file that could not be restored."""
        for path in (self.new, None if self.stuck else self.old):
            if path is not None:
                with suppress(OSError):
                    path.unlink(missing_ok=True)

    def _make_error(self, problem: object) -> OutputError:
        """Create an OutputError with the path of this file and a problem."""
        return OutputError(self.writing.path, problem)


def _undo_replacements(files: Sequence[_StagedFile], copies: Sequence[Path]) -> None:
    """Restore the replaced files, and remove the backup copies.

    If a file cannot be restored, an OutputError contains the path of the old file.
    """
    for file in reversed(files):
        file.restore()
    for path in copies:
        path.unlink(missing_ok=True)
    stuck = [file for file in files if file.stuck]
    if stuck:
        kept = [diagnose("file-kept", file=file.writing.path, copy=file.old) for file in stuck]
        raise OutputError(stuck[0].writing.path, diagnose("files-not-put-back", kept=kept))


def _sync_folders(folders: set[Path]) -> None:
    """Write the renames in the given folders to disk, if the system supports this."""
    for folder in folders:
        with suppress(OSError):
            handle = os.open(folder, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
