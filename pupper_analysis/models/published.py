"""Published models: names of robots, files of ROS packages, xacro files, and Git LFS pointers.

The Python packages ``robot_descriptions``, ``mujoco-menagerie`` and ``xacro`` are optional. Nothing
is downloaded.
"""

from __future__ import annotations

import difflib
import importlib
import io
import os
import pkgutil
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    ModelError,
    PupperAnalysisError,
    UnknownNameError,
)
from pupper_analysis.base.inputs import is_input, path_exists
from pupper_analysis.base.runs import register_input
from pupper_analysis.models.menagerie import (
    MENAGERIE_FOLDER,
    MENAGERIE_PACKAGE,
    describe_error,
    find_menagerie_file,
    has_fixed_menagerie_base,
    import_source,
    is_menagerie_name,
    list_menagerie_robots,
    make_menagerie_download,
)
from pupper_analysis.models.places import Place, make_file_error, one_line
from pupper_analysis.models.xml import (
    LFS_POINTER,
    XACRO_PREFIX,
    XACRO_SUFFIX,
    blank_faulty_declaration,
)


def existing_file(path: Path) -> Path | None:
    """Return the path of an existing file, and register the file as input of the running command.

    Returns:
        The path; None if there is no such file, for example, or only a Git LFS pointer.

    Raises:
        OutputError: If this run of the command line also writes this file.
    """
    try:
        if not path.is_file() or is_pointer(path):
            return None
    except (OSError, ValueError):
        return None
    register_input(path)
    return path


def is_pointer(path: Path) -> bool:
    """Return True if a file is a Git LFS pointer, which replaces content that was not downloaded.

    Only regular files are opened, because reading a pipe may block.
    """
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(LFS_POINTER)) == LFS_POINTER
    except (OSError, ValueError):
        return False


_PACKAGE_NAME: Final = re.compile(rb"<name>\s*([\w.-]+)\s*</name>")
"""Pattern of the name in a ``package.xml``."""

_MAX_MANIFEST_BYTES: Final = 65536
"""Number of bytes of a ``package.xml`` in which the name is searched. Chosen, not tuned."""


def _read_package_name(folder: Path) -> str:
    """Return the name in the ``package.xml`` of a folder; "" without such a file or name."""
    try:
        with (folder / "package.xml").open("rb") as file:
            found = _PACKAGE_NAME.search(file.read(_MAX_MANIFEST_BYTES))
    except (OSError, ValueError):
        return ""
    return found[1].decode() if found else ""


def find_package_folders(folder: Path, package: str) -> Iterator[Path]:
    """Yield the folders that may contain a ROS package: a given folder, and a subfolder.

    The given folder has the name of the package, or a ``package.xml`` with this name. The subfolder
    has the name of the package.
    """
    if package in (folder.name, _read_package_name(folder)):
        yield folder
    if package not in ("", ".", "..") and (folder / package).is_dir():
        yield folder / package


DESCRIPTION_PREFIX: Final = "robot_descriptions:"
"""Prefix that marks a name of the package ``robot_descriptions``, as in
``robot_descriptions:go2_mj_description``."""

_DESCRIPTION_NAME: Final = re.compile(r"[a-z0-9_]+")
"""Pattern of a robot's name in the package ``robot_descriptions``, without `DESCRIPTION_PREFIX`."""


class _NotCachedError(Exception):
    """Error: a repository is not in the local cache of ``robot_descriptions``."""


_BARE_DESCRIPTION: Final = re.compile(r"[a-z0-9_]+_description")
"""Pattern of the name of a description that is accepted without `DESCRIPTION_PREFIX`, as in
``go2_mj_description``."""

PACKAGE_PREFIX: Final = "package://"
"""Prefix that marks a file of a ROS package, as in ``package://go2_description/urdf/go2.urdf``."""

_PACKAGE_START: Final = re.compile(r"package:(//?|$)")
"""Pattern of `PACKAGE_PREFIX` at the start of a text. ``Path`` merges two slashes, and removes a
slash at the end."""


