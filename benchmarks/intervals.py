"""Ends of the intervals of `walk --vary`, compared with bisections in MuJoCo alone.

    python benchmarks/intervals.py FOLDER

FOLDER is that of `benchmarks/contract.py`. Two policies are used: neural_controller on Pupper v3,
and the biped of Berkeley Humanoid Lite. The separate loop compiles the MJCF with MuJoCo, sets
servo gains and torque limits, forms the observations, and evaluates falls and tracking. Both use
the same five initial states. An end agrees if the mean of the bare ends over the seeds is inside
the spread that `walk` prints, from the smallest tracked to the largest untracked value of a seed.
The exit status is 1 if an end does not agree.
"""

from __future__ import annotations

import copy
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click
import mujoco
import numpy as np
from contract import PROJECT_FOLDER

import pupper_analysis as pa
from pupper_analysis.tools.contract.deployment import read_deployment
from pupper_analysis.tools.walk.intervals import TrackedInterval, tracked_intervals
from pupper_analysis.tools.walk.policy import Policy

COMMAND, SECONDS, WARM_UP, SEEDS = np.array([0.5, 0.0, 0.0]), 5.0, 1.5, 5
"""Command [m/s, m/s, rad/s], duration and warm-up [s], and number of initial states, as in `walk`.
"""

SPEED_TOLERANCE, TURNING_TOLERANCE = 0.175, 0.1
"""Largest error of the velocity [m/s] for this command, and of the turning rate [rad/s]: those of
`walk`, 25 % of the command and 0.05 m/s."""

RANGES = {"payload": (0.0, 2.0), "kp": (1.0, 8.0), "friction": (1.0, 0.05), "strength": (1.0, 0.05)}
"""{quantity: value of the unchanged robot, and end of the searched range}. The payload is relative
to the mass of the robot; the others are factors."""

HALVINGS = 6
"""Number of bisections of the separate loop."""


@dataclass(frozen=True)
class Setting:
    """Policy on a robot for the separate loop.

    Attributes:
        name: Name of the robot.
        mjcf: File that MuJoCo compiles.
        base: Name of the base body.
        policy: Policy, of which the network and the stated numbers are used.
        limit: Torque limit of all motors [N m].
        integrator: Integrator instead of that of the file, which has no position servos.
    """

    name: str
    mjcf: Path
    base: str
    policy: Policy
    limit: float
    integrator: int | None = None


def make_model(setting: Setting) -> tuple[mujoco.MjModel, list[int], list[int]]:
    """Compile the MJCF with servos of the policy; return the model, joints and actuators."""
    model, contract = mujoco.MjModel.from_xml_path(str(setting.mjcf)), setting.policy.contract
    names = contract.joints or [model.joint(int(one)).name for one in model.actuator_trnid[:, 0]]
    joints = [model.joint(name).id for name in names]
    motors = [model.actuator_trnid[:, 0].tolist().index(joint) for joint in joints]
    assert contract.kp is not None
    assert contract.kd is not None
    model.actuator_gaintype[motors] = mujoco.mjtGain.mjGAIN_FIXED
    model.actuator_biastype[motors] = mujoco.mjtBias.mjBIAS_AFFINE
    model.actuator_gainprm[motors, 0] = contract.kp
    model.actuator_biasprm[motors, :3] = np.stack(
        [np.zeros(len(motors)), -contract.kp, -contract.kd], axis=1
    )
    model.actuator_ctrllimited[motors] = 0
    model.actuator_forcelimited[motors] = 1
    model.actuator_forcerange[motors] = (-setting.limit, setting.limit)
    if setting.integrator is not None:
        model.opt.integrator = setting.integrator
    return model, joints, motors


def change_model(
    setting: Setting, model: mujoco.MjModel, motors: list[int], name: str, value: float
) -> mujoco.MjModel:
    """Return a copy of a model with a changed quantity."""
    changed = copy.copy(model)
    if name == "payload":
        changed.body_mass[model.body(setting.base).id] += value * model.body_subtreemass[0]
    elif name == "kp":
        changed.actuator_gainprm[motors, 0] *= value
        changed.actuator_biasprm[motors, 1] *= value
    elif name == "friction":
        changed.geom_friction[:, 0] *= value
        changed.pair_friction[:, :2] *= value
    else:
        changed.actuator_forcerange[motors] *= value
    mujoco.mj_setConst(changed, mujoco.MjData(changed))
    return changed


