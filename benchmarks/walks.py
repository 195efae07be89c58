"""Speed of the simulation of a walking v3 per core, and its scaling to two cores.

    python benchmarks/walks.py [--policy policy_latest.json] [--robot v3]

Without a policy, the trot of the tests is used; Pupper's own policy is in
https://github.com/G-Levine/neural_controller (`launch/policy_latest.json`, MIT). The speed per core
uses processor time, which depends little on other programs; the time of MuJoCo's steps alone, with
the same commands, is printed beside it. Scaling uses elapsed time, so it is meaningful on an idle
machine only. The exit status is 1 if the speed is below 50 times real time, or the scaling to two
cores below 1.8.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import mujoco
import mujoco.rollout
import numpy as np

import pupper_analysis as pa
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import Lockstep, Run, Stage, prepare_stage, simulate_cases

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.tools.walk import made

RUNS, SECONDS, REPEATS = 16, 8.0, 5
"""Number of runs, simulated time of each [s], and number of repetitions."""

FASTER, SCALES = 50.0, 1.8
"""Minimum ratio of simulated to processor time, and minimum speed-up by a second core."""


def simulate_runs(stage: Stage, count: int, workers: int) -> list[Run]:
    """Simulate a policy with several seeds, and return the runs."""
    cases = [stage.make_case(np.array([0.5, 0.0, 0.0]), seed) for seed in range(count)]
    return list(simulate_cases(stage, cases, SECONDS, 2.0, workers))


def time_of_steps(stage: Stage, runs: Sequence[Run]) -> float:
    """Return the processor time [s] of MuJoCo's steps with the commands of some runs of equal
    length.
    """
    starts = Lockstep(stage, [run.case for run in runs]).current
    commands = np.array([run.targets for run in runs])
    data, runner = mujoco.MjData(stage.model), mujoco.rollout.Rollout(nthread=0)
    begin = time.process_time()
    runner.rollout([stage.model] * len(runs), data, starts, commands)
    return time.process_time() - begin


def main() -> int:
    """Measure speed and scaling; return 1 if one of them is too low."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--policy", type=Path, help="A policy; by default the trot of the tests.")
    parser.add_argument("--robot", default="v3", help="A variant.")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        policy = Policy.load(given.policy or made.trot(Path(place) / "trot.json"))
    stage = prepare_stage(pa.load_variant(given.robot), policy)
    simulate_runs(stage, 2, 1)  # what is loaded at first use
    simulated = RUNS * SECONDS
    ours, bare = [], []
    for _ in range(REPEATS):
        begin = time.process_time()
        runs = simulate_runs(stage, RUNS, 1)
        ours.append(time.process_time() - begin)
        bare.append(time_of_steps(stage, [run for run in runs if not run.fallen]))
        walked = sum(not run.fallen for run in runs)
    fast, steps = simulated / min(ours), walked * SECONDS / min(bare)
    print(f"{given.robot} by {policy.name}, {walked} of {RUNS} runs of {SECONDS:g} s do not fall")
    print(f"{fast:.1f} times real time per core; MuJoCo's steps alone {steps:.1f} times")
    taken = []
    for workers in (1, 2):
        begin = time.perf_counter()
        simulate_runs(stage, 100, workers)
        taken.append(time.perf_counter() - begin)
    scales = taken[0] / taken[1]
    print(f"100 runs: {taken[0]:.1f} s on one core, {taken[1]:.1f} s on two: {scales:.2f} times")
    return int(fast < FASTER or scales < SCALES)


if __name__ == "__main__":
    sys.exit(main())
