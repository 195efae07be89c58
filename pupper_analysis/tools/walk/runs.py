"""Simulation of many runs of a policy: batches run in lockstep, and threads share the batches.

The result of a run is bitwise independent of the number of workers and of the other runs. MuJoCo
steps each run separately, and the network multiplies the row of each run separately.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import mujoco.rollout
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.base.arrays import rotations_from_quaternions
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, UnknownNameError
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.robot.as_published import ServoSource
from pupper_analysis.robot.build import with_efforts
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.contact import find_acting_contacts
from pupper_analysis.robot.fall import FALLEN_TILT
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import find_servos_used, model_with_servos, resolve_servo_gains
from pupper_analysis.simulation.monitor import FALLEN_HEIGHT_RATIO, StandReference
from pupper_analysis.simulation.rollout import FORCED_CONTROL_SPEC, STATE_SPEC, full_state
from pupper_analysis.tools.walk.contract import BY_FRAME, PolicyContract
from pupper_analysis.tools.walk.policy import Policy

_BATCH_SIZE = 16
"""Maximum number of runs in lockstep. Chosen, not tuned: a compromise between Python's overhead per
run and the memory of the states.
"""

_JOINT_SPREAD, _SPEED_SPREAD = 0.05, 0.05
"""Bounds of the random deviations from the initial state of seed 0, for each joint position [rad,
m] and each component of the base velocity [m/s, rad/s]. Chosen to resemble a robot put down by
hand."""

PUSH_TIME = 2.0
"""Start of the push of a run [s]. Chosen so that the robot walks by then."""

_STEP_RTOL = 1e-6
"""Relative tolerance of the check that an action lasts at least a time step. The tolerance covers
rounding of the rate and the time step. Chosen, not tuned.
"""

_CHECKED_FALL_FRACTION = 0.9
"""Fraction of the tilt and height loss that define a fall. If a run exceeds this fraction, the
exact fall criterion, which is slower, is evaluated. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class Case:
    """Definition of a simulated run: model, command, seed, push, delay.

    Attributes:
        model: Simulated model.
        command: Commanded forward speed, speed to the left [m/s] and turning rate [rad/s], shape
            (3,).
        delay: Delay of commands at the servos [s].
        seed: Seed of the initial state; 0 is the default pose at rest.
        lift: Additional height of the initial state [m], for example for longer legs.
        push: Impulse on the CoM of the base body, along x and y of the world frame, shape (2,) [N
            s]. The impulse acts during the action that starts at `PUSH_TIME`.
    """

    model: mujoco.MjModel
    command: Array
    delay: float
    seed: int = 0
    lift: float = 0.0
    push: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class PolicyRun:
    """Recorded states, controls and fall of a simulated run of a policy.

    Attributes:
        case: Definition of the run.
        states: States after each step (mjSTATE_FULLPHYSICS), up to a fall, shape (n, size).
        targets: Applied controls of the step that ends in each state, shape (n, model.nu).
        fallen: True if the robot fell or the simulation diverged.
        lean: Largest tilt of the base from the default pose, at the end of any action after the
            warm-up [rad].
        lost: Largest height loss of the reference point at the same times, at least 0 [m]. The
            point is fixed to the base, at the CoM of the default pose (`StandReference`).
        largest_action: Largest magnitude of all actions of the policy.
    """

    case: Case
    states: Array
    targets: Array
    fallen: bool
    lean: float
    lost: float
    largest_action: float = math.nan


@dataclass(frozen=True, eq=False)
class Stage:
    """Robot, policy and simulated model: the data that all runs of a policy with n joints share.

    Attributes:
        robot: Robot.
        policy: Policy.
        model: MuJoCo model with the servos of the policy.
        joints: Index of the robot's joint for each joint of the policy, shape (n,).
        gear: Servo control (ctrl) per joint position, shape (n,).
        ctrl: Controls of the default pose, shape (model.nu,).
        default: Initial configuration of seed 0 without `Case.lift`, shape (nq,).
        substeps: Number of time steps per action.
        upright: Reference of the fall criterion.
    """

    robot: Robot
    policy: Policy
    model: mujoco.MjModel
    joints: IntArray
    gear: Array
    ctrl: Array
    default: Array
    substeps: int
    upright: StandReference

    @property
    def timestep(self) -> float:
        """MuJoCo time step of the simulated runs [s]."""
        return float(self.model.opt.timestep)

    def make_case(self, command: Array, seed: int = 0) -> Case:
        """Create the definition of a run with the unchanged robot.

        Args:
            command: Commanded forward speed, speed to the left [m/s] and turning rate [rad/s],
                shape (3,).
            seed: Seed of the random initial state; 0 for the default pose at rest.
        """
        return Case(self.model, command, self.policy.contract.latency, seed)


