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
from dataclasses import dataclass
from pathlib import Path

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError, OutputError
from pupper_analysis.base.inputs import MOST_TEXT, read_input
from pupper_analysis.models.places import one_line
from pupper_analysis.models.xml import LFS_POINTER

SAFE = ("-c", "core.fsmonitor=false", "-c", f"core.hooksPath={os.devnull}")

ENVIRONMENT = {
    "GIT_ALLOW_PROTOCOL": "none",  # objects that a partial clone lacks are not fetched
    "GIT_NO_LAZY_FETCH": "1",
    "GIT_OPTIONAL_LOCKS": "0",  # nothing is written, so no hook is told of it
    "GIT_TERMINAL_PROMPT": "0",
}


_LARGEST_POINTER = 1024
"""Bytes. Source: Git LFS specification, "Pointer files must be less than 1024 bytes in size"."""


@dataclass(frozen=True)
class GitEntry:
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
    staged = git_entries(_asked(here, "ls-files", "--stage", "-z", "--", name))
    if not staged:
        return
    committed = git_entries(_asked(here, "ls-tree", "-z", "HEAD", "--", path.name))
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
    return pointed_file(blob) == hashlib.sha256(content).hexdigest()


def _asked(folder: Path, *arguments: str) -> bytes | None:
    """Returns git's answer; None if it gives none."""
    found = _run(["git", *SAFE, *arguments], folder)
    return found.stdout if found.returncode == 0 else None


def pointed_file(blob: bytes) -> str | None:
    """Returns the SHA-256 of the file that a pointer of Git LFS stands for; None if it is none."""
    if not blob.startswith(LFS_POINTER) or len(blob) >= _LARGEST_POINTER:
        return None
    for line in blob.decode(errors="replace").splitlines():
        if line.startswith("oid sha256:"):
            return line.removeprefix("oid sha256:").strip()
    return None


def git_entries(listed: bytes | None) -> list[GitEntry] | None:
    """Returns the entries of ``ls-tree -z`` or ``ls-files --stage -z``."""
    if listed is None:
        return None
    entries = []
    for line in filter(None, listed.decode(errors="surrogateescape").split("\0")):
        facts, _, path = line.partition("\t")
        # A tree has mode, kind, object; the index mode, object, stage.
        mode, *others = facts.split()
        entries.append(GitEntry(mode, max(others, key=len), path))
    return entries


def git_text(given: str, *arguments: str, folder: Path | None = None) -> str:
    """Returns git's answer as text; see ``git_answer``."""
    return git_answer(given, *arguments, folder=folder).decode(errors="surrogateescape")


def git_answer(given: str, *arguments: str, folder: Path | None = None) -> bytes:
    """Returns git's answer.

    Args:
        given: What the user asked for, for the message.
        *arguments: Of git.
        folder: A folder of the repository; by default the current one.

    Raises:
        ModelError: If it gives none; the message is git's.
    """
    result = _run(git_command(given, *arguments), folder)
    if result.returncode:
        reason = one_line(result.stderr.decode(errors="replace")).removeprefix("fatal: ")
        raise ModelError(given, diagnose("not-in-git", reason=reason))
    return result.stdout


def git_command(given: str, *arguments: str) -> list[str]:
    """Returns a command line of git that starts no program of the repository's."""
    git = shutil.which("git")
    if git is None:
        raise ModelError(given, diagnose("no-file-and-no-git"))
    return [git, *SAFE, *arguments]


def _run(command: list[str], folder: Path | None = None) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        command,
        cwd=folder,
        env=os.environ | ENVIRONMENT,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        check=False,
    )
