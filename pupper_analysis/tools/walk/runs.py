"""Many runs of a policy at once: a batch moves in lockstep, batches go to threads.

What a run gives is the same exactly for any number of workers, and whatever runs beside it:
MuJoCo steps each by itself, and the network multiplies each run's row by itself.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import mujoco
import mujoco.rollout
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, UnknownNameError
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.robot.as_published import ServoSource
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.fall import FALLEN_TILT
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import find_servos_used, model_with_servos, resolve_servo_gains
from pupper_analysis.simulation.monitor import FALLEN_HEIGHT, Upright
from pupper_analysis.simulation.rollout import FORCED, full_state
from pupper_analysis.tools.walk.contract import BY_FRAME, Contract
from pupper_analysis.tools.walk.policy import Policy

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_BATCH = 16
"""Runs in lockstep: enough that Python's share is small, and states fit into memory."""

_JOINT_SPREAD, _SPEED_SPREAD = 0.05, 0.05
"""By how much the starts of seeds differ (rad; m/s, rad/s): a robot that was put down by hand."""

PUSH_TIME = 2.0
"""When a run is pushed (s): it walks by then."""

_NEAR = 0.9
"""Of what is a fall: what is nearer is looked at by the judge."""


@dataclass(frozen=True, eq=False)
class Case:
    """One run.

    Attributes:
        model: What is simulated.
        command: (3,) speed forward and to the left (m/s), and turning (rad/s).
        delay: Of commands at the servos (s).
        seed: Of its start; 0: exactly the default pose, at rest.
        lift: How much higher it stands than the stage's robot (m), as on longer legs.
        push: (2,) forward and to the left, on the base's com during one action after ``PUSHED``
            (N s), in the world.
    """

    model: mujoco.MjModel
    command: Array
    delay: float
    seed: int = 0
    lift: float = 0.0
    push: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Run:
    """What became of a case.

    Attributes:
        case: The case.
        states: (n, size) after each step (mjSTATE_FULLPHYSICS), up to a fall.
        targets: (n, model.nu) what the motors were commanded in each step.
        fallen: Whether it fell, or broke down.
        lean: Of the base, at most after the warm-up (rad).
        lost: Height of its centre of mass, at most after the warm-up (m).
    """

    case: Case
    states: Array
    targets: Array
    fallen: bool
    lean: float
    lost: float


@dataclass(frozen=True, eq=False)
class Stage:
    """A policy on a robot: all that its runs share.

    Attributes:
        robot: The robot.
        policy: The policy.
        model: Its MuJoCo model, with the servos that the policy asks for.
        joints: (n,) which joint of the robot each of the policy's is.
        gear: (n,) ctrl per joint position of these.
        ctrl: (model.nu,) commands of the default pose.
        default: (nq,) the pose in which a run starts.
        substeps: Time steps per action.
        upright: What a fall is measured against.
    """

    robot: Robot
    policy: Policy
    model: mujoco.MjModel
    joints: Integers
    gear: Array
    ctrl: Array
    default: Array
    substeps: int
    upright: Upright

    @property
    def timestep(self) -> float:
        """Of the simulation (s)."""
        return float(self.model.opt.timestep)

    def case(self, command: Array, seed: int = 0) -> Case:
        """Returns a run of the robot as it is."""
        return Case(self.model, command, self.policy.contract.latency, seed)


def prepare_stage(robot: Robot, policy: Policy) -> Stage:
    """Puts a policy on a robot, as its files have it, with the servos that the policy asks for.

    Raises:
        ConfigurationError: If the base is fixed, or it has no feet.
        ModelError: If a joint has no motor, if the policy states no gains and the robot has no
            servos, or their joints do not fit.
        UnknownNameError: If the policy names a joint that the robot has not.
    """
    robot.check_floating()
    contract = policy.contract
    joints = find_joint_indices(robot, policy)
    if not robot.feet:
        raise ConfigurationError("robot", diagnose("walks-on-no-feet", robot=robot.name))
    kp, kd = contract.kp, contract.kd
    if kp is not None and kd is not None:
        apart = len(joints) < robot.nu
        own = resolve_servo_gains(robot) if apart else None
        stiffness = np.zeros(robot.nu) if own is None else own.kp.copy()
        damping = np.zeros(robot.nu) if own is None else own.kd.copy()
        stiffness[joints], damping[joints] = kp, kd
        servos = model_with_servos(robot, stiffness, damping)
    elif kp is not None or kd is not None:
        key = "kp" if kp is None else "kd"
        raise ModelError(policy.name, diagnose("contract-lacks", key=key))
    elif find_servos_used(robot).source is ServoSource.ADDED:  # they are nobody's
        raise ModelError(policy.name, diagnose("policy-without-gains"))
    else:
        servos = model_with_servos(robot)
    model = copy.copy(servos.model)  # nobody reads its sensors, which are 7 % of v3's steps
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    substeps = round(1.0 / (contract.rate * model.opt.timestep))
    if substeps < 1:
        problem = diagnose("rate-above-steps", rate=contract.rate, timestep=model.opt.timestep)
        raise ConfigurationError("rate", problem)
    default = robot.home.copy()
    default[:2] = 0.0
    angles = default[7:]
    angles[joints] = contract.signs * contract.default
    config = Configuration(robot, default)
    feet = config.foot_positions()
    default[2] -= min(feet[foot][2] - robot.contact_radius[foot] for foot in feet)
    return Stage(
        robot=robot,
        policy=policy,
        model=model,
        joints=joints,
        gear=servos.gear[joints],
        ctrl=servos.command(robot, default[7:]),
        default=default,
        substeps=substeps,
        upright=Upright.of(robot, default),
    )