def prepare_stage(robot: Robot, policy: Policy) -> Stage:
    """Prepare the simulation of a policy on a robot: model, servo gains, start pose.

    The model is the robot's MuJoCo model, with the servo gains of the policy. If the policy states
    no gains, the gains of the robot's files are used.

    Raises:
        ConfigurationError: If the base is fixed or the robot has no feet, for example.
        ModelError: If policy and robot do not fit, or gains are missing, for example.
    """
    robot.check_floating()
    contract = policy.contract
    joints = find_joint_indices(robot, policy)
    undriven = joints[robot.mj_convention.actuator_index[joints] < 0]
    if undriven.size:  # for example, joints that an equality couples to another joint
        names = [robot.joint_names[joint] for joint in undriven]
        raise ModelError(policy.name, diagnose("policy-moves-joint-without-motor", joints=names))
    robot = with_contract_efforts(robot, contract, joints)
    if not robot.feet:
        raise ConfigurationError("robot", diagnose("walks-on-no-feet", robot=robot.name))
    kp, kd = contract.kp, contract.kd
    if kp is not None and kd is not None:
        has_other_joints = len(joints) < robot.nu
        own_gains = resolve_servo_gains(robot) if has_other_joints else None
        stiffness = np.zeros(robot.nu) if own_gains is None else own_gains.kp.copy()
        damping = np.zeros(robot.nu) if own_gains is None else own_gains.kd.copy()
        stiffness[joints], damping[joints] = kp, kd
        servos = model_with_servos(robot, stiffness, damping)
    elif kp is not None or kd is not None:
        key = "kp" if kp is None else "kd"
        raise ModelError(policy.name, diagnose("contract-lacks", key=key))
    elif find_servos_used(robot).source is ServoSource.ADDED:  # added gains belong to no real robot
        raise ModelError(policy.name, diagnose("policy-without-gains"))
    else:
        servos = model_with_servos(robot)
    model = copy.copy(servos.model)  # sensors are not used and take 7 % of the time of v3's steps
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    if contract.feet and contract.feet != len(robot.feet):
        problem = diagnose("contacts-of-feet", stated=contract.feet, feet=len(robot.feet))
        raise ModelError(policy.name, problem)
    steps_per_action = 1.0 / (contract.rate * model.opt.timestep)
    if steps_per_action < 1.0 - _STEP_RTOL:
        problem = diagnose("rate-above-steps", rate=contract.rate, timestep=model.opt.timestep)
        raise ConfigurationError("rate", problem)
    default = robot.home.copy()
    default[:2] = 0.0
    joint_positions = default[7:]
    joint_positions[joints] = contract.signs * contract.default
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
        substeps=round(steps_per_action),
        upright=StandReference.from_configuration(robot, default),
    )


def with_contract_efforts(robot: Robot, contract: PolicyContract, joints: IntArray) -> Robot:
    """Apply the torque limits of a policy's contract to a robot.

    A finite limit of a TOML file replaces the limit of the robot's files; a limit of another source
    only lowers it, since both limits apply to the motor. ``joints`` are the robot's joint indices,
    in the order of the policy.

    Raises:
        ConfigurationError: If an applied limit is below `MIN_EFFORT`.
    """
    if contract.effort is None:
        return robot
    file = contract.sources["effort"].rpartition(":")[0] or contract.sources["effort"]
    replaces = Path(file).suffix == ".toml"
    limits = {
        robot.joint_names[joint]: float(limit)
        for joint, limit in zip(joints, contract.effort, strict=True)
        if math.isfinite(limit) and (replaces or limit < robot.effort_limits[joint])
    }
    return with_efforts(robot, limits)


def replace_efforts(
    robot: Robot, policy: Policy, efforts: Mapping[str, float]
) -> tuple[Robot, Policy]:
    """Replace the torque limits of all files by passed limits, in robot and policy.

    ``efforts`` is {joint of the robot: limit [N m, N for slides]}.

    Raises:
        ConfigurationError: If a limit is below `MIN_EFFORT` or not finite.
        UnknownNameError: If a joint does not exist.
    """
    if not efforts:
        return robot, policy
    contract = policy.contract
    if contract.effort is not None:
        names = [robot.joint_names[joint] for joint in find_joint_indices(robot, policy)]
        replaced = np.array([name in efforts for name in names])
        policy = policy.with_contract(effort=np.where(replaced, np.inf, contract.effort))
    sources = {**contract.sources, "effort": "--effort"}
    if policy.contract.effort is None:
        policy = policy.with_contract(sources=sources)
    return with_efforts(robot, efforts), policy


