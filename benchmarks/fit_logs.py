"""Fits to logs of robots whose joint friction and servos the fit does not model.

    python benchmarks/fit_logs.py [--robot v3] [--kp 20 --kd 0.5] [--only none --only "dead band"]
        [--seeds 1] [--seconds 10] [--sysid] [--csv docs/data/fit-logs.csv]

The effects are, for example, Stribeck friction, a dead band and motor lag. Masses, CoM positions,
encoder offsets, kp, friction, damping and armature have random errors, as in ``fit_motions.py``.
Servos are MuJoCo's, with applied torques for the effects; friction is a bristle, in some cases with
higher static than sliding friction. Another motion (other sines and steps) is predicted, not
fitted. The table contains the number of intervals that contain the true value, for values that the
measurements determine (friction only if it is a single number), and the error of kp over mass.

In a second fit only kp, friction, damping and armature are unknown (as after weighing all parts):
by ``fit`` with ``--prior mass=0`` and so on, and with ``--sysid`` by ``mujoco.sysid`` (``pip
install mujoco[sysid]``), which has no priors, from the same initial guess.
"""

from __future__ import annotations

import argparse
import copy
import csv
import math
import time
import zlib
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path

import mujoco
import numpy as np
from fit_motions import (
    COM,
    INTERVAL,
    KP,
    MASS,
    OFFSET,
    QUANTUM,
    RUBS,
    SHAKES,
    draw_positive,
    make_commands,
)

import pupper_analysis as pa
from pupper_analysis.base.errors import FitError
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Gains, model_with_servos, resolve_servo_gains
from pupper_analysis.tools.fit.measurements.log import Log
from pupper_analysis.tools.fit.motions.fit import fit_motion
from pupper_analysis.tools.fit.motions.rollouts import MovingBodies
from pupper_analysis.tools.fit.parameters import PARAMETER_KINDS as KINDS_OF_FIT
from pupper_analysis.tools.fit.parameters import list_bodies
from pupper_analysis.tools.fit.result import Determined, MotionFit
from pupper_analysis.tools.study.parameters import scale_robot

STEP, BRISTLE, TICK = 2e-4, 5e-4, 1e-3
"""Time step of the simulation [s], deflection of the bristle before sliding [rad], and time step
of ``mujoco.sysid`` [s]."""
NO_DELAY_PRIORS = ("delay=0", "lag=0")
"""Priors that exclude delay and lag."""

PASSIVE_KINDS = ("friction", "damping", "armature")
"""Kinds of passive joint parameters."""


@dataclass(frozen=True)
class JointEffects:
    """Effects in the joints of a robot that the fit does not model.

    Attributes:
        more: Factor of the dry friction of the file.
        sticks: Ratio of static to sliding friction; the excess falls with exp(-(v / 0.2
            rad/s)^2).
        deadband: Servo error without torque [rad].
        with_load: Friction proportional to the motor torque, as in gears.
        lag: Time constant of the motor torque, without damping [s].
        late: Dead time of the motor torque [s].
        backlash: Backlash between motor and joint [rad].
    """

    more: float = 1.0
    sticks: float = 1.0
    deadband: float = 0.0
    with_load: float = 0.0
    lag: float = 0.0
    late: float = 0.0
    backlash: float = 0.0


KINDS = {
    "bristle": JointEffects(),
    "Stribeck 1.6": JointEffects(sticks=1.6),
    "4 times the friction, Stribeck 1.6": JointEffects(more=4.0, sticks=1.6),
    "dead band 0.3 deg": JointEffects(deadband=math.radians(0.3)),
    "friction of 5 % of the torque": JointEffects(with_load=0.05),
    "motors 5 ms slow": JointEffects(lag=0.005),
    "torques 5 ms late": JointEffects(late=0.005),
    "backlash 0.3 deg": JointEffects(backlash=math.radians(0.3)),
}
"""{name: effects}."""


@dataclass(frozen=True, eq=False)
class Planted:
    """Robot with a fixed base and known errors."""

    robot: Robot
    kp: np.ndarray
    rubs: dict[str, np.ndarray]
    offsets: np.ndarray
    truth: dict[str, float]


