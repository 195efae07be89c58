"""Execution of studies: equal results on any executor, and no loss by failures, crashes, signals or
full disks.
"""

from __future__ import annotations

import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import OutputError
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.tools.study import running, store
from pupper_analysis.tools.study.design import DesignBuilder
from pupper_analysis.tools.study.running import Chunk, Progress
from tests.support import legged, study_metrics
from tests.support.commands import run_command
from tests.support.repository import ROOT
from tests.support.variants import load, stand_of

FEW = {"leg_scale": [1.2, 1.3], "slope": [0.0, 0.1], "kp": [0.2, 5.0, 20.0]}
METRICS = ("peak_utilisation", "base_height", "servo_sag", "stands")


def study(vary: Mapping[str, Any] = FEW, *metrics: Any, **options: Any) -> pa.Study:
    return pa.Study("v3", vary, metrics or METRICS, **options)


@pytest.fixture
def threads() -> Iterator[Executor]:
    with ThreadPoolExecutor(2) as executor:
        yield executor


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    with ThreadPoolExecutor(1) as executor:
        return study().run(tmp_path_factory.mktemp("undisturbed"), executor=executor)


# ----------------------------------------------------------------------------- the table


@pytest.mark.slow
def test_design_that_does_not_stand_has_zero_metrics_and_no_sag(
    threads: Executor, tmp_path: Path
) -> None:
    """v3 with legs of 1.4: a design stands, has no stable equilibrium, or is out of reach.

    A fallen robot has no static deflection.
    """
    metrics = ("stands", "verified", "sag", "stiffness", "peak_utilisation")
    vary = {"leg_scale": [1.4], "torso_mass_scale": [1.0, 1.75, 2.5], "height": [0.19, 0.9]}
    table = study(vary, *metrics).run(tmp_path, executor=threads).set_index(
        ["torso_mass_scale", "height"]
    )  # fmt: skip
    assert table["stands"].to_list() == [True, False, False, False, False, False]
    assert table["stands"].dtype == bool
    assert table["sag"].notna().to_list() == [True, False, False, False, False, False]
    assert table["failure"].isna().to_list() == [True, False, False, False, False, False]
    heavy = table.loc[(2.5, 0.19)]
    assert (heavy["failure"], heavy["failed_metric"]) == ("does not stay up", "stands")
    robot, stand = standing(1.4, 2.5, 0.19)
    pose = pa.steady_state(robot, solve_stand_as_simulated(robot, stand))
    assert heavy["reason"] == "; ".join(map(str, pose.failures))
    assert heavy["stiffness"] == pytest.approx(pose.stiffness, rel=1e-6)  # the exact value
    assert heavy["peak_utilisation"] > 0
    assert (table["verified"].xs(0.9, level="height") == 0).all()


def standing(legs: float, torso: float, height: float) -> tuple[pa.Robot, pa.Stand]:
    robot = pa.load_variant(pa.pupper.VariantSpec("v3", leg_scale=legs, torso_mass_scale=torso))
    return robot, pa.solve_stand(robot, pa.StandTask(height=height))


@pytest.mark.slow
def test_failures_of_designs_have_a_kind_and_a_reason(threads: Executor, tmp_path: Path) -> None:
    vary = {"height": [0.12, 0.5], "slope": [0.0, 1.2], "mass:leg_*_3": pa.study.normal(1.0, 1e-3)}
    table = study(vary, "peak_utilisation", study_metrics.fails, samples=32).run(
        tmp_path, executor=threads
    )
    high = table["height"] == 0.5
    assert set(table[high]["failure"]) == {"unreachable"}
    steep = ~high & (table["slope"] > 0)
    assert set(table[steep]["failure"]) <= {"friction too low", "unreachable",
                                            "com outside the support polygon"}  # fmt: skip
    flat = table[~high & (table["slope"] == 0)]
    assert set(flat["failure"]) == {"error"}
    assert set(flat["reason"]) == {"RuntimeError: on purpose"}
    assert set(flat["failed_metric"]) == {"fails"}
    assert flat["peak_utilisation"].notna().all()


