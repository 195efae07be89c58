"""Intervals of fits to torques: how often they hold what was planted, on arms that MuJoCo moves.

Arms are those of others, in ``PUPPER_ROBOTS``; each draw plants errors in their masses, coms and
inertias, and friction, damping, armature and bias of which the files know nothing. Joints follow
sines, or servos whose commands are sines (--servos, with their bandwidth in rad/s: MuJoCo's own
dynamics, friction and time step, and joints that stick); encoders have steps, torques have noise.

    python benchmarks/fit_torques.py ur5 xarm7 --seeds 20
    python benchmarks/fit_torques.py so100 --seeds 20 --servos 30
"""

from __future__ import annotations

import argparse
import copy
import os
import time
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.convert.load import load_robot
from pupper_analysis.identification.measurements.log import Log
from pupper_analysis.identification.motions.bodies import MovingBodies
from pupper_analysis.identification.parameters import KINDS
from pupper_analysis.identification.torques.fit import fit_torques
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

EXAMPLES = "cmeel.prefix/share/example-robot-data/robots"
ARMS = {
    "ur5": f"{EXAMPLES}/ur_description/urdf/ur5_robot.urdf",
    "xarm7": f"{EXAMPLES}/xarm_description/urdf/xarm7.urdf",
    "z1": f"{EXAMPLES}/z1_description/urdf/z1.urdf",
    "so100": f"{EXAMPLES}/so_arm_description/urdf/so100.urdf",
}
SECONDS, RATE, WAVES = 40.0, 250.0, 6
STEP = 1.25e-4
"""s: what MuJoCo damps implicitly is damped half a step late, as by an armature of half a step's
damping and a lag of a tenth of a step: less than is told of either."""
QUANTUM = 2 * np.pi / 2**16
MASS_SHARE, COM_WIDTH = 0.2, 0.012  # kg / kg, m
PRIORS = (f"mass={100 * MASS_SHARE:g}%", f"com={1e3 * COM_WIDTH:g}mm")
"""Errors are planted as they are said to be: intervals are right on average over these alone."""
TORQUE_NOISE = 0.02
"""Of a joint's usual torque: standard deviation of a sample."""

Truth = dict[tuple[str, str, str], float]


def plant(robot: Robot, random: np.random.Generator) -> tuple[mujoco.MjModel, Truth]:
    """Returns a model with errors, and what they are."""
    bodies = MovingBodies(robot, robot.mj_model)
    model, truth = copy.copy(bodies.model), {}
    for joint, (name, link) in enumerate(zip(robot.joint_names, bodies.links, strict=True)):
        mass = bodies.mass[joint]
        if mass <= 0:
            continue
        body = model.jnt_bodyid[model.joint(name).id]
        factor = max(random.normal(1.0, MASS_SHARE), 0.1)
        shift = COM_WIDTH * random.normal(size=3)
        model.body_mass[body] = factor * mass
        com = bodies.com[joint] + shift
        to_link = bodies._to_link[joint]
        model.body_ipos[body] = to_link.actInv(com)
        turned = np.zeros(9)
        mujoco.mju_quat2Mat(turned, model.body_iquat[body])
        rotation = np.array(to_link.rotation) @ turned.reshape(3, 3)
        tensor = rotation @ np.diag(model.body_inertia[body]) @ rotation.T
        # As much as is not known of them; no such body need exist for equations to hold.
        width = np.hypot(KINDS["inertia"].share * np.trace(tensor) / 3, 9e-4 * mass)
        errors = np.triu(width * random.normal(size=(3, 3)))
        tensor += errors + np.triu(errors, 1).T
        moments, axes = np.linalg.eigh(np.array(to_link.rotation).T @ tensor @ to_link.rotation)
        axes[:, 2] *= np.linalg.det(axes)
        model.body_inertia[body] = moments
        mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())
        truth["mass", link, ""] = factor * mass
        for at, axis in enumerate("xyz"):
            truth["com", link, axis] = com[at]
            for beside in range(at, 3):
                truth["inertia", link, axis + "xyz"[beside]] = tensor[at, beside]
    limits = np.where(np.isfinite(robot.effort_limits), robot.effort_limits, 10.0)
    dofs = robot.mj_convention.qvel_index
    for kind, values, size in (
        ("friction", np.zeros(model.nv), 0.03 * limits),
        ("damping", model.dof_damping, 0.01 * limits),
        ("armature", model.dof_armature, 0.002 * limits),
    ):
        values[dofs] = size * random.uniform(0.5, 1.5, robot.nu)
        for name, value in zip(robot.joint_names, values[dofs].tolist(), strict=True):
            truth[kind, name, ""] = value
    return model, truth


