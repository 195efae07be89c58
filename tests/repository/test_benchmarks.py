"""The benchmarks run, their answers are exact, and their tables say what was measured."""

from __future__ import annotations

import ast
import csv
import importlib
import subprocess
import sys
from pathlib import Path

import orjson
import pytest

from tests.support.repository import ROOT

sys.path.append(str(ROOT / "benchmarks"))  # where its modules find each other

import run as benchmarks


@pytest.mark.slow
def test_the_quick_setting_runs_and_writes(tmp_path: Path) -> None:
    """Exit status 1 if a result is inexact; times are not tested."""
    written = tmp_path / "found.json"
    arguments = ["--quick", "--json", str(written), "--tables", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, ROOT / "benchmarks" / "run.py", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    found = orjson.loads(written.read_bytes())
    assert found["setting"]["versions"]["mujoco"].startswith("4.")
    assert all(row["exact"] and row["ours"] > 0 and row["calls"] for row in found["jobs"])
    with (tmp_path / "benchmarks-calls.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == list(benchmarks.TABLE)
    assert [row[0] for row in rows] == [row["name"] for row in found["jobs"]]
    setting = (tmp_path / "benchmarks-setting.csv").read_text()
    assert f"\nmujoco,{found['setting']['versions']['mujoco']}\n" in setting


@pytest.mark.parametrize("folder", ["benchmarks", "docs", "examples", "scripts"])
def test_names_that_benchmarks_import_exist(folder: str) -> None:
    """Most benchmarks are run by no test, so an import of a removed name would not be noticed."""
    wanted = {
        (node.module, alias.name)
        for file in (ROOT / folder).rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pupper_analysis")
        for alias in node.names
    }
    for module, name in sorted(wanted):
        if not hasattr(importlib.import_module(module), name):
            importlib.import_module(f"{module}.{name}")
