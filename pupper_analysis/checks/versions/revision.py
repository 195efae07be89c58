"""Files as git has them: ``REVISION:PATH``."""

from __future__ import annotations

import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from pupper_analysis.checks.places import path_of
from pupper_analysis.errors import ModelError
from pupper_analysis.models.places import Place, one_line

_T = TypeVar("_T")

_NEEDED = (".urdf", ".xml", ".mjcf", ".stl", ".obj", ".msh", ".dae", ".ply", ".png", ".hfield")
"""Ends of the names of files that a model may need; a repository may hold films, too."""


@dataclass(frozen=True)
class Source:
    """A file, or what git has of it.

    Attributes:
        path: Where it can be read.
        name: What the user calls it.
        revision: The revision, if git has it.
        root: The folder that stands for the repository's.
    """

    path: Path
    name: str
    revision: str = ""
    root: Path | None = None

    def label(self, place: Place) -> str:
        """Returns a place as the user knows it."""
        return self._known(path_of(place))

    def read(self, read: Callable[[Path], _T]) -> _T:
        """Reads the file; an error tells of it as the user knows it."""
        try:
            return read(self.path)
        except ModelError as error:
            if self.root is None:
                raise
            raise ModelError(self._known(error.source), self._known(error.problem)) from error

    def _known(self, text: str) -> str:
        if self.root is None:
            return text
        top = f"{self.revision}:"
        return text.replace(f"{self.root}/", top).replace(str(self.root), top)


@contextmanager
def opened(given: str | Path) -> Iterator[Source]:
    """Yields a file, or a copy of what git has of it, with all that it may include.

    Args:
        given: A path; or ``REVISION:PATH``, as ``git show`` has it: from the repository's top, or,
            if it begins with ``./``, from the current folder.

    Raises:
        ModelError: If git does not have it; the message is git's.
    """
    text = str(given)
    revision, separator, inside = text.partition(":")
    # A path that exists is meant; and "C:\\robot.urdf" is a path, too.
    if (
        Path(text).exists()
        or not separator
        or not inside
        or (len(revision) < 2 and revision != "@")
    ):
        yield Source(Path(text), text)
        return
    if revision.startswith("-"):
        raise ModelError(text, f"{revision!r} is no revision")
    prefix = _git(text, "rev-parse", "--show-prefix").strip()
    top = Path(_git(text, "rev-parse", "--show-toplevel").rstrip("\n"))
    relative = (prefix + inside) if inside.startswith(("./", "../")) else inside
    relative = _normal(relative)
    _git(text, "cat-file", "-e", f"{revision}:{relative}")
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder).resolve()
        _extract(text, top, revision, root)
        if not (root / relative).exists():  # `export-ignore` keeps files out of archives
            (root / relative).parent.mkdir(parents=True, exist_ok=True)
            content = _git(text, "cat-file", "blob", f"{revision}:{relative}")
            (root / relative).write_bytes(content.encode(errors="surrogateescape"))
        yield Source(root / relative, text, revision, root)


def _normal(path: str) -> str:
    """Returns a path without ``.`` and ``..``."""
    parts: list[str] = []
    for part in path.split("/"):
        if part == ".." and parts:
            parts.pop()
        elif part not in ("", "."):
            parts.append(part)
    return "/".join(parts)


def _git(given: str, *arguments: str) -> str:
    result = subprocess.run(_command(given, *arguments), capture_output=True, check=False)
    if result.returncode:
        raise ModelError(given, _refusal(result.stderr))
    return result.stdout.decode(errors="surrogateescape")


def _command(given: str, *arguments: str) -> list[str]:
    git = shutil.which("git")
    if git is None:
        raise ModelError(given, "there is no such file, and no git to ask for a revision of it")
    return [git, *arguments]


def _refusal(said: bytes) -> str:
    text = one_line(said.decode(errors="replace")).removeprefix("fatal: ")
    return f"there is no such file, and git does not have it: {text or 'it gives no reason'}"


def _extract(given: str, top: Path, revision: str, root: Path) -> None:
    """Writes the files of a revision that a model may need to a folder."""
    command = _command(given, "-C", str(top), "archive", "--format=tar", revision)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        try:
            with tarfile.open(fileobj=process.stdout, mode="r|") as archive:
                for member in archive:
                    wanted = member.name.lower().endswith(_NEEDED)
                    if wanted and (member.isfile() or member.issym()):
                        with suppress(
                            tarfile.FilterError
                        ):  # a link that leads out of the repository
                            archive.extract(member, root, filter="data")
        except tarfile.TarError as error:
            process.kill()
            refusal = process.stderr.read()
            raise ModelError(given, _refusal(refusal or str(error).encode())) from error
