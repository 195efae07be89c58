"""Benchmarks run with exact results, and their tables contain the measured values."""

from __future__ import annotations

import ast
import csv
import importlib
import re
import subprocess
import sys
from pathlib import Path

import orjson
import pytest

from tests.support.repository import ROOT

sys.path.append(str(ROOT / "benchmarks"))  # where its modules find each other

import published
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


def test_published_robots_are_found_and_processes_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: memory that a process allocates and writes."""
    monkeypatch.setenv("PUPPER_ROBOTS", str(tmp_path))
    file = tmp_path / published.ROBOTS["Go2"]
    file.parent.mkdir(parents=True)
    file.touch()
    assert published.find_robots()["Go2"] == str(file)
    assert published.find_robots()["v3"] == "v3"
    small, large = (published.measure_process(f"print(len(b'x' * {size}))") for size in (1, 10**8))
    assert large.output == "100000000"
    assert 90 < large.megabytes - small.megabytes < 110
    assert 0 < small.seconds < 10
    with pytest.raises(RuntimeError):
        published.measure_process("import sys; sys.exit(2)")
    processes = published._list_processes("Go2", str(file), tmp_path)
    assert {*published.COMMANDS, "load", "load, bare engine"} == set(processes)
    assert processes["payload"][1:] == ["payload", str(file)]
    assert re.fullmatch(r"([0-9a-f]{8,}\+?)?", published.find_commit())
