"""Robots of MuJoCo Menagerie by name: ``unitree_go2/go2.xml``, ``mujoco_menagerie/unitree_go2``.

The files are read from a clone (``MENAGERIE_ROOT``, or a folder ``mujoco_menagerie`` in the current
folder or above), or from the cache of the package ``mujoco-menagerie``. Nothing is downloaded.
"""

from __future__ import annotations

import importlib
import os
import re
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.base.inputs import path_exists
from pupper_analysis.models.places import one_line

MENAGERIE_FOLDER: Final = "mujoco_menagerie"
"""Name of the folder of a clone, and prefix of robot names, as in
``mujoco_menagerie/unitree_go2``."""

MENAGERIE_PACKAGE: Final = ("mujoco_menagerie", "mujoco-menagerie")
"""Module and distribution of the package ``mujoco-menagerie``."""

_ROBOT_NAME_PATTERN: Final = re.compile(r"[a-z0-9_]+")
"""Pattern of the name of a robot of MuJoCo Menagerie, such as ``unitree_go2``."""

_MAX_NAME_LENGTH: Final = 200
"""Largest number of characters of a robot name of MuJoCo Menagerie, including folder and file.
Chosen, not tuned: file systems permit 255 per name.
"""


def is_menagerie_name(word: str) -> bool:
    """Return True if a text names a robot of MuJoCo Menagerie, and is no existing path.

    With the prefix ``mujoco_menagerie/``, the robot need not exist. Without the prefix, the name
    must contain an underscore, and the installed package or a clone must contain the robot.
    """
    parts = Path(word).parts
    if not 1 <= len(parts) <= 3 or len(word) > _MAX_NAME_LENGTH or path_exists(word):
        return False
    if parts[0] == MENAGERIE_FOLDER:
        return len(parts) > 1
    if len(parts) > 2 or "_" not in parts[0] or not _ROBOT_NAME_PATTERN.fullmatch(parts[0]):
        return False
    return parts[0] in list_menagerie_robots()


def find_menagerie_file(word: str) -> Path:
    """Return the MJCF of a robot of MuJoCo Menagerie, such as ``unitree_go2/go2.xml``.

    Without a file name in ``word``, the result is the robot's default model, without the scene.

    Args:
        word: Name; `is_menagerie_name` states the valid forms.

    Raises:
        ModelError: If neither package nor clone is available, or the file is missing, for example.
        UnknownNameError: If neither the package nor the clone has such a robot.
    """
    name, *rest = Path(word.removeprefix(f"{MENAGERIE_FOLDER}/")).parts
    package, clone = _import_package(), _find_clone()
    if package is None and clone is None:
        raise ModelError(word, diagnose("menagerie-not-installed"))
    known = list_menagerie_robots()
    if name not in known:
        raise UnknownNameError("MuJoCo Menagerie", "robot", name, known)
    robot = package.get(name) if package is not None and name in package.names() else None
    folder = clone / name if clone is not None and (clone / name).is_dir() else None
    if folder is None:
        cache = package.Cache()
        folder = cache.model_path(robot) if cache.is_cached(robot) else None
    if folder is None:
        download = make_menagerie_download(name)
        problem = diagnose("menagerie-not-downloaded", download=download, fixed=False)
        raise ModelError(word, problem)
    file = folder.joinpath(*rest) if rest else _find_default_file(folder, name, robot)
    if file is None or not file.is_file():
        files = sorted(path.name for path in folder.glob("*.xml"))
        raise ModelError(word, diagnose("menagerie-without-file", name=name, files=files))
    return file


def make_menagerie_download(name: str) -> str:
    """Return the command line of the package ``mujoco-menagerie`` that downloads a robot."""
    return f"python -m {MENAGERIE_PACKAGE[0]} prefetch {name}"


_FIXED_CATEGORIES: Final = ("arm", "dual_arm", "end_effector")
"""Categories of MuJoCo Menagerie whose robots have a fixed base."""


def has_fixed_menagerie_base(word: str) -> bool:
    """Return True if a word names an arm or hand of MuJoCo Menagerie, by the package's category.

    False without the package, because a clone states no categories.
    """
    name = Path(word.removeprefix(f"{MENAGERIE_FOLDER}/")).parts[0] if word else ""
    try:
        package = _import_package()
    except ModelError:
        return False
    if package is None or name not in package.names():
        return False
    return package.get(name).category in _FIXED_CATEGORIES


def _find_default_file(folder: Path, name: str, robot: Any) -> Path | None:
    """Return the path of a Menagerie robot's default model in ``folder``, by the entry ``robot``.

    The entry is that of the Menagerie package; the file need not exist. Without an entry (None),
    the file is selected by the end of ``name``: ``go2.xml`` for ``unitree_go2``; None if none fits.
    """
    if robot is not None:
        return folder / str(robot.entry(robot.default_model).file)
    candidates = [path for path in folder.glob("*.xml") if name.endswith(path.stem)]
    return max(candidates, key=lambda path: len(path.stem), default=None)


def import_source(module: str, package: str) -> ModuleType | None:
    """Import a module of an optional package; None if the package is not installed.

    A folder of that name in the current folder, such as a clone, is no package.

    Args:
        module: Full name of the module.
        package: Name of the distribution, for the message.

    Raises:
        ModelError: If the package is installed and its import raises an exception.
    """
    try:
        imported = importlib.import_module(module)
    except Exception as error:  # code of another package
        names = (module, module.partition(".")[0])
        if isinstance(error, ModuleNotFoundError) and error.name in names:
            return None
        problem = diagnose("source-not-importable", message=describe_error(error), package=package)
        raise ModelError(package, problem) from error
    return None if getattr(imported, "__file__", "") is None else imported


def describe_error(error: Exception) -> str:
    """Return type and message of an exception of another package, on one line."""
    return one_line(f"{type(error).__name__}: {error}")


def _import_package() -> Any:
    """Return the package ``mujoco_menagerie``; None if it is not installed."""
    return import_source(*MENAGERIE_PACKAGE)


def _find_clone() -> Path | None:
    """Return the folder of a local clone of MuJoCo Menagerie; None if there is none.

    The environment variable ``MENAGERIE_ROOT`` contains the folder (not checked). Without the
    variable, the working directory and the folders above are searched.
    """
    root = os.environ.get("MENAGERIE_ROOT")
    if root:
        return Path(root).expanduser()
    here = Path.cwd()
    folders = (above / MENAGERIE_FOLDER for above in (here, *here.parents))
    return next((folder for folder in folders if folder.is_dir()), None)


def list_menagerie_robots() -> tuple[str, ...]:
    """Return the sorted names of robots of MuJoCo Menagerie, from the package and from a clone."""
    clone = _find_clone()
    try:
        package = _import_package()
    except ModelError:
        package = None
    names = set(package.names()) if package is not None else set()
    if clone is not None and clone.is_dir():
        names |= {path.parent.name for path in clone.glob("*/*.xml")}
    return tuple(sorted(names))
