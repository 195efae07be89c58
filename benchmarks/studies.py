"""Speed of studies, and their results after interruptions: docs/data/study-speed.csv.

    python benchmarks/studies.py speed 10000       # statics and sag of v3, two processes
    python benchmarks/studies.py simulated 500     # with a simulation each
    python benchmarks/studies.py efficiency        # 1 and 2 processes, 100 ms per design
    python benchmarks/studies.py overhead          # time per trivial design; memory
    python benchmarks/studies.py finding           # how large v3 may be, with a figure
    python benchmarks/studies.py dask 2000         # two Dask workers against two bare loops
    python benchmarks/studies.py scheduler 100000 --workers 1000  # workers that return rows at once
    python benchmarks/studies.py store 1000000     # rows: writing, reading, size
    python benchmarks/studies.py kills 20          # of the parent, of a worker

Designs of ``efficiency`` sleep, so that the use of the workers is measured independently of other
processes. Times of ``speed`` are elapsed and processor times.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import Any

import pupper_analysis as pa
from pupper_analysis.tools.study import running

SAG = ("peak_utilisation", "base_height", "servo_sag", "com_margin")
"""Measured quantities of ``speed``."""

AXES = {  # 10 000 designs of v3
    "leg_scale": pa.study.linspace(0.8, 1.7, 10),
    "torso_mass_scale": pa.study.linspace(1.0, 2.8, 10),
    "payload": pa.study.linspace(0.0, 1.0, 5),
    "slope": pa.study.linspace(0.0, 0.15, 4),
    "kp": [5.0, 8.0, 12.0, 20.0, 40.0],
}
"""{variable: values} of 10,000 designs of v3."""


def sleep_metric(_robot: pa.Robot, _stand: pa.Stand) -> float:
    """Return 1 after 100 ms."""
    time.sleep(0.1)
    return 1.0


def processor_time() -> float:
    """Return the processor time [s] of this process and of its finished child processes."""
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(used.ru_utime + used.ru_stime for used in both)


def peak_memory() -> float:
    """Return the peak memory of this process [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def reduce_axes(count: int) -> dict[str, object]:
    """Return the variables of about ``count`` designs, at least 400 and at most 10,000.

    For fewer designs, the two scales have fewer values.
    """
    axes: dict[str, object] = dict(AXES)
    size = 10_000
    for name in ("leg_scale", "torso_mass_scale"):
        keep = max(2, min(10, round(10 * count / size)))
        levels = AXES[name].levels  # type: ignore[attr-defined]
        axes[name] = [levels[index * 9 // (keep - 1)] for index in range(keep)]
        size = size // 10 * keep
    return axes


def measure_speed(count: int, workers: int) -> None:
    """Run a study without simulation, and print its speed."""
    study = pa.Study("v3", reduce_axes(count), SAG)
    marks: list[tuple[int, float]] = []

    def watch(progress: running.Progress) -> None:
        if not marks or progress.done >= marks[-1][0] + len(study) // 10:
            marks.append((progress.done, progress.seconds))

    with tempfile.TemporaryDirectory() as folder:
        before = processor_time()
        done = study.execute(folder, workers=workers, progress=watch)
        used = processor_time() - before
        print(f"{done.done} designs, {workers} processes: {done.seconds:.1f} s, {done.rate:.1f}/s")
        print(f"processor: {used:.1f} s, {1e3 * used / done.done:.1f} ms a design")
        print(
            f"load of the machine: {os.getloadavg()[0]:.1f}; parent's memory {peak_memory():.0f} MB"
        )
        print(f"failures: {dict(done.failures)}")
        print("designs, seconds:", ", ".join(f"{n} {s:.0f}" for n, s in marks))


def measure_simulated(count: int, workers: int) -> None:
    """Run a study with simulations, and print its speed and the height differences."""
    vary = {"leg_scale": [1.0, 1.2], "payload": [0.0, 0.3], "kp": pa.study.uniform(5.0, 20.0)}
    study = pa.Study("v3", vary, ["simulated_height", "base_height"], samples=count)
    with tempfile.TemporaryDirectory() as folder:
        before = processor_time()
        done = study.execute(folder, workers=workers)
        used = processor_time() - before
        table = study.table(folder)
        off = 1e3 * (table["simulated_height"] - table["base_height"])
    print(f"{done.done} simulated designs, {workers} processes: {done.seconds:.1f} s")
    print(f"processor: {1e3 * used / done.done:.0f} ms a design; failures {dict(done.failures)}")
    print(
        f"MuJoCo above the prediction: median {off.median():.2f} mm, most {off.abs().max():.2f} mm"
    )


def measure_efficiency() -> None:
    """Print the speed with n workers relative to n times the speed of one, without start-up."""
    vary = {"kp": pa.study.linspace(5.0, 20.0, 200)}

    def rate(**how: object) -> float:
        marks: list[tuple[int, float]] = []
        with tempfile.TemporaryDirectory() as folder:
            study = pa.Study("v3", vary, [sleep_metric])
            study.execute(
                folder,
                progress=lambda p: marks.append((p.done, p.seconds)),
                **how,  # type: ignore[arg-type]
            )
        first = next(mark for mark in marks if mark[0] >= 20)
        last = marks[-1]
        return (last[0] - first[0]) / (last[1] - first[1])

    one, two = rate(workers=1), rate(workers=2)
    print(f"1 process {one:.2f}/s, 2 processes {two:.2f}/s; 2 against 1: {two / (2 * one):.3f}")
    print(f"of 10 designs a second and worker: {one / 10:.3f}, {two / 20:.3f}")


def measure_overhead() -> None:
    """Print the time of the parent per design, and its memory, for 1e3 to 3e4 designs."""
    for count in (1_000, 10_000, 30_000):
        code = (
            "import time, sys, tempfile; sys.path.insert(0, sys.argv[2])\n"
            "import studies, pupper_analysis as pa\n"
            "if __name__ == '__main__':\n"
            "    study = pa.Study('v3', {'kp': pa.study.linspace(5.0, 20.0, int(sys.argv[1]))},\n"
            "                     ['com_margin'])\n"
            "    folder = tempfile.mkdtemp()\n"
            "    begun = time.process_time(); study.work(); study.digest\n"
            "    begun = time.process_time(); done = study.execute(folder, workers=1)\n"
            "    used = time.process_time() - begun\n"
            "    print(f'{done.done} designs: parent {1e6 * used / done.done:.0f} us a design, '\n"
            "          f'worker {1e6 * done.work / done.done:.0f} us, '\n"
            "          f'{studies.peak_memory():.0f} MB')\n"
        )
        with tempfile.TemporaryDirectory() as folder:
            script = Path(folder) / "overhead.py"
            script.write_text(code)
            here = str(Path(__file__).parent)
            subprocess.run([sys.executable, str(script), str(count), here], check=True)


def find_largest_robots() -> None:
    """Print and draw how long the legs and how heavy the torso of v3 may be (3 N m motors)."""
    from pupper_analysis.present.figures import drawing
    from pupper_analysis.tools.study.outcome import pareto_front

    vary = {
        "leg_scale": pa.study.linspace(0.8, 1.6, 9),
        "torso_mass_scale": pa.study.linspace(1.0, 6.0, 21),
    }
    measures = ["peak_utilisation", "rest_utilisation", "sag", "stands", "total_mass"]
    with tempfile.TemporaryDirectory() as folder:
        table = pa.Study("v3", {**vary, "kp": [5.0, 10.0]}, measures).run(folder, workers=2)
    strong = table["peak_utilisation"] < 1
    stands = table[strong & (table["stands"] == 1)]
    print(f"{len(table)} designs; the motors hold {strong.sum()}, the servos {len(stands)}")
    print(stands.groupby("kp")[["peak_utilisation", "rest_utilisation", "sag"]].max().to_string())
    heaviest = stands.groupby(["kp", "leg_scale"])["torso_mass_scale"].max()
    print(heaviest.unstack(0).to_string())
    said = "Longest legs and largest mass of a v3 that stands on its servos"
    figure = drawing.make_page_figure(said, 3.4, layout="constrained")
    axes = figure.add_subplot()
    axes.set_prop_cycle(color=drawing.SERIES_COLOURS)
    axes.set(xlabel="leg length relative to v3", ylabel="mass of the robot (kg)")
    for marker, (kp, part) in zip("os", stands.groupby("kp"), strict=True):
        front = pareto_front(part, {"leg_scale": "max", "total_mass": "max"})
        dots = axes.scatter(part["leg_scale"], part["total_mass"], s=4, alpha=0.35, marker=marker)
        look = {"color": dots.get_facecolor()[0, :3], "marker": marker, "ms": 4}
        label = f"kp = {kp:g} N m/rad: Pareto front (dots: other designs that stand)"
        axes.plot(front["leg_scale"], front["total_mass"], label=label, **look)
    drawing.title_panel(axes, "")
    axes.legend(fontsize=drawing.FONT_SIZE, frameon=False)
    docs = Path(__file__).parents[1] / "docs" / "images"
    drawing.save_figure(figure, docs / "study_front.png", force=True)


VICTIM = """
import sys
sys.path.insert(0, {here!r})
import studies, pupper_analysis as pa
from pupper_analysis.tools.study import running
running.SHARD_SECONDS = 0.1
if __name__ == "__main__":
    studies.make_study().execute(sys.argv[1], workers=2)
"""
"""Code of a process that runs a study and is killed."""


def make_study() -> pa.Study:
    """Return the study whose processes are killed."""
    return pa.Study(
        "v3", {"payload": pa.study.linspace(0.0, 1.0, 60)}, ["servo_sag", "peak_utilisation"]
    )


def count_rows(folder: Path) -> int:
    """Return the number of stored rows of a study."""
    import pyarrow.parquet as pq

    return sum(pq.read_metadata(path).num_rows for path in (folder / "shards").glob("*.parquet"))


def kill_parent(folder: Path, chance: random.Random) -> str:
    """Kill the parent process of a study at a random time."""
    with tempfile.TemporaryDirectory() as other:
        script = Path(other) / "victim.py"
        script.write_text(VICTIM.format(here=str(Path(__file__).parent)))
        process = subprocess.Popen([sys.executable, str(script), str(folder)])
        while process.poll() is None and not count_rows(folder):
            time.sleep(0.02)
        time.sleep(chance.uniform(0.0, 1.0))
        process.send_signal(signal.SIGKILL)
        process.wait()
    return f"{count_rows(folder)} rows were there"


def kill_worker(folder: Path, chance: random.Random) -> str:
    """Kill a worker process of a study at a random time."""
    killed: list[int] = []
    when = chance.uniform(0.0, 1.0)

    def watch(progress: running.Progress) -> None:
        if progress.done and not killed and progress.seconds > when:
            children = multiprocessing.active_children()
            if children:
                victim = chance.choice(children)
                killed.append(victim.pid or 0)
                victim.kill()

    done = make_study().execute(folder, workers=2, progress=watch)
    return f"{len(killed)} killed, {done.done} done"


def test_kills(count: int, kinds: tuple[str, ...]) -> None:
    """Kill and resume a study, and compare the table with an uninterrupted run, bit by bit."""
    with tempfile.TemporaryDirectory() as folder:
        whole = make_study().run(folder, workers=2)
    directions: dict[str, Callable[[Path, random.Random], str]] = {
        "parent": kill_parent,
        "worker": kill_worker,
    }
    for kind in kinds:
        chance = random.Random(1)
        good = 0
        for _ in range(count):
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name) / "study"
                message = directions[kind](folder, chance)
                table = make_study().run(folder, workers=2)
                same = table.equals(whole) and count_rows(folder) == len(whole)
                good += same
                print(f"{kind}: {message}; the same afterwards: {same}", flush=True)
        print(f"{kind}: {good} of {count} are the same afterwards")


def process_seconds() -> float:
    """Return the processor time [s] of this process, without child processes."""
    return sum(os.times()[:2])


def evaluate_chunk(chunk: running.Chunk) -> float:
    """Evaluate the designs of a chunk without a store; return the processor time [s]."""
    before = process_seconds()
    running.measure_designs(chunk)
    return process_seconds() - before


def split_study(study: pa.Study, parts: int) -> list[running.Chunk]:
    """Return the designs of a study in equal parts, sorted so that neighbours share a robot."""
    import numpy as np

    robot_columns = [
        index for index, name in enumerate(study.variables) if not running.is_servo_variable(name)
    ]
    ((names, numbers),) = study.designs()
    orders = np.array_split(np.lexsort(numbers[:, robot_columns[::-1]].T), parts)
    return [
        running.Chunk(
            study.work(),
            tuple(names[index] for index in order),
            tuple(map(tuple, numbers[order].tolist())),
        )
        for order in orders
    ]


def measure_dask(count: int) -> None:
    """Print the time of a study on two Dask workers, with the start of the workers apart.

    The processor time of all processes is compared with that of the evaluations on the same
    workers, because it depends on the load of the other core. The elapsed time is compared with
    that of two bare loops, which run afterwards.
    """
    from pupper_analysis.tools.study.cluster import connect_dask

    study = pa.Study("v3", reduce_axes(count), SAG)
    first = pa.Study("v3", {"payload": [0.0, 0.1], "kp": [5.0, 6.0]}, SAG)
    with tempfile.TemporaryDirectory() as folder:
        own = process_seconds()
        with connect_dask("local:2") as (executor, number):
            cluster: Any = executor._client  # type: ignore[attr-defined]

            def workers_seconds() -> float:
                return sum(cluster.run(process_seconds).values())

            first.execute(Path(folder) / "start", executor=executor, workers=number)
            start, used = time.monotonic(), workers_seconds()
            client = process_seconds()
            print(f"start: two workers {used:.1f} s, scheduler and client {client - own:.1f} s")
            done = study.execute(Path(folder) / "study", executor=executor, workers=number)
            elapsed = time.monotonic() - start
            rest = workers_seconds() - used - done.processor_time
            client = process_seconds() - client
        evaluation = done.processor_time
        print(f"{done.done} designs: evaluation {evaluation:.1f} s of processor, {elapsed:.0f} s")
        print(
            f"overhead {100 * (rest + client) / evaluation:.1f} % of the evaluation "
            f"(workers {rest:.1f} s, scheduler and client {client:.1f} s)",
            flush=True,
        )
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        list(pool.map(evaluate_chunk, split_study(first, 2)))
        start = time.monotonic()
        bare = sum(pool.map(evaluate_chunk, split_study(study, 2)))
        bare_elapsed = time.monotonic() - start
    print(f"two bare loops: {bare:.1f} s of processor, {bare_elapsed:.0f} s")
    print(f"elapsed time with Dask {100 * (elapsed / bare_elapsed - 1):+.1f} %")
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")


def return_rows(chunk: running.Chunk) -> running.ChunkOutcome:
    """Return a recorded row for each design of a chunk at once, as if each had taken 25 ms."""
    rows = tuple(
        {"design": name, "kp": numbers[0], **RECORDED_ROW}
        for name, numbers in zip(chunk.names, chunk.numbers, strict=True)
    )
    return running.ChunkOutcome(rows, 0.025 * len(rows), 0.025 * len(rows))


RECORDED_ROW: dict[str, object] = {
    "peak_utilisation": 0.16,
    "base_height": 0.12,
    "servo_sag": 0.008,
    "com_margin": 0.05,
    "failure": None,
    "reason": None,
    "failed_metric": None,
    "diagnostic": None,
}
"""Row of a design of v3 without the hash and the variables."""


class RecordedExecutor(Executor):
    """Executor that sends `return_rows` to a Dask cluster in place of the evaluation."""

    def __init__(self, executor: Executor) -> None:
        self.executor = executor
        self.num_chunks = 0

    def submit(self, _function: object, /, *given: object, **named: object) -> Future[object]:  # type: ignore[override]
        """Submit `return_rows` with the arguments of the evaluation, and count the chunk."""
        self.num_chunks += 1
        return self.executor.submit(return_rows, *given, **named)  # type: ignore[arg-type]


WORKERS_CODE = """
import asyncio, sys
sys.path.insert(0, sys.argv[3])
from distributed import Worker
async def main():
    workers = [Worker(sys.argv[1], nthreads=1, dashboard=False, heartbeat_interval="5s",
                      memory_limit=0) for _ in range(int(sys.argv[2]))]
    for start in range(0, len(workers), 50):
        await asyncio.gather(*workers[start:start + 50])
    await asyncio.gather(*(worker.finished() for worker in workers))
asyncio.run(main())
"""
"""Code of a process with many Dask workers."""


def measure_scheduler(count: int, num_workers: int) -> None:
    """Print time and memory of scheduler and client for many workers that return recorded rows.

    All workers run in a process of their own, so that only messages and bookkeeping are measured.
    """
    psutil: Any = import_module("psutil")
    distributed: Any = import_module("distributed")
    port = 18786
    address = f"tcp://127.0.0.1:{port}"
    scheduler = subprocess.Popen(
        [
            *(sys.executable, "-m", "distributed.cli.dask_scheduler", "--no-dashboard"),
            *("--host", "127.0.0.1", "--port", str(port)),
        ],
        stderr=subprocess.DEVNULL,
    )
    here = str(Path(__file__).parent)
    fake = subprocess.Popen(
        [sys.executable, "-c", WORKERS_CODE, address, str(num_workers), here],
        stderr=subprocess.DEVNULL,
    )
    try:
        with (
            distributed.Client(address, timeout=60) as client,
            tempfile.TemporaryDirectory() as folder,
        ):
            client.wait_for_workers(num_workers, timeout=600)
            watched = psutil.Process(scheduler.pid)
            before, used = sum(watched.cpu_times()[:2]), processor_time()
            study = pa.Study("v3", {"kp": pa.study.linspace(5.0, 20.0, count)}, SAG)
            executor = RecordedExecutor(client.get_executor())
            done = study.execute(folder, executor=executor, workers=num_workers)
            chunks = executor.num_chunks
            spent = sum(watched.cpu_times()[:2]) - before
            memory = watched.memory_info().rss / 1e6
            mine = processor_time() - used
            print(f"{num_workers} workers, {done.done} designs, {chunks} chunks:")
            print(f"scheduler {1e3 * spent / chunks:.2f} ms of processor a chunk, {memory:.0f} MB")
            print(
                f"client {1e3 * mine / chunks:.2f} ms of processor a chunk, {peak_memory():.0f} MB"
            )
            print(f"elapsed {done.seconds:.1f} s at a load of {os.getloadavg()[0]:.1f}")
    finally:
        for process in (fake, scheduler):
            process.kill()
            process.wait()


def measure_store(count: int) -> None:
    """Print time and size of the rows of a study in shards of the size that a long run writes."""
    import hashlib

    from pupper_analysis.tools.study.store import Store

    with tempfile.TemporaryDirectory() as name:
        store = Store(Path(name))
        store.shards.mkdir(parents=True)
        before = processor_time()
        for start in range(0, count, running.SHARD_ROWS):
            stop = min(count, start + running.SHARD_ROWS)
            hashes = [hashlib.sha256(str(k).encode()).hexdigest()[:32] for k in range(start, stop)]
            store.write([{"design": key, "kp": float(k), **RECORDED_ROW}
                         for k, key in enumerate(hashes, start)])  # fmt: skip
        written = processor_time()
        keys = store.designs()
        listed = processor_time()
        memory = peak_memory()
        table = store.table()
        read = processor_time()
        files = list(store.shards.glob("*.parquet"))
        size = sum(path.stat().st_size for path in files)
    print(f"{len(table)} rows in {len(files)} shards, {size / count:.0f} bytes a row")
    print(
        f"written in {written - before:.1f} s, {len(keys)} keys listed in {listed - written:.1f} s"
    )
    print(
        f"table read in {read - listed:.1f} s; memory {memory:.0f} MB, then {peak_memory():.0f} MB"
    )


WHAT = (
    "dask",
    "scheduler",
    "store",
    "speed",
    "simulated",
    "efficiency",
    "overhead",
    "kills",
    "finding",
)
"""Names of the measurements."""


def main() -> None:
    """Run the measurement that the command line selects."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=list(WHAT))
    parser.add_argument("count", nargs="?", type=int)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kind", choices=["parent", "worker"])
    given = parser.parse_args()
    if given.what == "speed":
        measure_speed(given.count or 1000, given.workers)
    elif given.what == "simulated":
        measure_simulated(given.count or 100, given.workers)
    elif given.what == "dask":
        measure_dask(given.count or 2000)
    elif given.what == "scheduler":
        measure_scheduler(given.count or 10_000, given.workers)
    elif given.what == "store":
        measure_store(given.count or 1_000_000)
    elif given.what in ("efficiency", "overhead", "finding"):
        {
            "efficiency": measure_efficiency,
            "overhead": measure_overhead,
            "finding": find_largest_robots,
        }[given.what]()
    else:
        kinds = (given.kind,) if given.kind else ("parent", "worker")
        test_kills(given.count or 3, kinds)


if __name__ == "__main__":
    main()