def plant_errors(robot: Robot, rng: np.random.Generator, gains: Gains) -> Planted:
    """Return a robot with random errors."""
    factors, truth = {}, {}
    held = build_robot(robot.description, fixed_base=True)
    bodies = MovingBodies(held, held.mj_model)
    for link, _ in list_bodies(robot):
        if link in bodies.links:
            at, factor = bodies.links.index(link), max(0.3, 1 + MASS * rng.normal())
            factors[f"mass:{link}"], truth[f"mass {link}"] = factor, factor * bodies.mass[at]
            for axis, stated in zip("xyz", bodies.com[at], strict=True):
                factors[f"com_{axis}:{link}"] = off = COM * rng.normal()
                truth[f"com.{axis} {link}"] = stated + off
    true, nu = scale_robot(robot, factors), robot.nu
    both = math.sqrt(0.5) * (rng.normal() + rng.normal(size=nu))
    kp, dofs = gains.kp * np.maximum(1 + KP * both, 0.3), robot.mj_convention.qvel_index[-nu:]
    model = robot.mj_model
    own = (model.dof_frictionloss[dofs], model.dof_damping[dofs], model.dof_armature[dofs])
    drawn = {  # what a file does not state is of the size that the fit expects
        kind: draw_positive(
            rng, values, np.where(values > 0, RUBS * values, KINDS_OF_FIT[kind].width)
        )
        for kind, values in zip(PASSIVE_KINDS, own, strict=True)
    }
    offsets = OFFSET * rng.normal(size=nu)
    for kind, values in {"kp": kp, **drawn, "offset": offsets}.items():
        truth |= {f"{kind} {n}": float(v) for n, v in zip(robot.joint_names, values, strict=True)}
    return Planted(true, kp, drawn, offsets, truth | {"delay servos": 0.0})


def simulate_log(
    planted: Planted, joints: JointEffects, command: np.ndarray, gains: Gains, seed: int
) -> Log:
    """Simulate commands (n, nu) [rad] in MuJoCo alone, and return the log of the encoders."""
    true = build_robot(planted.robot.description, fixed_base=True)
    at, model = true.mj_convention, model_with_servos(true, planted.kp, gains.kd).model
    dofs, where = at.qvel_index, at.qpos_index
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.dof_frictionloss[dofs] = 0  # it is our own
    model.dof_damping[dofs] = planted.rubs["damping"]
    model.dof_armature[dofs] = planted.rubs["armature"]
    data, seen = mujoco.MjData(model), []
    at.set_state(data, command[0] - planted.offsets)
    bristle, slides = data.qpos[where].copy(), joints.more * planted.rubs["friction"]
    side, torque = np.zeros(true.nu), np.zeros(true.nu)
    waiting = [torque] * round(joints.late / STEP)
    for row in command - planted.offsets:
        seen.append(data.qpos[where] + joints.backlash / 2 * side)
        data.ctrl[model.actuator_ctrladr[at.actuator_index]] = row
        for _ in range(round(INTERVAL / STEP)):
            q, rate = data.qpos[where], data.qvel[dofs]
            error = row - q - joints.backlash / 2 * side
            error = np.sign(error) * np.maximum(np.abs(error) - joints.deadband, 0.0)
            asked = planted.kp * error
            torque = torque + (asked - torque) * (STEP / (joints.lag + STEP) if joints.lag else 1)
            if joints.late:
                waiting.append(asked - gains.kd * rate)
                torque = waiting.pop(0) + gains.kd * rate  # that of now is MuJoCo's
            if joints.backlash:
                side += 0.02 * (np.clip(torque / (0.1 * slides + 1e-6), -1, 1) - side)
            sticks = 1 + (joints.sticks - 1) * np.exp(-np.square(rate / 0.2))
            held = np.clip((q - bristle) / BRISTLE, -1, 1)
            bristle = q - BRISTLE * held
            friction = slides * sticks + joints.with_load * np.abs(torque)
            # A servo is one of MuJoCo's (an explicit one's lag is in damping); the rest is added.
            data.qfrc_applied[dofs] = torque - planted.kp * (row - q) - friction * held
            mujoco.mj_step(model, data)
    read = np.array(seen) + planted.offsets
    read += SHAKES * np.random.default_rng(seed).normal(size=read.shape)
    clock = INTERVAL * np.arange(len(read))
    return Log("planted", clock, true.joint_names, command, QUANTUM * np.round(read / QUANTUM))


def count_true_intervals(
    fit: MotionFit, truth: dict[str, float], *, friction: bool
) -> tuple[int, int]:
    """Return the number of intervals that contain the true value, and the number of intervals.

    Args:
        fit: Fit; intervals of values that the measurements determine are counted.
        truth: {name of an estimate: true value}.
        friction: Whether friction is included.
    """
    own = [
        one.low <= truth[one.name] <= one.high
        for one in fit.estimates
        if one.name in truth
        and one.determined is Determined.DATA
        and (friction or one.kind != "friction")
    ]
    return sum(own), len(own)


