"""Growth of processor time with the number of variants, configurations, stands and simulations."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from bare import make_smooth_tasks
from measure import take_turns

import pupper_analysis as pa

COUNTS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Numbers of repetitions that are measured."""


def measure_growth(variant: str, most: int, seconds: float) -> dict[str, list[tuple[int, float]]]:
    """Return {computation: points (number, time [s])}.

    Args:
        variant: Name of the robot.
        most: Largest number.
        seconds: Minimum duration of each measurement [s]; the median is returned.
    """
    robot = pa.load_variant(variant)
    stand = pa.solve_stand(robot)
    tasks, new = make_smooth_tasks(robot, 1000), itertools.count()  # a variant is derived but once
    jobs: dict[str, tuple[int, Callable[[int], object]]] = {
        "load_variant, each a new one": (
            50,
            lambda count: [
                pa.load_variant(pa.pupper.VariantSpec("v3", leg_scale=1 + 1e-5 * next(new)))
                for _ in range(count)
            ],
        ),
        "cross_check, by configurations": (
            200,
            lambda count: pa.cross_check(robot, configurations=count),
        ),
        "solve_stands, by stands": (1000, lambda count: pa.solve_stands(robot, tasks[:count])),
        "sweep_gains, by cells of 2 s": (
            20,
            lambda count: pa.simulation.sweep_gains(
                robot, stand, kp=np.linspace(5, 50, count), kd=[0.5], duration=2.0
            ),
        ),
    }
    return {
        name: [
            (count, statistics.median(take_turns([lambda: run(count)], 2, seconds)[0]))  # noqa: B023
            for count in COUNTS
            if count <= min(limit, most)
        ]
        for name, (limit, run) in jobs.items()
    }


def fit_exponent(points: Sequence[tuple[int, float]]) -> float:
    """Return the exponent p of time ~ count^p, fitted to the last decade of counts."""
    last = [(count, took) for count, took in points if count >= points[-1][0] / 10]
    counts, times = np.log(np.array(last)).T
    return float(np.polyfit(counts, times, 1)[0])


def draw_growth(found: dict[str, list[tuple[int, float]]], path: Path) -> None:
    """Draw time [s] against number, with logarithmic axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.subplots()
    for name, points in found.items():
        counts, seconds = zip(*points, strict=True)
        axes.loglog(counts, seconds, "o-", label=name, markersize=4)
    axes.set(xlabel="how many", ylabel="time (s)")
    axes.grid(True, which="major", alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=120)