def test_metric_of_several_values_has_columns_and_a_wrong_type_fails(
    threads: Executor, tmp_path: Path
) -> None:
    own = study_metrics.places, study_metrics.wrong
    table = study({"kp": [5.0]}, *own, "torque").run(tmp_path, executor=threads)
    places = pa.solve_stand(load("v3")).contact_points
    for foot, place in places.items():
        assert table[f"places.{foot}"][0] == pytest.approx(place[0])
    assert table["failure"][0] == "invalid"
    assert "'much' is neither a number" in table["reason"][0]
    assert [f"torque.{name}" in table for name in load("v3").joint_names] == [True] * 12


# ----------------------------------------------------------------------------- executors


def assert_same_table(one: pd.DataFrame, other: pd.DataFrame) -> None:
    """To the last bit, in the same order."""
    pd.testing.assert_frame_equal(one, other, check_exact=True)


class Backwards(Executor):
    """Executor that runs each chunk at once, in reverse order, in this thread."""

    def submit(self, function: Any, chunk: Chunk, /, *_: Any, **__: Any) -> Future[Any]:  # type: ignore[override]
        future: Future[Any] = Future()
        order = sorted(range(len(chunk.names)), reverse=True)
        turned = Chunk(
            chunk.work,
            tuple(chunk.names[i] for i in order),
            tuple(chunk.numbers[i] for i in order),
        )
        future.set_result(function(turned))
        return future


@pytest.mark.slow
def test_threads_processes_and_any_order_give_the_same_bits(
    undisturbed: pd.DataFrame, tmp_path: Path, threads: Executor
) -> None:
    assert_same_table(study().run(tmp_path / "threads", executor=threads), undisturbed)
    assert_same_table(study().run(tmp_path / "processes", workers=2), undisturbed)
    assert_same_table(
        study().run(tmp_path / "backwards", executor=Backwards(), workers=3), undisturbed
    )
    mixed = {name: FEW[name] for name in ("kp", "slope", "leg_scale")}  # the other way round
    table = study(mixed).run(tmp_path / "mixed", executor=threads)
    ordered = table.set_index("design").loc[undisturbed["design"]].reset_index()
    assert_same_table(ordered[undisturbed.columns], undisturbed)


