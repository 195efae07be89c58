"""The names that a package offers, from the stub beside it, each imported when it is first used.

``import pupper_analysis`` stays light, and type checkers read the very list that is used. (That is
what the package ``lazy_loader`` does; but where nothing is installed, ``python -m pupper_analysis``
must still be imported, to say what to do.)
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def exports_of(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Returns the ``__getattr__``, ``__dir__`` and ``__all__`` of a package.

    Args:
        package: Its ``__name__``.
        file: Its ``__file__``, which has a stub beside it: lines ``from .module import name as
            name``, or ``from . import module as module``; of a module with another name ``from .
            import module as _module`` and ``name = _module``. What a tool offered is left out
            where its folder is gone.
    """
    stub = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    homes = {
        one.asname or one.name: (home, one.name)
        for node in imports
        for one in node.names
        if (home := _home(package, Path(file).parent, node, one.name))
    }
    for node in stub.body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Name):
            for target in node.targets:
                if isinstance(target, ast.Name) and node.value.id in homes:
                    homes[target.id] = homes[node.value.id]
    homes = {name: home for name, home in homes.items() if not name.startswith("_")}

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home, there = homes[name]
        if home == package:  # a module in it; to ask itself would lead here again
            return import_module(f"{package}.{there}")
        found = _take(home, there)
        setattr(sys.modules[package], name, found)  # and is asked for no more
        return found

    return find, lambda: sorted([*vars(sys.modules[package]), *homes]), sorted(homes)


def _home(package: str, folder: Path, node: ast.ImportFrom, name: str) -> str:
    """Returns the module from which a stub takes a name; empty if its tool is gone."""
    parts = node.module.split(".") if node.module else []
    above = package.split(".")[: len(package.split(".")) - node.level + 1]
    place = folder.joinpath(*[".."] * (node.level - 1), *parts)
    there = place.is_dir() or place.with_suffix(".py").is_file()
    if parts[-1:] == ["tools"]:
        there = (place / name).is_dir()
    return ".".join([*above, *parts]) if there else ""


def _take(home: str, name: str) -> Any:
    """Returns what a module has under a name, or the module of that name in it."""
    module = import_module(home)
    if not hasattr(module, name):
        return import_module(f"{home}.{name}")
    return getattr(module, name)