def find_joint_indices(robot: Robot, policy: Policy) -> Integers:
    """Returns which joint of a robot each of a policy's is, by its name, or its place.

    Raises:
        ModelError: If the policy names none, and has another number of joints.
        UnknownNameError: If it names a joint that the robot has not.
    """
    names = policy.contract.joints
    if not names:
        if policy.contract.num_joints != robot.nu:
            problem = diagnose(
                "joints-of-policy", policy=policy.contract.num_joints, robot=robot.nu
            )
            raise ModelError(policy.name, problem)
        return np.arange(robot.nu)
    for name in names:
        if name not in robot.joint_names:
            raise UnknownNameError(policy.name, "joint", name, robot.joint_names)
    return np.array([robot.joint_names.index(name) for name in names], dtype=np.int64)


def simulate_cases(
    stage: Stage,
    cases: Sequence[Case],
    duration: float,
    warm_up: float,
    workers: int | None = None,
) -> Iterator[Run]:
    """Simulates cases, and yields what became of each, in their order.

    Args:
        stage: The policy on its robot.
        cases: The runs; their models have the sizes of the stage's.
        duration: Simulated time of each (s).
        warm_up: What of it is not looked at (s).
        workers: Threads; by default one per core.
    """
    batches = [cases[start : start + _BATCH] for start in range(0, len(cases), _BATCH)]
    # Batches only as full as all workers have one.
    count = max(1, workers or os.cpu_count() or 1)
    if len(batches) < count and len(cases) > 1:
        size = -(-len(cases) // count)
        batches = [cases[start : start + size] for start in range(0, len(cases), size)]
    with silence_mujoco(), ThreadPoolExecutor(count) as pool:
        waiting = [
            pool.submit(_batch, stage, batch, duration, warm_up) for batch in batches[: 2 * count]
        ]
        for batch in batches[2 * count :]:
            yield from waiting.pop(0).result()
            waiting.append(pool.submit(_batch, stage, batch, duration, warm_up))
        for one in waiting:
            yield from one.result()


class Lockstep:
    """Some runs side by side, action by action: what `walk` measures, and `live` plays.

    Args:
        stage: The policy on its robot.
        cases: The runs; their pushes are not made here.

    Attributes:
        commands: (runs, 3) what they are commanded; may be changed between two actions.
        going: (n,) which go on.
        current: (n, size) the states of these.
        tick: How many actions they have had.
    """

    def __init__(self, stage: Stage, cases: Sequence[Case]) -> None:
        self._stage, self._models = stage, [case.model for case in cases]
        self.commands = np.array([case.command for case in cases])
        self.active = np.arange(len(cases))
        self.current = np.array([_start(stage, case) for case in cases])
        self.tick = 0
        self._data, self._runner = mujoco.MjData(stage.model), mujoco.rollout.Rollout(nthread=0)
        self._observer = Observer(stage, self.commands)
        self._memory = stage.policy.network.initial_memory(len(cases))
        delays = np.array([[round(case.delay / stage.timestep)] for case in cases])
        # Which command before the newest one is due at each step of an action.
        self._late = -((np.arange(stage.substeps) - delays) // stage.substeps)
        self._asked = np.tile(stage.ctrl, (len(cases), int(self._late.max()) + 1, 1))

    def advance(self, forces: Array | None = None) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Lets those that go on act once.

        Args:
            forces: (n, 6 nbody) on their bodies meanwhile; see ``FORCED``.

        Returns:
            Their states (n, substeps, size), what their motors are commanded (n, substeps, nu), and
            which of them broke down.
        """
        stage, going = self._stage, self.active
        seen = self._observer.observe(self.current, going, self.tick)
        actions, self._memory = stage.policy.network.forward(seen, self._memory)
        self._observer.last[going] = actions
        self._asked[going, 1:] = self._asked[going, :-1]
        self._asked[going, 0] = _commands(stage, actions)
        control = self._asked[going[:, None], self._late[going]]
        models = [self._models[index] for index in going.tolist()]
        asked, spec = control, {}
        if forces is not None:
            held = np.repeat(forces[:, None], stage.substeps, axis=1)
            asked, spec = np.concatenate([control, held], axis=2), {"control_spec": FORCED}
        states, _ = self._runner.rollout(models, self._data, self.current, asked, **spec)
        self._data.xfrc_applied[:] = 0.0  # what a state does not hold, the next rollout would keep
        self.tick += 1
        self.current = states[:, -1]
        # MuJoCo begins anew, at time 0, where a number is none or too large.
        broken = ~np.isfinite(self.current).all(axis=1)
        broken |= self.current[:, 0] < (self.tick * stage.substeps - 0.5) * stage.timestep
        return states, control, broken

    def keep_runs(self, kept: NDArray[np.bool_]) -> None:
        """Goes on with some of those that go on."""
        self.active, self.current = self.active[kept], self.current[kept]
        self._memory = tuple(one[kept] for one in self._memory)


def _batch(stage: Stage, cases: Sequence[Case], duration: float, warm_up: float) -> list[Run]:
    """Simulates some cases in lockstep."""
    count = len(cases)
    ticks = max(1, round(duration / (stage.substeps * stage.timestep)))
    runs, steps = Lockstep(stage, cases), stage.substeps
    kept = np.empty((count, ticks * steps, runs.current.shape[1]))
    control_kept = np.empty((count, ticks * steps, stage.model.nu))
    ends, fallen = np.full(count, ticks * steps), np.zeros(count, dtype=bool)
    worst = np.zeros((count, 2))
    lifts = np.array([case.lift for case in cases])
    uprights = [raise_upright(stage.upright, case.lift) for case in cases]
    pushes = make_push_forces(stage, [case.push for case in cases])
    pushed = round(PUSH_TIME / (steps * stage.timestep)) if pushes.any() else -1
    for tick in range(ticks):
        going, first, last = runs.active, tick * steps, (tick + 1) * steps
        states, control, broken = runs.advance(pushes[going] if tick == pushed else None)
        kept[going, first:last], control_kept[going, first:last] = states, control
        lean, lost = measure_lean_and_loss(stage, runs.current)
        lost += lifts[going]
        if last * stage.timestep > warm_up:
            worst[going] = np.fmax(worst[going], np.column_stack([lean, lost]))
        near = (lean > _NEAR * FALLEN_TILT) | (
            lost > _NEAR * (1 - FALLEN_HEIGHT) * (stage.upright.size + lifts[going])
        )
        for place in np.flatnonzero(near & ~broken):
            broken[place] = uprights[going[place]].has_fallen(runs.current[place])
        if broken.any():
            fallen[going[broken]], ends[going[broken]] = True, last
            runs.keep_runs(~broken)
            if not runs.active.size:
                break
    return [
        Run(
            case=case,
            states=kept[index, : ends[index]],
            targets=control_kept[index, : ends[index]],
            fallen=bool(fallen[index]),
            lean=float(worst[index, 0]),
            lost=float(worst[index, 1]),
        )
        for index, case in enumerate(cases)
    ]


def make_push_forces(stage: Stage, impulses: Sequence[tuple[float, float]]) -> Array:
    """Returns the forces (runs, 6 nbody) on bodies of pushes (N s) that last one action."""
    forces = np.zeros((len(impulses), stage.model.nbody, 6))
    forces[:, stage.model.body(stage.robot.mj_base).id, :2] = impulses
    return (forces / (stage.substeps * stage.timestep)).reshape(len(impulses), -1)


def raise_upright(upright: Upright, lift: float) -> Upright:
    """Returns what a fall is measured against of a robot that stands higher by a lift (m)."""
    place = upright.place + np.array([0.0, 0.0, lift])
    return replace(upright, place=place, size=upright.size + lift)


def _start(stage: Stage, case: Case) -> Array:
    """Returns the state (mjSTATE_FULLPHYSICS) in which a run begins."""
    data, robot = mujoco.MjData(case.model), stage.robot
    qpos, qvel = stage.default.copy(), np.zeros(robot.nv)
    qpos[2] += case.lift
    if case.seed:
        draw = np.random.default_rng(case.seed).uniform(-1.0, 1.0, robot.nu + 6)
        qpos[7:] += _JOINT_SPREAD * draw[6:]
        qvel[:6] = _SPEED_SPREAD * draw[:6]
    robot.mj_convention.set_state(data, qpos, qvel)
    return full_state(case.model, data)


def _commands(stage: Stage, actions: Array) -> Array:
    """Returns the ctrl (runs, model.nu) of actions (runs, n)."""
    contract = stage.policy.contract
    targets = contract.default + contract.action_scale * actions
    targets = contract.signs * np.clip(targets, contract.lower, contract.upper)
    ctrl = np.tile(stage.ctrl, (len(actions), 1))
    actuators = stage.robot.mj_convention.actuator_index[stage.joints]
    ctrl[:, stage.model.actuator_ctrladr[actuators]] = stage.gear * targets
    return ctrl


def rotations_from_quaternions(quaternions: Array) -> Array:
    """Returns the rotation matrices (..., 3, 3) of unit quaternions (..., 4), w first."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def measure_lean_and_loss(stage: Stage, states: Array) -> tuple[Array, Array]:
    """Returns how far bases lean (rad), and how much lower they are than they stood (m).

    Args:
        stage: The policy on its robot.
        states: (..., size).
    """
    upright, index = stage.upright, stage.robot.mj_convention.qpos_index
    up = rotations_from_quaternions(states[..., 1 + index[3:7]])[..., 2, :]
    with np.errstate(invalid="ignore"):
        lean = np.arccos(np.clip(up @ upright.rotation[2], -1.0, 1.0))
    height = states[..., 1 + index[2]] + up @ upright.lever
    return lean, upright.place[2] - height


class Observer:
    """Makes the observations of some runs in lockstep.

    Args:
        stage: The policy on its robot.
        commands: (runs, 3) what they are commanded.

    Attributes:
        last: (runs, n) their last actions.
    """

    def __init__(self, stage: Stage, commands: Array) -> None:
        self._stage, self._commands = stage, commands
        self._contract: Contract = stage.policy.contract
        self.last = np.zeros((len(commands), self._contract.num_joints))
        shape = (len(commands), self._contract.history, self._contract.frame_size)
        self._frames = np.zeros(shape)

    def observe(self, states: Array, going: Integers, tick: int) -> Array:
        """Returns the observations (n, inputs) of those runs that go on.

        Args:
            states: (n, size) of these.
            going: (n,) which they are.
            tick: How many actions they have had.
        """
        contract = self._contract
        frame = self._frame(states, going, tick)
        limit = contract.clip
        if math.isfinite(limit):
            frame = np.clip(frame, -limit, limit)
        if tick == 0:
            self._frames[going] = frame[:, None, :]
        else:  # the oldest first
            self._frames[going, :-1] = self._frames[going, 1:]
            self._frames[going, -1] = frame
        frames = self._frames[going]
        if contract.newest_first:
            frames = frames[:, ::-1]
        if contract.layout == BY_FRAME or contract.history == 1:
            return frames.reshape(len(going), -1)
        ends = np.cumsum([contract.term_size(term) for term in contract.terms])[:-1]
        parts = np.split(frames, ends, axis=2)
        return np.concatenate([part.reshape(len(going), -1) for part in parts], axis=1)

    def _frame(self, states: Array, going: Integers, tick: int) -> Array:
        stage, contract = self._stage, self._contract
        convention, joints = stage.robot.mj_convention, stage.joints
        qpos = states[:, 1 + convention.qpos_index]
        qvel = states[:, 1 + stage.model.nq + convention.qvel_index]
        turned = rotations_from_quaternions(qpos[:, 3:7])
        phase = contract.phase_offsets + (
            2 * math.pi * contract.phase_rate * tick * stage.substeps * stage.timestep
        )
        runs = len(going)
        up = np.array([0.0, 0.0, 1.0])
        values = {
            "linear-velocity": np.einsum("rji,rj->ri", turned, qvel[:, :3]),
            "angular-velocity": qvel[:, 3:6],
            "gravity": -turned[:, 2],
            "command": self._commands[going],
            "up-command": np.tile(up, (runs, 1)),
            "joint-positions": contract.signs * qpos[:, 7 + joints] - contract.default,
            "joint-velocities": contract.signs * qvel[:, 6 + joints],
            "last-action": self.last[going],
            "phase": np.tile(np.concatenate([np.cos(phase), np.sin(phase)]), (runs, 1)),
        }
        return np.concatenate([values[term.name] * term.scale for term in contract.terms], axis=1)