@dataclass(frozen=True)
class Row:
    """Log, and the results of its fits."""

    robot: str
    kind: str
    seed: int
    outcome: str
    held_out_file: float
    held_out: float
    hold: int
    of: int
    ratio_off: float
    ratio_half: float
    known_held_out: float
    known_hold: int
    known_of: int
    known_kp_off: float
    known_seconds: float
    sysid_held_out: float = math.nan
    sysid_hold: int = 0
    sysid_of: int = 0
    sysid_kp_off: float = math.nan
    sysid_seconds: float = math.nan


def rms_mrad(values: np.ndarray) -> float:
    """Return the root mean square of angles [rad] in mrad."""
    return round(1e3 * float(np.sqrt(np.mean(np.square(values)))), 3)


def remove_offsets(log: Log, offsets: np.ndarray) -> Log:
    """Return a log without encoder offsets (nu,) [rad]."""
    return replace(log, command=log.command - offsets, position=log.position - offsets)


def fit_with_sysid(
    robot: Robot, log: Log, other: Log, gains: Gains, planted: Planted, *, friction: bool
) -> tuple[float, int, int, float, float]:
    """Fit a log with ``mujoco.sysid``.

    Returns:
        Prediction error [mrad], number of intervals that contain the true value, number of
        intervals, median error of kp [%], and time [s].
    """
    from mujoco import rollout, sysid

    held = build_robot(robot.description, fixed_base=True)
    model, at = model_with_servos(held, gains.kp, gains.kd).model, held.mj_convention
    model.opt.timestep, model.opt.integrator = TICK, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    dofs, motors = at.qvel_index, at.actuator_index
    rubs = (model.dof_frictionloss, model.dof_damping, model.dof_armature)
    stated = np.concatenate([gains.kp, *(values[dofs] for values in rubs)])
    params = sysid.ParameterDict()
    params.add(sysid.Parameter("numbers", stated, 0.1 * stated, 10 * stated))

    def build(x: np.ndarray) -> mujoco.MjModel:
        made = copy.copy(model)
        kp, *rest = x.reshape(4, -1)
        made.actuator_gainprm[motors, 0], made.actuator_biasprm[motors, 1] = kp, -kp
        values = (made.dof_frictionloss, made.dof_damping, made.dof_armature)
        for whole, own in zip(values, rest, strict=True):
            whole[dofs] = own
        mujoco.mj_setConst(made, mujoco.MjData(made))
        return made

    def simulate_errors(x: np.ndarray, one: Log) -> np.ndarray:
        """Return simulated minus measured joint positions (m, samples - 1, nu) [rad].

        Args:
            x: Parameter vectors as columns, shape (n, m).
            one: Log.
        """
        models, data, every = [build(own) for own in x.T], mujoco.MjData(model), INTERVAL / TICK
        at.set_state(data, one.position[0])
        start = np.tile(sysid.create_initial_state(model, data.qpos, data.qvel), (len(models), 1))
        ctrl = np.zeros((len(one.time), model.nu))
        ctrl[:, model.actuator_ctrladr[motors]] = one.command
        fine = np.tile(np.repeat(ctrl, round(every), axis=0), (len(models), 1, 1))
        with rollout.Rollout(nthread=2) as roll:
            states, _ = roll.rollout(models, [mujoco.MjData(model) for _ in range(2)], start, fine)
        there = states[:, round(every) - 1 :: round(every), 1 + at.qpos_index][:, :-1]
        left: np.ndarray = there - one.position[1:]
        return left

    def residual(x: np.ndarray, _: object) -> tuple[list[np.ndarray], None, None]:
        found = simulate_errors(x.reshape(len(stated), -1), log)
        found = found.reshape(len(found), -1).T
        return [found if x.ndim > 1 else found[:, 0]], None, None

    begun = time.monotonic()
    best, result = sysid.optimize(params, residual, verbose=False, max_iters=60)
    x = best.as_vector()
    _, half = sysid.calculate_intervals(residual(x, best)[0], result.jac)
    spent = round(time.monotonic() - begun, 1)
    truth = np.concatenate([planted.kp, *(planted.rubs[kind] for kind in PASSIVE_KINDS)])
    counts = np.repeat([True, friction, True, True], robot.nu)
    inside = (np.abs(x - truth) <= half)[counts]
    kp_off = round(100 * float(np.median(np.abs(x[: robot.nu] / planted.kp - 1))), 2)
    return (
        rms_mrad(simulate_errors(x[:, None], other)),
        int(inside.sum()),
        len(inside),
        kp_off,
        spent,
    )


