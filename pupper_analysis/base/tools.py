"""Which tools there are: our own by their folders, others' by their entry points.

A tool is a package that answers one question. Its docstring's first line says which, its
``HEADING`` under which heading ``--help`` lists it; ``command.py`` has its ``command``,
``document.py`` the pages of its results, ``words.toml`` its words. None is imported here: whoever
lists them reads these lines.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

GROUP = "pupper_analysis.tools"
"""The group of entry points by which a distribution offers tools: ``name = "its_package"``."""

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


@cache
def own_tools() -> Mapping[str, Tool]:
    """Returns {name: tool} of the tools of this package, by name."""
    found = sorted(OWN.glob("*/command.py"))
    return MappingProxyType(
        {path.parent.name: Tool(f"{GROUP}.{path.parent.name}", path.parent) for path in found}
    )


@cache
def other_tools() -> Mapping[str, Tool]:
    """Returns {name: tool} of the tools of other distributions, by name; ours keep their names.

    One whose package is not there, or is no folder, is left out.
    """
    from importlib.metadata import entry_points  # takes 20 ms

    found = {}
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        spec = find_spec(point.module)
        places = spec.submodule_search_locations if spec else None
        if places and point.name not in own_tools():
            found[point.name] = Tool(point.module, Path(next(iter(places))))
    return MappingProxyType(found)
