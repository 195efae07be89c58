"""How often 95 % intervals of a fit to stands hold the truth: robots with planted errors.

    python benchmarks/fit_stands.py [--robot v3 --robot go2.xml] [--seeds 20] [--simulated]

What is true of a robot is drawn from the priors that the fit is told: masses (15 %), coms (10 mm),
zeros of encoders (1.5 deg, less of stiff servos), kp (15 %, half of it common), dry friction
(30 %), the IMU's turn (1 deg), the ground's slope (0.2 deg). Twice these widths hold 95 %: masses
and kp to 30 %, coms to 20 mm, zeros to 3 deg. (Masses and kp are drawn by amounts, and taken for
off by factors: a mass of a half is 3.3 widths away, and 4.6 for the fit, which calls it far from
the file.) Its stands are predicted by the equations of sag, which share none with the fit's, on
ground that is uneven; or simulated in MuJoCo. Encoders have 12 bits and shake, an IMU and a scale
are read, both with noise (``--unweighed``: no scale). Seeds are of a robot's own: runs are the same
each time.

``--slope`` and ``--soft`` are of the ground, and nobody tells the fit.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import sys
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

import pupper_analysis as pa
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos, servo_gains
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.sag.equilibrium import SagEquilibrium
from pupper_analysis.stance.sag.steady_state import HomotopyPath, describe_pose, release_margin
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands
from pupper_analysis.tools.fit.parameters import bodies_of
from pupper_analysis.tools.fit.stands.fit import StandFit, fit_stands
from pupper_analysis.tools.study.parameters import scale_robot

MASS, COM, OFFSET, KP, FRICTION = 0.15, 0.01, math.radians(1.5), 0.15, 0.3
IMU, SLOPE = math.radians(1.0), math.radians(0.2)
PRIORS = ("mass=15%", "com=10mm", "kp=15%")
STIFF = 0.05
"""Of the weight times the height: torque of a servo by its zero's error, on average. With more
of it a robot that is put on its feet slides, or lifts one: so stiff a robot is known to be off."""

TILT, SCALE = math.radians(0.2), 0.002
"""Noise of the IMU (rad), of a scale (of the weight)."""

LEAST = 5
KINDS = ("mass", "com", "offset", "kp", "friction", "slope", "imu")


Commanded = tuple[Stand, np.ndarray]


@dataclass(frozen=True, eq=False)
class Planted:
    """A robot with errors.

    Attributes:
        stated: The robot as its files have it.
        robot: With true masses, coms, dry friction, and gravity on the slope.
        kp: (nu,) true (N m/rad).
        offsets: (nu,) true (rad).
        imu: (2,) true (rad).
        truth: What is true by the estimates' names.
    """

    stated: Robot
    robot: Robot
    kp: np.ndarray
    offsets: np.ndarray
    imu: np.ndarray
    truth: dict[str, float]


def random_stands(robot: Robot, rng: np.random.Generator, count: int) -> list[Commanded]:
    """Returns stands, and what servos are commanded to hold them, as far as the file is right."""
    found: list[Commanded] = []
    size, many, tried = robot.stand_height, len(robot.feet) > 3, 0
    while len(found) < count and tried < 40 * count:
        tried += 1
        lifted = {rng.choice(list(robot.feet)): 0.1 * size} if many and rng.random() < 0.33 else {}
        turns, steps = (0.25, 0.15) if many else (0.1, 0.05)
        task = pa.StandTask(
            height=size * rng.uniform(0.75 if many else 0.85, 1.1 if many else 1.0),
            roll=rng.uniform(-turns, turns),
            pitch=rng.uniform(-turns, turns),
            swing=lifted,
            foot_offsets={f: tuple(rng.uniform(-steps, steps, 2) * size) for f in robot.feet},
            com="inside",
            com_margin=(0.03 if lifted or not many else 0.05) * size,
        )
        try:
            stand = pa.solve_stand(robot, task, explain=False)
            torques = pa.stance.stand_statics(robot, stand).joint_torques
            found.append((stand, stand.qpos[7:] + torques / servo_gains(robot).kp))
        except pa.PupperAnalysisError:
            continue
    return found


def offset_of(robot: Robot) -> float:
    """Returns the standard deviation of encoders' zeros (rad)."""
    weight = robot.total_mass * float(np.linalg.norm(robot.gravity))
    return min(OFFSET, STIFF * weight * robot.stand_height / float(servo_gains(robot).kp.mean()))


