"""Compare the spectrum of a simulation step with nudged simulations.

    python benchmarks/stability.py [COUNT] [--seed SEED] [--files FILE.xml ...]

Random variants, stances, payloads and gains (and MJCFs with a keyframe, each at three time steps)
are judged by ``step_stability``, and simulated for 12 s after three random nudges of 1e-3 m/s and
rad/s. A robot *leaves* if a joint moves more than 1e-2 rad from its position at any time, *goes on*
if a nudge does not decay, and *stays* otherwise. Disagreements are marked; the last table contains
the counts.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

import pupper_analysis as pa
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.robot.stability import (
    HOLD_DURATION,
    Mode,
    Stability,
    step_stability,
)
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.simulation.rollout import (
    STATE_SPEC,
    full_state,
    place_on_ground,
    simulate_commands,
)
from pupper_analysis.simulation.stability import (
    MAX_JOINT_DISPLACEMENT,
    NUDGE_SPEED,
    measure_response,
)

Array = NDArray[np.float64]

NUM_NUDGES = 3
"""Number of nudges per case."""

NUM_DOUBLINGS = 14.0
"""Number of doublings of a mode after which a nudge of 1e-3 (some 1e-5 rad) becomes 0.1 rad. A
case that the spectrum rejects is simulated for this time, if it exceeds 12 s."""

HARD_NUDGE_SPEED = 0.3
"""Speed of a stronger nudge [m/s, rad/s], which overcomes dry friction. Chosen, not tuned."""

MAX_DURATION = NUM_DOUBLINGS * HOLD_DURATION
"""Maximum simulated time [s]: modes that grow more slowly than in ``HOLD_DURATION`` are not
rejected."""


@dataclass
class Case:
    """Model at rest under a command."""

    name: str
    model: mujoco.MjModel
    start: Array
    ctrl: Array


@dataclass
class Response:
    """Response to nudges, in the worst case.

    Attributes:
        way: Largest displacement of a joint [rad, m]: at any time, or at the end of a stronger
            nudge, which itself displaces joints.
        goes_on: Whether a nudge did not decay: an oscillation may end in a limit cycle of
            milliradians.
    """

    way: float
    goes_on: bool

    @property
    def word(self) -> str:
        """Response in a word: leaves, goes on or stays."""
        if not self.way < MAX_JOINT_DISPLACEMENT:
            return "leaves"
        return "goes on" if self.goes_on else "stays"


def draw_cases(count: int, seed: int = 0) -> Iterator[Case]:
    """Yield random stands of the variants with random gains, and feed-forward."""
    random = np.random.default_rng(seed)
    names = sorted(pa.VARIANTS)
    while count:
        name = str(random.choice(names))
        robot = pa.load_variant(name)
        mass = float(random.choice([0.0, 0.0, random.uniform(0, 3)]))
        loaded = pa.robot.with_payload(robot, mass, [0.0, 0.0, 0.05]) if mass else robot
        swing = {str(random.choice(robot.contact_points)): 0.02} if random.random() < 0.2 else {}
        try:
            task = pa.StandTask(
                height=robot.stand_height * float(random.uniform(0.7, 1.05)),
                roll=float(random.normal(0, 0.05)),
                pitch=float(random.normal(0, 0.05)),
                swing=swing,
                com="inside" if swing else None,
                com_margin=0.01 if swing else 0.0,
            )
            stand = pa.stance.solve_stand_on_soft_ground(loaded, task)
        except pa.PupperAnalysisError:
            continue
        own = model_with_servos(loaded)
        kp = own.kp * float(np.exp(random.uniform(np.log(0.2), np.log(30))))
        kd = own.kd * float(np.exp(random.uniform(np.log(0.3), np.log(30))))
        ground = build_on_ground(loaded, stand.task.ground, stand.foot_targets)
        torques = pa.stance.stand_statics(ground, stand).joint_torques
        drive = model_with_servos(ground, kp, kd)
        ctrl = drive.command(ground, stand.joint_positions(ground), torques)
        what = f"{name} kp {kp[0]:.3g} kd {kd[0]:.3g} {mass:.2g} kg {'3 legs' if swing else ''}"
        yield Case(what, drive.model, place_on_ground(ground, drive, stand, torques), ctrl)
        count -= 1


def read_cases(paths: list[str]) -> Iterator[Case]:
    """Yield MJCFs at their first keyframes, with half, once and twice the time step of the file.

    Files without a keyframe are left out.
    """
    for path in paths:
        for factor in (0.5, 1.0, 2.0):
            model = mujoco.MjModel.from_xml_path(path)
            if not model.nkey:
                continue
            model.opt.timestep *= factor
            data = mujoco.MjData(model)
            mujoco.mj_resetDataKeyframe(model, data, 0)
            step = f"{1e3 * model.opt.timestep:g} ms"
            yield Case(f"{path} {step}", model, full_state(model, data), data.ctrl.copy())


def judge_case(case: Case) -> tuple[Stability, float]:
    """Return the stability of a case by the spectrum, and the time of the computation [ms]."""
    data = mujoco.MjData(case.model)
    mujoco.mj_setState(case.model, data, case.start, STATE_SPEC)
    data.ctrl[:] = case.ctrl
    begun = time.process_time()
    found = step_stability(case.model, data)
    return found, 1e3 * (time.process_time() - begun)


def simulated_time(mode: Mode) -> float:
    """Return the time [s] of the simulation of a case with a growing mode."""
    return min(max(HOLD_DURATION, NUM_DOUBLINGS * (mode.doubling_time or 0.0)), MAX_DURATION)


def simulate_nudges(
    case: Case, duration: float, speed: float = NUDGE_SPEED, *, enough: float = float("inf")
) -> Response:
    """Simulate a case after nudges.

    Args:
        case: The case.
        duration: Simulated time [s].
        speed: Speed of the nudges [m/s, rad/s].
        enough: Displacement [rad, m] after which no further nudge is simulated.
    """
    model, steps = case.model, round(duration / case.model.opt.timestep)
    settled = simulate_commands(
        model, case.start, np.tile(case.ctrl, (round(1 / model.opt.timestep), 1))
    )[-1]
    if abs(settled[0] - case.start[0] - 1.0) > 0.01 or not np.isfinite(settled).all():
        return Response(np.inf, goes_on=True)
    found = Response(0.0, goes_on=False)
    for seed in range(NUM_NUDGES):
        start = settled.copy()
        rates = slice(1 + model.nq, 1 + model.nq + model.nv)
        start[rates] += speed * np.random.default_rng(seed).uniform(-1, 1, model.nv)
        states = simulate_commands(model, start, np.tile(case.ctrl, (steps, 1)))
        whole = np.isfinite(states).all() and (np.diff(states[:, 0]) > 0).all()
        nudge = measure_response(model, settled, states)
        way = nudge.moved if speed > NUDGE_SPEED else nudge.farthest
        found.way = max(found.way, way if whole else np.inf)
        found.goes_on |= not nudge.decayed
        if found.way > enough:
            break
    return found


def simulate_case(case: Case, leaving: tuple[Mode, ...]) -> Response:
    """Simulate nudges of a case; longer, and with stronger nudges, if modes are growing."""
    found = simulate_nudges(case, HOLD_DURATION)
    if not leaving or found.word == "leaves" or (found.goes_on and leaving[0].shakes):
        return found
    longer = simulated_time(leaving[0])
    found = (
        simulate_nudges(case, longer, enough=MAX_JOINT_DISPLACEMENT)
        if longer > HOLD_DURATION
        else found
    )
    return (
        found if found.word != "stays" else simulate_nudges(case, HOLD_DURATION, HARD_NUDGE_SPEED)
    )


def main() -> None:
    """Judge and simulate all cases, and print the result of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--files", nargs="*", default=[])
    given = parser.parse_args()
    message: Counter[tuple[str, str]] = Counter()
    spent = []
    for case in (*draw_cases(given.count, given.seed), *read_cases(given.files)):
        found, took = judge_case(case)
        spent.append(took)
        leaving = found.modes_growing_within() if found.at_rest else ()
        if not found.at_rest:
            says = "not at rest"
        elif not leaving:
            says = "holds"
        elif leaving[0].without_dry_friction:
            says = "shakes without dry friction"
        else:
            says = "shakes" if leaving[0].shakes else "buckles"
        saw = simulate_case(case, leaving)
        message[says, saw.word] += 1
        differs = "DIFFERS: " if (says == "holds") != (saw.word == "stays") else ""
        mode = leaving[0] if leaving else found.least_damped
        print(f"{differs}{case.name}: {says}, {saw.word} ({saw.way:.1e} rad); {mode}", flush=True)
    print(f"{sum(message.values())} cases, {np.median(spent or [0]):.1f} ms each (median)")
    for (says, word), number in sorted(message.items()):
        print(f"{says:30s} {word:10s} {number}")


if __name__ == "__main__":
    main()