def find_joint_indices(robot: Robot, policy: Policy) -> IntArray:
    """Return the index of the robot's joint for each joint of the policy, by name or by order.

    Raises:
        ModelError: If the policy names no joints and the number of joints differs.
        UnknownNameError: If the policy names a joint that the robot does not have.
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
) -> Iterator[PolicyRun]:
    """Simulate the runs of several cases in threads, and yield the runs in the same order.

    Args:
        stage: Robot, policy and model of the simulation.
        cases: Definitions of the runs. The models must have the same sizes as the model of
            ``stage``.
        duration: Simulated time of each run without a fall [s].
        warm_up: Initial time in which tilt and height loss are not recorded [s].
        workers: Number of threads; by default the number of cores.
    """
    batches = [cases[start : start + _BATCH_SIZE] for start in range(0, len(cases), _BATCH_SIZE)]
    # Fewer batches than workers: use smaller batches.
    count = max(1, workers or os.cpu_count() or 1)
    if len(batches) < count and len(cases) > 1:
        size = -(-len(cases) // count)
        batches = [cases[start : start + size] for start in range(0, len(cases), size)]
    with silence_mujoco(), ThreadPoolExecutor(count) as pool:
        futures = [
            pool.submit(_simulate_batch, stage, batch, duration, warm_up)
            for batch in batches[: 2 * count]
        ]
        for batch in batches[2 * count :]:
            yield from futures.pop(0).result()
            futures.append(pool.submit(_simulate_batch, stage, batch, duration, warm_up))
        for future in futures:
            yield from future.result()


class Lockstep:
    """Runs of a policy that are simulated together, action by action, in MuJoCo.

    Args:
        stage: Robot, policy and model of the simulation.
        cases: Definitions of the runs. The caller applies the pushes.

    Attributes:
        commands: Commands of all runs, shape (runs, 3); may be changed between two actions.
        active: Indices of the n runs that continue, shape (n,).
        current: States of the active runs, shape (n, size).
        observed: Observations of the last action, shape (n, inputs), of the n runs that were active
            at this action.
        tick: Number of actions so far.
    """

    def __init__(self, stage: Stage, cases: Sequence[Case]) -> None:
        self._stage, self._models = stage, [case.model for case in cases]
        self.commands = np.array([case.command for case in cases])
        self.active = np.arange(len(cases))
        self.current = np.array([_make_start_state(stage, case) for case in cases])
        self.tick, self.observed = 0, np.zeros((0, stage.policy.network.inputs))
        self._data, self._runner = mujoco.MjData(stage.model), mujoco.rollout.Rollout(nthread=0)
        self._observer = Observer(stage, self.commands, self._models)
        self._memory = stage.policy.network.initial_memory(len(cases))
        delays = np.array([[round(case.delay / stage.timestep)] for case in cases])
        # Age, in actions, of the command that is applied at each step of an action.
        self._command_delays = -((np.arange(stage.substeps) - delays) // stage.substeps)
        self._command_history = np.tile(
            stage.ctrl, (len(cases), int(self._command_delays.max()) + 1, 1)
        )

    def advance(self, forces: Array | None = None) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Simulate an action (control step) of the active runs.

        Args:
            forces: Forces [N] and torques [N m] on the bodies of n active runs during the action,
                shape (n, 6 nbody), in the layout of ``xfrc_applied``. None for no forces.

        Returns:
            Full physics states of MuJoCo, shape (n, substeps, size); applied controls, shape
            (n, substeps, model.nu); True for each active run that diverged, shape (n,).
        """
        stage, active = self._stage, self.active
        observations = self._observer.observe(self.current, active, self.tick)
        self.observed = observations
        actions, self._memory = stage.policy.network.forward(observations, self._memory)
        self._observer.second_last[active] = self._observer.last[active]
        self._observer.last[active] = actions
        self._command_history[active, 1:] = self._command_history[active, :-1]
        self._command_history[active, 0] = _compute_controls(stage, actions)
        control = self._command_history[active[:, None], self._command_delays[active]]
        self._observer.controls[active] = control[:, -1]
        models = [self._models[index] for index in active.tolist()]
        controls, spec = control, {}
        if forces is not None:
            repeated_forces = np.repeat(forces[:, None], stage.substeps, axis=1)
            controls, spec = (
                np.concatenate([control, repeated_forces], axis=2),
                {"control_spec": FORCED_CONTROL_SPEC},
            )
        states, _ = self._runner.rollout(models, self._data, self.current, controls, **spec)
        self._data.xfrc_applied[:] = (
            0.0  # not part of the state: the next rollout would keep the forces
        )
        self.tick += 1
        self.current = states[:, -1]
        # MuJoCo resets the state to time 0 after a number that is not finite or too large.
        broken = ~np.isfinite(self.current).all(axis=1)
        broken |= self.current[:, 0] < (self.tick * stage.substeps - 0.5) * stage.timestep
        return states, control, broken

    @property
    def last_actions(self) -> Array:
        """Last actions of the active runs, shape (n, outputs)."""
        actions: Array = self._observer.last[self.active]
        return actions

    def keep_runs(self, is_kept: NDArray[np.bool_]) -> None:
        """Continue the simulation with a subset of the active runs; the state is changed in place.

        Args:
            is_kept: Mask of the active runs that continue, shape (n,) for n active runs.
        """
        self.active, self.current = self.active[is_kept], self.current[is_kept]
        self._memory = tuple(states[is_kept] for states in self._memory)


