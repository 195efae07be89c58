"""How often 95 % intervals of a fit to stands hold the truth: robots with planted errors.

    python benchmarks/fit_stands.py [--robot v3] [--seeds 20] [--simulated] [--uneven 0.0003]

The robot's masses, coms and zeros of encoders are drawn from the priors that the fit is told. Its
stands are predicted by the equations of sag, which share none with the fit's, on ground that is
uneven; or simulated in MuJoCo for 12 s. Encoders have 14 bits.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace

import mujoco
import numpy as np

import pupper_analysis as pa
from pupper_analysis.identification.links import bodies_of
from pupper_analysis.identification.stand_fit import fit_stands
from pupper_analysis.identification.stands import MeasuredStands
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos, servo_gains
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.sag.equilibrium import SagEquilibrium
from pupper_analysis.stance.sag.homotopy_path import HomotopyPath
from pupper_analysis.stance.sag.steady_state import follow_to_end
from pupper_analysis.study.parameters import scale_robot

STEP = 2 * math.pi / 2**14
MASS, COM = 0.2, 0.01
PRIORS = ("kp=0", "mass=20%", "com=10mm")
LEAST = 5


Commanded = tuple[Stand, np.ndarray]


def random_stands(robot: Robot, rng: np.random.Generator, count: int) -> list[Commanded]:
    """Returns stands, and what servos are commanded to hold them, as far as the file is right."""
    found: list[Commanded] = []
    size = robot.stand_height
    while len(found) < count:
        lifted = {rng.choice(list(robot.feet)): 0.1 * size} if rng.random() < 0.33 else {}
        task = pa.StandTask(
            height=size * rng.uniform(0.75, 1.1),
            roll=rng.uniform(-0.25, 0.25),
            pitch=rng.uniform(-0.25, 0.25),
            swing=lifted,
            foot_offsets={f: tuple(rng.uniform(-0.15, 0.15, 2) * size) for f in robot.feet},
            com="inside",
            com_margin=(0.03 if lifted else 0.05) * size,
        )
        try:
            stand = pa.solve_stand(robot, task)
            torques = pa.stance.stand_statics(robot, stand).joint_torques
            found.append((stand, stand.qpos[7:] + torques / servo_gains(robot).kp))
        except pa.PupperAnalysisError:
            continue
    return found


def plant(
    robot: Robot, rng: np.random.Generator, offset: float = math.radians(2.0)
) -> tuple[Robot, dict[str, float], np.ndarray]:
    """Returns the robot with errors, what is true by the estimates' names, and offsets."""
    factors, truth = {}, {}
    for link, number in bodies_of(robot):
        body = robot.structure.model.inertias[number]
        factor, moved = max(0.3, 1 + MASS * rng.normal()), COM * rng.normal(size=3)
        factors[f"mass:{link}"], truth[f"mass {link}"] = factor, body.mass * factor
        for axis, stated, off in zip("xyz", body.lever, moved, strict=True):
            factors[f"com_{axis}:{link}"], truth[f"com.{axis} {link}"] = off, stated + off
    offsets = offset * rng.normal(size=robot.nu)
    truth |= {f"offset {n}": float(o) for n, o in zip(robot.joint_names, offsets, strict=True)}
    return replace(scale_robot(robot, factors), fingerprint=robot.fingerprint), truth, offsets


def predict(
    true: Robot, commanded: Commanded, offsets: np.ndarray, rng: np.random.Generator, uneven: float
) -> np.ndarray | None:
    """Returns where joints come to rest: dry friction anywhere in its band, steps under feet."""
    (stand, command), kp = commanded, servo_gains(true).kp
    rubbing = true.mj_model.dof_frictionloss[true.mj_convention.qvel_index[6:]]
    heights = {foot: float(rng.normal(0, uneven)) for foot in true.feet}
    on_steps = replace(stand, task=replace(stand.task, ground=Ground(heights=heights)))
    end = command - offsets + rng.uniform(-1, 1, true.nu) * rubbing / kp
    try:
        way = HomotopyPath(SagEquilibrium(true, on_steps, kp, "pinned"), end)
        pose = follow_to_end(way, feedforward=False)
    except pa.PupperAnalysisError:
        return None
    same = set(pose.stance_feet) == set(stand.stance_feet)
    return pose.qpos[7:] if same and not pose.failures else None