def move(robot: Robot, model: mujoco.MjModel, truth: Truth, random: np.random.Generator) -> Log:
    """Returns the log of an arm that follows sines: what torques that takes says MuJoCo."""
    _disable(model, "CONTACT", "LIMIT", "FRICTIONLOSS", "ACTUATION")
    data = mujoco.MjData(model)
    clock = np.arange(0, SECONDS, 1 / RATE)
    position, velocity, acceleration = sines(robot, clock, random)
    torque = np.zeros_like(position)
    dofs = robot.mj_convention.qvel_index
    friction = np.array([truth["friction", name, ""] for name in robot.joint_names])
    for row in range(len(clock)):
        robot.mj_convention.set_state(data, position[row], velocity[row])
        data.qacc[dofs] = acceleration[row]
        mujoco.mj_inverse(model, data)
        torque[row] = data.qfrc_inverse[dofs] + friction * np.sign(velocity[row])
    return measured(robot, clock, position, torque, truth, random)


def serve(
    robot: Robot,
    model: mujoco.MjModel,
    truth: Truth,
    random: np.random.Generator,
    bandwidth: float,
) -> Log | None:
    """Returns the log of an arm whose servos follow sines, by MuJoCo's own steps.

    None if no such arm can be: a drawn inertia makes energy negative, and the simulation unstable.

    Positions and torques are those of one moment: what ``mj_step`` leaves are the torques of the
    moment before. Friction is made for the planted masses and armatures: without ``mj_setConst``
    MuJoCo takes those of the file for it (``dof_invweight0``), and where these are much less, as
    where a file has no armature, its friction is viscous and never gets to its own size.
    """
    _disable(model, "CONTACT", "LIMIT", "ACTUATION")
    dofs, qpos = robot.mj_convention.qvel_index, robot.mj_convention.qpos_index
    model.dof_frictionloss[dofs] = [truth["friction", name, ""] for name in robot.joint_names]
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST.value
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    clock = np.arange(0, SECONDS, STEP)
    command = sines(robot, clock, random)[0]
    robot.mj_convention.set_state(data, command[0], np.zeros(robot.nu))
    mujoco.mj_forward(model, data)
    whole = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, whole)
    kp = bandwidth**2 * np.diag(whole)[dofs]
    kd = 2 * 0.7 / bandwidth * kp  # damped as servos are
    each, position, torque = round(1 / RATE / STEP), [], []
    for row, wanted in enumerate(command):
        now = data.qpos[qpos].copy()
        data.qfrc_applied[dofs] = kp * (wanted - now) - kd * data.qvel[dofs]
        if row % each == 0:
            position.append(now)
            torque.append(data.qfrc_applied[dofs].copy())
        mujoco.mj_step(model, data)
        if any(one.number for one in data.warning):
            return None
    return measured(robot, clock[::each], np.array(position), np.array(torque), truth, random)