def _simulate_batch(
    stage: Stage, cases: Sequence[Case], duration: float, warm_up: float
) -> list[PolicyRun]:
    """Simulate several cases in the same time steps, each until a fall or the end.

    In the initial ``warm_up`` [s], tilt and height loss are not recorded.
    """
    count = len(cases)
    ticks = max(1, round(duration / (stage.substeps * stage.timestep)))
    lockstep, steps = Lockstep(stage, cases), stage.substeps
    recorded_states = np.empty((count, ticks * steps, lockstep.current.shape[1]))
    recorded_controls = np.empty((count, ticks * steps, stage.model.nu))
    num_steps, fallen = np.full(count, ticks * steps), np.zeros(count, dtype=bool)
    worst, largest_actions = np.zeros((count, 2)), np.zeros(count)
    lifts = np.array([case.lift for case in cases])
    uprights = [raise_upright(stage.upright, case.lift) for case in cases]
    pushes = make_push_forces(stage, [case.push for case in cases])
    push_tick = round(PUSH_TIME / (steps * stage.timestep)) if pushes.any() else -1
    for tick in range(ticks):
        active, first, last = lockstep.active, tick * steps, (tick + 1) * steps
        states, control, broken = lockstep.advance(pushes[active] if tick == push_tick else None)
        magnitudes = np.abs(lockstep.last_actions).max(axis=1, initial=0.0)
        largest_actions[active] = np.maximum(largest_actions[active], magnitudes)
        recorded_states[active, first:last], recorded_controls[active, first:last] = states, control
        lean, lost = measure_lean_and_loss(stage, lockstep.current)
        lost += lifts[active]
        if last * stage.timestep > warm_up:
            worst[active] = np.fmax(worst[active], np.column_stack([lean, lost]))
        near_fall = (lean > _CHECKED_FALL_FRACTION * FALLEN_TILT) | (
            lost
            > _CHECKED_FALL_FRACTION
            * (1 - FALLEN_HEIGHT_RATIO)
            * (stage.upright.com_height + lifts[active])
        )
        for row in np.flatnonzero(near_fall & ~broken):
            broken[row] = uprights[active[row]].has_fallen(lockstep.current[row])
        if broken.any():
            fallen[active[broken]], num_steps[active[broken]] = True, last
            lockstep.keep_runs(~broken)
            if not lockstep.active.size:
                break
    return [
        PolicyRun(
            case=case,
            states=recorded_states[index, : num_steps[index]],
            targets=recorded_controls[index, : num_steps[index]],
            fallen=bool(fallen[index]),
            lean=float(worst[index, 0]),
            lost=float(worst[index, 1]),
            largest_action=float(largest_actions[index]),
        )
        for index, case in enumerate(cases)
    ]


