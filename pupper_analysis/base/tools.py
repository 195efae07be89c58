"""Discovery of tools and formats: our own by folder, other packages' by entry point.

A tool is a package that answers one question. The first line of the package docstring is the
question, and ``HELP_HEADING`` selects the heading in ``--help``. ``command.py`` contains the
command, ``document.py`` the pages of the results, and ``words.toml`` the texts. Other packages find
the optional modules ``causes.py``, ``guard.py`` and ``metrics.py`` by name. Discovery imports no
tool: question and heading are read from the source text. Of a tool from another package, only the
parent packages are imported.

A format is a package that reads model files. ``format.toml`` describes the format, ``reader.py``
reads the files (`models.loading`), and the optional ``rules.toml`` contains audit rules for this
format.
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

TOOLS_GROUP = "pupper_analysis.tools"
"""Group of entry points for tools of other Python packages: ``name = "its_package"``. This
package's own tools are in the package of this name.
"""

FORMATS_GROUP = "pupper_analysis.formats"
"""Group of entry points for formats of other Python packages: ``name = "its_package"``."""

_TOOLS_FOLDER = Path(__file__).parents[1] / "tools"
"""Folder of the tools of this package."""

HELP_HEADINGS = ("Files", "Stance", "Design", "Real robot", "Look", "Other tools")
"""Headings in the order of ``--help``. A tool with another heading, or none, is listed under the
last."""

_FIRST_LINE = re.compile(r'\A[rR]?"""(.+?)(?:"""|\n)')
"""Pattern of the first line of a module's docstring: the question that a tool answers."""

_HEADING_PATTERN = re.compile(r'^HELP_HEADING = "(.+)"$', re.MULTILINE)
"""Pattern of the constant in a module that selects its heading in ``--help``."""


class ToolPackage(NamedTuple):
    """Python package of a tool (answers one question) or of a format (reads model files).

    Attributes:
        package: Name of the package.
        folder: Folder of the package.
    """

    package: str
    folder: Path

    @property
    def question(self) -> str:
        """Question that the tool answers (first line of the package's docstring); may be empty."""
        found = _FIRST_LINE.match(self._source_text)
        return found[1] if found else ""

    @property
    def heading(self) -> str:
        """Heading under which ``--help`` lists this tool, an element of ``HELP_HEADINGS``."""
        found = _HEADING_PATTERN.search(self._source_text)
        return found[1] if found and found[1] in HELP_HEADINGS else HELP_HEADINGS[-1]

    @property
    def _source_text(self) -> str:
        """Text of the package's ``__init__.py``."""
        return (self.folder / "__init__.py").read_text(encoding="utf-8")


class Format(NamedTuple):
    """Format of model files other than URDF and MJCF.

    Attributes:
        name: Name of the format: of its folder, or of the entry point of another package.
        package: Name of the package that reads the format.
        folder: Folder of the package.
        suffixes: Suffixes of the file names, with the dot, in lower case.
        begins: First bytes by which files can be recognised; may be empty.
    """

    name: str
    package: str
    folder: Path
    suffixes: tuple[str, ...]
    begins: tuple[bytes, ...]


def own_tools() -> Mapping[str, ToolPackage]:
    """Return {name: tool} of the tools of this package, sorted by name."""
    return _find_own_packages("command.py")


def other_tools() -> Mapping[str, ToolPackage]:
    """Return {name: tool} of the tools of other installed Python packages, sorted by name.

    Tools of this package have priority over tools of other packages with the same name.
    """
    return _find_plugins(TOOLS_GROUP, "command.py")


def find_tool_modules(module: str) -> Mapping[str, str]:
    """Return {tool: package} of the tools that contain a module with a given name.

    Tools of this package are first. ``module`` is the name without ``.py``.
    """
    tools = {**own_tools(), **other_tools()}
    return {
        name: tool.package
        for name, tool in tools.items()
        if (tool.folder / f"{module}.py").is_file()
    }


def own_packages() -> Mapping[str, ToolPackage]:
    """Return {name: tool or format} of all tools and formats that are part of this package."""
    return MappingProxyType({**own_tools(), **_find_own_packages("format.toml")})


def other_packages() -> Mapping[str, ToolPackage]:
    """Return {name: tool or format} of all tools and formats of other installed packages."""
    return MappingProxyType({**other_tools(), **_find_plugins(FORMATS_GROUP, "format.toml")})


@cache
def formats() -> Mapping[str, Format]:
    """Return {name: format} of all file formats besides URDF and MJCF.

    Formats of this package are first, then formats of other distributions.
    """
    by_name = {}
    packages = {
        **_find_own_packages("format.toml"),
        **_find_plugins(FORMATS_GROUP, "format.toml"),
    }
    for name, package in packages.items():
        settings = tomllib.loads((package.folder / "format.toml").read_text(encoding="utf-8"))
        begins = tuple(text.encode() for text in settings.get("begins", ()))
        by_name[name] = Format(
            name, package.package, package.folder, tuple(settings["suffixes"]), begins
        )
    return MappingProxyType(by_name)


def find_format(path: Path) -> Format | None:
    """Return the file format, other than URDF and MJCF, that uses the suffix of a file, or None."""
    suffix = path.suffix.lower()
    if suffix in _COMMON_SUFFIXES:
        return None
    return next(
        (model_format for model_format in formats().values() if suffix in model_format.suffixes),
        None,
    )


def detect_format(data: bytes) -> Format | None:
    """Return the file format, other than URDF and MJCF, that the first bytes of a file indicate.

    None for XML or unknown content.
    """
    if data.lstrip()[:1] == b"<":
        return None
    return next(
        (
            model_format
            for model_format in formats().values()
            if data.startswith(model_format.begins)
        ),
        None,
    )


_COMMON_SUFFIXES = ("", ".urdf", ".xml", ".mjcf", ".xacro")
"""Suffixes of URDF, xacro and MJCF files; "" is a name without suffix. For these suffixes,
`find_format` does not load the list of formats, which takes time."""


@cache
def _find_own_packages(file_name: str) -> Mapping[str, ToolPackage]:
    """Return {name: package} of the subpackages of ``tools`` with a file of this name."""
    paths = sorted(_TOOLS_FOLDER.glob(f"*/{file_name}"))
    return MappingProxyType(
        {
            path.parent.name: ToolPackage(f"{TOOLS_GROUP}.{path.parent.name}", path.parent)
            for path in paths
        }
    )


@cache
def _find_plugins(group: str, file_name: str) -> Mapping[str, ToolPackage]:
    """Return {name: package} of the tools or formats that other distributions register.

    ``group`` is the group of entry points. Names of this package's packages with ``file_name`` are
    left out.
    """
    if not _may_have_entry_points(group):
        return MappingProxyType({})
    from importlib.metadata import entry_points  # import and search take 35 ms

    packages = {}
    for entry_point in sorted(entry_points(group=group), key=lambda entry_point: entry_point.name):
        try:
            spec = find_spec(entry_point.module)
        except ModuleNotFoundError:  # the parent of a nested package is missing
            continue
        locations = spec.submodule_search_locations if spec else None
        if locations and entry_point.name not in _find_own_packages(file_name):
            packages[entry_point.name] = ToolPackage(
                entry_point.module, Path(next(iter(locations)))
            )
    return MappingProxyType(packages)


def _may_have_entry_points(group: str) -> bool:
    """Return False if certainly no installed package has an entry point in a group.

    The files ``entry_points.txt`` in ``sys.path`` are searched for the name of the group, which is
    faster than the import of ``importlib.metadata``.
    """
    for finder in sys.meta_path:
        if hasattr(finder, "find_distributions") and finder is not PathFinder:
            return True
    folders = [Path(entry) for entry in dict.fromkeys(sys.path)]  # "" is the current folder
    if any(folder.suffix.lower() == ".egg" or folder.is_file() for folder in folders):
        return True
    for folder in folders:
        for path in folder.glob("*-info/entry_points.txt"):  # .dist-info, .egg-info
            try:
                if group.encode() in path.read_bytes():
                    return True
            except OSError:
                continue
    return False
