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
            name``, or ``from . import module as module``.
    """
    stub = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    homes = {one.name: node.module for node in imports for one in node.names}

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = homes[name]
        if home is None:
            return import_module(f"{package}.{name}")
        found = getattr(import_module(f"{package}.{home}"), name)
        setattr(sys.modules[package], name, found)  # and is asked for no more
        return found

    return find, lambda: sorted([*vars(sys.modules[package]), *homes]), sorted(homes)