def make_push_forces(stage: Stage, impulses: Sequence[tuple[float, float]]) -> Array:
    """Compute forces on the base that exert an impulse during an action of the policy.

    ``impulses`` are those of each run in the world frame, (x, y) [N s].

    Returns:
        Forces at the CoM of the base body, shape (runs, 6 nbody) [N, N m], in the layout of
        MuJoCo's ``xfrc_applied``.
    """
    forces = np.zeros((len(impulses), stage.model.nbody, 6))
    forces[:, stage.model.body(stage.robot.mj_base).id, :2] = impulses
    return (forces / (stage.substeps * stage.timestep)).reshape(len(impulses), -1)


def raise_upright(upright: StandReference, lift: float) -> StandReference:
    """Return a copy of the reference of the fall criterion whose CoM is higher by ``lift`` [m]."""
    place = upright.com_position + np.array([0.0, 0.0, lift])
    return replace(upright, com_position=place, com_height=upright.com_height + lift)


def _make_start_state(stage: Stage, case: Case) -> Array:
    """Return the initial MuJoCo state of a case (mjSTATE_FULLPHYSICS), shape (size,)."""
    data, robot = mujoco.MjData(case.model), stage.robot
    qpos, qvel = stage.default.copy(), np.zeros(robot.nv)
    qpos[2] += case.lift
    if case.seed:
        draw = np.random.default_rng(case.seed).uniform(-1.0, 1.0, robot.nu + 6)
        qpos[7:] += _JOINT_SPREAD * draw[6:]
        qvel[:6] = _SPEED_SPREAD * draw[:6]
    robot.mj_convention.set_state(data, qpos, qvel)
    return full_state(case.model, data)


def _compute_controls(stage: Stage, actions: Array) -> Array:
    """Convert actions of the policy, (runs, n), to MuJoCo controls, shape (runs, model.nu)."""
    contract = stage.policy.contract
    clipped = np.clip(actions, -contract.action_clip, contract.action_clip)
    offset = contract.default if contract.offset is None else contract.offset
    targets = offset + contract.action_scale * clipped
    targets = contract.signs * np.clip(targets, contract.lower, contract.upper)
    ctrl = np.tile(stage.ctrl, (len(actions), 1))
    actuators = stage.robot.mj_convention.actuator_index[stage.joints]
    ctrl[:, stage.model.actuator_ctrladr[actuators]] = stage.gear * targets
    return ctrl


def measure_lean_and_loss(stage: Stage, states: Array) -> tuple[Array, Array]:
    """Return the tilt of the base [rad] and the height loss of the reference point [m].

    Both are relative to the policy's default pose; a loss is positive downwards. The reference
    point is fixed to the base, at the CoM of the default pose (`StandReference`).

    Args:
        stage: Robot, policy and model of the simulation.
        states: Full physics states of MuJoCo, shape (..., size).

    Returns:
        Tilt, shape (...) [rad]; height loss, shape (...) [m].
    """
    upright, index = stage.upright, stage.robot.mj_convention.qpos_index
    up = rotations_from_quaternions(states[..., 1 + index[3:7]])[..., 2, :]
    with np.errstate(invalid="ignore"):
        lean = np.arccos(np.clip(up @ upright.rotation[2], -1.0, 1.0))
    height = states[..., 1 + index[2]] + up @ upright.com_offset
    return lean, upright.com_position[2] - height


