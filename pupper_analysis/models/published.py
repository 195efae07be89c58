"""Models as they are published: by a description's name in robot_descriptions, or as xacro.

Both packages are optional, and nothing is downloaded here. Files that a model names are found in
the folders of ROS packages.
"""

from __future__ import annotations

import importlib
import os
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.runs import note_input
from pupper_analysis.models.places import Place, one_line, refuse_file
from pupper_analysis.models.xml import LFS_POINTER


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
    if folder.name == package:
        yield folder
    if package not in ("", ".", "..") and (folder / package).is_dir():
        yield folder / package


SCHEME: Final = "robot_descriptions:"
"""How the name of a description begins: ``robot_descriptions:go2_mj_description``."""

_NAME: Final = re.compile(r"[a-z0-9_]+")

XACRO: Final = ".xacro"
"""How the name of a file ends that is to be expanded."""


class _NotCachedError(Exception):
    """A repository is not in the cache."""


def find_file(model: str | Path) -> Path:
    """Returns the file that a model is given by: a path, or the name of a description.

    Raises:
        ModelError: If the package of descriptions is not installed, has none of that name, or its
            cache has not got the files.
    """
    word = str(model)
    if not word.startswith(SCHEME):
        return Path(model)
    name = word.removeprefix(SCHEME)
    try:
        cache = importlib.import_module("robot_descriptions._cache")
    except ImportError as error:
        raise ModelError(word, diagnose("descriptions-not-installed")) from error
    if not _NAME.fullmatch(name):
        raise ModelError(word, diagnose("no-such-description", name=name))
    description = _from_cache(word, name, cache)
    for attribute in ("MJCF_PATH", "URDF_PATH", "XACRO_PATH"):
        if hasattr(description, attribute):
            return Path(getattr(description, attribute))
    raise ModelError(word, diagnose("description-without-file", name=name))


def _from_cache(word: str, name: str, cache: ModuleType) -> ModuleType:
    """Imports a description, which clones its repository if it is let."""

    def cached(repository: str, commit: str | None = None) -> str:
        del commit
        known = importlib.import_module("robot_descriptions._repositories").REPOSITORIES
        default = Path.home() / ".cache" / "robot_descriptions"
        root = Path(os.environ.get("ROBOT_DESCRIPTIONS_CACHE", default)).expanduser()
        folder = root / known[repository].cache_path
        if not folder.is_dir():
            raise _NotCachedError
        return str(folder)

    clone, cache.clone_to_cache = cache.clone_to_cache, cached  # type: ignore[attr-defined]
    try:
        return importlib.import_module(f"robot_descriptions.{name}")
    except ModuleNotFoundError as error:
        raise ModelError(word, diagnose("no-such-description", name=name)) from error
    except _NotCachedError as error:
        raise ModelError(word, diagnose("description-not-cached", name=name)) from error
    finally:
        cache.clone_to_cache = clone  # type: ignore[attr-defined]


def expand_xacro(path: Path) -> str:
    """Returns the URDF that a xacro file expands to, with its arguments' defaults.

    Raises:
        ModelError: If xacro is not installed, or refuses the file.
    """
    try:
        xacro = importlib.import_module("xacro")
    except ImportError as error:
        raise refuse_file(Place(path), diagnose("file-is-xacro")) from error
    if not path.is_file():
        raise refuse_file(Place(path), diagnose("file-not-read", message="no such file"))
    # It lists what is included by all files that are expanded, one after another.
    before = len(getattr(xacro, "all_includes", ()))
    try:
        text = str(xacro.process_file(str(path)).toxml())
    except Exception as error:  # whatever a macro's Python raises
        problem = diagnose("xacro-not-expanded", message=one_line(error))
        raise refuse_file(Place(path), problem) from error
    for name in getattr(xacro, "all_includes", ())[before:]:
        note_input(name)
    return text
