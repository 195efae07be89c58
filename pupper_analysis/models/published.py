"""Published models: names of ``robot_descriptions``, xacro files, and Git LFS pointers.

The packages ``robot_descriptions`` and ``xacro`` are optional. Nothing is downloaded.
"""

from __future__ import annotations

import importlib
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.runs import register_input
from pupper_analysis.models.places import Place, make_file_error, one_line
from pupper_analysis.models.xml import LFS_POINTER


def existing_file(path: Path) -> Path | None:
    """Return the path if the file exists, and register the file as an input of the run.

    The name may be any text of a model file. A Git LFS pointer counts as missing.
    """
    try:
        if not path.is_file() or is_pointer(path):
            return None
    except (OSError, ValueError):
        return None
    register_input(path)
    return path


def is_pointer(path: Path) -> bool:
    """Return True if a file is a Git LFS pointer without content.

    Only regular files are opened, because reading a pipe may block.
    """
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(LFS_POINTER)) == LFS_POINTER
    except (OSError, ValueError):
        return False


def find_package_folders(folder: Path, package: str) -> Iterator[Path]:
    """Yield the folder itself and its subfolder, if they have the name of a ROS package."""
    if folder.name == package:
        yield folder
    if package not in ("", ".", "..") and (folder / package).is_dir():
        yield folder / package


DESCRIPTION_PREFIX: Final = "robot_descriptions:"
"""Prefix of the name of a description, as in ``robot_descriptions:go2_mj_description``."""

_DESCRIPTION_NAME: Final = re.compile(r"[a-z0-9_]+")

XACRO_SUFFIX: Final = ".xacro"
"""Suffix of xacro files."""


class _NotCachedError(Exception):
    """Repository that is not in the local cache of ``robot_descriptions``."""


_BARE_DESCRIPTION: Final = re.compile(r"[a-z0-9_]+_description")

PACKAGE_PREFIX: Final = "package://"
"""Prefix of a file of a ROS package, as in ``package://go2_description/urdf/go2.urdf``."""


def is_description(word: str) -> bool:
    """Return True if a word names a description of ``robot_descriptions``, and no existing file.

    Either with the prefix, or a name such as ``go2_mj_description``.
    """
    return word.startswith(DESCRIPTION_PREFIX) or (
        _BARE_DESCRIPTION.fullmatch(word) is not None and not Path(word).exists()
    )


def find_file(model: str | Path, packages: Mapping[str, Path] | None = None) -> Path:
    """Return the file of a model: a path, the name of a description, or ``package://NAME/FILE``.

    Args:
        model: Path or name.
        packages: {ROS package: its folder}. Without an entry, the package is searched in the
            current folder, in the folders above, and in ``ROS_PACKAGE_PATH`` and
            ``AMENT_PREFIX_PATH``.

    Raises:
        ModelError: If ``robot_descriptions`` is not installed, or has no such description, if its
            cache does not contain the files, if the description contains no model file, or if a ROS
            package is not found.
    """
    word = str(model)
    # `Path` merges the slashes.
    for prefix in (PACKAGE_PREFIX, PACKAGE_PREFIX[:-1]):
        if word.startswith(prefix):
            return _find_in_package(word.removeprefix(prefix), packages or {})
    if not is_description(word):
        return Path(model)
    name = word.removeprefix(DESCRIPTION_PREFIX)
    try:
        cache = importlib.import_module("robot_descriptions._cache")
    except ImportError as error:
        raise ModelError(word, diagnose("descriptions-not-installed")) from error
    if not _DESCRIPTION_NAME.fullmatch(name):
        raise ModelError(word, diagnose("no-such-description", name=name))
    description = _import_cached_description(word, name, cache)
    for attribute in ("MJCF_PATH", "URDF_PATH", "XACRO_PATH"):
        if hasattr(description, attribute):
            return Path(getattr(description, attribute))
    raise ModelError(word, diagnose("description-without-file", name=name))


def _find_in_package(name: str, packages: Mapping[str, Path]) -> Path:
    """Return the file of a ROS package, given as ``NAME/FILE``.

    Raises:
        ModelError: If the package is not found, or does not contain the file.
    """
    package, _, rest = name.partition("/")
    here = Path.cwd()
    folders = [packages[package]] if package in packages else []
    if not folders:
        for above in (here, *here.parents):
            folders += find_package_folders(above, package)
        for variable, share in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
            for top in filter(None, os.environ.get(variable, "").split(os.pathsep)):
                folders += find_package_folders(Path(top) / share, package)
    for candidate in folders:
        if rest and (candidate / rest).is_file():
            return candidate / rest
    problem = diagnose("package-not-found", package=package, file=rest, found=bool(folders))
    raise ModelError(f"{PACKAGE_PREFIX}{name}", problem)


def _import_cached_description(source: str, name: str, cache: ModuleType) -> ModuleType:
    """Import a description without downloading: its clone function only returns cached folders."""

    def find_in_cache(repository: str, commit: str | None = None) -> str:
        del commit
        repositories = importlib.import_module("robot_descriptions._repositories").REPOSITORIES
        default = Path.home() / ".cache" / "robot_descriptions"
        root = Path(os.environ.get("ROBOT_DESCRIPTIONS_CACHE", default)).expanduser()
        folder = root / repositories[repository].cache_path
        if not folder.is_dir():
            raise _NotCachedError
        return str(folder)

    clone, cache.clone_to_cache = cache.clone_to_cache, find_in_cache  # type: ignore[attr-defined]
    try:
        return importlib.import_module(f"robot_descriptions.{name}")
    except ModuleNotFoundError as error:
        raise ModelError(source, diagnose("no-such-description", name=name)) from error
    except _NotCachedError as error:
        raise ModelError(source, diagnose("description-not-cached", name=name)) from error
    finally:
        cache.clone_to_cache = clone  # type: ignore[attr-defined]


def expand_xacro(path: Path) -> str:
    """Return the URDF text of a xacro file, with the default values of the arguments.

    Raises:
        ModelError: If xacro is not installed, the file does not exist, or the expansion fails.
    """
    try:
        xacro = importlib.import_module("xacro")
    except ImportError as error:
        raise make_file_error(Place(path), diagnose("file-is-xacro")) from error
    if not path.is_file():
        raise make_file_error(Place(path), diagnose("file-not-read", message="no such file"))
    # xacro appends the included files of each expansion to a global list.
    before = len(getattr(xacro, "all_includes", ()))
    try:
        text = str(xacro.process_file(str(path)).toxml())
    except Exception as error:  # Python code in a macro may raise any exception
        problem = diagnose("xacro-not-expanded", message=one_line(error))
        raise make_file_error(Place(path), problem) from error
    for name in getattr(xacro, "all_includes", ())[before:]:
        register_input(name)
    return text