class Observer:
    """Observation model of a policy: computes the observations of runs that advance together.

    Args:
        stage: Robot, policy and model of the simulation.
        commands: Commands of all runs, shape (runs, 3).
        models: Model of each run; by default the model of the stage.

    Attributes:
        controls: Applied controls at the time of the observation, shape (runs, model.nu). The
            caller updates the array, as well as ``last`` and ``second_last``.
        last: Last actions of all runs, shape (runs, n).
        second_last: Actions before the last actions, shape (runs, n).
    """

    def __init__(
        self, stage: Stage, commands: Array, models: Sequence[mujoco.MjModel] = ()
    ) -> None:
        self._stage, self._commands = stage, commands
        self._models = list(models) or [stage.model] * len(commands)
        self.controls = np.tile(stage.ctrl, (len(commands), 1))
        self._contract: PolicyContract = stage.policy.contract
        self.last = np.zeros((len(commands), self._contract.num_joints))
        self.second_last = np.zeros_like(self.last)
        names = {term.name for term in self._contract.terms}
        self._is_dynamic = bool(names & {"accelerometer", "contacts"})
        shape = (len(commands), self._contract.max_history, self._contract.frame_size)
        self._frames = np.zeros(shape)

    def observe(self, states: Array, active: IntArray, tick: int) -> Array:
        """Return the observations (inputs of the policy) of the active runs, shape (n, inputs).

        The newest frame of each active run is added to the history of frames.

        Args:
            states: Full physics states of MuJoCo of the active runs, shape (n, size).
            active: Indices of the active runs, shape (n,).
            tick: Number of actions so far.
        """
        contract = self._contract
        frame = self._make_frame(states, active, tick)
        limit = contract.clip
        if math.isfinite(limit):
            frame = np.clip(frame, -limit, limit)
        if tick == 0:
            self._frames[active] = frame[:, None, :]
        else:  # the oldest first
            self._frames[active, :-1] = self._frames[active, 1:]
            self._frames[active, -1] = frame
        frames, step = self._frames[active], -1 if contract.newest_first else 1
        if contract.layout == BY_FRAME or contract.max_history == 1:
            return frames[:, ::step].reshape(len(active), -1)
        ends = np.cumsum([contract.term_size(term) for term in contract.terms])[:-1]
        parts = [
            part[:, -contract.count_frames(term) :][:, ::step]
            for term, part in zip(contract.terms, np.split(frames, ends, axis=2), strict=True)
        ]
        return np.concatenate([part.reshape(len(active), -1) for part in parts], axis=1)

    def _make_frame(self, states: Array, active: IntArray, tick: int) -> Array:
        """Return the newest observation frame of n runs, shape (n, frame size).

        ``active`` are the indices of the n runs among all runs; ``tick`` is the number of the
        action.
        """
        stage, contract = self._stage, self._contract
        convention, joints = stage.robot.mj_convention, stage.joints
        qpos = states[:, 1 + convention.qpos_index]
        qvel = states[:, 1 + stage.model.nq + convention.qvel_index]
        base_rotations = rotations_from_quaternions(qpos[:, 3:7])
        phase = contract.phase_offsets + (
            2 * math.pi * contract.phase_rate * tick * stage.substeps * stage.timestep
        )
        num_runs = len(active)
        up = np.array([0.0, 0.0, 1.0])
        values = {
            "linear-velocity": np.einsum("rji,rj->ri", base_rotations, qvel[:, :3]),
            "angular-velocity": qvel[:, 3:6],
            "gravity": -base_rotations[:, 2],
            "command": self._commands[active],
            "up-command": np.tile(up, (num_runs, 1)),
            "joint-positions": contract.signs * qpos[:, 7 + joints] - contract.default,
            "joint-velocities": contract.signs * qvel[:, 6 + joints],
            "last-action": self.last[active],
            "phase": np.tile(np.concatenate([np.cos(phase), np.sin(phase)]), (num_runs, 1)),
            "phase-sine": np.tile(np.sin(phase), (num_runs, 1)),
            "phase-cosine": np.tile(np.cos(phase), (num_runs, 1)),
            "command-velocity": self._commands[active, :2],
            "command-turning": self._commands[active, 2:],
            "second-last-action": self.second_last[active],
        }
        if self._is_dynamic:
            values |= self._measure_dynamics(states, active, base_rotations)
        parts = [np.clip(values[term.name], *term.clip) * term.scale for term in contract.terms]
        return np.concatenate(parts, axis=1)

    def _measure_dynamics(
        self, states: Array, active: IntArray, base_rotations: Array
    ) -> dict[str, Array]:
        """Return the accelerometer at the origin of the base, and the contacts of the feet.

        Returns:
            {"accelerometer": acceleration minus gravity in the base frame, shape (n, 3) [m/s^2];
            "contacts": 1 for each foot that touches anything, else 0, shape (n, feet)}.
        """
        stage, data, feet = self._stage, mujoco.MjData(self._stage.model), [*self._stage.robot.feet]
        specific, contacts = np.zeros((len(states), 3)), np.zeros((len(states), len(feet)))
        index = stage.robot.mj_convention.qvel_index[:3]
        for row, (state, run) in enumerate(zip(states, active.tolist(), strict=True)):
            model = self._models[run]
            mujoco.mj_setState(model, data, state, STATE_SPEC)
            data.ctrl[:] = self.controls[run]
            mujoco.mj_forward(model, data)
            specific[row] = base_rotations[row].T @ (data.qacc[index] - model.opt.gravity)
            geoms = data.contact.geom[np.flatnonzero(find_acting_contacts(data))]
            touching = {stage.robot.foot_geoms.get(int(geom)) for geom in geoms.ravel()}
            contacts[row] = [foot in touching for foot in feet]
        return {"accelerometer": specific, "contacts": contacts}
