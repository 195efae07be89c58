"""Layer of each subpackage, and the syntax trees of all modules."""

from __future__ import annotations

import ast
import re
import tomllib
from functools import cache
from pathlib import Path

import pupper_analysis
from tests.support.repository import ROOT

PACKAGE = Path(pupper_analysis.__file__).parent
"""Folder of the package."""


def _list_layers() -> list[list[str]]:
    """Return the layers from the lowest on, as ``pyproject.toml`` states them for import-linter."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(
        contract["layers"] for contract in settings["contracts"] if contract["id"] == "layers"
    )
    return [re.split(r" [|:] ", layer) for layer in reversed(layers)]


LAYERS = {name: layer for layer, names in enumerate(_list_layers()) for name in names}
"""{subpackage: number of its layer, 0 for the lowest}."""


@cache
def trees() -> dict[str, ast.Module]:
    """Return {path of a module within the package: its syntax tree}."""
    return {
        path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(PACKAGE.rglob("*.py"))
    }
