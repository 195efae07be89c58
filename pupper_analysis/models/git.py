"""What git has of files, read without running anything that a repository brings along.

A repository may be somebody else's. Its configuration and attributes can name programs: filters,
hooks, a file system monitor, the transport of objects that are not there. So only git's plumbing is
asked, which applies no filter, and whatever could start a program is switched off for it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError, OutputError
from pupper_analysis.base.inputs import MOST_TEXT, read_input
from pupper_analysis.models.places import one_line
from pupper_analysis.models.xml import LFS_POINTER

_SAFE = ("-c", "core.fsmonitor=false", "-c", f"core.hooksPath={os.devnull}")

_ENVIRONMENT = {
    "GIT_ALLOW_PROTOCOL": "none",  # objects that a partial clone lacks are not fetched
    "GIT_NO_LAZY_FETCH": "1",
    "GIT_OPTIONAL_LOCKS": "0",  # nothing is written, so no hook is told of it
    "GIT_TERMINAL_PROMPT": "0",
}

_LINK = "120000"
"""The mode of a symbolic link in a tree."""

_LARGEST_POINTER = 1024
"""Bytes. Source: Git LFS specification, "Pointer files must be less than 1024 bytes in size"."""


@dataclass(frozen=True)
class _Entry:
    """A file in a tree or in the index."""

    mode: str
    object: str
    path: str


def refuse_uncommitted(path: Path) -> None:
    """Refuses a file of a git repository that has changes which are not committed.

    A file that git does not track has none, nor has one that differs in its ends of lines alone, or
    whose pointer of Git LFS is committed.

    Raises:
        OutputError: If it has.
    """
    path = path.resolve()
    git = shutil.which("git")
    if git is None or not any((folder / ".git").exists() for folder in path.parents):
        return
    here, name = path.parent, _literal(path.name)
    staged = _entries(_asked(here, "ls-files", "--stage", "-z", "--", name))
    if not staged:
        return
    committed = _entries(_asked(here, "ls-tree", "-z", "HEAD", "--", path.name))
    if (
        committed is None
        or [entry.object for entry in staged] != [entry.object for entry in committed]
        or not _is_same(path, _asked(here, "cat-file", "blob", committed[0].object))
    ):
        raise OutputError(path, diagnose("uncommitted-changes"))


def _literal(name: str) -> str:
    """Returns a file's name as a pathspec in which no letter is special."""
    return f":(literal){name}"


def _is_same(path: Path, blob: bytes | None) -> bool:
    """Tells whether a file is what git has of it, but for ends of lines and Git LFS."""
    content = read_input(path, MOST_TEXT)
    if blob is None or content == blob:
        return blob is not None
    if content.replace(b"\r\n", b"\n") == blob.replace(b"\r\n", b"\n"):
        return True
    return _pointed(blob) == hashlib.sha256(content).hexdigest()


def _pointed(blob: bytes) -> str | None:
    """Returns the SHA-256 of the file that a pointer of Git LFS stands for; None if it is none."""
    if not blob.startswith(LFS_POINTER) or len(blob) >= _LARGEST_POINTER:
        return None
    for line in blob.decode(errors="replace").splitlines():
        if line.startswith("oid sha256:"):
            return line.removeprefix("oid sha256:").strip()
    return None


def _asked(folder: Path, *arguments: str) -> bytes | None:
    """Returns git's answer; None if it gives none."""
    found = _run(["git", *_SAFE, *arguments], folder)
    return found.stdout if found.returncode == 0 else None


def _entries(listed: bytes | None) -> list[_Entry] | None:
    """Returns the entries of ``ls-tree -z`` or ``ls-files --stage -z``."""
    if listed is None:
        return None
    entries = []
    for line in filter(None, listed.decode(errors="surrogateescape").split("\0")):
        facts, _, path = line.partition("\t")
        # A tree has mode, kind, object; the index mode, object, stage.
        mode, *others = facts.split()
        entries.append(_Entry(mode, max(others, key=len), path))
    return entries


def top_of(folder: Path) -> Path:
    """Returns the top folder of the repository that a folder is in.

    Raises:
        ModelError: If it is in none; the message is git's.
    """
    return Path(_answer(str(folder), "rev-parse", "--show-toplevel", folder=folder).rstrip("\n"))


