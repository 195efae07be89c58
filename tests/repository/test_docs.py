"""The docs name what is there: links, rooms, modules, and the homes of the glossary's words."""

from __future__ import annotations

import ast
import importlib
import os
import re
import subprocess
from pathlib import Path

import pytest

from tests.support.repository import ROOT
from tests.support.rooms import FLOOR

PACKAGE = ROOT / "pupper_analysis"
PAGES = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").glob("*.md")]
)
IDS = [str(page.relative_to(ROOT)) for page in PAGES]
TOPS = [room for room, floor in FLOOR.items() if floor == 0]


def rows(page: str) -> list[list[str]]:
    """The rows of a page's tables, without their headers; a cell may hold an escaped bar."""
    lines = [line for line in (ROOT / page).read_text().splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    rules = [index for index, row in enumerate(cells) if set(row) == {"---"}]
    return [row for index, row in enumerate(cells) if not {index, index + 1} & set(rules)]


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(((?!https?:)[^)#\s]+)[^)]*\)", page.read_text()):
        assert (page.parent / link).exists(), link


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_named_modules_are_there(page: Path) -> None:
    """Of this package, as a path (``robot/feet.py``, ``stance/sag/``) or with dots."""
    named = re.findall(r"`([a-z_]+/[a-z_/]*(?:\.py)?)`", page.read_text())
    for path in named:
        room = path.split("/")[0]
        if room in FLOOR:
            assert (PACKAGE / path).exists(), path
        else:  # of the repository, or made by a command of the Makefile
            assert (ROOT / path).exists() or f"{room}/" in (ROOT / ".gitignore").read_text(), path
    dotted = re.findall(r"`pupper_analysis\.([a-z_.]+)`", page.read_text())
    for name in dotted:
        importlib.import_module(f"pupper_analysis.{name}")


def test_modules_named_in_docstrings_are_there() -> None:
    for path in PACKAGE.rglob("*.py"):
        for name in re.findall(r"``pupper_analysis\.([a-z_.]+)``", path.read_text()):
            importlib.import_module(f"pupper_analysis.{name}")


def test_every_room_is_described_in_the_architecture() -> None:
    described = [row[0] for row in rows("docs/architecture.md") if len(row) == 4]
    rooms = [f"`{room}/`" for room in FLOOR if room not in TOPS]
    assert sorted(described) == sorted(["the package's top", *rooms])
    assert all(f"`{top}`" in (ROOT / "docs/architecture.md").read_text() for top in TOPS)


def test_every_room_has_an_answer_to_where_a_new_thing_goes() -> None:
    places = " ".join(row[1] for row in rows("docs/architecture.md") if len(row) == 2)
    asked = {room for room in FLOOR if re.search(rf"`{room}/", places)}
    # What is found out about one robot is put together in analysis: nothing new begins there.
    assert asked == set(FLOOR) - set(TOPS) - {"analysis"}


GLOSSARY = [row for row in rows("docs/glossary.md") if len(row) == 4]


def test_the_glossary_has_one_entry_per_word() -> None:
    words = [row[0].lower() for row in GLOSSARY]
    assert len(words) > 50
    assert len(set(words)) == len(words)


@pytest.mark.parametrize("row", GLOSSARY, ids=[row[0] for row in GLOSSARY])
def test_a_word_is_used_in_its_home(row: list[str]) -> None:
    """In its docstrings or names, or its own, with blanks, hyphens or underscores."""
    home = re.fullmatch(r"`([a-z_/]+\.py)`", row[2])
    assert home is not None, row[2]
    text = re.sub(r"[\s_\-\"]+", " ", home[1] + (PACKAGE / home[1]).read_text()).lower()
    joined = text.replace(" ", "")
    for word in row[0].lower().split(", "):
        plain = re.sub(r"[\s\-]+", " ", word)
        assert plain in text or plain.replace(" ", "") in joined, f"{word!r} is not in {home[1]}"


def test_decisions_are_listed_and_have_the_same_parts() -> None:
    folder = ROOT / "docs" / "decisions"
    records = sorted(path.name for path in folder.glob("0*.md"))
    listed = re.findall(r"^\d+\. \[[^]]+\]\(([^)]+)\)$", (folder / "README.md").read_text(), re.M)
    assert listed == records
    for number, name in enumerate(records, 1):
        text = (folder / name).read_text()
        assert text.startswith(f"# {number}. ")
        for part in ("Context", "Decision", "Consequences"):
            assert f"**{part}.**" in text, f"{name}: {part}"


def test_contributing_names_targets_that_are_there() -> None:
    targets = set(re.findall(r"^([a-z-]+):.*## ", (ROOT / "Makefile").read_text(), re.M))
    named = set(re.findall(r"`make ([a-z-]+)`", (ROOT / "CONTRIBUTING.md").read_text()))
    assert named <= targets
    assert {"setup", "test", "lint", "types", "docs", "coverage"} <= named


def test_the_workflow_runs_what_ci_runs() -> None:
    """Both call the Makefile's targets.

    The lowest versions and the longest proofs are for the workflow alone; the quick benchmark is
    one of the tests in the other.
    """
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    script = (ROOT / ".ci" / "run").read_text()
    targets = set(re.findall(r"^([a-z-]+):.*## ", (ROOT / "Makefile").read_text(), re.M))
    called = set(re.findall(r"\bmake ((?:[a-z-]+ ?)+)", script))
    ours = {word for words in called for word in words.split()} & targets
    theirs = {
        word for words in re.findall(r"run: make (.+)$", workflow, re.M) for word in words.split()
    } & targets
    assert {"test", "lint", "types", "docs"} <= theirs
    assert theirs == ours - {"setup", "test-slow"} | {
        "test-lowest",
        "test-longest",
        "benchmark-quick",
    }
    assert ".ci/run" in workflow


def test_hooks_are_the_projects_own_tools() -> None:
    text = (ROOT / ".pre-commit-config.yaml").read_text()
    assert re.findall(r"repo: (\S+)", text) == ["local"]
    entries = [entry.split()[:2] for entry in re.findall(r"entry: (.+)$", text, re.M)]
    assert {runner for runner, _ in entries} == {".ci/tool"}
    assert {tool for _, tool in entries} == {"ruff", "mypy", "lint-imports"}


def test_hooks_find_their_tools_in_an_environment_of_any_name(tmp_path: Path) -> None:
    """The active one, then that from which pre-commit was installed, then .venv."""
    tool, folder = str(ROOT / ".ci" / "tool"), tmp_path / "checkout"
    for name in ("active", "installed", "checkout/.venv"):
        program = tmp_path / name / "bin" / "ruff"
        program.parent.mkdir(parents=True)
        program.write_text(f"#!/bin/sh\necho {name} $*\n")
        program.chmod(0o755)
    clean = {key: os.environ[key] for key in ("PATH", "HOME") if key in os.environ}

    def said(**environment: str) -> str:
        run = subprocess.run(
            [tool, "ruff", "check"],
            cwd=folder,
            env=clean | environment,
            capture_output=True,
            text=True,
            check=True,
        )
        return run.stdout.strip()

    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)
    assert said() == "checkout/.venv check"
    hook = folder / ".git" / "hooks" / "pre-commit"
    hook.parent.mkdir(exist_ok=True)
    hook.write_text(f"#!/usr/bin/env bash\nINSTALL_PYTHON={tmp_path}/installed/bin/python\n")
    assert said() == "installed check"
    assert said(VIRTUAL_ENV=str(tmp_path / "active")) == "active check"
    with pytest.raises(subprocess.CalledProcessError) as failed:
        subprocess.run([tool, "no-such"], env=clean, capture_output=True, text=True, check=True)
    assert "make lint" in failed.value.stderr


def test_examples_and_scripts_are_documented() -> None:
    for folder in ("examples", "scripts"):
        for path in (ROOT / folder).glob("*.py"):
            assert ast.get_docstring(ast.parse(path.read_text())), path
