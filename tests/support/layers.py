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


def _floors() -> list[list[str]]:
    """Return the layers from the lowest on, as ``pyproject.toml`` states them for import-linter."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(one["layers"] for one in settings["contracts"] if one["id"] == "floors")
    return [re.split(r" [|:] ", layer) for layer in reversed(layers)]


FLOOR = {room: floor for floor, rooms in enumerate(_floors()) for room in rooms}
"""{subpackage: number of its layer, 0 for the lowest}."""


@cache
def trees() -> dict[str, ast.Module]:
    """Return {path of a module within the package: its syntax tree}."""
    return {
        path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(PACKAGE.rglob("*.py"))
    }