def plant(robot: Robot, rng: np.random.Generator, slope: float) -> Planted:
    """Returns a robot with errors, on a slope (rad), or where it is 0 on one that is drawn."""
    factors, truth, names = {}, {}, robot.joint_names
    for link, number in bodies_of(robot):
        body = robot.structure.model.inertias[number]
        factor, moved = max(0.3, 1 + MASS * rng.normal()), COM * rng.normal(size=3)
        factors[f"mass:{link}"], truth[f"mass {link}"] = factor, body.mass * factor
        for axis, stated, off in zip("xyz", body.lever, moved, strict=True):
            factors[f"com_{axis}:{link}"], truth[f"com.{axis} {link}"] = off, stated + off
    common, own = rng.normal(), rng.normal(size=robot.nu)
    stiffness = servo_gains(robot).kp * (1 + KP * math.sqrt(0.5) * (common + own))
    rubbing, rubs = robot.joint_friction, 1 + FRICTION * rng.normal(size=robot.nu)
    rubs = np.maximum(0.1, rubs)
    factors |= {
        f"frictionloss:{name}": float(one)
        for name, one, has in zip(names, rubs, rubbing, strict=True)
        if has
    }
    offsets, imu = offset_of(robot) * rng.normal(size=robot.nu), IMU * rng.normal(size=2)
    tilt, way = SLOPE * rng.normal(size=2), rng.uniform(0, 2 * math.pi)
    if slope:
        tilt = slope * np.array([math.cos(way), math.sin(way)])
    for kind, values in (("kp", stiffness), ("friction", rubbing * rubs), ("offset", offsets)):
        truth |= {f"{kind} {n}": float(one) for n, one in zip(names, values, strict=True)}
    truth |= {f"slope.{axis} floor": float(one) for axis, one in zip("xy", tilt, strict=True)}
    truth |= {f"imu.{n} imu": float(one) for n, one in zip(("roll", "pitch"), imu, strict=True)}
    true = scale_robot(robot, factors)
    size, models = float(np.linalg.norm(robot.gravity)), (true.pin_model.copy(), true.mj_model)
    down = size * np.array([*tilt, -math.sqrt(1 - tilt @ tilt)])
    models[0].gravity.linear, models[1].opt.gravity[:] = down, down
    true = replace(true, pin_model=models[0], fingerprint=robot.fingerprint)
    return Planted(robot, true, stiffness, offsets, imu, truth)


def predict(
    planted: Planted,
    commanded: Commanded,
    rng: np.random.Generator,
    given: argparse.Namespace,
) -> np.ndarray | None:
    """Returns qpos at rest: dry friction anywhere in its band, steps under feet."""
    (stand, command), true, kp = commanded, planted.robot, planted.kp
    rubbing, share = true.joint_friction, rng.uniform(-1, 1, true.nu)
    heights = {foot: float(rng.normal(0, given.uneven)) for foot in true.feet}
    on_steps = replace(stand, task=replace(stand.task, ground=Ground(heights=heights)))
    end = command - planted.offsets + share * rubbing / kp
    try:
        system = SagEquilibrium(true, on_steps, kp, "pinned")
        system.laws = {
            foot: replace(law, stiffness=law.stiffness / given.soft)
            for foot, law in system.laws.items()
        }
        way = HomotopyPath(system, end)
        way.follow(1.0)
        pose = describe_pose(way, release_margin(way))
    except pa.PupperAnalysisError:
        return None
    same = set(pose.stance_feet) == set(stand.stance_feet)
    return pose.qpos if same and not pose.failures else None


