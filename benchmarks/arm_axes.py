"""Measure whether a reversed axis of an arm is visible in one file.

    python benchmarks/arm_axes.py --robots FOLDER --csv docs/data/arm-axes.csv

FOLDER is a site-packages folder with public robots (see benchmarks/corpus.py). A reversed axis with
a symmetric range describes the same set of postures. With another range, the postures change: the
table contains the fraction of random postures, within the limits, in which shapes of the arm
penetrate each other by more than 5 mm, as published and with the joint's sign reversed.
"""

from __future__ import annotations

from pathlib import Path

import click
import mujoco
import numpy as np
from corpus import DATA
from planted import PACKAGE, ROBOTS
from tables import write_csv

import pupper_analysis as pa

ARMS = ("panda", "ur5", "z1", "xarm7", "kinova", "so101")
"""Arms of benchmarks/planted.py."""

NUM_POSTURES = 400
"""Random postures for each joint and sign."""

MIN_DEPTH = 0.005
"""Penetration of two shapes that counts as a collision [m]. Chosen, not tuned."""

SYMMETRY_TOLERANCE = 0.02
"""Largest distance of the middle of a range from zero, relative to the width, of a symmetric range.
Chosen, not tuned."""


def measure_collisions(
    model: mujoco.MjModel, limits: dict[int, tuple[float, float]], turned: int | None, seed: int
) -> float:
    """Return the fraction of random postures with a collision; ``turned`` is the reversed joint."""
    random, data, count = np.random.default_rng(seed), mujoco.MjData(model), 0
    for _ in range(NUM_POSTURES):
        for joint, (lower, upper) in limits.items():
            angle = random.uniform(lower, upper)
            data.qpos[model.jnt_qposadr[joint]] = -angle if joint == turned else angle
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        count += bool((data.contact.dist[: data.ncon] < -MIN_DEPTH).any())
    return count / NUM_POSTURES


@click.command()
@click.option("--robots", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--seed", type=int, default=5, show_default=True)
@click.option("--csv", "to", type=click.Path(path_type=Path), help="Write the table here.")
def main(robots: Path, seed: int, to: Path | None) -> None:
    """Compare self-collisions of arms with published and reversed joints."""
    share, rows = (robots / DATA).parent.resolve(), []
    for name in ARMS:
        robot = pa.load_robot(robots / ROBOTS[name], packages={PACKAGE: share})
        model = robot.mj_model
        limits = {
            joint: tuple(model.jnt_range[joint] if model.jnt_limited[joint] else (-np.pi, np.pi))
            for joint in range(model.njnt)
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE.value
        }
        for joint, (lower, upper) in limits.items():
            symmetric = abs(lower + upper) < SYMMETRY_TOLERANCE * (upper - lower)
            fractions = [
                "" if symmetric else f"{measure_collisions(model, limits, turned, seed):.2f}"
                for turned in (None, joint)
            ]
            rows.append(
                (name, model.joint(joint).name, f"{lower:.2f}", f"{upper:.2f}",
                 "yes" if symmetric else "no", *fractions)
            )  # fmt: skip
            click.echo(" | ".join(rows[-1]))
    if to is not None:
        columns = (
            "arm", "joint", "lower (rad)", "upper (rad)", "symmetric range",
            "collisions as published", "collisions reversed",
        )  # fmt: skip
        write_csv(to, columns, rows)


if __name__ == "__main__":
    main()
