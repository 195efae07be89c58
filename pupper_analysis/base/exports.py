"""Lazy imports of the public names of a package, as listed in the stub beside ``__init__.py``.

A name is imported at first use, so ``import pupper_analysis`` is fast. Type checkers read the same
stub. The package ``lazy_loader`` does the same, but ``python -m pupper_analysis`` must be
importable without installed dependencies, to print installation instructions.
"""

from __future__ import annotations

import ast
import sys
import warnings
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any


def make_lazy_exports(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Create ``__getattr__``, ``__dir__`` and ``__all__`` of a package from its stub file (.pyi).

    The stub contains ``from .module import name as name``, or ``from . import module as module``.
    Names from missing modules are left out.

    Args:
        package: ``__name__`` of the package.
        file: ``__file__`` of the package.

    Returns:
        ``__getattr__`` of the package; ``__dir__``; ``__all__``, the exported names.
    """
    stub = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    sources = {
        alias.asname or alias.name: (module, alias.name)
        for node in imports
        for alias in node.names
        if (module := _find_module(package, Path(file).parent, node, alias.name))
    }
    for node in stub.body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Name):
            for target in node.targets:
                if isinstance(target, ast.Name) and node.value.id in sources:
                    sources[target.id] = sources[node.value.id]
    sources = {name: source for name, source in sources.items() if not name.startswith("_")}

    def get_attribute(name: str) -> Any:
        """Import and return an object that the package's stub file (``.pyi``) exports.

        Raises:
            AttributeError: If no such name is exported.
        """
        if name not in sources:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, attribute = sources[name]
        if module == package:  # a submodule; getattr of the package would call this function again
            return _import_module(f"{package}.{attribute}")
        value = _import_name(module, attribute)
        setattr(sys.modules[package], name, value)  # later accesses do not call this function
        return value

    def list_names() -> list[str]:
        """Return the exported names and the special names of the package, sorted, for ``dir``."""
        special = [name for name in vars(sys.modules[package]) if name.startswith("__")]
        return sorted({*special, *sources})

    return get_attribute, list_names, sorted(sources)


def _find_module(package: str, folder: Path, node: ast.ImportFrom, name: str) -> str:
    """Return the module from which a stub imports a name; "" if the module is missing."""
    parts = node.module.split(".") if node.module else []
    parents = package.split(".")[: len(package.split(".")) - node.level + 1]
    path = folder.joinpath(*[".."] * (node.level - 1), *parts)
    if not parts or parts[-1] == "tools":
        path = path / name
    exists = path.is_dir() or path.with_suffix(".py").is_file()
    return ".".join([*parents, *parts]) if exists else ""


def _import_name(module_name: str, name: str) -> Any:
    """Return an attribute of a module; import the submodule of that name if no attribute exists."""
    module = _import_module(module_name)
    if not hasattr(module, name):
        return _import_module(f"{module_name}.{name}")
    return getattr(module, name)


def _import_module(name: str) -> ModuleType:
    """Import a module, without the warning that Pinocchio 3.8 itself causes.

    Pinocchio imports Coal by its deprecated name ``hppfcl``. With ``python -W error`` this warning
    would stop the import of this package.
    """
    if "pinocchio" in sys.modules:
        return import_module(name)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Please update your 'hppfcl'", DeprecationWarning)
        return import_module(name)
