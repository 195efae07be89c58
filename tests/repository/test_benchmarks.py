"""Benchmarks run with exact results, and their tables contain the measured values."""

from __future__ import annotations

import ast
import csv
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import click
import numpy as np
import orjson
import pytest
from click.testing import CliRunner

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Severity
from tests.support.repository import ROOT, benchmark
from tests.support.variants import load, stand_of

sys.path.append(str(ROOT / "benchmarks"))  # where its modules find each other

import measure
import published
import ratios
import run as benchmarks
import whole


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


def test_commands_of_benchmarks_accept_the_names_of_their_parameters() -> None:
    """Most commands are run by no test, so a parameter of another name would not be noticed."""
    tried = 0
    for path in sorted((ROOT / "benchmarks").glob("*.py")):
        if "import click" not in path.read_text():
            continue
        for top in {id(value): value for value in vars(benchmark(path.stem)).values()}.values():
            for command in [top, *getattr(top, "commands", {}).values()]:
                if not isinstance(command, click.Command) or command.callback is None:
                    continue
                accepted = inspect.signature(command.callback).parameters
                given = {param.name for param in command.params if param.expose_value}
                assert given == set(accepted), f"{path.name}: {command.name}"
                tried += 1
    assert tried > 20


def test_notes_of_audit_are_no_mistakes_found_by_a_checker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An audit with one finding of each severity."""
    findings = [
        SimpleNamespace(rule=severity, element="leg", severity=severity) for severity in Severity
    ]
    audit = SimpleNamespace(findings=findings, counts=dict.fromkeys(Severity, 1))
    monkeypatch.setattr(pa, "audit_model", lambda *_, **__: audit)
    found = benchmark("checkers").run_audit(tmp_path, tmp_path, tmp_path)
    assert found == {"error leg": 1, "warning leg": 1}
    result: dict[str, object] = {}
    benchmark("one_slip").add_audit(result, tmp_path)
    assert result["rules"] == ["error", "warning"]


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


@pytest.mark.slow
def test_simulated_steps_are_counted_in_loops_and_rollouts() -> None:
    """Reference: the steps that the program itself requests."""
    program = """
import numpy as np
model = mujoco.MjModel.from_xml_string("<mujoco/>")
data = mujoco.MjData(model)
mujoco.mj_step(model, data)
mujoco.mj_step(model, data, nstep=6)
with mujoco.rollout.Rollout(nthread=0) as pool:
    pool.rollout([model] * 2, data, np.zeros((2, 1)), nstep=5)
"""
    assert published.measure_process(published._COUNT_STEPS + program).output == "17"


def test_measured_rows_replace_those_of_the_same_robot_and_command() -> None:
    """The exponent of stands with 10 and 20 joints, 2 s and 8 s, is log2(8 / 2) = 2."""
    known = [
        ("A", "10", "stand", "3 s", "9 MB", "5", "old"),
        ("A", "10", "push", "4 s", "9 MB", "6", "old"),
        ("B", "20", "stand", "8 s", "9 MB", "7", "old"),
        ("all", "", "stand: exponent of the joints", "1.00", "", "", "old"),
    ]
    measured = [
        ("A", "10", "payload", "6 s", "9 MB", "8", "new"),
        ("A", "10", "stand", "2 s", "9 MB", "5", "new"),
    ]
    assert published.merge_rows(known, measured, "new") == [
        measured[1],
        known[1],
        measured[0],
        known[2],
        ("all", "", "stand: exponent of the joints", "2.00", "", "", "new"),
    ]


def make_job(name: str, error: float = 0.0) -> measure.Job:
    """Return a job with an engine, whose result has an error [m] with the limit 1e-9 m."""
    return measure.Job(
        name,
        lambda: None,
        lambda: measure.Accuracy(error, 1e-9, "m"),
        measure.Rival("an engine", lambda: None),
    )


@pytest.mark.parametrize(("error", "exact"), [(1e-10, True), (1e-8, False), (float("nan"), False)])
def test_result_is_exact_up_to_the_limit_of_its_error(error: float, exact: bool) -> None:
    assert measure.measure_job(make_job("a job", error), 1, 0.0).exact is exact


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
def test_processors_of_one_product_line_are_a_family(processor: str, family: str) -> None:
    assert ratios.processor_family(processor) == family


def test_ratio_without_a_record_of_a_family_is_the_largest_of_all(tmp_path: Path) -> None:
    """Also after the record is written to a table and read again."""
    record = {"one": {"stand": 1.25, "load": 1.5}, "other": {"stand": 1.75}}
    header, *rows = ratios.make_record_table(record)
    assert (header, rows[1]) == (("job", "one", "other"), ("load", "1.5", "-"))
    benchmarks.write_tables(tmp_path, {"Ratios": [header, *rows]})
    assert ratios.read_recorded(tmp_path) == record
    assert ratios.expected_ratios(record, "other") == {"stand": 1.75, "load": 1.5}
    assert ratios.expected_ratios(record, "a third") == {"stand": 1.75, "load": 1.5}


@pytest.mark.parametrize(
    ("measured", "kept", "count"),
    [([1.9], True, 1), ([2.6, 2.3], True, 2), ([2.6, 2.5, 2.7], False, 3)],
    ids=["first", "second", "none"],
)
def test_ratio_is_kept_if_one_of_three_measurements_is_permitted(
    measured: list[float], kept: bool, count: int
) -> None:
    """The recorded ratio is 2, so 2.4 is permitted; a job without a record is not measured."""
    left = list(measured)
    jobs = [make_job("stand"), make_job("new")]
    (found,) = ratios.compare_ratios(
        jobs, {"stand": 2.0}, lambda _: left.pop(0), lambda _: ({}, {}), lambda _: None
    )
    assert (found.job, found.is_kept, found.now) == ("stand", kept, min(measured))
    assert len(measured) - len(left) == count


def test_ratio_of_1_3_times_the_recorded_one_fails_by_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recorded state is as fast as recorded."""
    record = ratios.read_recorded(ROOT / "docs/data")
    name, recorded = next(iter(record.items()))
    assert len(recorded) >= 9
    slow = "solve_stand"
    monkeypatch.setattr(benchmarks, "processor_name", lambda: f"{name} 7R13 48-Core Processor")
    monkeypatch.setattr(benchmarks.bare, "jobs", lambda _: list(map(make_job, recorded)))
    monkeypatch.setattr(ratios, "PAUSE", 0.0)
    for factor in (1.1, 1.3):
        times = recorded | {slow: factor * recorded[slow]}
        monkeypatch.setattr(ratios, "measure_ratio", lambda job, times=times: times[job.name])
        monkeypatch.setattr(
            ratios,
            "measure_both",
            lambda _root, _record, _variant, names, times=times: (
                {name: times[name] for name in names},
                {name: recorded[name] for name in names},
            ),
        )
        assert benchmarks.check_ratios("v3") is (factor < ratios.MAX_SLOWDOWN)
        errors = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
        assert [line.split(":")[1].strip() for line in errors] == [slow] * (factor > 1.2)


