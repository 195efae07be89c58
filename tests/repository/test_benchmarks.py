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
from pupper_analysis.robot.joints import leg_lengths
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


def test_tables_have_the_names_that_the_site_knows(tmp_path: Path) -> None:
    titles = ("Calls: medians by turns, of v3", "Start-up", "Where the time of a call goes")
    titles += ("Default run: stages, 6 variants", "How time grows", "Ratios", "setting")
    benchmarks.write_tables(tmp_path, {title: [("what", "value")] for title in titles})
    site = {path.name for path in (ROOT / "docs/data").glob("benchmarks-*.csv")}
    assert {path.name for path in tmp_path.iterdir()} == site


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


@pytest.mark.parametrize(
    ("measured", "kept", "tries"),
    [([1.9], True, 1), ([2.6, 2.3], True, 2), ([2.6, 2.7, 2.5], False, 3)],
    ids=["at once", "at the second try", "never"],
)
def test_a_ratio_is_kept_if_one_of_three_tries_is_near_the_recorded_one(
    measured: list[float], kept: bool, tries: int
) -> None:
    """Of 2 recorded, 2.4 is the most; what is not recorded is not measured."""
    left = list(measured)
    jobs = [_job("stand"), _job("new")]
    (found,) = ratios.compare(jobs, {"stand": 2.0}, lambda _: left.pop(0))
    assert (found.job, found.kept, found.now) == ("stand", kept, min(measured))
    assert len(measured) - len(left) == tries


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


@pytest.mark.parametrize(
    ("processor", "family"),
    [
        ("Intel(R) Xeon(R) Processor", "Intel Xeon"),
        ("Intel(R) Xeon(R) CPU E5-2686 v4 @ 2.30GHz", "Intel Xeon"),
        ("12th Gen Intel(R) Core(TM) i7-12700K", "Intel Core"),
        ("AMD EPYC", "AMD EPYC"),
        ("AMD EPYC 7763 64-Core Processor", "AMD EPYC"),
        ("AMD Ryzen 9 5950X 16-Core Processor", "AMD Ryzen"),
    ],
)
def test_processors_of_one_line_are_a_family(processor: str, family: str) -> None:
    assert ratios.family(processor) == family


def test_a_job_without_a_record_of_a_family_has_the_largest_of_all(tmp_path: Path) -> None:
    record = {"one": {"stand": 1.25, "load": 1.5}, "other": {"stand": 1.75}}
    header, *rows = ratios.record_rows(record)
    benchmarks.write_tables(tmp_path, {"Ratios": [header, *rows]})
    assert (header, rows[1]) == (("job", "one", "other"), ("load", "1.5", "-"))
    assert ratios.read_recorded(tmp_path) == record
    assert ratios.expected(record, "other") == {"stand": 1.75, "load": 1.5}
    assert ratios.expected(record, "a third") == {"stand": 1.75, "load": 1.5}
