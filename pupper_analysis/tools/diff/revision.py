"""Files as git has them: ``REVISION:PATH``."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models import git
from pupper_analysis.models.places import Place

_T = TypeVar("_T")

_NEEDED = (".urdf", ".xml", ".mjcf", ".stl", ".obj", ".msh", ".dae", ".ply", ".png", ".hfield")
"""Ends of the names of files that a model may need; a repository may hold films, too."""


@dataclass(frozen=True)
class VersionedFile:
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
        return self._known(place.path)

    def read(self, read: Callable[[Path], _T]) -> _T:
        """Reads the file; an error tells of it as the user knows it."""
        try:
            return read(self.path)
        except ModelError as error:
            if self.root is None:
                raise
            cause = error.cause.with_names(self._known)
            raise ModelError(self._known(error.source), cause) from error

    def _known(self, text: str) -> str:
        if self.root is None:
            return text
        top = f"{self.revision}:"
        return text.replace(f"{self.root}/", top).replace(str(self.root), top)


@contextmanager
def open_version(given: str | Path) -> Iterator[VersionedFile]:
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
        yield VersionedFile(Path(text), text)
        return
    if revision.startswith("-"):
        raise ModelError(text, diagnose("no-revision", revision=revision))
    relative = git.path_in(text, revision, inside)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder).resolve()
        asked = (relative.lower(),) if relative else ()
        git.write_revision(text, revision, root, (*_NEEDED, *asked))
        yield VersionedFile(root / relative, text, revision, root)
