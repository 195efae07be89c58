"""Times that a user waits: whole commands by stage, and jobs that no engine does alone."""

from __future__ import annotations

import io
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from measure import Accuracy, Job, Rival, median_seconds
from rich.console import Console

import pupper_analysis as pa
from pupper_analysis.present.terminal import print_document
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.tools.analyze.analysis import analyze_variant, measure_leg_lengths
from pupper_analysis.tools.analyze.document import analysis_document

STEP = 0.02
"""Step [rad] of the grid search. Chosen, not tuned: the tutorial does not state its step."""


def jobs(variant: str) -> list[Job]:
    """Return the jobs that need more than one engine."""
    robot = pa.load_variant(variant)
    stand = pa.solve_stand(robot)
    return [_grid_search(), _cross_check(robot), _push(robot, stand)]


def search_grid(thigh: float, calf: float, height: float) -> tuple[float, float, float, float]:
    """Search the pose of a leg on a grid, as the tutorial describes it.

    A leg has two links in a plane, and zero abduction. Of all pairs of hip and knee angles, the
    pair is returned whose foot is nearest to the height below the hip and, with less weight,
    vertically below.

    Args:
        thigh: Length of the thigh [m].
        calf: Length of the calf [m].
        height: Height of the hip above the centre of the foot [m].

    Returns:
        Hip and knee angle [rad], and foot error forwards and upwards [m].
    """
    best = (math.inf, 0.0, 0.0, 0.0, 0.0)
    for hip in np.arange(0.0, 1.6, STEP).tolist():
        for knee in np.arange(-2.6, 0.0, STEP).tolist():
            x = -thigh * math.sin(hip) - calf * math.sin(hip + knee)
            z = -thigh * math.cos(hip) - calf * math.cos(hip + knee)
            score = (z + height) ** 2 + 0.25 * x**2
            if score < best[0]:
                best = score, hip, knee, x, z + height
    return best[1:]


def _grid_search() -> Job:
    """Return the job that solves the stand of the tutorial."""
    robot = pa.load_variant("original")
    stand = pa.solve_stand(robot)
    thigh, calf = measure_leg_lengths(robot)
    config = pa.Configuration(robot, stand.qpos)
    foot = robot.contact_points[0]
    hip = config.joint_position(next(name for name in robot.joint_names if name.endswith("HFE")))
    height = float(hip[2] - stand.foot_targets[foot][2])

    def missed() -> Accuracy:
        _, _, x, z = search_grid(thigh, calf, height)
        return Accuracy(math.hypot(x, z), np.inf, "m")

    return Job(
        "the tutorial's stand (original)",
        lambda: pa.solve_stand(robot),
        lambda: Accuracy(pa.solve_stand(robot).foot_error, 1e-9, "m, the feet"),
        peers=(
            Rival(
                f"grid search, one leg, {STEP:g} rad",
                lambda: search_grid(thigh, calf, height),
                missed,
            ),
        ),
    )


def _cross_check(robot: pa.Robot) -> Job:
    """Return the job that compares both files and engines."""

    def accuracy() -> Accuracy:
        check = pa.cross_check(robot)
        worst = max(quantity.relative for quantity in check.quantities)
        return Accuracy(worst, check.tolerance, "between engines and files, relative")

    return Job("cross_check, 20 configurations", lambda: pa.cross_check(robot), accuracy)


def _push(robot: pa.Robot, stand: pa.Stand) -> Job:
    """Return the job that searches the largest pushes."""

    def run() -> pa.simulation.PushRecovery:
        return pa.push_recovery(robot, stand, directions=4)

    def accuracy() -> Accuracy:
        first, second = run().impulses, run().impulses
        return Accuracy(float(np.abs(first - second).max()), 0.0, "N s between two runs")

    return Job("push_recovery, 4 directions", run, accuracy, quick=False)


def measure_start_up(repeats: int) -> dict[str, float]:
    """Return {command: start-up time [s]}."""
    commands = {
        "python -c pass": ["-c", "pass"],
        "import pupper_analysis": ["-c", "import pupper_analysis"],
        "... and a name of it": ["-c", "import pupper_analysis as pa; pa.Configuration"],
        "pupper-analysis --help": ["-m", "pupper_analysis", "--help"],
        "pupper-analysis stand --help": ["-m", "pupper_analysis", "stand", "--help"],
        "pupper-analysis analyze v3 --no-figures": [
            *("-m", "pupper_analysis", "analyze", "v3", "--no-figures")
        ],
    }

    # A named OpenGL is loaded before anything else (base/drivers.py), which few users ask for.
    plain = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}

    def run(arguments: list[str]) -> Callable[[], object]:
        command = [sys.executable, *arguments]
        return lambda: subprocess.run(command, check=True, capture_output=True, env=plain)

    return {name: median_seconds(run(given), repeats) for name, given in commands.items()}


def measure_default_run(names: Iterable[str]) -> dict[str, float]:
    """Return {stage: time [s]} of the default run for some variants."""
    from pupper_analysis.present.figures.pose import write_pose_figure
    from pupper_analysis.tools.analyze import figures as render
    from pupper_analysis.tools.analyze.comparison_figures import FIGURES

    taken: dict[str, float] = {}

    def stage(name: str, work: Callable[[], object]) -> None:
        start = time.perf_counter()
        work()
        taken[name] = time.perf_counter() - start

    robots = [pa.load_variant(name) for name in names]
    stands = [pa.solve_stand(robot) for robot in robots]
    pairs = list(zip(robots, stands, strict=True))
    stage("loading", lambda: [pa.load_variant(name) for name in names])
    stage("stands", lambda: [pa.solve_stand(robot) for robot in robots])
    stage("statics", lambda: [pa.stance.stand_statics(*pair) for pair in pairs])
    stage(
        "verification, fed forward and not",
        lambda: [
            pa.verify_stand(*pair, feedforward=message, duration=HOLD_DURATION)
            for pair in pairs
            for message in (True, False)
        ],
    )
    stage("gain sweeps", lambda: [pa.simulation.sweep_gains(*pair) for pair in pairs])
    stage("cross-checks", lambda: [pa.cross_check(robot) for robot in robots])
    analyses = [analyze_variant(robot) for robot in robots]
    quiet = Console(file=io.StringIO(), width=100)
    stage(
        "text",
        lambda: [
            print_document(quiet, analysis_document(analysis), everything=True)
            for analysis in analyses
        ],
    )
    with tempfile.TemporaryDirectory() as message:
        folder = Path(message)
        stage(
            "figures of poses",
            lambda: [
                write_pose_figure(robot, one.stand, one.statics, folder / f"{robot.name}.png")
                for robot, one in zip(robots, analyses, strict=True)
            ],
        )
        stage(
            "other figures",
            lambda: [draw(analyses, folder / name) for name, draw in FIGURES.items()],
        )
        stage("picture of all", lambda: render.render_variants(pairs, folder / "variants.png"))
    return taken
