"""Which tools and formats there are: our own by their folders, others' by their entry points.

A tool is a package that answers one question. Its docstring's first line says which, its
``HEADING`` under which heading ``--help`` lists it; ``command.py`` has its ``command``,
``document.py`` the pages of its results, ``words.toml`` its words; some have what others look for
by its name: ``causes.py``, ``guard.py``, ``metrics.py``, ``modes.py``. None is imported here:
whoever lists them reads these lines.

A format is a package that reads model files: ``format.toml`` says which, ``reader.py`` reads them
(`models.readers`), ``rules.toml`` has rules of the audit for it alone.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

GROUP = "pupper_analysis.tools"
"""The group of entry points by which a distribution offers tools: ``name = "its_package"``."""

FORMATS_GROUP = "pupper_analysis.formats"
"""Likewise of formats."""

OWN = Path(__file__).parents[1] / "tools"

HEADINGS = ("Files", "Stance", "Design", "Real robot", "Look", "Other tools")
"""In the order in which ``--help`` has them; what states none of these is another tool."""

_FIRST_LINE = re.compile(r'\A[rR]?"""(.+?)(?:"""|\n)')
_HEADING = re.compile(r'^HEADING = "(.+)"$', re.MULTILINE)


class Tool(NamedTuple):
    """A tool.

    Attributes:
        package: The name of its package.
        folder: Where that is.
    """

    package: str
    folder: Path

    @property
    def question(self) -> str:
        """The first line of its docstring: what its command does; empty if it has none."""
        found = _FIRST_LINE.match(self._stated)
        return found[1] if found else ""

    @property
    def heading(self) -> str:
        """Under which of ``HEADINGS`` it is listed."""
        found = _HEADING.search(self._stated)
        return found[1] if found and found[1] in HEADINGS else HEADINGS[-1]

    @property
    def _stated(self) -> str:
        return (self.folder / "__init__.py").read_text(encoding="utf-8")


class Format(NamedTuple):
    """A format of model files besides URDF and MJCF.

    Attributes:
        name: What it is called, in lower case.
        package: The name of the package that reads it.
        folder: Where that is.
        suffixes: How the names of its files end.
        begins: How the files themselves begin, as far as that tells.
    """

    name: str
    package: str
    folder: Path
    suffixes: tuple[str, ...]
    begins: tuple[bytes, ...]


def own_tools() -> Mapping[str, Tool]:
    """Returns {name: tool} of the tools of this package, by name."""
    return _own("command.py")


def other_tools() -> Mapping[str, Tool]:
    """Returns {name: tool} of the tools of other distributions, by name; ours keep their names.

    One whose package is not there, or is no folder, is left out.
    """
    return _others(GROUP, "command.py")


def offering(module: str) -> Mapping[str, str]:
    """Returns {tool: its package} of the tools that have a module of a name, our own first."""
    tools = {**own_tools(), **other_tools()}
    return {
        name: one.package for name, one in tools.items() if (one.folder / f"{module}.py").is_file()
    }


def own_packages() -> Mapping[str, Tool]:
    """Returns {name: package} of what in this package has words: tools and formats."""
    return MappingProxyType({**own_tools(), **_own("format.toml")})


def other_packages() -> Mapping[str, Tool]:
    """Returns the same of other distributions."""
    return MappingProxyType({**other_tools(), **_others(FORMATS_GROUP, "format.toml")})


@cache
def formats() -> Mapping[str, Format]:
    """Returns {name: format} of all formats, our own before others'."""
    found = {}
    packages = {**_own("format.toml"), **_others(FORMATS_GROUP, "format.toml")}
    for name, one in packages.items():
        said = tomllib.loads((one.folder / "format.toml").read_text(encoding="utf-8"))
        begins = tuple(text.encode() for text in said.get("begins", ()))
        found[name] = Format(name, one.package, one.folder, tuple(said["suffixes"]), begins)
    return MappingProxyType(found)


def format_of(path: Path) -> Format | None:
    """Returns the format of a file by its name; None of a URDF's or an MJCF's."""
    ending = path.suffix.lower()
    if ending in _USUAL:
        return None
    return next((one for one in formats().values() if ending in one.suffixes), None)


def format_begun(data: bytes) -> Format | None:
    """Returns the format of what a file holds; None where it may be XML."""
    if data.lstrip()[:1] == b"<":
        return None
    return next((one for one in formats().values() if data.startswith(one.begins)), None)


_USUAL = ("", ".urdf", ".xml", ".mjcf", ".xacro")
"""What ends so is no other's: nobody is asked, which takes time."""


@cache
def _own(mark: str) -> Mapping[str, Tool]:
    found = sorted(OWN.glob(f"*/{mark}"))
    return MappingProxyType(
        {path.parent.name: Tool(f"{GROUP}.{path.parent.name}", path.parent) for path in found}
    )


@cache
def _others(group: str, mark: str) -> Mapping[str, Tool]:
    from importlib.metadata import entry_points  # takes 20 ms

    found = {}
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        spec = find_spec(point.module)
        places = spec.submodule_search_locations if spec else None
        if places and point.name not in _own(mark):
            found[point.name] = Tool(point.module, Path(next(iter(places))))
    return MappingProxyType(found)
