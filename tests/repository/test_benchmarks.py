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

import pupper_analysis as pa
from pupper_analysis.tools.analyze.analysis import leg_lengths
from tests.support.repository import ROOT
from tests.support.variants import load, stand_of

sys.path.append(str(ROOT / "benchmarks"))  # where its modules find each other

import measure
import ratios
import run as benchmarks
import whole


def test_the_quick_setting_runs_and_writes(tmp_path: Path) -> None:
    """It ends with 1 where an answer is not exact; times are not looked at."""
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
def test_what_is_imported_of_ours_exists(folder: str) -> None:
    """Most benchmarks run in no test: what left the package would be missed by nobody."""
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


def job(value: float) -> measure.Job:
    return measure.Job(
        "a job",
        lambda: None,
        lambda: measure.Accuracy(value, 1e-9, "m"),
        measure.Rival("an engine", lambda: None),
        goal=2.0,
        peers=(measure.Rival("a peer", lambda: None, lambda: measure.Accuracy(3.0, 4.0, "N")),),
    )


def test_what_is_not_exact_is_noticed() -> None:
    assert measure.measured(job(1e-10), 1, 0.0).exact
    assert not measure.measured(job(1e-8), 1, 0.0).exact
    assert not measure.measured(job(float("nan")), 1, 0.0).exact


def test_the_tutorials_grid_misses_by_what_it_says() -> None:
    """By Pinocchio: the foot of a leg so bent is where the grid search has it."""
    robot, stand = load("original"), stand_of("original")
    thigh, calf = leg_lengths(robot)
    height = 0.9 * (thigh + calf)
    hip, knee, x, z = whole.grid_pose(thigh, calf, height)
    assert max(abs(x), abs(z)) < 2 * whole.STEP * (thigh + calf)
    joints = stand.joint_positions(robot).copy()
    names = list(robot.joint_names)
    joints[names.index("FL_HAA")] = 0.0
    joints[names.index("FL_HFE")], joints[names.index("FL_KFE")] = hip, knee
    config = pa.Configuration(robot, robot.posed(joints))
    place = config.foot_positions()["FL"] - config.joint_position("FL_HFE")
    assert place[0] == pytest.approx(x, abs=1e-12)
    assert place[2] == pytest.approx(z - height, abs=1e-12)


def _job(name: str) -> measure.Job:
    return measure.Job(name, int, lambda: measure.Accuracy(0.0, 1.0, ""), measure.Rival("", int))


def test_a_ratio_1_3_times_the_recorded_one_fails_and_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record = ratios.read_recorded(ROOT / "docs/data")
    name, recorded = next(iter(record.items()))
    assert len(recorded) >= 9
    monkeypatch.setattr(benchmarks, "processor", lambda: f"{name} 7R13 48-Core Processor")
    monkeypatch.setattr(benchmarks.bare, "jobs", lambda _: list(map(_job, recorded)))
    slow = "solve_stand"
    for factor in (1.1, 1.3):
        times = recorded | {slow: factor * recorded[slow]}
        monkeypatch.setattr(ratios, "measure_ratio", lambda job, times=times: times[job.name])
        assert benchmarks.check_ratios("v3") == (factor < ratios.SLOWER)
        errors = capsys.readouterr().err.splitlines()
        assert [line.split(":")[1].strip() for line in errors] == [slow] * (factor > 1.2)
