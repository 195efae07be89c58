"""A tool is removed by deleting its folders: the remaining package works."""

from __future__ import annotations

import ast
import compileall
import json
import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

from pupper_analysis.base.tools import HELP_HEADINGS, own_packages, own_tools
from tests.support.patience import PATIENCE
from tests.support.repository import ROOT

QUICK = (
    "tests/base/test_arrays.py",
    "tests/robot/test_contact.py",
    "tests/statics/test_support_polygon.py",
    "tests/prepare/test_own_run.py",
    "tests/repository/test_architecture.py",
)
"""Quick tests of the core that use no tool."""

ALONE = ("best", "hold", "path", "payload", "sync")
"""Tools that no test of another tool imports: without them all other tests are collected."""

ALSO = ("diff", "workspace", "crosscheck", "audit")
"""Tools for quick tests after another tool is removed: the first two that remain."""


def known_to() -> dict[str, set[str]]:
    """Return {tool: tools that pyproject.toml allows it to import}."""
    text = (ROOT / "pyproject.toml").read_text()
    pairs = re.findall(
        r'"pupper_analysis\.tools\.(\w+)\.\*\* -> pupper_analysis\.tools\.(\w+)\.', text
    )
    found: dict[str, set[str]] = {name: set() for name in own_packages()}
    for first, second in pairs:
        found[first].add(second)
    return found


def dependents(tools: Iterable[str]) -> set[str]:
    """Return tools, and the tools that are allowed to import them."""
    known, gone = known_to(), set(tools)
    while more := {one for one, others in known.items() if others & gone} - gone:
        gone |= more
    return gone


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy of the checkout with the bytecode of the package, from which all copies are linked."""
    left_out = shutil.ignore_patterns(".git", ".venv*", "build", ".*_cache", "docs")
    copy = tmp_path_factory.mktemp("complete") / "checkout"
    shutil.copytree(ROOT, copy, ignore=left_out)
    shutil.copytree(ROOT / "docs/how-to", copy / "docs/how-to")  # of which tests take examples
    shutil.copytree(ROOT / "docs/data", copy / "docs/data")  # tables that are tests
    shutil.copy(ROOT / "docs/draw_architecture.py", copy / "docs")  # computes the imports
    assert compileall.compile_dir(copy / "pupper_analysis", quiet=1)
    return copy


def copy_without(tools: Iterable[str], checkout: Path, folder: Path) -> Path:
    """Link the files of a checkout, except some tools and their dependents; return the folder."""
    copy = folder / "checkout"
    shutil.copytree(checkout, copy, copy_function=os.link)
    for importer in dependents(tools):
        shutil.rmtree(copy / "pupper_analysis/tools" / importer)
        shutil.rmtree(copy / "tests/tools" / importer, ignore_errors=True)
    return copy


def run_in_copy(copy: Path, *words: str) -> str:
    """Run Python in a copy of the checkout, assert its success, and return the printed text."""
    done = subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        cwd=copy,
        env={**os.environ, "PYTHONPATH": str(copy)},
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


FORKING = """
import json, os, runpy, sys, traceback
import clarabel, lxml.etree, matplotlib.figure, mujoco.rollout, pinocchio, placo, rich.progress
import scipy.optimize, scipy.signal

assert not any(name.startswith(("pupper_analysis", "tests")) for name in sys.modules)
for line in sys.stdin:
    copy, output = json.loads(line)
    if child := os.fork():
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
        continue
    status = 1
    try:
        file = os.open(output, os.O_WRONLY | os.O_CREAT)
        os.dup2(file, 1), os.dup2(file, 2)
        os.chdir(copy)
        sys.path.insert(0, copy)
        import pupper_analysis as pa
        print(pa.__file__)
        [getattr(pa, name) for name in pa.__all__]
        [getattr(module, name) for module in vars(pa).values() if hasattr(module, "__all__")
         for name in module.__all__ if module.__name__.startswith("pupper_analysis.")]
        sys.argv = ["pupper-analysis", "--help"]
        runpy.run_module("pupper_analysis", run_name="__main__")
        status = 0
    except SystemExit as leaving:
        status = leaving.code or 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
"""
"""Program that imports each public name of copies of the package, and prints the help.

