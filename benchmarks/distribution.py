"""Which contact forces last: `python benchmarks/distribution.py` prints two tables.

Random stands, on ground as soft as MuJoCo's, are simulated with the feed-forward torques of each
distribution of forces, with the model's own contact and with others.
"""

from __future__ import annotations

from dataclasses import dataclass

import click
import mujoco
import mujoco.rollout
import numpy as np
from rich.console import Console
from rich.table import Table
from stances import random_task

import pupper_analysis as pa
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.simulation.rollout import place_on_ground
from pupper_analysis.stance.stand import stand_statics

SECONDS = 12.0
JOINTS = 1e-3  # rad
TORQUES = 1e-2  # of the largest

CONTACTS: dict[str, dict[str, float]] = {
    "the model's own": {},
    "noslip_iterations 3": {"noslip_iterations": 3},
    "impratio 1": {"impratio": 1},
    "impratio 10000": {"impratio": 10_000},
}


@dataclass
class Run:
    """How far joints (rad) and torques (of the largest) are off at the end."""

    joints: float
    torques: float

    @property
    def holds(self) -> bool:
        return self.joints < JOINTS and self.torques < TORQUES


def simulate(
    robot: pa.Robot,
    stand: pa.Stand,
    distribution: pa.statics.ForceDistribution,
    options: dict[str, float],
) -> Run:
    torques = stand_statics(robot, stand, distribution=distribution).joint_torques
    drive = model_with_servos(robot)
    for name, value in options.items():
        setattr(drive.model.opt, name, value)
    positions = stand.joint_positions(robot)
    ctrl = drive.command(robot, positions, torques)
    start = place_on_ground(robot, drive, stand, torques)
    steps = round(SECONDS / drive.model.opt.timestep)
    states, _ = mujoco.rollout.rollout(
        drive.model, mujoco.MjData(drive.model), start, np.tile(ctrl, (1, steps, 1))
    )
    off = states[0, -1, 1 + robot.mj_convention.qpos_index[7:]] - positions
    return Run(
        joints=float(np.abs(off).max()),
        torques=float(np.abs(drive.kp * off).max() / np.abs(torques).max()),
    )


def random_stands(robot: pa.Robot, count: int, seed: int) -> list[pa.Stand]:
    """Level stands that are in reach and hold, with their feet sunk into the ground."""
    random, stands = np.random.default_rng(seed), []
    while len(stands) < count:
        task = random_task(robot, random)
        if not task.ground.level:
            continue
        try:
            stand = pa.stance.solve_stand_on_soft_ground(robot, task, explain=False)
            stand_statics(robot, stand)
        except pa.PupperAnalysisError:
            continue
        stands.append(stand)
    return stands


@click.command()
@click.option("--count", default=30, show_default=True, help="Random stands per robot.")
@click.option("--seed", default=0, show_default=True)
def main(count: int, seed: int) -> None:
    """Simulates random stands of v3 and original for 12 s with each distribution of forces."""
    out = Console(width=120)
    robots = [pa.load_variant(name) for name in ("v3", "original")]
    stands = [(robot, stand) for robot in robots for stand in random_stands(robot, count, seed)]
    table = Table(
        "contact", *pa.statics.ForceDistribution, title="hold for 12 s (1e-3 rad, 1 % of torque)"
    )
    worst = Table("contact", *pa.statics.ForceDistribution, title="median error of the torques (%)")
    for label, options in CONTACTS.items():
        runs = {
            distribution: [simulate(robot, stand, distribution, options) for robot, stand in stands]
            for distribution in pa.statics.ForceDistribution
        }
        table.add_row(label, *(f"{sum(r.holds for r in rs)} of {len(rs)}" for rs in runs.values()))
        worst.add_row(
            label, *(f"{100 * np.median([r.torques for r in rs]):.2g}" for rs in runs.values())
        )
    peaks = [
        [
            stand_statics(robot, stand, distribution=distribution).motor_utilisation.max()
            for distribution in pa.statics.ForceDistribution
        ]
        for robot, stand in stands
    ]
    out.print(table)
    out.print(worst)
    even, least, _ = np.array(peaks).T
    out.print(
        f"least torque has the greater peak in {(least > even * 1.001).sum()} of {len(peaks)}"
    )
    mean = np.mean(peaks, axis=0)
    out.print(
        "mean peak utilisation: "
        + ", ".join(
            f"{s} {100 * m:.1f} %" for s, m in zip(pa.statics.ForceDistribution, mean, strict=True)
        )
    )


if __name__ == "__main__":
    main()
