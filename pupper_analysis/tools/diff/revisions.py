"""Files of a revision, as git has them, without anything that a repository brings along."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from pupper_analysis.models.git import (
    ENVIRONMENT,
    GitEntry,
    git_answer,
    git_command,
    git_entries,
    git_text,
    pointed_file,
)

_LINK = "120000"
"""The mode of a symbolic link in a tree."""


def top_of(folder: Path) -> Path:
    """Returns the top folder of the repository that a folder is in.

    Raises:
        ModelError: If it is in none; the message is git's.
    """
    return Path(git_text(str(folder), "rev-parse", "--show-toplevel", folder=folder).rstrip("\n"))


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
    prefix = git_text(given, "rev-parse", "--show-prefix").strip()
    relative = _normal(prefix + inside if inside.startswith(("./", "../")) else inside)
    git_text(given, "cat-file", "-e", f"{revision}:{relative}")
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
    listed = git_answer(given, "ls-tree", "-r", "-z", "--full-tree", revision, folder=folder)
    kept = git_text(
        given, "rev-parse", "--path-format=absolute", "--git-common-dir", folder=folder
    ).rstrip("\n")
    wanted = [
        entry
        for entry in git_entries(listed) or []
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
    found = pointed_file(content)
    if found is None or not found.isalnum():
        return content
    try:
        return (kept / "lfs" / "objects" / found[:2] / found[2:4] / found).read_bytes()
    except OSError:
        return content


def _contents(
    given: str, entries: Sequence[GitEntry], folder: Path | None
) -> Iterator[tuple[GitEntry, bytes]]:
    command = git_command(given, "cat-file", "--batch")
    with subprocess.Popen(
        command,
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | ENVIRONMENT,
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
