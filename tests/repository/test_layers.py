"""Data flows down: no room imports one above it, and rooms alone are the package's parts."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import pupper_analysis

PACKAGE = Path(pupper_analysis.__file__).parent

ROOMS = (
    (
        "diagnostics",
        "frozen",
        "errors",
        "results",
        "files",
        "together",
        "arguments",
        "arrays",
        "drivers",
    ),  # serve all
    ("models",),
    ("robot_model",),
    ("robot",),
    ("matching",),
    ("statics",),
    ("stance",),
    ("simulation",),
    ("checks",),
    ("sync", "guard"),
    ("prepare",),
    ("convert",),
    ("analysis", "study"),
    ("report",),
    ("live",),
    ("pupper",),
    ("cli",),
)
FLOOR = {room: floor for floor, rooms in enumerate(ROOMS) for room in rooms}

MODULES = sorted(PACKAGE.rglob("*.py"))


def imported(path: Path) -> Iterator[str]:
    """The package's modules that a module imports, at its top or later."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            if node.module == "pupper_analysis":
                yield from (f"pupper_analysis.{alias.name}" for alias in node.names)
            yield node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def room(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else ""


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_import_points_up(path: Path) -> None:
    relative = path.relative_to(PACKAGE)
    here = relative.parts[0].removesuffix(".py")
    if here in ("__init__", "__main__"):
        return
    assert here in FLOOR, f"{relative} is in no room; see docs/architecture.md"
    for module in imported(path):
        there = room(module)
        if module.startswith("pupper_analysis") and there in FLOOR:
            assert FLOOR[there] <= FLOOR[here], f"{relative} imports {module}"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_only_pupper_and_the_command_line_know_pupper(path: Path) -> None:
    here = path.relative_to(PACKAGE).parts[0]
    if here not in ("pupper", "cli", "__init__.py"):
        assert not [m for m in imported(path) if room(m) == "pupper"]


@pytest.mark.slow
def test_no_two_modules_import_each_other() -> None:
    graph = {}
    for path in MODULES:
        name = ".".join(("pupper_analysis", *path.relative_to(PACKAGE).with_suffix("").parts))
        graph[name.removesuffix(".__init__")] = {
            module
            for node in ast.parse(path.read_text()).body
            if isinstance(node, ast.ImportFrom) and node.module
            for module in (
                node.module,
                *(f"{node.module}.{alias.name}" for alias in node.names),
            )
            if module.startswith("pupper_analysis")
        }
    done: set[str] = set()

    def visit(module: str, way: tuple[str, ...]) -> None:
        assert module not in way, " -> ".join((*way, module))
        if module in done or module not in graph:
            return
        for other in graph[module]:
            if other != module and not module.startswith(f"{other}."):
                visit(other, (*way, module))
        done.add(module)

    for module in graph:
        visit(module, ())