def simulate(
    true: Robot, commanded: Commanded, offsets: np.ndarray, seconds: float
) -> np.ndarray | None:
    """Returns where joints are after some seconds in MuJoCo, if the feet stand as they should."""
    (stand, command), drive = commanded, model_with_servos(true)
    model, where = drive.model, true.mj_convention.qpos_index
    data = mujoco.MjData(model)
    data.qpos[where] = stand.qpos
    data.ctrl[:] = drive.command(true, command - offsets)
    for _ in range(int(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    touching = {
        true.foot_geoms.get(int(geom)) for contact in data.contact for geom in contact.geom
    } - {None}
    at_limit = (data.qpos[where][7:] > true.upper_limits - 1e-3).any() or (
        data.qpos[where][7:] < true.lower_limits + 1e-3
    ).any()
    alike = touching == set(stand.stance_feet) and data.ncon == len(touching)
    return data.qpos[where][7:].copy() if alike and not at_limit else None


def measure(robot: Robot, rows: list[tuple[Commanded, np.ndarray]]) -> MeasuredStands:
    blank = np.full((len(rows), robot.nu), np.nan)
    return MeasuredStands(
        source="planted",
        names=tuple(str(row) for row in range(len(rows))),
        joints=robot.joint_names,
        command=np.array([command for (_, command), _ in rows]),
        position=np.array([np.round(read / STEP) * STEP for _, read in rows]),
        torque=blank,
        force={},
        tilt=np.full((len(rows), 2), np.nan),
        swing=tuple(tuple(stand.task.swing) for (stand, _), _ in rows),
        approach=("",) * len(rows),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robot", default="v3", help="a variant, or a file")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--stands", type=int, default=25)
    parser.add_argument("--simulated", action="store_true", help="in MuJoCo, not predicted")
    parser.add_argument("--uneven", type=float, default=3e-4, help="of the ground (m)")
    parser.add_argument("--offset", type=float, default=2.0, help="of encoders (deg): stiff servos")
    given = parser.parse_args()
    known = given.robot in pa.VARIANTS
    robot = pa.load_variant(given.robot) if known else pa.load_robot(given.robot)
    pool = random_stands(robot, np.random.default_rng(0), 3 * given.stands)
    held: dict[str, list[bool]] = {}
    explained, seconds, fits = 0, 0.0, 0
    for seed in range(given.seeds):
        rng = np.random.default_rng(1000 + seed)
        true, truth, offsets = plant(robot, rng, math.radians(given.offset))
        rows = []
        for number in rng.permutation(len(pool)):
            stand = pool[number]
            if given.simulated:
                found = simulate(true, stand, offsets, 12.0)
            else:
                found = predict(true, stand, offsets, rng, given.uneven)
            if found is not None:
                rows.append((stand, found + offsets))
            if len(rows) == given.stands:
                break
        if len(rows) < LEAST:  # with these errors its feet slide, or it falls
            continue
        begun = time.process_time()
        fit = fit_stands(robot, measure(robot, rows), priors=(*PRIORS, f"offset={given.offset}deg"))
        seconds, fits = seconds + time.process_time() - begun, fits + 1
        explained += fit.explained
        whole = fit.total_mass
        held.setdefault("total mass", []).append(whole.low <= true.total_mass <= whole.high)
        for one in fit.estimates:
            if one.name in truth:
                inside = one.low <= truth[one.name] <= one.high
                for key in ("all", f"{one.kind}, told by {one.told.value}"):
                    held.setdefault(key, []).append(inside)
    if not fits:
        raise SystemExit(f"{robot.name}: with such errors it takes no stand as it is told to")
    print(
        f"{robot.name}: {fits} fits of up to {given.stands} stands, {explained} explained, ", end=""
    )
    print(f"{seconds / fits:.1f} s of processor each")
    for key, inside in sorted(held.items()):
        print(f"  {key:28s} {100 * np.mean(inside):5.1f} % of {len(inside)} intervals hold it")


if __name__ == "__main__":
    main()
