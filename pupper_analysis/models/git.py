"""What git has of files, read without running anything that a repository brings along.

A repository may be somebody else's. Its configuration and attributes can name programs: filters,
hooks, a file system monitor, the transport of objects that are not there. So only git's plumbing is
asked, which applies no filter, and whatever could start a program is switched off for it.
"""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

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


def run_git(command: list[str], folder: Path | None = None) -> subprocess.CompletedProcess[bytes]:
    """Runs git, and starts no program of the repository's."""
    return subprocess.run(
        command,
        cwd=folder,
        env=os.environ | ENVIRONMENT,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        check=False,
    )
