"""What a policy asks of a robot's motors as it walks, and how well it follows its command."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.prepare.judge import list_file_remarks
from pupper_analysis.robot.contact import bodies_on_ground
from pupper_analysis.robot.fall import FALLEN_TILT
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.monitor import FALLEN_HEIGHT
from pupper_analysis.simulation.rollout import STATE
from pupper_analysis.tools.walk.contract import Contract
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import (
    Run,
    Stage,
    prepare_stage,
    rotations_from_quaternions,
    simulate_cases,
)

Array = NDArray[np.float64]

DEFAULT_SECONDS, WARM_UP_SECONDS = 8.0, 2.0
"""Of a run, and what of it is not looked at (s): a robot that starts walking needs a second."""

SPEED_RTOL, SPEED_ATOL = 0.25, 0.05
"""A speed is followed that is off by no more than this share of the command, and so many m/s: a
choice. Pupper's public policy reaches 0.93 of its command; the slack is for one of zero."""

TURN_ATOL = 0.1
"""Likewise of turning (rad/s)."""

MIN_FOLLOWED_FRACTION = 0.5
"""Of any command that is not zero, however slow, half is followed: beside 0.13 m/s the slack is
most of the command."""

LIMIT_FRACTION = 0.99
"""Of its limit: a motor that gives more is at it."""

_FASTEST = 100.0
"""Of commands (m/s, rad/s): beyond, a unit is wrong."""

_FRAME = 1 / 25
"""s between the configurations that are kept to be looked at."""


@dataclass(frozen=True, eq=False)
class Gait(Result):
    """One run of a policy on a robot: means are over what follows the warm-up.

    Attributes:
        command: (3,) speed forward and to the left (m/s), and turning to the left (rad/s).
        seed: Of its start; 0: exactly the default pose, at rest.
        fall: Why it is a fall, if it is one; else None.
        duration: Until a fall, or to the end (s).
        velocity: (2,) mean speed forward and to the left, in the base's heading (m/s).
        turning: Mean turning to the left (rad/s).
        tracks: Whether it has not fallen, and follows its command.
        torque_rms: (nu,) root of the mean square of each motor's torque (N m).
        torque_peak: (nu,) its greatest torque (N m).
        at_limit: (nu,) share of the time in which it gives all it can.
        speed_peak: (nu,) its greatest speed (rad/s).
        power: Mean of the positive mechanical power of all motors: nothing is won back (W).
        transport: Cost of transport: that power over weight and speed over ground; None where it
            does not move.
        duty: {foot: share of the time in which it touches the ground}.
        touching: Bodies besides the feet that touched the ground.
        static: (nu,) root of the mean square of what statics ask of each motor at the same moments
            (N m); of the first run (seed 0) alone, else None.
        roll: Standard deviation of the base's roll (rad).
        pitch: Of its pitch (rad).
        bounce: Of its height (m).
        margin: How far it stays from a fall: 1 as upright and high as it stood, 0 where it falls.
        motion_time: (m,) samples (s).
        motion: (m, nq) the configurations at these, to be looked at.
        torque_time: (k,) samples of a second at the end (s).
        torques: (k, nu) the motors' torques at these (N m).
    """

    command: Array = field(metadata={"unit": "m/s or rad/s"})
    seed: int
    fall: Diagnostic | None
    duration: float = field(metadata={"unit": "s"})
    velocity: Array = field(metadata={"unit": "m/s"})
    turning: float = field(metadata={"unit": "rad/s"})
    tracks: bool
    torque_rms: Array = field(metadata={"unit": "N m"})
    torque_peak: Array = field(metadata={"unit": "N m"})
    at_limit: Array = field(metadata={"unit": "1"})
    speed_peak: Array = field(metadata={"unit": "rad/s"})
    power: float = field(metadata={"unit": "W"})
    transport: float | None = field(metadata={"unit": "1"})
    duty: Mapping[str, float] = field(metadata={"unit": "1"})
    touching: tuple[str, ...]
    static: Array | None = field(metadata={"unit": "N m"})
    roll: float = field(metadata={"unit": "rad"})
    pitch: float = field(metadata={"unit": "rad"})
    bounce: float = field(metadata={"unit": "m"})
    margin: float = field(metadata={"unit": "1"})
    motion_time: Array = field(metadata={"unit": "s"})
    motion: Array = field(metadata={"unit": "m, 1 (quaternion) and rad"})
    torque_time: Array = field(metadata={"unit": "s"})
    torques: Array = field(metadata={"unit": "N m"})


