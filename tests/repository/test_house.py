"""Rooms one can live in: no module that does not fit one subject, no function that fits no screen.

``test_layers`` keeps the rooms apart; this keeps them small.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import pupper_analysis

PACKAGE = Path(pupper_analysis.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))

MOST_LINES = 400
"""Of a module, with its docstrings."""

MOST_BODY_LINES = 60
"""Lines of a function's body, without its docstring: what a screen shows."""

FUNCTIONS = ast.FunctionDef | ast.AsyncFunctionDef


def name(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def body_lines(function: FUNCTIONS) -> int:
    first, *rest = function.body
    if ast.get_docstring(function) is not None:
        if not rest:
            return 0
        first = rest[0]
    end = function.end_lineno
    assert end is not None
    return end - first.lineno + 1


def long_functions(text: str) -> list[str]:
    return [
        node.name
        for node in ast.walk(ast.parse(text))
        if isinstance(node, FUNCTIONS) and body_lines(node) > MOST_BODY_LINES
    ]


@pytest.mark.parametrize("path", MODULES, ids=name)
def test_a_module_has_one_subject(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= MOST_LINES


@pytest.mark.parametrize("path", MODULES, ids=name)
def test_a_function_fits_a_screen(path: Path) -> None:
    assert long_functions(path.read_text()) == []


@pytest.mark.parametrize("path", MODULES, ids=name)
def test_no_banner_stands_where_a_file_is_missing(path: Path) -> None:
    assert not re.findall(r"^ *# ?[-=#*]{4,}.*", path.read_text(), re.MULTILINE)


def test_docstrings_do_not_count_and_bodies_do() -> None:
    """What is counted: 61 lines of body are too many, 60 are not, however long the docstring."""
    docstring = '    """' + "\n" * 80 + '    """\n'
    for lines, expected in ((MOST_BODY_LINES, []), (MOST_BODY_LINES + 1, ["long"])):
        body = "    x = 0\n" * lines
        assert long_functions(f"def long():\n{docstring}{body}") == expected
        assert long_functions(f"def long():\n{body}") == expected
