"""The packages are few, import each other without cycles, and equal the architecture page.
import-linter checks the allowed imports (`make lint`); ruff bounds the complexity of functions.
"""

from __future__ import annotations

import ast
import graphlib
import re
from collections.abc import Iterator
from itertools import chain

import pytest

from pupper_analysis.base.tools import own_packages, own_tools
from tests.support.layers import LAYERS, PACKAGE, trees
from tests.support.repository import script

drawing = script("docs/draw_architecture.py")


def list_imports(tree: ast.Module) -> Iterator[str]:
    """Yield the names of modules that a module imports on its import, or for annotations."""
    blocks = [node.body for node in tree.body if isinstance(node, ast.If)]
    for node in (*tree.body, *chain(*blocks)):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


@pytest.mark.slow
def test_no_modules_import_each_other_in_a_circle() -> None:
    """Checked for all modules; a package's `__init__` may import its own modules."""
    graph = {}
    for path, tree in trees().items():
        name = f"pupper_analysis/{path}".removesuffix(".py").removesuffix("/__init__")
        graph[name.replace("/", ".")] = set(list_imports(tree))
    for name, imported in graph.items():
        imported.intersection_update(graph)
        imported -= {module for module in imported if f"{name}.".startswith(f"{module}.")}
    graphlib.TopologicalSorter(graph).prepare()


@pytest.mark.slow
def test_number_of_packages_and_imports_is_bounded() -> None:
    graph = drawing.folder_graph()
    assert len(graph) <= 11
    assert sum(map(len, graph.values())) <= 70
    loose = {path.name for path in drawing.PACKAGE.glob("*.py")}
    assert loose == {"__init__.py", "__main__.py"}
    assert set(graph) == set(LAYERS)
    for folder, below in graph.items():
        assert all(LAYERS[dependency] < LAYERS[folder] for dependency in below), folder


def test_modules_contain_no_banners() -> None:
    """Lines of dashes that divide a module: it is short enough without."""
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert not re.findall(r"^ *# ?[-=#*]{4,}.*", text, re.MULTILINE), path


@pytest.mark.slow
def test_tools_import_each_other_rarely_and_without_cycles() -> None:
    graph = drawing.tool_graph()
    assert sum(map(len, graph.values())) <= 12
    graphlib.TopologicalSorter(graph).prepare()


@pytest.mark.slow
def test_commands_are_defined_in_the_command_modules_of_tools_only() -> None:
    """Reference: the decorator `shared.command` in the source code, and the discovered tools."""
    found = {
        path
        for path, tree in trees().items()
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
        and any("shared.command(" in ast.unparse(decorator) for decorator in node.decorator_list)
    }
    assert found == {f"tools/{name}/command.py" for name in own_tools()}
    with_format = {path.parent.name for path in drawing.PACKAGE.glob("tools/*/format.toml")}
    assert set(own_packages()) - with_format == set(own_tools())