For each copy a child process is forked before the package is imported. The libraries, whose import
takes most of the time, are imported once."""


@pytest.fixture(scope="module")
def import_copy() -> Iterator[Callable[[Path], str]]:
    """Return the function that imports a copy of the package, and returns the printed text."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", FORKING],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd="/",
        env=environment,
    )
    assert process.stdin is not None
    assert process.stdout is not None

    def import_in_child(copy: Path) -> str:
        output = copy.parent / "output.txt"
        print(json.dumps([str(copy), str(output)]), file=process.stdin, flush=True)
        status = process.stdout.readline().strip()  # type: ignore[union-attr]
        printed = output.read_text()
        assert status == "0", printed[-3000:]
        return printed

    yield import_in_child
    process.stdin.close()
    assert process.wait(PATIENCE) == 0
    process.stdout.close()


def check_imports(tool: str, copy: Path, printed: str) -> None:
    """Compare the commands that a copy without a tool lists with its folders."""
    assert str(copy) in printed
    left = {path.parent.name for path in (copy / "pupper_analysis/tools").glob("*/command.py")}
    listed = re.findall(r"^  (\w+)  +\S", printed.partition(f"{HELP_HEADINGS[0]}:")[2], re.M)
    assert set(listed) == left
    assert tool not in left
    assert len(left) > len(own_tools()) / 2


def run_tests(copy: Path) -> None:
    """Run quick tests of the core, and of two tools that are left, in a copy without a tool."""
    left = {path.parent.name for path in (copy / "pupper_analysis/tools").glob("*/command.py")}
    tools = [
        path.relative_to(copy).as_posix()
        for name in ALSO
        if name in left
        for path in sorted((copy / "tests/tools" / name).glob("test_*.py"))[:1]
    ]
    core = [path for path in QUICK if (copy / path).exists()]
    options = ("-n", "0", "-q", "-m", "not slow", "--maxfail", "3")
    run_in_copy(copy, "-m", "pytest", *options, *core, *tools[:2])


def test_core_names_no_package_without_command() -> None:
    for name in own_packages().keys() - own_tools().keys():
        for path in (ROOT / "pupper_analysis").rglob("*.*"):
            if path.suffix in (".py", ".toml", ".pyi") and "tools" not in path.parts:
                text = re.sub(r'"USD"|\[USD\]', "", path.read_text(encoding="utf-8"))  # a price
                assert not re.search(rf"\b{name}", text, re.I), path


@pytest.mark.slow
@pytest.mark.parametrize("tool", own_packages())
def test_the_package_is_imported_without_a_tool(
    tool: str, checkout: Path, import_copy: Callable[[Path], str], tmp_path: Path
) -> None:
    copy = copy_without((tool,), checkout, tmp_path)
    check_imports(tool, copy, import_copy(copy))


def list_imports(path: Path) -> list[str]:
    """List the names that the import statements of a file contain, in functions too."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


@cache
def imports_of_tests() -> dict[Path, list[str]]:
    """Return {test file: names that its import statements contain}."""
    return {path: list_imports(path) for path in sorted((ROOT / "tests").rglob("test_*.py"))}


@pytest.mark.parametrize("path", QUICK)
def test_quick_tests_of_the_core_import_no_tool(path: str) -> None:
    """Any tool may be the one that is deleted before these tests run in a copy."""
    tool = re.compile(r"(pupper_analysis|tests)\.tools\.")
    assert list(filter(tool.match, list_imports(ROOT / path))) == []


@pytest.mark.slow
@pytest.mark.parametrize("tool", ALONE)
def test_tests_of_other_tools_do_not_import_a_tool(tool: str) -> None:
    """Reference: the syntax trees. Tests of dependent tools are deleted with the tool."""
    gone = dependents((tool,))
    imported = re.compile(rf"(pupper_analysis|tests)\.tools\.({'|'.join(sorted(gone))})(\.|$)")
    assert [
        path
        for path, names in imports_of_tests().items()
        if not gone & set(path.parts) and any(map(imported.match, names))
    ] == []


@pytest.mark.slow
def test_all_other_tests_are_collected_without_five_tools(checkout: Path, tmp_path: Path) -> None:
    """The tools are deleted together: each collection takes 7 s."""
    copy = copy_without(ALONE, checkout, tmp_path)
    run_in_copy(copy, "-m", "pytest", "-n", "0", "--collect-only", "-q", "tests")


@pytest.mark.slow
def test_quick_tests_pass_without_a_tool_drawn_by_the_commit(
    checkout: Path, tmp_path: Path
) -> None:
    """Each commit draws another tool; the same commit draws the same tool."""
    head = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    tool = random.Random(head.stdout.strip()).choice(sorted(own_packages()))
    run_tests(copy_without((tool,), checkout, tmp_path))
