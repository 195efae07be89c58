"""The spectrum of a step against nudged simulations: do both say the same of what stands?

    python benchmarks/stability.py [COUNT] [--seed SEED] [--files FILE.xml ...]

Random variants, stances, payloads and gains (and MJCFs with a keyframe, each at three time steps)
are judged by ``step_stability``, and simulated for 12 s, nudged by 1e-3 m/s and rad/s in three
random ways. A robot *leaves* if a joint is further than 1e-2 rad from where it was at any time,
*goes on* if a nudge does not decay, and *stays* otherwise. What differs is marked; the
last table counts.
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

NUDGES = 3

DOUBLINGS = 14.0
"""After so many a nudge of 1e-3 (some 1e-5 rad) is 0.1 rad: what is refused is simulated for so
long, if that is longer than 12 s."""

HARD = 0.3
"""Of a push beyond dry friction (m/s, rad/s), which frees what that holds."""

SLOW = DOUBLINGS * HOLD_DURATION
"""Longer is not waited (s): what buckles more slowly than in ``HOLD_DURATION`` is not refused."""


@dataclass
class Case:
    """A model at rest, under a command."""

    name: str
    model: mujoco.MjModel
    start: Array
    ctrl: Array


@dataclass
class Seen:
    """What became of nudges, at worst.

    Attributes:
        way: The greatest way of a joint from where it was before (rad, m): at any time, or at the
            end of a harder push, which itself takes joints away.
        goes_on: Whether one did not decay: what shakes may end in a cycle of milliradians.
    """

    way: float
    goes_on: bool

    @property
    def word(self) -> str:
        """One word for it."""
        if not self.way < MAX_JOINT_DISPLACEMENT:
            return "leaves"
        return "goes on" if self.goes_on else "stays"


def variants(count: int, seed: int = 0) -> Iterator[Case]:
    """Yields random stands of the variants on random gains, with feed-forward."""
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


def files(paths: list[str]) -> Iterator[Case]:
    """Yields MJCFs from their keyframes, at their time step, half and twice of it."""
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


def judged(case: Case) -> tuple[Stability, float]:
    """Judges a case, and tells how long that took (ms)."""
    data = mujoco.MjData(case.model)
    mujoco.mj_setState(case.model, data, case.start, STATE_SPEC)
    data.ctrl[:] = case.ctrl
    begun = time.process_time()
    found = step_stability(case.model, data)
    return found, 1e3 * (time.process_time() - begun)


def waited(mode: Mode) -> float:
    """Returns for how long a stand is simulated that a mode is said to take away (s)."""
    return min(max(HOLD_DURATION, DOUBLINGS * (mode.doubling_time or 0.0)), SLOW)


def seen(
    case: Case, duration: float, speed: float = NUDGE_SPEED, *, enough: float = float("inf")
) -> Seen:
    """Simulates what nudges do to a case.

    Nudges after one that takes it ``enough`` away (rad) are not tried.
    """
    model, steps = case.model, round(duration / case.model.opt.timestep)
    settled = simulate_commands(
        model, case.start, np.tile(case.ctrl, (round(1 / model.opt.timestep), 1))
    )[-1]
    if abs(settled[0] - case.start[0] - 1.0) > 0.01 or not np.isfinite(settled).all():
        return Seen(np.inf, goes_on=True)
    found = Seen(0.0, goes_on=False)
    for seed in range(NUDGES):
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


def tried(case: Case, leaving: tuple[Mode, ...]) -> Seen:
    """Simulates nudges of a case; longer, and harder, if modes are said to take it away."""
    found = seen(case, HOLD_DURATION)
    if not leaving or found.word == "leaves" or (found.goes_on and leaving[0].shakes):
        return found
    longer = waited(leaving[0])
    found = seen(case, longer, enough=MAX_JOINT_DISPLACEMENT) if longer > HOLD_DURATION else found
    return found if found.word != "stays" else seen(case, HOLD_DURATION, HARD)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--files", nargs="*", default=[])
    given = parser.parse_args()
    message: Counter[tuple[str, str]] = Counter()
    spent = []
    for case in (*variants(given.count, given.seed), *files(given.files)):
        found, took = judged(case)
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
        saw = tried(case, leaving)
        message[says, saw.word] += 1
        differs = "DIFFERS: " if (says == "holds") != (saw.word == "stays") else ""
        mode = leaving[0] if leaving else found.slowest
        print(f"{differs}{case.name}: {says}, {saw.word} ({saw.way:.1e} rad); {mode}", flush=True)
    print(f"{sum(message.values())} cases, {np.median(spent or [0]):.1f} ms each (median)")
    for (says, word), number in sorted(message.items()):
        print(f"{says:30s} {word:10s} {number}")


if __name__ == "__main__":
    main()