@dataclass(frozen=True, eq=False)
class Walk(Result):
    """What a policy asks of a robot.

    Attributes:
        name: The robot's name.
        policy: The name of the policy's file.
        contract: What it observes, and what its actions mean.
        joints: The robot's, in actuator order.
        limits: (nu,) torque that each motor can give (N m); infinite without a limit.
        mass: kg.
        gaits: One for each seed; the first starts exactly in the default pose.
        integrator: MuJoCo's.
        timestep: s.
        rate: How often the policy was asked (Hz): a whole number of time steps.
        warm_up: What is not looked at (s).
        remarks: Errors and assumptions of the robot's files that it rests on.
    """

    name: str
    policy: str
    contract: Contract
    joints: tuple[str, ...]
    limits: Array = field(metadata={"unit": "N m"})
    mass: float = field(metadata={"unit": "kg"})
    gaits: tuple[Gait, ...]
    integrator: str
    timestep: float = field(metadata={"unit": "s"})
    rate: float = field(metadata={"unit": "Hz"})
    warm_up: float = field(metadata={"unit": "s"})
    remarks: tuple[Diagnostic, ...]

    @property
    def passed(self) -> bool:
        """Whether every run follows its command."""
        return all(gait.tracks for gait in self.gaits)


def check_command(command: ArrayLike) -> Array:
    """Returns a command (3,), checked.

    Raises:
        ConfigurationError: If it is not three finite numbers below 100.
    """
    try:
        found = np.array(command, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise ConfigurationError("command", diagnose("no-numbers", count=3)) from error
    if found.shape != (3,) or not np.isfinite(found).all():
        raise ConfigurationError("command", diagnose("no-numbers", count=3))
    most = float(found[np.abs(found).argmax()])
    if abs(most) > _FASTEST:
        problem = diagnose("not-between", given=most, low=-_FASTEST, high=_FASTEST)
        raise ConfigurationError("command", problem)
    return found


def check_runs(seeds: int, seconds: float, warm_up: float) -> None:
    """Checks how many runs are asked for, and how long they are.

    Raises:
        ConfigurationError: If a number is out of its range.
    """
    for name, value, low, high in (
        ("seconds", seconds, 3, 600),
        ("warm_up", warm_up, 0, seconds - 1),
        ("seeds", seeds, 1, 1000),
    ):
        if not (math.isfinite(value) and low <= value <= high):
            problem = diagnose("not-between", given=str(value), low=low, high=high)
            raise ConfigurationError(name, problem)


@check_arguments
def simulate_walk(
    robot: Robot,
    policy: Policy,
    command: ArrayLike = (0.5, 0.0, 0.0),
    *,
    seeds: int = 1,
    seconds: float = DEFAULT_SECONDS,
    warm_up: float = WARM_UP_SECONDS,
    workers: int | None = None,
) -> Walk:
    """Lets a policy walk a robot in MuJoCo, as its files have it, and measures what it does.

    The servos have the policy's gains where it states them, and the robot's limits of torque. It
    starts in the policy's default pose, its lowest foot on the ground, and has its command at once.

    Args:
        robot: The robot.
        policy: The policy.
        command: Speed forward and to the left (m/s), and turning to the left (rad/s).
        seeds: How many runs, whose starts differ by 0.05 rad and 0.05 m/s at most.
        seconds: Of each, 3 to 600.
        warm_up: What of it is not looked at (s).
        workers: Threads; by default one per core. The result is the same for any number.

    Raises:
        ConfigurationError: If an argument is out of its range, or the base is fixed.
        ModelError: If the policy does not fit the robot.
    """
    wanted = check_command(command)
    check_runs(seeds, seconds, warm_up)
    stage = prepare_stage(robot, policy)
    cases = [stage.case(wanted, seed) for seed in range(seeds)]
    runs = simulate_cases(stage, cases, seconds, warm_up, workers)
    gaits = tuple(measure_gait(stage, run, warm_up) for run in runs)
    return Walk(
        name=robot.name,
        policy=policy.name,
        contract=policy.contract,
        joints=robot.joint_names,
        limits=robot.effort_limits,
        mass=robot.total_mass,
        gaits=gaits,
        integrator=mujoco.mjtIntegrator(int(stage.model.opt.integrator)).name[6:],
        timestep=stage.timestep,
        rate=1.0 / (stage.substeps * stage.timestep),
        warm_up=warm_up,
        remarks=list_file_remarks(robot),
    )


def joint_torques(stage: Stage, run: Run) -> Array:
    """Returns the torques (n, nu) of the robot's motors at the beginning of each step (N m).

    By the servos' law, as MuJoCo's: clip(gain ctrl + bias, force range) times the gear.
    """
    model, convention = run.case.model, stage.robot.mj_convention
    driven = np.flatnonzero(convention.actuator_index >= 0)
    motors = convention.actuator_index[driven]
    before = run.states[:-1]
    rows = slice(1, None)
    qpos = before[:, 1 + convention.qpos_index[7:]][:, driven]
    qvel = before[:, 1 + model.nq + convention.qvel_index[6:]][:, driven]
    controls = model.actuator_ctrladr[motors]
    ctrl = run.targets[rows][:, controls]
    ranges = np.where(
        model.actuator_ctrllimited[controls][:, None], model.actuator_ctrlrange[controls], np.inf
    )
    ranges[:, 0] = np.where(model.actuator_ctrllimited[controls], ranges[:, 0], -np.inf)
    ctrl = np.clip(ctrl, ranges[:, 0], ranges[:, 1])
    lagging = model.actuator_actadr[motors] >= 0
    if lagging.any():
        ends = (model.actuator_actadr + model.actuator_actnum - 1)[motors[lagging]]
        ctrl[:, lagging] = before[:, 1 + model.nq + model.nv + ends]
    gear, bias = model.actuator_gear[motors, 0], model.actuator_biasprm[motors]
    force = model.actuator_gainprm[motors, 0] * ctrl + bias[:, 0]
    force += gear * (bias[:, 1] * qpos + bias[:, 2] * qvel)
    limited = model.actuator_forcelimited[motors].astype(bool)
    force[:, limited] = np.clip(force[:, limited], *model.actuator_forcerange[motors[limited]].T)
    torques = np.zeros((len(before), stage.robot.nu))
    torques[:, driven] = gear * force
    return torques


@dataclass(frozen=True, eq=False)
class Tracking:
    """How a run follows its command: see ``Gait``."""

    velocity: Array
    turning: float
    tracks: bool


def evaluate_tracking(stage: Stage, run: Run, warm_up: float) -> Tracking:
    """Returns how a run follows its command after the warm-up."""
    first = round(warm_up / stage.timestep)
    index = stage.robot.mj_convention.qpos_index
    seen = run.states[first:]
    if len(seen) < 2 or not np.isfinite(seen).all():
        return Tracking(np.zeros(2), 0.0, False)
    turned = rotations_from_quaternions(seen[:, 1 + index[3:7]])
    heading = np.unwrap(np.arctan2(turned[:, 1, 0], turned[:, 0, 0]))
    time = (len(seen) - 1) * stage.timestep
    steps = np.diff(seen[:, 1 + index[:2]], axis=0)
    cosine, sine = np.cos(heading[:-1]), np.sin(heading[:-1])
    velocity = np.array(
        [
            np.sum(cosine * steps[:, 0] + sine * steps[:, 1]),
            np.sum(cosine * steps[:, 1] - sine * steps[:, 0]),
        ]
    )
    velocity /= time
    turning = float(heading[-1] - heading[0]) / time
    command = run.case.command
    off = float(np.linalg.norm(velocity - command[:2]))
    tracks = not run.fallen
    for error, slack, asked in (
        (off, SPEED_ATOL, float(np.linalg.norm(command[:2]))),
        (abs(turning - command[2]), TURN_ATOL, abs(command[2])),
    ):
        most = (1 - MIN_FOLLOWED_FRACTION) * asked if asked else math.inf
        tracks &= error <= min(SPEED_RTOL * asked + slack, most)
    return Tracking(velocity, turning, bool(tracks))


def measure_gait(stage: Stage, run: Run, warm_up: float) -> Gait:
    """Returns what a run asks of the motors, and how it follows its command."""
    robot, step = stage.robot, stage.timestep
    first = min(round(warm_up / step), max(0, len(run.states) - 2))
    whole = np.asarray(np.isfinite(run.states).all(axis=1))
    torques = joint_torques(stage, run)[first:]
    torques = np.nan_to_num(torques, nan=0.0)
    convention = robot.mj_convention
    rates = run.states[first:-1, 1 + stage.model.nq + convention.qvel_index[6:]]
    rates = np.nan_to_num(rates, nan=0.0)
    limits = robot.effort_limits
    followed = evaluate_tracking(stage, run, warm_up)
    power = float(np.maximum(torques * rates, 0.0).sum(axis=1).mean())
    speed = float(np.linalg.norm(followed.velocity))
    weight = robot.weight
    ticks = run.states[first :: stage.substeps]
    ticks = ticks[np.isfinite(ticks).all(axis=1)]
    seen, touching = find_ground_contacts(stage, run.case.model, ticks, statics=not run.case.seed)
    duty = {foot: sum(foot in one.feet for one in seen) / max(1, len(seen)) for foot in robot.feet}
    turned = rotations_from_quaternions(ticks[:, 1 + convention.qpos_index[3:7]])
    allowed = (FALLEN_TILT, (1 - FALLEN_HEIGHT) * stage.upright.size)
    used = 1.0 if run.fallen else max(run.lean / allowed[0], run.lost / allowed[1], 0.0)
    every = max(1, round(_FRAME / step))
    shown = run.states[::every][whole[::every]]
    last = round(1.0 / step)
    times = run.states[first:-1, 0]
    return Gait(
        command=run.case.command,
        seed=run.case.seed,
        fall=describe_fall(stage, run, len(run.states) * step) if run.fallen else None,
        duration=len(run.states) * step,
        velocity=followed.velocity,
        turning=followed.turning,
        tracks=followed.tracks,
        torque_rms=_rms(torques),
        torque_peak=np.abs(torques).max(axis=0),
        at_limit=np.asarray(np.mean(np.abs(torques) >= LIMIT_FRACTION * limits, axis=0)),
        speed_peak=np.abs(rates).max(axis=0),
        power=power,
        transport=power / (weight * speed) if speed > SPEED_ATOL else None,
        duty=duty,
        touching=touching,
        static=_rms(np.array([one.static for one in seen])) if seen and not run.case.seed else None,
        roll=float(np.std(np.arctan2(turned[:, 2, 1], turned[:, 2, 2]))),
        pitch=float(np.std(np.arcsin(np.clip(-turned[:, 2, 0], -1, 1)))),
        bounce=float(np.std(ticks[:, 1 + convention.qpos_index[2]])),
        margin=max(0.0, 1.0 - used),
        motion_time=shown[:, 0].copy(),
        motion=np.round(shown[:, 1 + convention.qpos_index], 5),
        torque_time=times[-last:].copy(),
        torques=np.round(torques[-last:], 5),
    )


def describe_fall(stage: Stage, run: Run, duration: float) -> Diagnostic:
    """Says how a run fell that began so long ago (s)."""
    time, end = Quantity(duration, "s"), run.states[-1]
    if not np.isfinite(end).all() or end[0] < duration - 0.5 * stage.timestep:
        return diagnose("walk-diverged", time=time)
    lean = Quantity(stage.upright.lean(end), "rad")
    height = Quantity(float(end[1 + stage.robot.mj_convention.qpos_index[2]]), "m")
    return diagnose("fell-over", tilt=lean, height=height, time=time)


class ContactSample(NamedTuple):
    """Which feet touch at a moment, and what statics ask of the motors (nu,) there (N m).

    Statics: the same joints, nothing moving, vertical forces at the points that touch, which carry
    the weight as close beneath the centre of mass as they can. Where that is outside, a robot
    standing so would tip; it does not while it walks.
    """

    feet: tuple[str, ...]
    static: Array


def find_ground_contacts(
    stage: Stage, model: mujoco.MjModel, states: Array, *, statics: bool
) -> tuple[list[ContactSample], tuple[str, ...]]:
    """Returns which feet touch the ground in some states, and what else touches it in any.

    Without ``statics`` what these ask is zeros, and takes no time.
    """
    robot, data = stage.robot, mujoco.MjData(model)
    found, others = [], set()
    for state in states:
        mujoco.mj_setState(model, data, state, STATE)
        if statics:
            data.qvel[:] = 0.0
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
        else:
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
        near = np.flatnonzero(data.contact.dist <= 0)
        pairs = data.contact.geom[near]
        bodies = model.geom_bodyid[pairs]
        geoms = np.where(bodies[:, 0] == 0, pairs[:, 1], pairs[:, 0])
        feet = [robot.foot_geoms.get(int(geom)) for geom in geoms]
        ground = (bodies == 0).any(axis=1) & np.array([foot is not None for foot in feet], bool)
        named = {str(feet[index]) for index in np.flatnonzero(ground)}
        touching = tuple(foot for foot in robot.feet if foot in named)
        asked = np.zeros(robot.nu)
        if statics:
            points, bearing = data.contact.pos[near[ground]], model.geom_bodyid[geoms[ground]]
            asked = _statics(stage, model, data, points, bearing)
        found.append(ContactSample(touching, asked))
        others |= bodies_on_ground(model, data, robot.foot_geoms)
    return found, tuple(sorted(others))


_UPRIGHT, _EVEN = 1e3, 1e-5
"""How much the forces' sum counts beside their place, and that they be even where that is free."""


def _statics(
    stage: Stage, model: mujoco.MjModel, data: mujoco.MjData, points: Array, bodies: NDArray[Any]
) -> Array:
    """Returns the motors' torques (nu,) of statics on some points.

    Vertical forces n >= 0 at the points p: least |sum n p / W - c|, with sum n = W.
    """
    from scipy.optimize import nnls  # takes a quarter of a second

    free = data.qfrc_bias - data.qfrc_passive
    weight = float(np.linalg.norm(model.opt.gravity)) * float(model.body_subtreemass[1:].max())
    if len(points):
        com = data.subtree_com[stage.model.body(stage.robot.mj_base).id, :2]
        apart = (points[:, :2] - com).T
        rows = np.vstack([apart, np.full(len(points), _UPRIGHT), _EVEN * np.eye(len(points))])
        shares, _ = nnls(rows, np.r_[0.0, 0.0, _UPRIGHT, np.zeros(len(points))])
        jacobian = np.empty((3, model.nv))
        for point, body, share in zip(points, bodies, shares, strict=True):
            mujoco.mj_jac(model, data, jacobian, None, point, int(body))
            free = free - weight * share * jacobian[2]
    torques: Array = free[stage.robot.mj_convention.qvel_index[6:]]
    return torques


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt((values**2).mean(axis=0)))