def path_in(given: str, revision: str, inside: str) -> str:
    """Returns a path of ``REVISION:PATH`` from the repository's top, if git has it.

    Args:
        given: What the user asked for, for the message.
        revision: The revision.
        inside: The path: from the repository's top, or, if it begins with ``./`` or ``../``, from
            the current folder.

    Raises:
        ModelError: If git does not have it; the message is git's.
    """
    prefix = _answer(given, "rev-parse", "--show-prefix").strip()
    relative = _normal(prefix + inside if inside.startswith(("./", "../")) else inside)
    _answer(given, "cat-file", "-e", f"{revision}:{relative}")
    return relative


def write_revision(
    given: str, revision: str, root: Path, endings: tuple[str, ...], folder: Path | None = None
) -> None:
    """Writes those files of a revision to a folder whose names end in one of some ways.

    Files are as they are committed; in place of a pointer of Git LFS is its file, if the repository
    has that. Symbolic links that lead out of the folder are left out.

    Args:
        given: What the user asked for, for the message.
        revision: The revision.
        root: The folder, which is empty.
        endings: In small letters.
        folder: A folder of the repository; by default the current one.

    Raises:
        ModelError: If git does not have it; the message is git's.
    """
    listed = _answer_bytes(given, "ls-tree", "-r", "-z", "--full-tree", revision, folder=folder)
    kept = _answer(
        given, "rev-parse", "--path-format=absolute", "--git-common-dir", folder=folder
    ).rstrip("\n")
    wanted = [
        entry
        for entry in _entries(listed) or []
        if entry.path.lower().endswith(endings) and not _leads_out(entry.path)
    ]
    links = []
    for entry, content in _contents(given, wanted, folder):
        place = root / entry.path
        place.parent.mkdir(parents=True, exist_ok=True)
        if entry.mode == _LINK:
            links.append((place, os.fsdecode(content)))
        else:
            place.write_bytes(_brought(content, Path(kept)))
    for place, target in links:  # after all files, so that none is written through a link
        with suppress(OSError, ValueError):
            place.symlink_to(target)
    while out := [place for place, _ in links if place.is_symlink() and _is_outside(place, root)]:
        for place in out:
            place.unlink()


def _leads_out(path: str) -> bool:
    return path.startswith("/") or ".." in path.split("/")


def _is_outside(link: Path, root: Path) -> bool:
    try:
        return not link.resolve().is_relative_to(root)
    except (OSError, RuntimeError):  # links in a ring
        return True


def _brought(content: bytes, kept: Path) -> bytes:
    """Returns a file's content, from the store of Git LFS if it is a pointer to what is there."""
    found = _pointed(content)
    if found is None or not found.isalnum():
        return content
    try:
        return (kept / "lfs" / "objects" / found[:2] / found[2:4] / found).read_bytes()
    except OSError:
        return content


def _contents(
    given: str, entries: Sequence[_Entry], folder: Path | None
) -> Iterator[tuple[_Entry, bytes]]:
    """Yields what git has of each entry."""
    command = _command(given, "cat-file", "--batch")
    with subprocess.Popen(
        command,
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | _ENVIRONMENT,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        for entry in entries:
            process.stdin.write(f"{entry.object}\n".encode())
            process.stdin.flush()
            _, kind, *size = process.stdout.readline().split()
            if kind == b"missing":  # a partial clone
                continue
            content = process.stdout.read(int(size[0]))
            process.stdout.read(1)
            if kind == b"blob":  # no other repository's commit
                yield entry, content


def _normal(path: str) -> str:
    """Returns a path without ``.`` and ``..``."""
    parts: list[str] = []
    for part in path.split("/"):
        if part == ".." and parts:
            parts.pop()
        elif part not in ("", "."):
            parts.append(part)
    return "/".join(parts)


def _answer(given: str, *arguments: str, folder: Path | None = None) -> str:
    return _answer_bytes(given, *arguments, folder=folder).decode(errors="surrogateescape")


def _answer_bytes(given: str, *arguments: str, folder: Path | None = None) -> bytes:
    result = _run(_command(given, *arguments), folder)
    if result.returncode:
        reason = one_line(result.stderr.decode(errors="replace")).removeprefix("fatal: ")
        raise ModelError(given, diagnose("not-in-git", reason=reason))
    return result.stdout


def _command(given: str, *arguments: str) -> list[str]:
    git = shutil.which("git")
    if git is None:
        raise ModelError(given, diagnose("no-file-and-no-git"))
    return [git, *_SAFE, *arguments]


def _run(command: list[str], folder: Path | None = None) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        command,
        cwd=folder,
        env=os.environ | _ENVIRONMENT,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        check=False,
    )