def sines(robot: Robot, clock: Array, random: np.random.Generator) -> tuple[Array, Array, Array]:
    """Returns positions of joints within their limits, and their derivatives (times, nu)."""
    low = np.maximum(robot.lower_limits, -2.5)
    high = np.minimum(robot.upper_limits, 2.5)
    frequencies = 2 * np.pi * random.uniform(0.05, 0.8, (WAVES, robot.nu))
    sizes = 0.4 * (high - low) * random.dirichlet(np.ones(WAVES), robot.nu).T
    sizes /= np.maximum(1, 0.5 * frequencies)
    phases = random.uniform(0, 2 * np.pi, (WAVES, robot.nu))
    angle = frequencies * clock[:, None, None] + phases
    return (
        (low + high) / 2 + (sizes * np.sin(angle)).sum(axis=1),
        (sizes * frequencies * np.cos(angle)).sum(axis=1),
        -(sizes * frequencies**2 * np.sin(angle)).sum(axis=1),
    )


def _disable(model: mujoco.MjModel, *flags: str) -> None:
    for flag in flags:
        model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}").value


def measured(
    robot: Robot,
    clock: Array,
    position: Array,
    torque: Array,
    truth: Truth,
    random: np.random.Generator,
) -> Log:
    """Returns a log with what sensors do; the truth gets their bias."""
    scale = np.sqrt(np.mean(torque**2, axis=0))
    bias = 0.02 * scale * random.normal(size=robot.nu)
    for name, value in zip(robot.joint_names, bias.tolist(), strict=True):
        truth["bias", name, ""] = value
    torque = torque + bias + TORQUE_NOISE * scale * random.normal(size=torque.shape)
    position = position + 0.3 * QUANTUM * random.normal(size=position.shape)
    position = QUANTUM * np.round(position / QUANTUM)
    blank = np.full(position.shape, np.nan)
    return Log("simulated", clock, robot.joint_names, blank, position, None, torque)


def run(
    name: str, path: Path, seeds: int, bandwidth: float | None = None
) -> Mapping[str, tuple[int, int]]:
    """Prints how often intervals hold what was planted, by kind of parameter."""
    robot = load_robot(path)
    held: dict[str, list[bool]] = defaultdict(list)
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        model, truth = plant(robot, random)
        log = (
            serve(robot, model, truth, random, bandwidth)
            if bandwidth
            else move(robot, model, truth, random)
        )
        if log is None:
            print(f"{name} {seed}: no such arm can be")
            continue
        start = time.perf_counter()
        found = fit_torques(robot, [log], priors=PRIORS)
        seconds = time.perf_counter() - start
        truth["lag", "torques", ""] = 0.0
        inside = {
            (one.kind, one.subject, one.component): one.low
            <= truth[one.kind, one.subject, one.component]
            <= one.high
            for one in found.estimates
        }
        told = [one for one in found.estimates if one.told == "data"]
        for one in found.estimates:
            key = one.kind, one.subject, one.component
            held[one.kind].append(inside[key])
            held["all"].append(inside[key])
            if one.told == "data":
                held["told by data"].append(inside[key])
                held[f"{one.kind} by data"].append(inside[key])
        print(
            f"{name} {seed}: {seconds:.1f} s, held out {found.held_out:.3g} N m "
            f"({100 * found.held_out / found.torque:.2f} %), file {found.held_out_before:.3g}; "
            f"cut-off {min(found.cutoff.values()):.1f}-{max(found.cutoff.values()):.1f} Hz, "
            f"{found.directions} of {len(found.estimates)} directions, {len(told)} by data, "
            f"{100 * np.mean(list(inside.values())):.1f} % inside",
            [one.code for one in (*found.failures, *found.diagnostics)],
            flush=True,
        )
    for kind, inside_all in held.items():
        print(f"  {name} {kind}: {100 * np.mean(inside_all):.1f} % of {len(inside_all)}")
    return {kind: (sum(inside_all), len(inside_all)) for kind, inside_all in held.items()}


def main() -> None:
    """Runs arms by their names, or by paths of their files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("arms", nargs="*", default=list(ARMS))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--servos", type=float, help="servos' bandwidth (rad/s)")
    given = parser.parse_args()
    for name in given.arms:
        folder = Path(os.environ.get("PUPPER_ROBOTS", "."))
        path = folder / ARMS[name] if name in ARMS else Path(name)
        run(name, path, given.seeds, given.servos)


if __name__ == "__main__":
    main()
