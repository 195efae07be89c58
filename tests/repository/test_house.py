"""Rooms one can live in: no module that does not fit one subject, no function that fits no screen.

import-linter keeps the rooms apart (`make lint`); this keeps them small, and free of circles.
"""

from __future__ import annotations

import ast
import graphlib
import re
from collections.abc import Iterator

from tests.support.rooms import PACKAGE, trees

MOST_LINES = 400
"""Of a module, with its docstrings."""

MOST_BODY_LINES = 60
"""Lines of a function's body, without its docstring: what a screen shows."""

FUNCTIONS = ast.FunctionDef | ast.AsyncFunctionDef


def body_lines(function: FUNCTIONS) -> int:
    first, *rest = function.body
    if ast.get_docstring(function) is not None:
        if not rest:
            return 0
        first = rest[0]
    end = function.end_lineno
    assert end is not None
    return end - first.lineno + 1


def long_functions(tree: ast.Module) -> list[str]:
    return [
        node.name
        for node in ast.walk(tree)
        if isinstance(node, FUNCTIONS) and body_lines(node) > MOST_BODY_LINES
    ]


def test_modules_have_one_subject_and_need_no_banners() -> None:
    for path in trees():
        text = (PACKAGE / path).read_text(encoding="utf-8")
        assert len(text.splitlines()) <= MOST_LINES, path
        assert not re.findall(r"^ *# ?[-=#*]{4,}.*", text, re.MULTILINE), path


def test_functions_fit_a_screen() -> None:
    found = {path: long for path, tree in trees().items() if (long := long_functions(tree))}
    assert found == {}


def test_docstrings_do_not_count_and_bodies_do() -> None:
    """What is counted: 61 lines of body are too many, 60 are not, however long the docstring."""
    docstring = '    """' + "\n" * 80 + '    """\n'
    for lines, expected in ((MOST_BODY_LINES, []), (MOST_BODY_LINES + 1, ["long"])):
        body = "    x = 0\n" * lines
        assert long_functions(ast.parse(f"def long():\n{docstring}{body}")) == expected
        assert long_functions(ast.parse(f"def long():\n{body}")) == expected


def imported(tree: ast.Module) -> Iterator[str]:
    """The package's modules that a module imports when it is itself imported."""
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Of one room, too; a package's own `__init__` may import what is in it."""
    graph = {}
    for path, tree in trees().items():
        name = f"pupper_analysis/{path}".removesuffix(".py").removesuffix("/__init__")
        graph[name.replace("/", ".")] = set(imported(tree))
    for name, those in graph.items():
        those.intersection_update(graph)
        those -= {one for one in those if f"{name}.".startswith(f"{one}.")}
    graphlib.TopologicalSorter(graph).prepare()