def make_row(name: str, robot: Robot, kind: str, seed: int, given: argparse.Namespace) -> Row:
    """Simulate a log with some effects, fit it, and return the results."""
    joints, gains = KINDS[kind], resolve_servo_gains(robot, given.kp, given.kd)
    rng = np.random.default_rng([zlib.crc32(name.encode()), seed])
    planted = plant_errors(robot, rng, gains)
    fitted, other = (make_commands(robot, rng, s) for s in (given.seconds, given.seconds / 2))
    log, held = (
        simulate_log(planted, joints, one, gains, seed + k) for k, one in enumerate((fitted, other))
    )
    after = {"command": joints.lag, "position": joints.lag + joints.late}
    planted.truth.update({f"lag.{part} servos": value for part, value in after.items()})
    planted.truth["delay servos"] = joints.lag + joints.late
    one_number = replace(joints, lag=0.0, late=0.0) == JointEffects()
    fit = fit_motion(robot, [log], hold_out=[held], kp=given.kp, kd=given.kd)
    masses = [one.subject for one in fit.estimates if one.kind == "mass"]
    stated = {one.name: one.stated for one in fit.estimates}
    ratio = math.exp(np.mean(np.log(planted.kp / gains.kp)))
    ratio *= sum(stated[f"mass {m}"] for m in masses) / sum(
        planted.truth[f"mass {m}"] for m in masses
    )
    assert fit.kp_over_mass is not None
    begun = time.monotonic()
    known = fit_motion(
        planted.robot,
        [remove_offsets(log, planted.offsets)],
        hold_out=[remove_offsets(held, planted.offsets)],
        priors=(
            "mass=0",
            "com=0",
            "offset=0",
            *(() if joints.lag or joints.late else NO_DELAY_PRIORS),
        ),
        kp=given.kp,
        kd=given.kd,
    )
    spent = time.monotonic() - begun
    means = {one.name: one.mean for one in known.estimates}
    kp = np.array([means[f"kp {one}"] for one in robot.joint_names])
    found = Row(
        name, kind, seed, "EXPLAINED" if fit.explained else "NOT EXPLAINED",
        round(1e3 * fit.held_out_before, 2), round(1e3 * fit.held_out, 3),
        *count_true_intervals(fit, planted.truth, friction=one_number),
        round(100 * (fit.kp_over_mass.mean / ratio - 1), 2),
        round(100 * (fit.kp_over_mass.high / fit.kp_over_mass.mean - 1), 2),
        round(1e3 * known.held_out, 3),
        *count_true_intervals(known, planted.truth, friction=one_number),
        round(100 * float(np.median(np.abs(kp / planted.kp - 1))), 2), round(spent, 1),
    )  # fmt: skip
    if not given.sysid:
        return found
    logs = (remove_offsets(log, planted.offsets), remove_offsets(held, planted.offsets))
    own = fit_with_sysid(planted.robot, *logs, gains, planted, friction=one_number)
    return replace(found, **dict(zip([f.name for f in fields(Row)][-5:], own, strict=True)))


def main() -> None:
    """Run the fits that the command line selects, and print a row for each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robot", default="v3", help="a variant, or a file")
    parser.add_argument("--kp", type=float, help="of the servos, where the file states none")
    parser.add_argument("--kd", type=float)
    parser.add_argument("--only", action="append", choices=list(KINDS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--sysid", action="store_true")
    parser.add_argument("--csv", type=Path, help="a file to add rows to")
    given = parser.parse_args()
    known = given.robot in pa.VARIANTS
    robot = pa.load_variant(given.robot) if known else pa.load_robot(given.robot)
    for kind in given.only or KINDS:
        for seed in range(given.first, given.first + given.seeds):
            name = Path(given.robot).stem
            try:
                found = make_row(name, robot, kind, seed, given)
            except FitError:
                nothing = [math.nan, math.nan, 0, 0, *[math.nan] * 3, 0, 0, math.nan, math.nan]
                found = Row(name, kind, seed, "does not converge", *nothing)
            print(*astuple(found), sep=" | ", flush=True)
            if given.csv:
                new = not given.csv.exists()
                with given.csv.open("a", newline="") as file:
                    writer = csv.writer(file, lineterminator="\n")
                    if new:
                        writer.writerow([one.name for one in fields(Row)])
                    writer.writerow(astuple(found))


if __name__ == "__main__":
    main()