_WEB_ADDRESS: Final = re.compile(r"(https?|ftp|ssh|git)://?", re.IGNORECASE)
"""Pattern of the start of a web address; ``Path`` merges the slashes."""


def is_uri(word: str) -> bool:
    """Return True if a word begins like ``package://NAME/FILE`` or a web address."""
    return any(pattern.match(word) for pattern in (_PACKAGE_START, _WEB_ADDRESS))


def is_published_name(word: str) -> bool:
    """Return True if a word has the form of a published robot's name.

    Accepted are names with `DESCRIPTION_PREFIX` (even if no such description exists), and names of
    robots of MuJoCo Menagerie (`is_menagerie_name`). Existing paths without `DESCRIPTION_PREFIX`
    are not accepted.
    """
    return _is_description(word) or is_menagerie_name(word)


_DESCRIPTIONS_PACKAGE: Final = ("robot_descriptions", "robot_descriptions")
"""Module and distribution of the package ``robot_descriptions``."""

_DESCRIPTION_SUFFIX: Final = re.compile(r"(_mj)?_description$")
"""Pattern of the end of a description's name, behind the name of the robot."""

_NUM_SIMILAR_NAMES: Final = 3
"""Largest number of names that `list_similar_published_names` returns. Chosen, not tuned."""

_MIN_NAME_SIMILARITY: Final = 0.75
"""Smallest similarity (`difflib`, 0 to 1) of a published name that `list_similar_published_names`
returns although the name does not contain the given word. Chosen, not tuned.
"""

_GENERIC_WORD: Final = re.compile(r"arm|hand|model|robot|v?\d+")
"""Pattern of words that are parts of names of many robots, such as versions, and identify none."""


def list_similar_published_names(word: str) -> list[str]:
    """Return up to three names of published robots that are similar to a word.

    The names are robots of MuJoCo Menagerie, and descriptions of the package
    ``robot_descriptions``, if installed. Names that contain a specific word between underscores,
    such as ``unitree_go2`` for ``go2``, count as similar.
    """
    name = word.removeprefix(DESCRIPTION_PREFIX).removeprefix(f"{MENAGERIE_FOLDER}/").lower()
    known = [*_list_descriptions(), *list_menagerie_robots()]
    similar = difflib.get_close_matches(name, known, cutoff=_MIN_NAME_SIMILARITY)
    robot = _DESCRIPTION_SUFFIX.sub("", name)
    if not all(map(_GENERIC_WORD.fullmatch, robot.split("_"))):
        similar += [
            known_name
            for known_name in known
            if f"_{robot}_" in f"_{known_name}_" and known_name not in similar
        ]
    return similar[:_NUM_SIMILAR_NAMES]


def is_available(name: str) -> bool:
    """Return True if the model of a published robot is on this machine."""
    try:
        find_file(name)
    except PupperAnalysisError:
        return False
    return True


def has_fixed_base(name: str) -> bool:
    """Return True if a published robot is known to have a fixed base; False if unknown."""
    return is_menagerie_name(name) and has_fixed_menagerie_base(name)


def make_download_command(name: str) -> str:
    """Return the command line of another program that downloads the model of a published robot."""
    if _is_description(name):
        return f"python -m robot_descriptions pull {name.removeprefix(DESCRIPTION_PREFIX)}"
    return make_menagerie_download(Path(name.removeprefix(f"{MENAGERIE_FOLDER}/")).parts[0])


def list_source_problems() -> list[Diagnostic]:
    """Return a diagnostic for each package of published names that is missing or not importable."""
    problems = []
    for module, package in (_DESCRIPTIONS_PACKAGE, MENAGERIE_PACKAGE):
        try:
            if import_source(module, package) is None:
                problems.append(diagnose("source-not-installed", package=package))
        except ModelError as error:
            problems.append(error.diagnostic)
    return problems