def test_results_of_other_engine_versions_are_not_reused(
    tmp_path: Path, threads: Executor, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = study()
    work = made.work()
    monkeypatch.setattr(
        "pupper_analysis.tools.study.running.list_versions", lambda: {"mujoco": "3.9"}
    )
    monkeypatch.setattr(made, "work", lambda: work)
    with pytest.raises(pa.StudyError, match=r"other versions.*mujoco 3.9 \(here 4"):
        made.run(tmp_path, executor=threads)


# ----------------------------------------------------------------------------- going on


@pytest.mark.slow
def test_existing_results_are_not_computed_again(
    undisturbed: pd.DataFrame, tmp_path: Path, threads: Executor
) -> None:
    part = study({**FEW, "kp": [20.0, 5.0]})
    assert part.execute(tmp_path, executor=threads).done == 8
    progress = study().execute(tmp_path, executor=threads)
    assert (progress.total, progress.num_stored, progress.done) == (12, 8, 4)
    assert_same_table(study().table(tmp_path), undisturbed)
    again = study().execute(tmp_path, executor=threads)
    assert (again.num_stored, again.done) == (12, 0)
    assert len(pa.read_study(tmp_path)) == 12
    assert_same_table(pa.read_study(tmp_path), undisturbed)


def test_changed_study_uses_only_its_own_rows(tmp_path: Path, threads: Executor) -> None:
    study({"kp": [5.0]}).execute(tmp_path, executor=threads)
    other = study({"kp": [5.0, 6.0]}, "servo_sag")
    assert other.execute(tmp_path, executor=threads).done == 2  # other metrics: other designs
    assert len(pa.read_study(tmp_path)) == 2
    assert "peak_utilisation" not in pa.read_study(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("sole", [True, False], ids=["boxes", "spheres"])
def test_study_of_published_files_scales_both_models(
    sole: bool, tmp_path: Path, threads: Executor
) -> None:
    """Other joint names, torque motors and no floor."""
    foot = {"foot": legged.BOX.format(name="")} if sole else {}
    files = legged.quadruped(tmp_path, prefix="x_", **foot)
    (tmp_path / "study.toml").write_text(
        f"""
        measure = ["total_mass", "peak_torque", "peak_utilisation", "servo_sag"]
        [robot]
        urdf = "{files.urdf.name}"
        mjcf = "{files.mjcf.name}"
        [vary]
        "mass:*calf" = [1.0, 1.5]
        "effort:*" = [0.5, 1.0]
        payload = [0.0, 2.0]
        "kp:*" = [0.5, 1.0]
        """
    )
    study = pa.Study.read(tmp_path / "study.toml")
    table = study.run(tmp_path / "study", executor=threads)
    assert table["failure"].isna().all()
    masses = 8.4 + 4 * 0.2 * (table["mass:*calf"] - 1) + table["payload"]
    assert list(table["total_mass"]) == pytest.approx(list(masses))
    for _, group in table.groupby(["mass:*calf", "payload", "kp:*"]):
        weak, strong = group["peak_utilisation"]
        assert weak == pytest.approx(2 * strong)
        assert group["peak_torque"].nunique() == 1
    soft, stiff = (table[table["kp:*"] == kp]["servo_sag"].to_numpy() for kp in (0.5, 1.0))
    assert (soft > 1.8 * stiff).all()  # linear would be 2
    maker = DesignBuilder(study.source, study.task, study.point)
    changed = maker.design({"mass:*calf": 1.5, "payload": 2.0}).robot
    check = pa.cross_check(changed, configurations=3)
    # Which the files, as they are published, state otherwise.
    assert {quantity.name for quantity in check.quantities if not quantity.passed} == {
        "effort limits"
    }


@pytest.mark.slow
def test_other_files_are_other_designs(tmp_path: Path) -> None:
    """The design depends on the content of the file, not on its name."""
    files = {}
    for kind, name in (("urdf", "pupper_skeleton.urdf"), ("mjcf", "pupper_skeleton.xml")):
        files[kind] = str(shutil.copy(ROOT / kind / name, tmp_path / name))
    feet = [f"{leg}_foot" for leg in ("FL", "FR", "RL", "RR")]

    def first(**changes: str) -> str:
        made = pa.Study({**files, "feet": feet, **changes}, {"kp": [5.0]}, ["servo_sag"])
        return next(made.designs())[0][0]

    before = first()
    moved = shutil.copy(files["urdf"], tmp_path / "moved.urdf")
    assert first(urdf=str(moved)) == before  # only the content counts
    text = Path(files["urdf"]).read_text()
    assert '<mass value="' in text
    (tmp_path / "moved.urdf").write_text(text.replace('<mass value="', '<mass value="1', 1))
    assert first(urdf=str(moved)) != before


# ----------------------------------------------------------------------------- crashes


HEAVY = {"torso_mass_scale": [1.0, 1.2, 2.0, 1.4, 1.1]}  # one of these weighs more than 4 kg


@pytest.mark.slow
@pytest.mark.parametrize("guilty", ["crashes", "hangs"])
def test_design_that_crashes_its_worker_is_marked(guilty: str, tmp_path: Path) -> None:
    """The time limit is raised until the sound designs meet the limit, because the machine may
    be busy."""
    kind = {"crashes": "crashed", "hangs": "timed out"}[guilty]
    for limit in (3.0, 12.0, 60.0, 240.0):
        folder = tmp_path / str(limit)
        made = study(HEAVY, getattr(study_metrics, guilty), time_limit=limit)
        table = made.run(folder, workers=2)
        if table["failure"][2] == kind and not table["failure"].drop(2).notna().any():
            break
    assert table["failure"][2] == kind
    assert pd.isna(table[guilty][2])
    assert not table["failure"].drop(2).notna().any()
    assert list(table[guilty].drop(2)) == [1, 1, 1, 1]
    assert made.execute(folder, workers=1).done == 0  # marked for good


@pytest.mark.slow
def test_killed_worker_loses_no_design(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STUDY_MARKER", str(tmp_path / "marker"))
    table = study(HEAVY, study_metrics.crashes_once).run(tmp_path / "study", workers=2)
    assert (tmp_path / "marker").exists()
    assert list(table["crashes_once"]) == [1.0] * 5


@pytest.mark.slow
def test_workers_are_restarted_after_a_number_of_designs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Processes without a design end by themselves: exit code 0, not that of a signal.

    A process that was ended during the import of MuJoCo printed a traceback of GLFW.
    """
    codes: list[int | None] = []
    end_processes = running.WorkerPool.end_processes

    def record_exit_codes(pool: running.WorkerPool, *, idle: bool = False) -> None:
        processes = list(pool._processes)
        end_processes(pool, idle=idle)
        codes[:] = [process.exitcode for process in processes]

    monkeypatch.setattr(running.WorkerPool, "end_processes", record_exit_codes)
    monkeypatch.setattr(running, "DESIGNS_PER_PROCESS", 2)
    monkeypatch.setattr(running, "MAX_CHUNK_DESIGNS", 1)
    table = study(HEAVY, study_metrics.process).run(tmp_path, workers=1)
    assert not table["failure"].notna().any()
    assert 2 <= table["process"].nunique() < 5
    assert codes == [0]


@pytest.mark.slow
def test_broken_executor_loses_no_finished_design(tmp_path: Path) -> None:
    made = study(HEAVY, study_metrics.crashes)
    with (
        ProcessPoolExecutor(1, get_context("spawn")) as executor,
        pytest.raises(pa.StudyError, match="run the same command again"),
    ):
        made.run(tmp_path, executor=executor)
    assert made.run(tmp_path, workers=1)["failure"].notna().sum() == 1


@pytest.mark.slow
def test_workers_of_any_executor_write_no_log_of_mujoco(tmp_path: Path) -> None:
    """Reference: the setting of MuJoCo. That of the process that starts the run is not changed."""
    made = study({"payload": [0.0]}, study_metrics.writes_log)
    with ProcessPoolExecutor(1, get_context("spawn")) as executor:
        assert list(made.run(tmp_path / "process", executor=executor)["writes_log"]) == [0.0]
    before = study_metrics.writes_log(load("v3"), stand_of("v3"))
    with ThreadPoolExecutor(1) as executor:
        assert list(made.run(tmp_path / "thread", executor=executor)["writes_log"]) == [before]


NOTEBOOK = """
import sys
import pupper_analysis as pa
from concurrent.futures import ThreadPoolExecutor

def my_metric(robot, stand):
    return stand.com_margin

study = pa.Study("v3", {"leg_scale": [1.0]}, [my_metric])
try:
    study.run(sys.argv[1], workers=1)
except pa.StudyError as error:
    print(error)
print(study.run(sys.argv[1], executor=ThreadPoolExecutor(1))["my_metric"][0])
"""


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [(["-c", NOTEBOOK], "cannot import my_metric"), (["-"], "read from standard input")],
    ids=["without a file", "standard input"],
)
@pytest.mark.slow
def test_metric_of_a_notebook_is_refused_before_the_run(
    arguments: list[str], expected: str, tmp_path: Path
) -> None:
    """Reference: the CoM margin of the stand in this process, which the thread reproduces."""
    done = subprocess.run(
        [sys.executable, *arguments, str(tmp_path)],
        input=NOTEBOOK if arguments == ["-"] else "",
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=100,
        check=True,
    )
    message, value = done.stdout.splitlines()
    assert expected in message
    assert "ThreadPoolExecutor(1)" in message
    assert float(value) == pytest.approx(pa.solve_stand_as_simulated(load("v3")).com_margin)


def test_a_function_that_a_worker_cannot_import_is_named() -> None:
    """Reference: the messages for a notebook, and for another version of a module."""
    for module, expected in (("__main__", "import my_metric"), ("math", "math .*has no my_metric")):
        pickled = f"c{module}\nmy_metric\n.".encode()
        with pytest.raises(pa.StudyError, match=expected):
            running.load_definition(pickled)


# ----------------------------------------------------------------------------- kills


SCRIPT = """
import sys
from pupper_analysis.tools.study import running
from tests.tools.study.test_running import slow_study
running.SHARD_SECONDS = 0.2

if __name__ == "__main__":
    print("begins", flush=True)
    slow_study().execute(sys.argv[1], workers=2)
    print("done", flush=True)
"""


def slow_study() -> pa.Study:
    vary = {"torso_mass_scale": pa.study.linspace(1.0, 2.0, 24)}
    return study(vary, study_metrics.slow, "servo_sag")


def start(*words: object) -> subprocess.Popen[str]:
    """Start Python in a new session with the default action of SIGINT, which children of background
    shells ignore otherwise.
    """
    return subprocess.Popen(
        [sys.executable, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def rows_of(folder: Path) -> int:
    import pyarrow.parquet as pq

    shards = (folder / "shards").glob("*.parquet")
    return sum(pq.read_metadata(path).num_rows for path in shards)


def members(session: int) -> list[int]:
    """Return the ids of live processes of a session."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            found.append(int(path.parent.name))
    return found


def left_over(session: int) -> list[int]:
    """Return processes of a session that are alive after up to 20 s."""
    deadline = time.monotonic() + 20
    while members(session) and time.monotonic() < deadline:
        time.sleep(0.05)
    return members(session)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="it looks into /proc")
@pytest.mark.slow
def test_killed_study_resumes_without_loss(tmp_path: Path) -> None:
    """The parent is killed after some rows, again and again; no row is lost, doubled or halved."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    folder, chance, kills = tmp_path / "study", random.Random(0), 0
    while True:
        before = rows_of(folder)
        process = start(script, folder)
        assert process.stdout is not None
        assert process.stdout.readline() == "begins\n"
        while process.poll() is None and (kills == 2 or rows_of(folder) <= before):
            time.sleep(0.02)
        time.sleep(chance.uniform(0.0, 0.3))
        if process.poll() is not None:
            break
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
        kills += 1
        assert left_over(process.pid) == []  # its workers have gone with it
        assert rows_of(folder) >= before
    process.communicate()
    assert kills == 2
    assert process.returncode == 0
    assert rows_of(folder) == 24  # each once
    with ThreadPoolExecutor(2) as executor:
        assert_same_table(
            pa.read_study(folder), slow_study().run(tmp_path / "other", executor=executor)
        )


LOCKED = """import os, signal, sys
from pathlib import Path
from pupper_analysis.tools.study.store import Store
with Store(Path(sys.argv[1])).locked()"""


@pytest.mark.slow
def test_second_run_in_one_folder_is_refused(tmp_path: Path, threads: Executor) -> None:
    """The second is refused, in this process and in another; a dead run does not hold it."""
    refusals = []

    def again(_: Progress) -> None:
        if not refusals:
            try:
                study({"kp": [5.0]}).execute(tmp_path, executor=threads)
            except pa.StudyError as error:
                refusals.append(str(error))
            refusals.append(start("-c", f"{LOCKED}: print('held')", tmp_path).communicate()[1])

    study({"kp": [5.0, 6.0]}).execute(tmp_path, executor=threads, progress=again)
    assert len(refusals) == 2
    assert all("another run writes to this folder" in text for text in refusals)
    killed = start("-c", f"{LOCKED}: os.kill(os.getpid(), signal.SIGKILL)", tmp_path)
    killed.communicate()
    assert killed.returncode == -signal.SIGKILL
    assert study({"kp": [5.0]}).execute(tmp_path, executor=threads).num_stored == 1


@pytest.mark.slow
def test_a_full_disk_leaves_whole_shards(
    tmp_path: Path, threads: Executor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running, "SHARD_ROWS", 1)
    written, write = [], store.Store.write

    def full(self: store.Store, rows: Any) -> None:
        if len(written) >= 2 and rows:
            raise OutputError(self.folder, "No space left on device")
        written.extend(rows)
        write(self, rows)

    monkeypatch.setattr(store.Store, "write", full)
    with pytest.raises(OutputError, match="No space left"):
        study().run(tmp_path, executor=threads)
    monkeypatch.undo()
    assert rows_of(tmp_path) == len(written) > 0
    assert study().execute(tmp_path, executor=threads).done == 12 - len(written)


def test_a_damaged_shard_and_a_strange_folder_are_named(tmp_path: Path, threads: Executor) -> None:
    with pytest.raises(pa.StudyError, match="not the folder of a study"):
        pa.read_study(tmp_path)
    study({"kp": [5.0]}).execute(tmp_path, executor=threads)
    (shard,) = (tmp_path / "shards").glob("*.parquet")
    shard.write_bytes(shard.read_bytes()[:-5])
    with pytest.raises(pa.StudyError, match=rf"{shard.name} is damaged .*delete the file"):
        pa.read_study(tmp_path)
    pd.DataFrame({"other": [1.0]}).to_parquet(shard)
    with pytest.raises(pa.StudyError, match=rf"{shard.name} is damaged .*design"):
        pa.read_study(tmp_path)
    for values in ({}, {"study": 5}, {"study": {"vary": {}}}, {"digest": "a", "study": []}):
        (tmp_path / "study.json").write_text(json.dumps({"format": 1} | values))
        with pytest.raises(pa.StudyError, match="does not contain a valid request"):
            pa.read_study(tmp_path)
    request = {"vary": {"kp": [5, 6]}, "measure": ["total_mass"], "robot": "v3"}
    for seed in ({}, {"seed": "x"}, {"seed": None}):
        values = {"digest": "a", "study": request | seed}
        (tmp_path / "study.json").write_text(json.dumps({"format": 1} | values))
        with pytest.raises(pa.StudyError, match="seed"):
            pa.read_study(tmp_path)
    sampled = request | {"seed": 0, "samples": 2.5, "vary": {"kp": {"uniform": [5, 6]}}}
    values = {"format": 1, "digest": "a", "study": sampled}
    (tmp_path / "study.json").write_text(json.dumps(values))
    with pytest.raises(pa.StudyError, match="samples"):
        pa.read_study(tmp_path)
    (tmp_path / "study.json").write_text('{"format": 99}')
    with pytest.raises(pa.StudyError, match="another version"):
        pa.read_study(tmp_path)
    with pytest.raises(pa.StudyError, match="another version"):
        study({"kp": [5.0]}).execute(tmp_path, executor=threads)


# ----------------------------------------------------------------------------- commands


LEGS = """
robot = "v3"
measure = ["peak_utilisation", "servo_sag"]
[vary]
leg_scale = { linspace = [1.2, 1.3, 2] }
kp = [0.2, 10]
"""


@pytest.mark.slow
def test_the_study_command_writes_its_results(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file, folder = tmp_path / "legs.toml", tmp_path / "legs"
    file.write_text(LEGS)
    status, out, _ = run_command(capfd, "study", str(file), "-o", str(folder), "--workers", "1")
    assert status == 0
    assert out.startswith("MEASURED v3: 4 designs, 2 failed: ")  # no progress bar
    assert "no equilibrium (2)" in out
    table = pa.read_study(folder)
    _, unit, *line = next(row for row in out.splitlines() if row.startswith("servo_sag")).split()
    assert unit == "(mm)"  # the table of the study is in m
    least, most = 1e3 * table["servo_sag"].min(), 1e3 * table["servo_sag"].max()
    assert [float(line[0]), float(line[2])] == pytest.approx([least, most], rel=1e-4)
    assert line[3] == "2"
    written = tmp_path / "study.json"
    arguments = ("study", str(file), "-o", str(folder), "--json", str(written))
    status, out, _ = run_command(capfd, *arguments)
    assert status == 0
    columns = json.loads(written.read_text())
    assert columns["kp"] == [0.2, 10.0, 0.2, 10.0]
    assert columns["servo_sag"][0] is None
    assert columns["servo_sag"][1] == table["servo_sag"][1]


@pytest.mark.slow
def test_interrupted_study_can_be_resumed_and_leaves_no_process(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(
        'robot = "v3"\nmeasure = ["minimum_stiffness"]\n[vary]\n'
        "torso_mass_scale = { linspace = [1.0, 2.0, 400] }\n"
    )
    folder = tmp_path / "study"
    words = ("study", tmp_path / "study.toml", "-o", folder, "--workers", 2)
    process = start("-m", "pupper_analysis", *words)
    while not rows_of(folder):
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)  # as the terminal does it, to all of them
    _, err = process.communicate(timeout=300)  # a guard against hanging
    assert process.returncode == 130
    assert "run the same command to continue" in err
    assert "interrupted" in err
    assert "Traceback" not in err
    assert 0 < rows_of(folder) < 400
    assert left_over(process.pid) == []


def test_chunks_last_longer_on_more_workers() -> None:
    """Closed form for designs of 25 ms: 0.5 s, or 100 chunks per second of all workers."""
    progress = running.Progress(10_000, done=4, work=0.1, processor_time=0.1)
    sizes = [running.choose_chunk_size(progress, number) for number in (1, 8, 100, 1000)]
    assert sizes == [20, 20, 40, 400]
    slow = running.Progress(10_000, done=4, work=40.0, processor_time=40.0)
    assert [running.choose_chunk_size(slow, number) for number in (8, 3000)] == [1, 3]
    assert running.choose_chunk_size(running.Progress(10), 1000) == 1


def test_other_load_does_not_reduce_the_number_of_designs_per_chunk() -> None:
    """Closed form for 25 ms of processor time per design: 20 designs, also if each takes 100 ms.

    Designs that wait for 100 ms, without processor time: chunks of 2 s.
    """
    loaded = running.Progress(10_000, done=4, work=0.4, processor_time=0.1)
    assert running.choose_chunk_size(loaded, 2) == 20
    waiting = running.Progress(10_000, done=4, work=0.4, processor_time=0.0)
    assert running.choose_chunk_size(waiting, 2) == 20
    overloaded = running.Progress(10_000, done=4, work=1.0, processor_time=0.1)
    assert running.choose_chunk_size(overloaded, 2) == 8


def test_evaluation_reports_the_processor_time_without_waiting() -> None:
    """Reference: a metric that sleeps 50 ms per design takes elapsed time, no processor time."""
    made = study({"payload": [0.0, 0.1]}, study_metrics.slow)
    ((names, numbers),) = made.designs()
    rows = tuple(map(tuple, numbers.tolist()))
    outcome = running.measure_designs(Chunk(made.work(), tuple(names), rows))
    assert outcome.seconds - outcome.processor_seconds > 2 * 0.05 - 0.01


def test_remaining_time_follows_from_the_rate_of_this_run() -> None:
    """Closed form: of 10 designs 4 are stored, and 2 take 1 s, so the other 4 take 2 s."""
    assert running.Progress(10, num_stored=4, done=2, seconds=1.0).remaining_time == 2.0
    assert running.Progress(10, num_stored=4).remaining_time == float("inf")
    assert running.Progress(10, num_stored=10).remaining_time == 0.0


@pytest.mark.slow
def test_design_without_equilibrium_is_a_row_with_its_reason(undisturbed: pd.DataFrame) -> None:
    """Servos of 0.2 N m/rad hold no stand; metrics that need no servos are measured."""
    soft = undisturbed[undisturbed["kp"] == 0.2]
    assert set(soft["failure"]) == {"no equilibrium"}
    assert soft["reason"].str.startswith("no equilibrium: ").all()
    assert set(soft["failed_metric"]) == {"base_height"}
    assert soft["servo_sag"].isna().all()
    assert soft["peak_utilisation"].notna().all()
    others = undisturbed[undisturbed["kp"] > 0.2]
    assert others["failure"].isna().all()
    assert others["servo_sag"].notna().all()


@pytest.mark.slow
def test_further_samples_are_added_to_the_existing_samples(
    tmp_path: Path, threads: Executor
) -> None:
    vary = {"kp": pa.study.uniform(5, 20)}
    study(vary, "servo_sag", samples=4).execute(tmp_path, executor=threads)
    assert study(vary, "servo_sag", samples=6).execute(tmp_path, executor=threads).done == 2


def test_repeated_designs_are_measured_once(tmp_path: Path, threads: Executor) -> None:
    """16 samples of two variables, each of which has two values, are at most four designs."""
    vary = {"kp": [5.0, 6.0], "payload": pa.study.uniform(1, math.nextafter(1, 2))}
    table = study(vary, "total_mass", samples=16).run(tmp_path, executor=threads)
    assert 2 <= len(table) <= 4
    assert len(table) == table["design"].nunique()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LEGS.replace("kp", "kq"), "unknown parameter"),
        (LEGS.replace("servo_sag", "sagging"), "no metric 'sagging'"),
        ("robot =", "not a TOML file"),
    ],
)
def test_invalid_study_file_is_refused_before_the_run(
    text: str, message: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "study.toml").write_text(text)
    arguments = ["study", str(tmp_path / "study.toml"), "-o", str(tmp_path / "out")]
    status, _, err = run_command(capfd, *arguments)
    assert status == 2
    assert message in err
    assert not (tmp_path / "out").exists()
