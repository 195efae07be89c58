"""Idioms of our own stay out of what others read; CONTRIBUTING.md lists what to write."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest

from pupper_analysis import cli
from tests.support.repository import ROOT

PACKAGE = ROOT / "pupper_analysis"
SECTION = (ROOT / "CONTRIBUTING.md").read_text().partition("\n## Words\n")[2].partition("\n## ")[0]
IDIOMS = dict(re.findall(r"^\| ([a-z' ]+?) \| (.+) \|$", SECTION, re.M)[1:])


def found(text: str) -> list[str]:
    """The idioms in a text, whose lines may be wrapped."""
    plain = " ".join(re.sub(r"```.*?```|`[^`]*`", "", text, flags=re.S).split()).lower()
    return [idiom for idiom in IDIOMS if re.search(rf"(?<![\w-]){idiom}(?![\w-])", plain)]


def english(stated: Any) -> Iterator[str]:
    """The English of a catalogue."""
    if isinstance(stated, dict):
        for key, value in stated.items():
            if key == "en":
                yield from value.values() if isinstance(value, dict) else [str(value)]
            elif key != "zh":
                yield from english(value)


PAGES = [
    page
    for page in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md"))
    if not {"generated", "decisions", "zh"} & set(page.parts) and page.name != "CHANGELOG.md"
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_pages_have_none(page: Path) -> None:
    text = page.read_text()
    assert found(text.replace(SECTION, "")) == []


def test_catalogues_have_none() -> None:
    wrong = [
        (file.name, found(text), text)
        for file in PACKAGE.rglob("*.toml")
        for text in english(tomllib.loads(file.read_text("utf-8")))
        if found(text)
    ]
    assert wrong == []


def test_help_has_none() -> None:
    for name, command in {"": cli.group, **{n: cli.find_command(n) for n in cli.COMMANDS}}.items():
        options = [one.help or "" for one in command.params if isinstance(one, click.Option)]
        for text in (command.help or "", *options):
            assert found(text) == [], (name, text)


def test_docstrings_have_none() -> None:
    kinds = ast.FunctionDef | ast.ClassDef | ast.Module
    wrong = [
        (file.name, found(text), text)
        for file in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, kinds) and found(text := ast.get_docstring(node) or "")
    ]
    assert wrong == []
