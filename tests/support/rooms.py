"""The package's rooms by floor, and its modules as they are written."""

from __future__ import annotations

import ast
import re
import tomllib
from functools import cache
from pathlib import Path

import pupper_analysis
from tests.support.repository import ROOT

PACKAGE = Path(pupper_analysis.__file__).parent


def _floors() -> list[list[str]]:
    """From the ground up, as `pyproject.toml` tells import-linter, which checks them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(one["layers"] for one in settings["contracts"] if one["id"] == "floors")
    return [re.split(r" [|:] ", layer) for layer in reversed(layers)]


FLOOR = {room: floor for floor, rooms in enumerate(_floors()) for room in rooms}


@cache
def trees() -> dict[str, ast.Module]:
    """{path of a module in the package: its syntax}, parsed once."""
    return {
        path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(PACKAGE.rglob("*.py"))
    }
