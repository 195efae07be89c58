"""Check the names of this package on the pages of a built site, in a new process.

    python docs/check_names.py build/docs

Exit status 1 if a page prints a private path, or a type as Sphinx spells it internally.
"""

from __future__ import annotations

import html
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pupper_analysis as pa

INTERNAL = re.compile(
    r"~[a-z_]+\.|\btyping\.|\bndarray\[|TypeAliasForwardRef|<factory>|<object object"
)
"""Spellings of types that no page prints: they are written for Sphinx, not for readers."""

PATH = re.compile(r"(?<![\w./])(?:pa|pupper_analysis)(?:\.[A-Za-z_]\w*)+(?!\.\w)")
"""Dotted path of a name of this package."""

FILE = re.compile(r"\.(?:csv|toml|txt|py|md)$")
"""End of a file name, such as pupper_analysis.toml."""


def has_public_name(path: str) -> bool:
    """Return whether a path can be evaluated after ``import pupper_analysis as pa`` alone.

    A submodule is an attribute of its package only after an import, for example by another name.
    Each module on the path must therefore be in the ``__all__`` of the module that contains it.
    """
    value: object = pa
    for name in path.split(".")[1:]:
        if not hasattr(value, name):
            fields = (vars(base).get("__annotations__", {}) for base in _list_bases(value))
            return any(name in annotations for annotations in fields)
        member = getattr(value, name)
        if isinstance(member, ModuleType) and name not in getattr(value, "__all__", ()):
            return False
        value = member
    return True


def _list_bases(value: object) -> tuple[type, ...]:
    """Return a class and its base classes; nothing for other objects."""
    return value.__mro__ if isinstance(value, type) else ()


def read_text(page: str) -> str:
    """Return the text of an HTML page, without its head and its scripts."""
    body = re.sub(r"<(head|script|style|title)\b.*?</\1>", "", page, flags=re.S)
    return html.unescape(re.sub(r"<[^>]+>", "", body))


def find_faults(page: str, *, is_reference: bool) -> Iterator[str]:
    """Yield the internal spellings and the private paths of an HTML page.

    Args:
        page: Content of the page.
        is_reference: Whether paths of modules are reported, too. The guides show imports of modules
            that are not public (``from pupper_analysis.tools.walk.gait import simulate_walk``).
    """
    text = read_text(page)
    yield from sorted({found[0] for found in INTERNAL.finditer(text)})
    for path in sorted({found[0] for found in PATH.finditer(text)}):
        checked = is_reference or path.startswith("pa.")
        if checked and not FILE.search(path) and not has_public_name(path):
            yield path


def main(site: Path) -> int:
    """Print the faults of a site, and return the exit status."""
    status = 0
    for path in sorted(site.rglob("*.html")):
        name = path.relative_to(site).as_posix()
        if "/tables/" in name:  # measurements, also of names of former versions
            continue
        page = path.read_text("utf-8")
        for fault in find_faults(page, is_reference="api" in path.relative_to(site).parts):
            print(f"{name}: {fault}", file=sys.stderr)
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
