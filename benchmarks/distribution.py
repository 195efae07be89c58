"""Compare the stands of force distributions: `python benchmarks/distribution.py` prints two tables.

Random stands on MuJoCo's soft ground are simulated with the feed-forward torques of each force
distribution, with the contact parameters of the model and with others.
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
"""Simulated time [s]."""

MAX_JOINT_ERROR = 1e-3  # rad
"""Largest joint error [rad] of a stand that holds."""

MAX_TORQUE_ERROR = 1e-2  # of the largest
"""Largest torque error, relative to the largest torque, of a stand that holds."""

CONTACTS: dict[str, dict[str, float]] = {
    "the model's own": {},
    "noslip_iterations 3": {"noslip_iterations": 3},
    "impratio 1": {"impratio": 1},
    "impratio 10000": {"impratio": 10_000},
}
"""{label: MuJoCo options}."""


@dataclass
class Run:
    """Errors at the end of a simulation.

    Attributes:
        joints: Largest joint error [rad].
        torques: Largest torque error, relative to the largest torque.
    """

    joints: float
    torques: float

    @property
    def holds(self) -> bool:
        """Whether both errors are below their limits."""
        return self.joints < MAX_JOINT_ERROR and self.torques < MAX_TORQUE_ERROR


def simulate_stand(
    robot: pa.Robot,
    stand: pa.Stand,
    distribution: pa.statics.ForceDistribution,
    options: dict[str, float],
) -> Run:
    """Simulate a stand with the torques of a force distribution, and return the errors at the end.

    Args:
        robot: Robot.
        stand: Stand on soft ground.
        distribution: Force distribution.
        options: {MuJoCo option: value} that differ from the model.
    """
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


def draw_stands(robot: pa.Robot, count: int, seed: int) -> list[pa.Stand]:
    """Return random feasible stands on level soft ground."""
    random, stands = np.random.default_rng(seed), []
    while len(stands) < count:
        task = random_task(robot, random)
        if not task.ground.is_level:
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
    """Simulate random stands of v3 and original for 12 s with each force distribution."""
    out = Console(width=120)
    robots = [pa.load_variant(name) for name in ("v3", "original")]
    stands = [(robot, stand) for robot in robots for stand in draw_stands(robot, count, seed)]
    table = Table(
        "contact", *pa.statics.ForceDistribution, title="hold for 12 s (1e-3 rad, 1 % of torque)"
    )
    worst = Table("contact", *pa.statics.ForceDistribution, title="median error of the torques (%)")
    for label, options in CONTACTS.items():
        runs = {
            distribution: [
                simulate_stand(robot, stand, distribution, options) for robot, stand in stands
            ]
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