def _list_descriptions() -> list[str]:
    """Return the names of all descriptions of ``robot_descriptions``; empty if not importable."""
    try:
        package = import_source(*_DESCRIPTIONS_PACKAGE)
    except ModelError:
        return []
    modules = [] if package is None else pkgutil.iter_modules(package.__path__)
    return [module.name for module in modules if _BARE_DESCRIPTION.fullmatch(module.name)]


def _is_description(word: str) -> bool:
    """Return True if a word has the form of a description's name in ``robot_descriptions``.

    Without the prefix ``DESCRIPTION_PREFIX``, the name must end with ``_description`` and not be an
    existing path.
    """
    if word.startswith(DESCRIPTION_PREFIX) or _BARE_DESCRIPTION.fullmatch(word) is None:
        return word.startswith(DESCRIPTION_PREFIX)
    return not path_exists(word)


def find_file(model: str | Path, packages: Mapping[str, Path] | None = None) -> Path:
    """Return the file of a model: a path, a published name, or ``package://NAME/FILE``.

    Published names are robots of MuJoCo Menagerie, and descriptions of the package
    ``robot_descriptions``. A path is returned unchanged, also if the file does not exist. MJCF
    files of a description are preferred to URDF files.

    Args:
        model: Path or name.
        packages: {ROS package: its folder}. Other packages are searched in the current folder, in
            the folders above, and in the folders of ROS.

    Raises:
        ModelError: For example if a package or a description is not found, or the name is a web
            address.
        UnknownNameError: If a name with the prefix ``mujoco_menagerie/`` is unknown.
    """
    word = str(model)
    if found := _PACKAGE_START.match(word):
        return _find_in_package(word[found.end() :], packages or {})
    if _WEB_ADDRESS.match(word):
        raise ModelError(_WEB_ADDRESS.sub(r"\1://", word), diagnose("file-of-the-web"))
    if is_menagerie_name(word):
        return find_menagerie_file(word)
    if not _is_description(word):
        return Path(model)
    name = word.removeprefix(DESCRIPTION_PREFIX)
    cache = import_source("robot_descriptions._cache", _DESCRIPTIONS_PACKAGE[1])
    if cache is None:
        similar = list_similar_published_names(name)
        raise ModelError(word, diagnose("descriptions-not-installed", alike=similar))
    if not _DESCRIPTION_NAME.fullmatch(name):
        raise ModelError(word, diagnose("no-such-description", name=name, alike=[]))
    description = _import_cached_description(word, name, cache)
    for attribute in ("MJCF_PATH", "URDF_PATH", "XACRO_PATH"):
        if hasattr(description, attribute):
            return Path(getattr(description, attribute))
    raise ModelError(word, diagnose("description-without-file", name=name))


def find_packages(package: str, folder: Path, packages: Mapping[str, Path]) -> list[Path]:
    """Return the folders that may be a ROS package, by descending priority.

    Args:
        package: Name of the package.
        folder: This folder and the folders above are searched, then ``ROS_PACKAGE_PATH`` and
            ``AMENT_PREFIX_PATH``.
        packages: {ROS package: its folder}. A folder given here is the only result.
    """
    if package in packages:
        return [packages[package]]
    folders: list[Path] = []
    for above in (folder, *folder.parents):
        folders += find_package_folders(above, package)
    for variable, share in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        for top in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            folders += find_package_folders(Path(top) / share, package)
    return folders


def _find_in_package(name: str, packages: Mapping[str, Path]) -> Path:
    """Return the file of a ROS package, given as ``NAME/FILE``; raise a ModelError if not found."""
    package, _, rest = name.partition("/")
    if not package or not rest:
        raise ModelError(f"{PACKAGE_PREFIX}{name}", diagnose("package-path-incomplete"))
    folders = find_packages(package, Path.cwd(), packages)
    for candidate in folders:
        if (candidate / rest).is_file():
            return candidate / rest
    problem = diagnose("package-not-found", package=package, file=rest, found=bool(folders))
    raise ModelError(f"{PACKAGE_PREFIX}{name}", problem)


