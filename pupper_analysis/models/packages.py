"""Files that a model names, and the folders of ROS packages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.runs import note_input
from pupper_analysis.models.xml import LFS_POINTER, parse_xml


def existing_file(path: Path) -> Path | None:
    """Returns the path if there is such a file, which counts as read then.

    The name may be any text of a model file. A pointer that Git LFS leaves in place of a file is
    none.
    """
    try:
        if not path.is_file() or is_pointer(path):
            return None
    except (OSError, ValueError):
        return None
    note_input(path)
    return path


def is_pointer(path: Path) -> bool:
    """Says whether a file is a pointer of Git LFS, whose content was not brought along.

    What is no regular file is not opened: a pipe would wait for ever.
    """
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(LFS_POINTER)) == LFS_POINTER
    except (OSError, ValueError):
        return False


def folders_of_package(folder: Path, package: str) -> Iterator[Path]:
    """Yields the folders of that package that are a folder or stand in it."""
    if folder.name == package or _package_name(folder) == package:
        yield folder
    if package not in ("", ".", "..") and (folder / package).is_dir():
        yield folder / package


def _package_name(folder: Path) -> str | None:
    """Returns the name that a folder's package.xml gives."""
    manifest = existing_file(folder / "package.xml")
    if manifest is None:
        return None
    try:
        _, root = parse_xml(manifest)
    except ModelError:
        return None
    return str(root.findtext("name", "")).strip()