def find_height(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return the height of the base at which the lowest point touches the ground [m]."""
    low, high = 0.0, 2.0
    for _ in range(40):
        data.qpos[2] = (low + high) / 2
        mujoco.mj_forward(model, data)
        grounded = any(0 in model.geom_bodyid[contact.geom] for contact in data.contact)
        low, high = (data.qpos[2], high) if grounded else (low, data.qpos[2])
    return high


def walks(
    setting: Setting, model: mujoco.MjModel, joints: list[int], motors: list[int], seed: int
) -> bool:
    """Return True if the robot does not fall and tracks the command, from the state of a seed."""
    contract, network = setting.policy.contract, setting.policy.network
    data = mujoco.MjData(model)
    places, rates = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    data.qpos[:7] = (0, 0, 1, 1, 0, 0, 0)
    data.qpos[places] = contract.signs * contract.default
    data.qpos[2] = find_height(model, data)
    data.qvel[:] = 0.0
    if seed:
        draw = np.random.default_rng(seed).uniform(-1.0, 1.0, len(joints) + 6)
        places_of_all = [model.joint(int(one)).qposadr[0] for one in model.actuator_trnid[:, 0]]
        data.qpos[places_of_all] += 0.05 * draw[6:]
        data.qvel[:6] = 0.05 * draw[:6]
    mujoco.mj_forward(model, data)
    base = model.body(setting.base).id
    reference = data.subtree_com[base] - data.xpos[base]
    reference = data.xmat[base].reshape(3, 3).T @ reference
    height = data.xpos[base][2] + reference[2]
    memory, last, frames = network.initial_memory(1), np.zeros(len(joints)), list[Any]()
    every = round(1 / (contract.rate * model.opt.timestep))
    track: list[tuple[float, float, float]] = []
    for step in range(round(SECONDS / model.opt.timestep)):
        turned = data.xmat[base].reshape(3, 3)
        if step % every == 0:
            mujoco.mj_forward(model, data)
            turned = data.xmat[base].reshape(3, 3)
            signals: dict[str, Any] = {
                "angular-velocity": data.qvel[3:6],
                "gravity": turned.T @ (0.0, 0.0, -1.0),
                "command": COMMAND,
                "up-command": (0.0, 0.0, 1.0),
                "joint-positions": contract.signs * data.qpos[places] - contract.default,
                "joint-velocities": contract.signs * data.qvel[rates],
                "last-action": last,
            }
            parts = [np.asarray(signals[term.name]) * term.scale for term in contract.terms]
            frame = np.clip(np.concatenate(parts), -contract.clip, contract.clip)
            frames = [frame] * contract.history if not frames else [*frames[1:], frame]
            seen = frames[::-1] if contract.newest_first else frames
            action, memory = network.forward(np.concatenate(seen)[None], memory)
            last = action[0]
            offset = contract.default if contract.offset is None else contract.offset
            clipped = np.clip(last, -contract.action_clip, contract.action_clip)
            target = np.clip(
                offset + contract.action_scale * clipped, contract.lower, contract.upper
            )
            data.ctrl[motors] = contract.signs * target
        mujoco.mj_step(model, data)
        turned = data.xmat[base].reshape(3, 3)
        drop = height - (data.xpos[base] + turned @ reference)[2]
        if math.acos(np.clip(turned[2, 2], -1, 1)) > 0.5 or drop > 0.5 * height:
            return False
        if data.time > WARM_UP:
            heading = math.atan2(turned[1, 0], turned[0, 0])
            ahead = np.array([math.cos(heading), math.sin(heading)])
            moving = data.qvel[:2]
            track.append((float(ahead @ moving), float(ahead[0] * moving[1] - ahead[1] * moving[0]),
                          heading))  # fmt: skip
    forward, left, heading = np.array(track).T
    error = math.hypot(forward.mean() - COMMAND[0], left.mean() - COMMAND[1])
    turning = (np.unwrap(heading)[-1] - heading[0]) / (SECONDS - WARM_UP)
    return error <= SPEED_TOLERANCE and abs(turning) <= TURNING_TOLERANCE


def tracks_changed(setting: Setting, name: str, seed: int, value: float) -> bool:
    """Return True if the robot tracks the command with a changed quantity, from a seed's state."""
    model, joints, motors = make_model(setting)
    return walks(setting, change_model(setting, model, motors, name, value), joints, motors, seed)


def bisect_end(tracks: Callable[[float], bool], start: float, end: float, factor: bool) -> float:
    """Return the midpoint of the bracket of an end; the end of the range if it is tracked."""
    if tracks(end):
        return end
    good, bad = start, end
    for _ in range(HALVINGS):
        middle = math.sqrt(good * bad) if factor else (good + bad) / 2
        good, bad = (middle, bad) if tracks(middle) else (good, middle)
    return math.sqrt(good * bad) if factor else (good + bad) / 2


def get_spread(interval: TrackedInterval, *, upper: bool) -> tuple[float, float]:
    """Return the smallest and the largest value at which a seed of `walk` may end."""
    tracked, other = (interval.most, interval.above) if upper else (interval.least, interval.below)
    values = np.concatenate([tracked, np.where(np.isnan(other), tracked, other)])
    return float(values.min()), float(values.max())


@click.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--quantity", "names", multiple=True, type=click.Choice(list(RANGES)))
@click.option("--robot", "chosen", type=click.Choice(["v3", "bhl"]))
def main(folder: Path, names: tuple[str, ...], chosen: str | None) -> None:
    """Compare ends of intervals; print the bare ends of all seeds and the spread of `walk`."""
    lite = folder / "HybridRobotics/Berkeley-Humanoid-Lite"
    scene = folder / "HybridRobotics/Berkeley-Humanoid-Lite-Assets/data/mjcf/bhl_biped_scene.xml"
    trainer = (
        "source/berkeley_humanoid_lite/berkeley_humanoid_lite/tasks/locomotion/velocity/config"
    )
    cases = []
    if chosen != "bhl":
        robot = pa.load_variant("v3")
        policy = Policy.load(folder / "G-Levine/neural_controller/launch/policy_latest.json")
        mjcf = PROJECT_FOLDER / "mjcf/pupper_v3.xml"
        cases.append((robot, Setting("v3", mjcf, "base_link", policy, 3.0)))
    if chosen != "v3":
        robot = pa.load_robot(mjcf=scene)
        onnx = lite / "checkpoints/policy_biped_50hz.onnx"
        files = [lite / "configs/policy_biped_50hz.yaml", lite / trainer / "biped/env_cfg.py"]
        policy = Policy.load(onnx, deployment=read_deployment(robot, files, onnx))
        cases.append(
            (
                robot,
                Setting(
                    "bhl", scene, "base", policy, 5.0, mujoco.mjtIntegrator.mjINT_IMPLICITFAST.value
                ),
            )
        )
    missed = 0
    for robot, setting in cases:
        found = tracked_intervals(robot, setting.policy, COMMAND, quantities=names or tuple(RANGES))
        for interval in found.intervals:
            start, end = RANGES[interval.quantity]
            ends = [
                bisect_end(partial(tracks_changed, setting, interval.quantity, seed), start, end,
                           interval.unit == "x")
                for seed in found.seeds
            ]  # fmt: skip
            low, high = get_spread(interval, upper=end > start)
            agrees = low <= float(np.mean(ends)) <= high
            missed += not agrees
            shown = ", ".join(f"{one:.3g}" for one in ends)
            click.echo(f"{'agrees' if agrees else 'DIFFERS'} {setting.name} {interval.quantity}: "
                       f"bare {shown}; walk {low:.3g} to {high:.3g}")  # fmt: skip
    sys.exit(bool(missed))


if __name__ == "__main__":
    main()
