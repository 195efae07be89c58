"""Reading of files from git without executing any program that the repository configures.

A repository may come from an untrusted source. The configuration and attributes of a repository can
name programs: filters, hooks, a file system monitor, the transport of missing objects. Therefore
callers use plumbing commands, which apply no filters, with the options and the environment below.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import OutputError
from pupper_analysis.base.inputs import MAX_TEXT_BYTES, read_input
from pupper_analysis.models.xml import LFS_POINTER

SAFE_OPTIONS = ("-c", "core.fsmonitor=false", "-c", f"core.hooksPath={os.devnull}")
"""Options of git that disable the file system monitor and hooks."""

SAFE_ENVIRONMENT = {
    "GIT_ALLOW_PROTOCOL": "none",  # objects that a partial clone lacks are not fetched
    "GIT_NO_LAZY_FETCH": "1",
    "GIT_OPTIONAL_LOCKS": "0",  # git writes nothing, so no hook is started
    "GIT_TERMINAL_PROMPT": "0",
}
"""Environment variables that disable network access, optional writes and prompts of git."""


_MAX_POINTER_BYTES = 1024
"""Exclusive upper bound of the size of a pointer file. Source: Git LFS specification, "Pointer
files must be less than 1024 bytes in size"."""


@dataclass(frozen=True)
class GitEntry:
    """File in a commit tree or in the index of git.

    Attributes:
        mode: File mode, octal.
        object: Hash of the object.
        path: Path in the repository.
    """

    mode: str
    object: str
    path: str


def pointed_file(blob: bytes) -> str | None:
    """Return the SHA-256 hash of the file that a Git LFS pointer represents.

    None for other contents, and for a pointer without SHA-256.
    """
    if not blob.startswith(LFS_POINTER) or len(blob) >= _MAX_POINTER_BYTES:
        return None
    for line in blob.decode(errors="replace").splitlines():
        if line.startswith("oid sha256:"):
            return line.removeprefix("oid sha256:").strip()
    return None


def git_entries(output: bytes | None) -> list[GitEntry] | None:
    """Parse the file list that ``git ls-tree -z`` or ``git ls-files --stage -z`` prints.

    None if ``output`` is None, because git failed.
    """
    if output is None:
        return None
    entries = []
    for line in filter(None, output.decode(errors="surrogateescape").split("\0")):
        fields, _, path = line.partition("\t")
        # Fields of a tree: mode, kind, object. Fields of the index: mode, object, stage.
        mode, *hash_and_kind = fields.split()
        entries.append(GitEntry(mode, max(hash_and_kind, key=len), path))
    return entries


def run_git(command: list[str], folder: Path | None = None) -> subprocess.CompletedProcess[bytes]:
    """Run git without network access, prompts and standard input, and capture the output.

    The environment disables network access and prompts (``SAFE_ENVIRONMENT``).

    Args:
        command: Words of the command, with ``SAFE_OPTIONS``, which disable hooks.
        folder: Working folder; by default the current folder.
    """
    return subprocess.run(
        command,
        cwd=folder,
        env=os.environ | SAFE_ENVIRONMENT,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        check=False,
    )


def refuse_uncommitted(path: Path) -> None:
    """Raise an error if a file in a git repository differs from its committed version.

    Untracked files are accepted, and files that differ from the commit only in line ends. If git is
    not available, nothing is checked.

    Raises:
        OutputError: If the file has uncommitted changes, for example.
        InputError: If the file is tracked and cannot be read.
    """
    path = path.resolve()
    if shutil.which("git") is None or not any(
        (folder / ".git").exists() for folder in path.parents
    ):
        return
    folder_of_file = path.parent
    if not _query_git(folder_of_file, "ls-files", "-z", "--", f":(literal){path.name}"):
        return
    committed = _query_git(folder_of_file, "cat-file", "blob", f"HEAD:./{path.name}")
    content = read_input(path, MAX_TEXT_BYTES)
    if committed is None or content.replace(b"\r\n", b"\n") != committed.replace(b"\r\n", b"\n"):
        raise OutputError(path, diagnose("uncommitted-changes"))


def _query_git(folder: Path, *arguments: str) -> bytes | None:
    """Run a git command in a folder and return its output; None if git fails."""
    completed = run_git(["git", *SAFE_OPTIONS, *arguments], folder)
    return completed.stdout if completed.returncode == 0 else None
