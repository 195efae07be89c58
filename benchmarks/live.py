"""Processor time in which the live page responds to a moved slider: solver, forces, scene and
texts.

    python benchmarks/live.py [--variant v3] [--moves 300]

Each move is a step of a slider. The data for browsers are created and put into viser's queue, but
no browser draws them. Times are processor times of the thread, since the elapsed time depends on
other processes.
"""

from __future__ import annotations

import statistics
import time

import click
import numpy as np

import pupper_analysis as pa
from pupper_analysis.tools.live import render
from pupper_analysis.tools.live.documents import stance_document
from pupper_analysis.tools.live.model import StanceSolver, predict_sag
from pupper_analysis.tools.live.scene import Scene
from pupper_analysis.tools.live.server import DEFAULT_HOST
from pupper_analysis.tools.live.session import Panels, Session
from pupper_analysis.tools.live.state import State


class StubSession(Session):
    """Session whose buttons nobody presses."""

    def __init__(self) -> None:
        pass


def measure_moves(variant: str, moves: int) -> dict[str, list[float]]:
    """Return {part: processor times [s] of each move}; "all, by the clock" is elapsed time."""
    model = StanceSolver(pa.load_variant(variant))
    port = render.find_free_port(DEFAULT_HOST, None)
    server = render.start_server(DEFAULT_HOST, port, "benchmark")
    taken: dict[str, list[float]] = {name: [] for name in ("solve and forces", "scene", "words")}
    wall = taken["all, by the clock"] = []
    try:
        scene = Scene(server.scene)
        panels = Panels(server, model, StubSession(), render.Translator())
        for angle in np.sin(np.linspace(0.0, 12.0, moves)):
            begun, since = time.perf_counter(), time.thread_time()
            answer = model.solve_state(State(roll=float(12 * angle), height=130.0))
            assert answer.refusal is None, answer.refusal
            solved = time.thread_time()
            with server.atomic():
                scene.show(answer)
                shown = time.thread_time()
                panels.show_status(stance_document(answer, None, None))
                panels.clear_results()
            done = time.thread_time()
            wall.append(time.perf_counter() - begun)
            for name, took in zip(
                taken, (solved - since, shown - solved, done - shown), strict=False
            ):
                taken[name].append(took)
        since = time.thread_time()
        predict_sag(answer)
        taken["sag, once it is still"] = [time.thread_time() - since]
    finally:
        render.stop_server(server)
    return taken


@click.command()
@click.option("--variant", default="v3", show_default=True)
@click.option("--moves", default=300, show_default=True)
def main(variant: str, moves: int) -> None:
    """Print the median times, and the resulting number of moves per second."""
    taken = measure_moves(variant, moves)
    for name, times in taken.items():
        print(f"{name:24} {1e3 * statistics.median(times):7.2f} ms")
    work = sum(statistics.median(taken[name]) for name in ("solve and forces", "scene", "words"))
    clock = statistics.median(taken["all, by the clock"])
    print(f"moves a second           {1 / work:7.0f} of work, {1 / clock:.0f} by the clock")


if __name__ == "__main__":
    main()