def _import_cached_description(source: str, name: str, cache: ModuleType) -> ModuleType:
    """Import a description of ``robot_descriptions`` from its local cache, without downloading.

    ``source`` is the name in error messages, ``name`` the module of the description, and ``cache``
    the module with the function that downloads.
    """

    def find_in_cache(repository: str, commit: str | None = None) -> str:
        """Return the cached folder of a repository; raise `_NotCachedError` if there is none."""
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
    except _NotCachedError as error:
        problem = diagnose("description-not-cached", download=make_download_command(name))
        raise ModelError(source, problem) from error
    except Exception as error:  # the module of a description is code of another package
        problem = diagnose("description-not-importable", name=name, message=describe_error(error))
        if isinstance(error, ModuleNotFoundError) and error.name == f"robot_descriptions.{name}":
            similar = list_similar_published_names(name)
            problem = diagnose("no-such-description", name=name, alike=similar)
        raise ModelError(source, problem) from error
    finally:
        cache.clone_to_cache = clone  # type: ignore[attr-defined]


def make_xacro_request(
    models: Iterable[object],
    packages: Mapping[str, Path] | None,
    *,
    xacro: bool,
    arguments: Mapping[str, str] | None,
) -> Mapping[str, str] | None:
    """Return the arguments with which xacro files are expanded; None if they are not expanded.

    Args:
        models: Models of the user: paths, names, or robots in memory.
        packages: {ROS package: its folder}.
        xacro: Whether the user accepts that xacro evaluates the Python expressions in the files.
        arguments: {argument of a xacro file: value}; None or empty for the default values.

    Raises:
        ConfigurationError: If a value is no text, or arguments are given without a xacro file or
            without ``xacro``.
        ModelError: If the file of a model is not found (`find_file`).
    """
    given = dict(arguments or {})
    for name, value in given.items():
        check_type(f"xacro_args[{name}]", value, str)
    if given and not xacro:
        raise ConfigurationError("xacro_args", diagnose("xacro-args-alone"))
    named = [model for model in models if isinstance(model, str | Path)]
    if given and not any(is_xacro(find_file(model, packages)) for model in named):
        problem = diagnose("no-xacro-file", file=", ".join(map(str, named)) or "the robot")
        raise ConfigurationError("xacro_args", problem)
    return given if xacro else None


def is_xacro(path: Path) -> bool:
    """Return True if a file has the suffix ``.xacro``, or its text contains ``<xacro:``."""
    if path.suffix.lower() == XACRO_SUFFIX:
        return True
    try:
        return path.is_file() and f"<{XACRO_PREFIX}:".encode() in path.read_bytes()
    except (OSError, ValueError):
        return False


def expand_xacro(
    path: Path,
    packages: Mapping[str, Path] | None = None,
    arguments: Mapping[str, str] | None = None,
) -> str:
    """Expand a xacro file, and return the URDF text. Python expressions in the file are evaluated.

    ``$(find NAME)`` is resolved as ``package://NAME``, from the folder of the file; a ROS
    installation is not necessary.

    Args:
        path: The file.
        packages: {ROS package: its folder}.
        arguments: {argument of the file: value}; other arguments have their default values.

    Raises:
        ModelError: For example if xacro is not installed, or the expansion fails.
        UnknownNameError: If the file and the included files do not mention an argument.
        OutputError: If this run of the command line also writes an included file.
    """
    xacro = import_source("xacro", "xacro")
    if xacro is None:
        raise make_file_error(Place(path), diagnose("xacro-not-installed"))
    if not is_input(path):
        raise make_file_error(Place(path), diagnose("file-not-read", message="no such file"))
    given = dict(arguments or {})
    # xacro appends the included files of each expansion to a global list.
    before = len(getattr(xacro, "all_includes", ()))
    options = {"mappings": given} if given else {}
    try:
        with _find_xacro_packages(path, packages or {}), _blank_faulty_declarations(xacro):
            text = str(xacro.process_file(str(path), **options).toxml())
    except ModelError:
        raise
    except Exception as error:  # Python code in a macro may raise any exception
        if isinstance(error.__context__, ModelError):  # xacro encloses the error of `find`
            raise error.__context__ from None
        missing = _UNDEFINED_ARGUMENT.search(str(error))
        problem = (
            diagnose("xacro-not-expanded", message=one_line(error))
            if missing is None
            else diagnose("xacro-argument-missing", name=missing[1])
        )
        raise make_file_error(Place(path), problem) from error
    files = [path, *map(Path, getattr(xacro, "all_includes", ())[before:])]
    for name in files[1:]:
        register_input(name)
    if given:
        _check_xacro_arguments(path, files, given)
    return text


