"""Coverage of the 95 % intervals of a fit to a motion, and the time that it takes.

    python benchmarks/fit_motions.py [--robot v3 --robot go2.xml] [--kp 20 --kd 1] [--seeds 20]
        [--first 500] [--seconds 10]
    python benchmarks/fit_motions.py --log 0.csv --log 1.csv --hold-out 5.csv --robot go2.xml
        [--kp 20 --kd 1]

True parameters are drawn from the priors of the fit: masses (15 %), CoM positions (10 mm), encoder
offsets (1.5 deg), kp (15 %, half of it common), dry friction, damping, armature (30 %) and the
delay of commands (10 ms). The base is fixed, and the servos follow sines and steps in MuJoCo with a
time step of 0.25 ms. (With an Euler step of 0.1 ms the lag of half a step is seven standard
deviations of the delay.) Encoders have 12 bits and noise. Each robot has its own seeds, so that
runs are repeatable. With ``--log``, the logs of a real robot are fitted.
"""

from __future__ import annotations

import argparse
import math
import time
import zlib

import mujoco
import numpy as np

import pupper_analysis as pa
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Gains, model_with_servos, resolve_servo_gains
from pupper_analysis.tools.fit.measurements.log import Log, read_log
from pupper_analysis.tools.fit.motions.fit import fit_motion
from pupper_analysis.tools.fit.motions.rollouts import MovingBodies
from pupper_analysis.tools.fit.parameters import list_bodies
from pupper_analysis.tools.study.parameters import scale_robot

MASS, COM, OFFSET, KP, RUBS, DELAY = 0.15, 0.01, math.radians(1.5), 0.15, 0.3, 0.01
"""Standard deviations: masses, CoM positions [m], encoder offsets [rad], kp, passive parameters
(relative), delay [s]."""

PRIORS = (
    "mass=15%", "com=10mm", "offset=1.5deg", "kp=15%",
    "friction=30%", "damping=30%", "armature=30%", "delay=10ms",
)  # fmt: skip
"""Priors of the fit, from which the true parameters are drawn."""

INTERVAL, TICKS = 0.005, 20
"""Sampling interval of a log [s], and number of time steps per interval."""

QUANTUM, SHAKES = 2 * math.pi / 4096, 3e-4
"""Resolution [rad] and standard deviation of the noise [rad] of the encoders."""