def test_tables_have_the_names_of_the_recorded_files(tmp_path: Path) -> None:
    titles = ("Calls: medians by turns, of v3", "Start-up", "Where the time of a call goes")
    titles += ("Default run: stages, 6 variants", "How time grows", "Ratios", "setting")
    benchmarks.write_tables(tmp_path, {title: [("what", "value")] for title in titles})
    recorded = {path.name for path in (ROOT / "docs/data").glob("benchmarks-*.csv")}
    assert {path.name for path in tmp_path.iterdir()} == recorded - {
        "benchmarks-published-robots.csv"
    }


def test_foot_of_the_grid_search_has_the_position_of_pinocchio() -> None:
    """Reference: Pinocchio's foot and hip positions [m] at the found joint angles."""
    robot, stand = load("original"), stand_of("original")
    thigh, calf = whole.measure_leg_lengths(robot)
    assert thigh is not None
    assert calf is not None
    height = 0.9 * (thigh + calf)
    hip, knee, x, z = whole.search_grid(thigh, calf, height)
    assert max(abs(x), abs(z)) < 2 * whole.STEP * (thigh + calf)
    joints = stand.joint_positions(robot).copy()
    names = list(robot.joint_names)
    joints[names.index("FL_HAA")] = 0.0
    joints[names.index("FL_HFE")], joints[names.index("FL_KFE")] = hip, knee
    config = pa.Configuration(robot, robot.make_qpos(joints))
    place = config.foot_positions()["FL"] - config.joint_position("FL_HFE")
    np.testing.assert_allclose(place[[0, 2]], (x, z - height), atol=1e-12)


def test_robots_with_unchanged_files_are_not_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The row of a removed robot is made again; a robot with another file as well."""
    robots = benchmark("robots")
    made = []

    def make_row(name: str, files: object, shown: str, digest: str) -> tuple[str, ...]:
        made.append(name)
        return (name, shown, *[""] * (len(robots.COLUMNS) - 3), digest)

    files = {name: tmp_path / f"{name}.urdf" for name in ("a1", "go2")}
    for name, file in files.items():
        file.write_text(name)
    table = tmp_path / "robots.csv"
    table.write_text(",".join(robots.COLUMNS) + "\n")
    monkeypatch.setattr(robots, "make_row", make_row)
    monkeypatch.setattr(robots, "list_robots", lambda _: [(n, (f,)) for n, f in files.items()])

    def run() -> str:
        made.clear()
        done = CliRunner().invoke(robots.main, [str(tmp_path), "--csv", str(table)])
        assert done.exit_code == 0, done.output
        return done.output

    assert run().endswith("2 robots, 2 rows changed\n")
    assert run() == "2 robots, 0 rows changed\n"
    table.write_text("".join(x for x in table.read_text().splitlines(True) if "go2" not in x))
    assert run().endswith("2 robots, 1 rows changed\n")
    assert made == ["go2"]
    files["a1"].write_text("another file")
    run()
    assert made == ["a1"]