@contextmanager
def _find_xacro_packages(path: Path, packages: Mapping[str, Path]) -> Iterator[None]:
    """Resolve ``$(find NAME)`` of xacro by `find_packages`, then by ROS, in a ``with`` block.

    The folder of the xacro file ``path`` and the folders above are searched.
    """
    try:
        substitution = importlib.import_module("xacro.substitution_args")
    except ImportError:  # another package with the name xacro
        yield
        return
    find_by_ros = substitution._eval_find

    def find(package: str) -> str:
        """Return the folder of a ROS package, from `find_packages`, or otherwise from ROS."""
        folders = find_packages(package, path.absolute().parent, packages)
        if folders:
            return str(folders[0].absolute())
        try:
            return str(find_by_ros(package))
        except Exception as error:  # ROS is not installed, or has no such package
            problem = diagnose("package-not-found", package=package, file="", found=False)
            raise make_file_error(Place(path), problem) from error

    substitution._eval_find = find  # type: ignore[attr-defined]
    try:
        yield
    finally:
        substitution._eval_find = find_by_ros  # type: ignore[attr-defined]


@contextmanager
def _blank_faulty_declarations(xacro: Any) -> Iterator[None]:
    """Let xacro read files with a faulty XML declaration, in a ``with`` block.

    ``xacro`` is the imported package, whose parsing function is replaced during the block.
    """
    parse = getattr(xacro, "parse", None)
    if parse is None:  # another package with the name xacro
        yield
        return

    def parse_blanked(content: Any, filename: str | None = None) -> Any:
        """Parse a file as xacro does, but with a declaration that parsers reject replaced."""
        if content is None and filename is not None:
            with suppress(OSError):  # xacro reports the error
                data = Path(filename).read_bytes()
                if (blanked := blank_faulty_declaration(data)) != data:
                    content = io.BytesIO(blanked)
        return parse(content, filename)

    xacro.parse = parse_blanked
    try:
        yield
    finally:
        xacro.parse = parse


_UNDEFINED_ARGUMENT: Final = re.compile(r"Undefined substitution argument (\w+)")
"""Pattern of xacro's error about an argument without value, with the name of the argument."""

_XACRO_ARGUMENT: Final = re.compile(
    r"<xacro:arg\s[^>]*?\bname\s*=\s*[\"']([^\"']+)|\$\(arg\s+([^\s)]+)\s*\)"
)
"""Pattern of the declaration of a xacro argument, or of its use ``$(arg NAME)``, with its name."""


def _check_xacro_arguments(path: Path, files: Iterable[Path], given: Mapping[str, str]) -> None:
    """Raise an UnknownNameError if no file mentions an argument, because xacro ignores it.

    Files may use an argument that no file declares, as AR4 does with ``ar_model``.
    """
    known = {
        declared or used
        for file in files
        for declared, used in _XACRO_ARGUMENT.findall(
            file.read_text(encoding="utf-8", errors="replace")
        )
    }
    for name in given:
        if name not in known:
            raise UnknownNameError(str(path), "xacro argument", name, sorted(known))