def draw_positive(rng: np.random.Generator, mean: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Draw from normal distributions, and draw negative values again."""
    drawn = rng.normal(mean, width)
    while (drawn < 0).any():
        drawn = np.where(drawn < 0, rng.normal(mean, width), drawn)
    return drawn


def make_commands(robot: Robot, rng: np.random.Generator, seconds: float) -> np.ndarray:
    """Return commands (n, nu) [rad] within the limits: sines of 0.3 to 3 Hz, a step per second."""
    clock = np.arange(0, seconds, INTERVAL)
    wide = np.minimum(robot.upper_limits - robot.lower_limits, 2.0)
    middle = np.clip(
        robot.home[-robot.nu :], robot.lower_limits + wide / 4, robot.upper_limits - wide / 4
    )
    found = np.empty((len(clock), robot.nu))
    for joint in range(robot.nu):
        rates, phases = rng.uniform(0.3, 3, 3), rng.uniform(0, 2 * math.pi, 3)
        sines = np.sin(2 * math.pi * np.outer(clock, rates) + phases).mean(axis=1)
        steps = rng.uniform(-1, 1, int(seconds) + 2)[(clock + rng.uniform()).astype(int)]
        found[:, joint] = middle[joint] + wide[joint] / 8 * (sines + steps)
    return found


def drive_joints(
    robot: Robot, rng: np.random.Generator, seconds: float, gains: Gains
) -> tuple[Log, dict[str, float]]:
    """Return the log of a robot with random errors, and {name of an estimate: true value}."""
    factors, truth = {}, {}
    names = robot.joint_names
    held = build_robot(robot.description, fixed_base=True)
    bodies = MovingBodies(held, held.mj_model)
    by_link = {link: number for link, number in list_bodies(robot) if link in bodies.links}
    for link in by_link:
        at, factor = bodies.links.index(link), max(0.3, 1 + MASS * rng.normal())
        factors[f"mass:{link}"], truth[f"mass {link}"] = factor, factor * bodies.mass[at]
        for axis, stated in zip("xyz", bodies.com[at], strict=True):
            factors[f"com_{axis}:{link}"] = off = COM * rng.normal()
            truth[f"com.{axis} {link}"] = stated + off
    true = build_robot(scale_robot(robot, factors).description, fixed_base=True)
    kp = gains.kp * np.maximum(
        1 + KP * (math.sqrt(0.5) * (rng.normal() + rng.normal(size=robot.nu))), 0.3
    )
    model = model_with_servos(true, kp, gains.kd).model
    dofs, where = true.mj_convention.qvel_index, true.mj_convention.qpos_index
    for kind, values in (
        ("friction", model.dof_frictionloss),
        ("damping", model.dof_damping),
        ("armature", model.dof_armature),
    ):
        values[dofs] = draw_positive(rng, values[dofs], RUBS * values[dofs])
        truth |= {
            f"{kind} {name}": float(values[dof]) for name, dof in zip(names, dofs, strict=True)
        }
    offsets, delay = OFFSET * rng.normal(size=robot.nu), abs(DELAY * rng.normal())
    truth |= {f"kp {name}": float(one) for name, one in zip(names, kp, strict=True)}
    truth |= {f"offset {name}": float(one) for name, one in zip(names, offsets, strict=True)}
    command, late = make_commands(robot, rng, seconds), round(delay / INTERVAL * TICKS)
    truth["delay servos"] = late / TICKS * INTERVAL
    model.opt.timestep, model.opt.integrator = INTERVAL / TICKS, INTEGRATOR
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT.value
    data, seen = mujoco.MjData(model), []
    true.mj_convention.set_state(data, command[0] - offsets)
    actuators = true.mj_convention.actuator_index
    for tick in range(TICKS * len(command)):
        if tick % TICKS == 0:
            seen.append(data.qpos[where] + offsets)
        asked = command[max(tick - late, 0) // TICKS] - offsets
        data.ctrl[model.actuator_ctrladr[actuators]] = gains.gear * asked
        mujoco.mj_step(model, data)
    read = np.array(seen) + SHAKES * rng.normal(size=command.shape)
    clock = INTERVAL * np.arange(len(command))
    return Log("planted", clock, names, command, QUANTUM * np.round(read / QUANTUM)), truth


INTEGRATOR = mujoco.mjtIntegrator.mjINT_RK4.value
"""MuJoCo's integrator of the simulated logs."""


def measure_coverage(name: str, given: argparse.Namespace) -> None:
    """Fit robots with random errors, and print how many intervals contain the true values."""
    robot = pa.load_variant(name) if name in pa.VARIANTS else pa.load_robot(name)
    gains, seeds, seconds = (
        resolve_servo_gains(robot, given.kp, given.kd),
        given.seeds,
        given.seconds,
    )
    held: dict[str, list[bool]] = {}
    spent, waited, explained = [], [], 0
    for seed in range(given.first, given.first + seeds):
        rng = np.random.default_rng([zlib.crc32(robot.name.encode()), seed])
        log, truth = drive_joints(robot, rng, seconds, gains)
        begun, waiting = time.process_time(), time.monotonic()
        fit = fit_motion(robot, [log], priors=PRIORS, kp=given.kp, kd=given.kd)
        spent.append(time.process_time() - begun)
        waited.append(time.monotonic() - waiting)
        explained += fit.explained
        own = []
        for one in fit.estimates:
            if one.name in truth:
                inside = one.low <= truth[one.name] <= one.high
                own.append(inside)
                for key in (
                    "all",
                    f"told by {one.determined.value}",
                    f"{one.kind}, {one.determined.value}",
                ):
                    held.setdefault(key, []).append(inside)
                if abs(truth[one.name] - one.mean) > MAX_DEVIATION * one.std:
                    off = (truth[one.name] - one.mean) / one.std
                    print(f"  seed {seed}: {one.name} is {off:.1f} standard deviations off")
        print(
            f"  seed {seed}: {100 * np.mean(own):.1f} %, held out {1e3 * fit.held_out:.2f} mrad "
            f"({1e3 * fit.held_out_before:.1f} before), {spent[-1]:.1f} s of processor",
            flush=True,
        )
    print(f"{robot.name}: {seeds} logs of {seconds:g} s, {explained} explained, ", end="")
    print(f"{np.mean(spent):.1f} s of processor each, {np.mean(waited):.1f} s waited")
    for key, inside in sorted(held.items()):
        print(f"  {key:28s} {100 * np.mean(inside):5.1f} % of {len(inside)} intervals hold it")


MAX_DEVIATION = 4.0
"""Error in standard deviations above which an estimate is printed: one of 16,000 normal numbers."""


def fit_real_logs(given: argparse.Namespace) -> None:
    """Fit real logs, and print the prediction error of other logs."""
    name = given.robot[0]
    robot = pa.load_variant(name) if name in pa.VARIANTS else pa.load_robot(name)
    logs = [read_log(one) for one in given.log]
    others = [read_log(one) for one in given.hold_out]
    begun, waiting = time.process_time(), time.monotonic()
    fit = fit_motion(robot, logs, hold_out=others or 0.2, kp=given.kp, kd=given.kd)
    spent, waited = time.process_time() - begun, time.monotonic() - waiting
    print(f"{robot.name}: {sum(one.duration for one in logs):.0f} s of log fitted in ", end="")
    print(f"{spent:.0f} s of processor, {waited:.0f} s waited")
    print(
        f"  held out {1e3 * fit.held_out:.3f} mrad, the file's own {1e3 * fit.held_out_before:.3f},"
    )
    print(f"  fitted {1e3 * fit.fitted:.3f} ({1e3 * fit.fitted_before:.3f}), ", end="")
    print(f"the robot from itself {1e3 * fit.repeatability:.3f}")
    messages = [one.determined.value for one in fit.estimates]
    print(
        f"  { ({kind: messages.count(kind) for kind in sorted(set(messages))}) } of {len(messages)}"
    )


def main() -> None:
    """Fit the simulated or real logs that the command line selects."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robot", action="append", help="a variant, or a file")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--seconds", type=float, default=10.0, help="of a simulated log")
    parser.add_argument("--log", action="append", default=[], help="of a real robot")
    parser.add_argument("--hold-out", action="append", default=[], help="to be predicted")
    parser.add_argument("--kp", type=float, nargs="*", help="of servos (N m/rad)")
    parser.add_argument("--kd", type=float, nargs="*", help="of servos (N m s/rad)")
    given = parser.parse_args()
    given.robot = given.robot or ["v3"]
    for gain in ("kp", "kd"):
        values = getattr(given, gain)
        if values and len(values) == 1:
            setattr(given, gain, values[0])
    if given.log:
        fit_real_logs(given)
        return
    for name in given.robot:
        measure_coverage(name, given)


if __name__ == "__main__":
    main()
