"""Prediction errors of the files of a fitted robot, in stands that were not fitted.

    python benchmarks/fit_held_out.py --robot v3 [--kp 60] [--seeds 5] [--csv FILE]

Robots and stands are those of ``fit_disturbed.py``, without disturbance: simulated in MuJoCo alone,
with static friction. Three of four stands are fitted with the default settings; the fit writes
models, which are loaded again. With these models, the fitted kp and encoder offsets, and no
friction, the stands that were left out are simulated again; the same is done with the original
files. The errors of joints and base height are root mean squares over these stands, relative to the
true robot.
"""

from __future__ import annotations

import argparse
import csv
import math
import zlib
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from fit_disturbed import PLAIN, Planted, Rig, load_or_measure_stands, plant_errors

import pupper_analysis as pa
from pupper_analysis.pupper.variant_files import write_variant
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import resolve_servo_gains
from pupper_analysis.tools.fit.stands.fit import StandFit, fit_stands
from pupper_analysis.tools.fit.stands.plan import PlannedStand, StandPlan, plan_stands
from pupper_analysis.tools.fit.write import write_fit

HELD_OUT_INTERVAL = 4
"""Number of stands of which one is not fitted. Chosen, not tuned."""


@dataclass(frozen=True)
class Row:
    """Prediction errors of the files of a robot, before and after a fit.

    Errors of joints are in mrad, of base heights in mm; ``feet_before`` and ``feet_after`` are the
    numbers of stands in which the same feet carry load. ``fitted`` and ``predicted`` are numbers of
    stands.
    """

    robot: str
    seed: int
    fitted: int
    predicted: int
    outcome: str
    joints_before: float
    joints_after: float
    height_before: float
    height_after: float
    feet_before: int
    feet_after: int


def load_fitted_robot(name: str, robot: Robot, fit: StandFit, folder: Path) -> Robot:
    """Return the robot of the files that a fit writes to a folder."""
    files = write_variant(pa.VARIANTS[name], folder / "own") if name in pa.VARIANTS else None
    models = write_fit(robot, fit.posterior, folder, fit=fit, files=files).models
    files = [str(folder / one) for one in (models.urdf, models.mjcf) if one is not None]
    return pa.load_robot(*files)


Taken = tuple[np.ndarray, float, list[int]]
"""Encoder readings (nu,) [rad], height of the base [m], and indices of the feet without load."""


def simulate_stands(rig: Rig, stands: list[PlannedStand], robot: Robot) -> list[Taken | None]:
    """Return the measurements of each planned stand; None for a robot that falls.

    Args:
        rig: Simulated robot.
        stands: Planned stands.
        robot: Robot whose foot names the stands use; the files of the rig may use others.
    """
    said, own, found = list(robot.feet), list(rig.robot.feet), []
    for one in stands:
        swing = tuple(own[said.index(foot)] for foot in one.swing)
        taken = rig.simulate_stand(replace(one, swing=swing), np.zeros(3))
        found.append(taken and (taken[0], rig.height, [own.index(foot) for foot in taken[1]]))
    return found


def compute_errors(
    found: list[Taken | None], truth: list[Taken | None]
) -> tuple[float, float, int]:
    """Return the errors of simulated stands relative to the true robot.

    Returns:
        Root mean square of joint errors [mrad] and of base height errors [mm], and number of
        stands in which the same feet carry load.
    """
    joints, heights, feet = [], [], 0
    for one, true in zip(found, truth, strict=True):
        if one is not None and true is not None:
            joints.append(one[0] - true[0])
            heights.append(one[1] - true[1])
            feet += one[2] == true[2]
    if not joints:
        return math.nan, math.nan, 0
    rms = [float(np.sqrt(np.mean(np.square(one)))) for one in (joints, heights)]
    return round(1e3 * rms[0], 2), round(1e3 * rms[1], 2), feet


def make_row(
    name: str, seed: int, robot: Robot, kp: float | None, plan: StandPlan, keep: Path | None
) -> Row | None:
    """Fit a robot with random errors, and return the prediction errors; None if the robot does not
    stand.
    """
    planted = plant_errors(robot, np.random.default_rng([seed, zlib.crc32(name.encode())]))
    stated = resolve_servo_gains(robot, kp, None if kp is None else 0.0).kp
    if kp is not None:
        planted = replace(planted, kp=planted.kp * kp / resolve_servo_gains(robot).kp)
    rig = Rig(planted, PLAIN)
    taken = load_or_measure_stands(name, "none", seed, rig, lambda: plan, keep)
    if taken is None:
        return None
    places = [at for at in range(len(taken)) if at % HELD_OUT_INTERVAL == HELD_OUT_INTERVAL - 1]
    fit = fit_stands(
        robot,
        taken.select_rows([at for at in range(len(taken)) if at not in places]),
        weight=rig.robot.total_mass * planted.scale,
        kp=kp,
    )
    by = {one.name: one for one in plan.stands}
    left = [by[taken.names[at]] for at in places]
    truth = simulate_stands(rig, left, robot)
    mean = {one.name: one.mean for one in fit.estimates}
    numbers = partial(Planted, robot, truth={}, scale=1.0, added=np.zeros(4))
    with TemporaryDirectory() as folder:
        fitted = replace(
            load_fitted_robot(name, robot, fit, Path(folder)), fingerprint=robot.fingerprint
        )
    before = numbers(robot=robot, kp=stated, offsets=np.zeros(robot.nu))
    names = robot.joint_names
    after = numbers(
        robot=fitted,
        kp=np.array([mean.get(f"kp {n}", k) for n, k in zip(names, stated, strict=True)]),
        offsets=np.array([mean[f"offset {n}"] for n in names]),
    )
    smooth = replace(PLAIN, stiction=0.0)
    (j0, h0, f0), (j1, h1, f1) = (
        compute_errors(simulate_stands(Rig(one, smooth), left, robot), truth)
        for one in (before, after)
    )
    said = "EXPLAINED" if fit.explained else "NOT EXPLAINED"
    return Row(name, seed, len(taken) - len(places), len(left), said, j0, j1, h0, h1, f0, f1)


def main() -> None:
    """Run the fits that the command line selects, and print a row for each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robot", default="v3", help="a variant, or a file")
    parser.add_argument("--kp", type=float, help="of the servos, where the file states none")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--keep", type=Path, help="a folder of measurements: what it has is used")
    parser.add_argument("--csv", type=Path, help="a file to add rows to")
    given = parser.parse_args()
    known = given.robot in pa.VARIANTS
    robot = pa.load_variant(given.robot) if known else pa.load_robot(given.robot)
    plan = plan_stands(robot, 16, kp=given.kp, added=0.0)
    for seed in range(given.first, given.first + given.seeds):
        found = make_row(Path(given.robot).stem, seed, robot, given.kp, plan, given.keep)
        if found is None:
            continue
        print(*vars(found).values(), sep=" | ", flush=True)
        if given.csv:
            new = not given.csv.exists()
            with given.csv.open("a", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                if new:
                    writer.writerow(vars(found))
                writer.writerow(vars(found).values())


if __name__ == "__main__":
    main()