def simulate(
    planted: Planted, commanded: Commanded, given: argparse.Namespace
) -> np.ndarray | None:
    """Returns qpos after some seconds in MuJoCo, if the feet stand as they should."""
    (stand, command), true = commanded, planted.robot
    drive = model_with_servos(true, planted.kp, servo_gains(true).kd)
    model, where = copy.copy(drive.model), true.mj_convention.qpos_index
    stiff = model.geom_solref[:, 0] > 0
    model.geom_solref[:, 0] *= np.where(stiff, math.sqrt(given.soft), 1 / given.soft)
    model.opt.noslip_iterations = 20 if given.grip else model.opt.noslip_iterations
    data = mujoco.MjData(model)
    data.qpos[where] = stand.qpos
    data.qpos[where[2]] += given.drop
    data.ctrl[:] = drive.command(true, command - planted.offsets)
    for _ in range(int(given.seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    touching = {
        true.foot_geoms.get(int(geom)) for contact in data.contact for geom in contact.geom
    } - {None}
    qpos = data.qpos[where].copy()
    at_limit = (qpos[7:] > true.upper_limits - 1e-3) | (qpos[7:] < true.lower_limits + 1e-3)
    points = sum(len(points) for foot, points in true.feet.items() if foot in touching)
    alike = touching == set(stand.stance_feet) and data.ncon == points
    still = np.abs(data.qvel).max() < 0.05
    return qpos if alike and still and not at_limit.any() else None


def measure(
    planted: Planted,
    rows: list[tuple[Commanded, np.ndarray]],
    given: argparse.Namespace,
    rng: np.random.Generator,
) -> MeasuredStands:
    """Returns what encoders and an IMU read of stands (qpos)."""
    robot = planted.robot
    step, shape = 2 * math.pi / 2**given.bits, (len(rows), robot.nu)
    read = np.array([qpos[7:] for _, qpos in rows]) + planted.offsets
    read += given.shakes * rng.normal(size=shape)
    up = -robot.gravity / np.linalg.norm(robot.gravity)
    ups = [Configuration(robot, qpos).base_rotation().T @ up for _, qpos in rows]
    tilt = np.array([[math.atan2(y, z), -math.asin(x)] for x, y, z in ups]) + planted.imu
    return MeasuredStands(
        source="planted",
        names=tuple(str(row) for row in range(len(rows))),
        joints=robot.joint_names,
        command=np.array([command for (_, command), _ in rows]),
        position=np.round(read / step) * step,
        tilt=tilt + TILT * rng.normal(size=tilt.shape),
        swing=tuple(tuple(stand.task.swing) for (stand, _), _ in rows),
    )


def fits(
    robot: Robot, given: argparse.Namespace
) -> Iterator[tuple[int, Planted, StandFit | None, float]]:
    """Yields seed, what is true, the fit (None: none, or too few stands), and seconds."""
    pool = random_stands(robot, np.random.default_rng(0), 3 * given.stands)
    for seed in range(given.first, given.first + given.seeds):
        rng = np.random.default_rng([seed, zlib.crc32(robot.name.encode()), given.simulated])
        planted = plant(robot, rng, math.radians(given.slope))
        rows: list[tuple[Commanded, np.ndarray]] = []
        for number in rng.permutation(len(pool)):
            if given.simulated:
                found = simulate(planted, pool[number], given)
            else:
                found = predict(planted, pool[number], rng, given)
            if found is not None:
                rows.append((pool[number], found))
            if len(rows) == given.stands:
                break
        if len(rows) < LEAST:  # with these errors its feet slide, or it falls
            yield seed, planted, None, 0.0
            continue
        stands = measure(planted, rows, given, rng)
        priors = (*PRIORS, f"offset={offset_of(robot)}rad")
        weight = planted.robot.total_mass * (1 + SCALE * rng.normal())
        encoder = math.hypot(2 * math.pi / 2**given.bits / math.sqrt(12), given.shakes)
        kp, begun = servo_gains(robot).kp, time.process_time()
        try:
            known = None if given.unweighed else weight
            fit = fit_stands(robot, stands, priors=priors, weight=known, kp=kp, encoder=encoder)
        except pa.PupperAnalysisError as error:
            print(f"{robot.name}, seed {seed}: {error}", file=sys.stderr)
            yield seed, planted, None, 0.0
            continue
        yield seed, planted, fit, time.process_time() - begun


def row_of(name: str, robot: Robot, given: argparse.Namespace) -> str:
    """Returns a row of the table; writes what is found of each seed to a file, if one is named."""
    held: dict[str, list[bool]] = {}
    took, codes, failed = [], [], 0
    for seed, planted, fit, seconds in fits(robot, given):
        if fit is None:
            failed += 1
            continue
        took.append(seconds)
        codes.append([one.code for one in fit.failures])
        truth = planted.truth | {"mass": planted.robot.total_mass}
        whole = replace(fit.total_mass, name="mass")
        rows = {}
        for one in (whole, *fit.estimates):
            if one.name not in truth:
                continue
            rows[one.name] = ((one.mean - truth[one.name]) / one.std, one.determined.value)
            inside = one.low <= truth[one.name] <= one.high
            for key in ("all", one.determined.value, "total" if one is whole else one.kind):
                held.setdefault(key, []).append(inside)
        if given.log:
            line = {"robot": name, "seed": seed, "failures": codes[-1], "z": rows}
            line |= {"noise": dict(fit.noise), "chi2": [fit.chi2, fit.freedom]}
            with given.log.open("a") as file:
                file.write(json.dumps(line) + "\n")
    shares = [
        f"{100 * np.mean(held[key]):.1f} ({len(held[key])})" if key in held else ""
        for key in ("all", "data", "total", *KINDS)
    ]
    unexplained: dict[str, int] = {}
    for code in (code for one in codes for code in set(one)):
        unexplained[code] = unexplained.get(code, 0) + 1
    said = ", ".join(f"{code} {count}" for code, count in sorted(unexplained.items()))
    explained = sum(not one for one in codes)
    cells = [name, f"{len(took)} ({failed} were not fitted)", str(explained), *shares, said]
    return f"| {' | '.join(cells)} | {np.mean(took) if took else math.nan:.1f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robot", action="append", help="a variant, or a file; may be repeated")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--stands", type=int, default=25)
    parser.add_argument("--simulated", action="store_true", help="in MuJoCo, not predicted")
    parser.add_argument("--seconds", type=float, default=12.0, help="that MuJoCo simulates")
    parser.add_argument("--grip", action="store_true", help="MuJoCo's feet do not creep")
    parser.add_argument("--drop", type=float, default=0.0, help="set down from so high (m)")
    parser.add_argument("--uneven", type=float, default=3e-4, help="of the ground (m)")
    parser.add_argument("--unweighed", action="store_true", help="no scale weighs the robot")
    parser.add_argument("--bits", type=int, default=12, help="of encoders")
    parser.add_argument("--shakes", type=float, default=5e-4, help="noise of encoders (rad)")
    parser.add_argument("--slope", type=float, default=0.0, help="that nobody mentioned (deg)")
    parser.add_argument("--soft", type=float, default=1.0, help="times as deep as feet should sink")
    parser.add_argument("--log", type=Path, help="a file for what is found of each seed")
    given = parser.parse_args()
    heads = ("robot", "fits", "explained", "all %", "told by data", "total mass", *KINDS)
    print(f"| {' | '.join(heads)} | not explained | s |\n|{'---|' * (len(heads) + 2)}")
    for one in given.robot or ["v3"]:
        robot = pa.load_variant(one) if one in pa.VARIANTS else pa.load_robot(one)
        print(row_of(Path(one).stem, robot, given), flush=True)


if __name__ == "__main__":
    main()
