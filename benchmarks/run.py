"""Measures the package: `python benchmarks/run.py` prints a table of medians.

Nothing here is asserted: times belong to a machine, and tests must not depend on one.
"""

from __future__ import annotations

import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable

import bare
import click
import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

import pupper_analysis as pa
from pupper_analysis.robot.servos import servos
from pupper_analysis.simulation.rollout import place_on_ground


def median_seconds(job: Callable[[], object], repeats: int) -> float:
    job()  # what is loaded on first use is not measured
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        job()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def import_seconds(statement: str, repeats: int) -> float:
    command = [sys.executable, "-c", statement]
    return median_seconds(lambda: subprocess.run(command, check=True), repeats)


def steps_per_second(robot: pa.Robot, stand: pa.Stand, batch: int, steps: int) -> float:
    drive = servos(robot)
    ctrl = drive.command(robot, stand.joint_positions(robot))
    torques = pa.gravity_compensation(pa.Configuration(robot, stand.qpos)).joint_torques
    start = place_on_ground(robot, drive, stand, torques)
    datas = [mujoco.MjData(drive.model) for _ in range(2)]
    control = np.tile(ctrl, (1, steps, 1))
    with mujoco.rollout.Rollout(nthread=2) as pool:
        seconds = median_seconds(
            lambda: pool.rollout([drive.model] * batch, datas, np.tile(start, (batch, 1)), control),
            3,
        )
    return batch * steps / seconds


@click.command()
@click.option("--variant", default="v3", show_default=True, help="The robot to measure with.")
@click.option("--repeats", default=10, show_default=True, help="Runs per line.")
def main(variant: str, repeats: int) -> None:
    """Measure how long each part of the package takes."""
    robot = pa.load_variant(variant)
    stand = pa.solve_stand(robot)
    config = pa.Configuration(robot, stand.qpos)
    apart = pa.StandTask(self_clearance=0.001)
    squat = [pa.StandTask(), pa.StandTask(height=0.9 * robot.stand_height)]
    jobs: list[tuple[str, Callable[[], object]]] = [
        ("load_variant (base model)", lambda: pa.load_variant(pa.VariantSpec(base="v3"))),
        ("load_variant (derived)", lambda: pa.load_variant("v3-long-leg")),
        ("Configuration", lambda: pa.Configuration(robot, stand.qpos)),
        ("foot_jacobians", config.foot_jacobians),
        ("mass_matrix", config.mass_matrix),
        ("gravity_compensation", lambda: pa.gravity_compensation(config)),
        ("solve_stand", lambda: pa.solve_stand(robot)),
        ("solve_stand (links apart)", lambda: pa.solve_stand(robot, apart)),
        ("sunk_stand", lambda: pa.sunk_stand(robot)),
        ("steady_state", lambda: pa.steady_state(robot, stand)),
        ("stance_path (2 s, 101 samples)", lambda: pa.stance_path(robot, squat, 2.0)),
        ("base_workspace", lambda: pa.base_workspace(robot)),
        ("verify_stand (5 s simulated)", lambda: pa.verify_stand(robot, stand)),
        ("sweep_gains (16 cells of 4 s)", lambda: pa.sweep_gains(robot, stand)),
        ("cross_check (20 configurations)", lambda: pa.cross_check(robot)),
    ]
    table = Table("what", "median", title=f"{variant}, {platform.machine()}, {platform.system()}")
    table.columns[1].justify = "right"
    for statement in ("import pupper_analysis", "import pupper_analysis as pa; pa.Configuration"):
        table.add_row(f"python -c '{statement}'", f"{1e3 * import_seconds(statement, 5):.0f} ms")
    for name, job in jobs:
        table.add_row(name, f"{1e3 * median_seconds(job, repeats):.3f} ms")
    speed = steps_per_second(robot, stand, 16, 1000)
    table.add_row("mujoco.rollout, 2 threads", f"{speed / 1e3:.0f} k steps/s")
    Console().print(table)
    Console().print(engines(variant, repeats))


def engines(variant: str, repeats: int) -> Table:
    """Compares with the bare engines; ours and theirs take turns, so that both meet the same."""
    columns = ("what", "ours", "bare engine", "ratio", "goal", "engine", "accuracy")
    table = Table(*columns, title=f"{variant} against the bare engines, medians")
    for job in bare.jobs(variant):
        ours, theirs = take_turns((job.ours, job.bare), repeats)
        table.add_row(
            job.name,
            f"{1e3 * ours:.3f} ms",
            f"{1e3 * theirs:.3f} ms",
            f"{ours / theirs:.2f}",
            f"{job.goal:.2f}",
            job.engine,
            job.accuracy(),
        )
    return table


def take_turns(both: tuple[Callable[[], object], ...], repeats: int) -> list[float]:
    """Returns the median time of each of some jobs, run by turns for a second or longer (s)."""
    times: list[list[float]] = [[] for _ in both]
    for job in both:
        job()
    end = time.perf_counter() + 1.0
    while len(times[0]) < repeats or time.perf_counter() < end:
        for job, taken in zip(both, times, strict=True):
            start = time.perf_counter()
            job()
            taken.append(time.perf_counter() - start)
    return [statistics.median(taken) for taken in times]


if __name__ == "__main__":
    main()
