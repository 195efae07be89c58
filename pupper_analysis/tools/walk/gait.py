"""Gait of a simulated policy: motor torques, power, contacts, tracking of the command.

Inputs are a robot, a policy with its contract, and a velocity command; output is a `Walk` with a
`Gait` per seed. The policy is simulated in MuJoCo on servos with the gains of the policy, if
stated, and the torque limits of the model or of the contract. Means exclude the warm-up.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import rotations_from_quaternions
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import EFFORT_UNIT, VELOCITY_UNIT
from pupper_analysis.models.motors.energy import MotorEnergy, compute_motor_energy
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.motors.region import compute_motor_utilisation
from pupper_analysis.models.transmission import read_gears
from pupper_analysis.prepare.judge import list_file_remarks
from pupper_analysis.robot.contact import bodies_on_ground, find_acting_contacts
from pupper_analysis.robot.fall import FALLEN_TILT
from pupper_analysis.robot.joints import list_force_units
from pupper_analysis.robot.masses import describe_missing_masses
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import integrate_servo_damping, read_torque_ranges
from pupper_analysis.simulation.monitor import FALLEN_HEIGHT_RATIO
from pupper_analysis.simulation.rollout import STATE_SPEC
from pupper_analysis.tools.contract.contract import SIMULATED
from pupper_analysis.tools.walk.contract import PolicyContract
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import (
    PolicyRun,
    Stage,
    prepare_stage,
    simulate_cases,
)
from pupper_analysis.tools.walk.trace import TraceCheck

DEFAULT_SECONDS, WARM_UP_SECONDS = 8.0, 2.0
"""Duration of a run [s], and of the warm-up [s], which is not evaluated, except for falls. Chosen,
not tuned."""

SPEED_RTOL, SPEED_ATOL = 0.25, 0.05
"""Relative tolerance of the errors of the mean horizontal velocity and of the turning rate, and
absolute tolerance [m/s] of the velocity error. A run tracks the commanded speed v if the error is
at most `SPEED_RTOL` v + `SPEED_ATOL` and, if v is not 0, at most v / 2 (`MIN_FOLLOWED_FRACTION`).
The cost of transport is not computed for a mean speed of up to `SPEED_ATOL`, which also bounds the
divisor of `Candidate.error`. Chosen: Pupper's public policy reaches 0.93 of the command 0.5 m/s.
"""

TURN_ATOL = 0.1
"""Absolute tolerance of the error of the turning rate [rad/s], like `SPEED_ATOL` for the speed.
Chosen, not tuned.
"""

MIN_FOLLOWED_FRACTION = 0.5
"""Fraction of a nonzero command (speed or turning rate) that a run must reach to track the command:
the error is at most (1 - fraction) x command. The bound matters for slow commands: at 0.13 m/s the
tolerances (`SPEED_RTOL`, `SPEED_ATOL`) are 63 % of the command. Chosen, not tuned.
"""

LIMIT_FRACTION = 0.99
"""Fraction of the torque limit from which a motor is counted as saturated. Chosen, not tuned."""

MAX_BEYOND_FRACTION = 0.01
"""Largest accepted fraction [1] of the time of a walk in which a motor is outside of its
torque-speed region. The bound permits single time steps after an impact. Chosen, not tuned.
"""

_REGION_RTOL = 1e-9
"""Relative tolerance of the edge of a torque-speed region. The tolerance covers rounding if the
simulation limits a torque to the largest torque of the motor. Chosen, not tuned.
"""

_MAX_COMMAND = 100.0
"""Largest accepted magnitude of a command [m/s, rad/s]. A larger number is refused, since the unit
is probably wrong. Chosen, not tuned.
"""

_MOTION_PERIOD = 1 / 25
"""Approximate time between the recorded configurations of a run [s], for the animation. Chosen, not
tuned."""


@dataclass(frozen=True, eq=False)
class Gait(Result):
    """Evaluated run of a policy on a robot. Means and peaks exclude the warm-up.

    If the robot falls during the warm-up, means and peaks refer to the last step of the run.

    Attributes:
        command: Commanded forward speed, speed to the left (m/s) and turning rate to the left
            (rad/s), shape (3,).
        seed: Seed of the initial state; 0 is the default pose at rest.
        fall: Description of the fall or divergence; None without.
        duration: Time until the fall, or until the end.
        velocity: Mean forward speed and speed to the left, in the heading of the base, shape (2,);
            zero if the run ends before the warm-up or diverges.
        turning: Mean turning rate to the left; zero if the run ends before the warm-up or diverges.
        tracks: True if the robot does not fall and tracks the command.
        torque_rms: Root mean square of each motor's torque, shape (nu,); NaN if the run has a
            single state.
        torque_peak: Largest magnitude of each motor's torque, shape (nu,); NaN if the run has a
            single state.
        at_limit: Fraction of the time in which each motor is saturated, shape (nu,); NaN for a
            motor without a finite torque limit, or if the run has a single state.
        region_peak: Largest ratio of each motor's torque to the torque that the motor can exert at
            the present speed, shape (nu,). NaN without an assigned motor, or if the run has a
            single state.
        beyond_region: Fraction of the time in which each motor is outside of the torque-speed
            region, shape (nu,). NaN without an assigned motor, or if the run has a single state.
        speed_peak: Largest speed of each joint, shape (nu,); NaN if the run has a single state.
        power: Mean of the positive mechanical power of all motors, without recuperation; NaN if the
            run has a single state.
        transport: Cost of transport: power / (weight x speed); None up to 0.05 m/s.
        duty: {foot: fraction of the time in contact with the ground}, sampled once per action.
        touching: Bodies that touched the ground in a sample, with a geom of no foot.
        static: Root mean square of the torque with which each motor would hold the sampled poses
            without motion, shape (nu,). None if the seed is not 0, or without samples.
        roll: Standard deviation of the base roll.
        pitch: Standard deviation of the base pitch.
        bounce: Standard deviation of the base height.
        margin: Distance from a fall: 1 without tilt and height loss, 0 at a fall. The larger of
            tilt and height loss, relative to the bound of a fall, determines the margin.
        motion_time: Times of the recorded configurations, shape (m,).
        motion: Recorded configurations, shape (m, nq).
        torque_time: Times of the recorded torques, in the last second, shape (k,).
        torques: Recorded motor torques, shape (k, nu).
        energy: Electrical energy of the motors after the warm-up; None without motors, or for
            example if the run has a single state.
        largest_action: Largest magnitude of all actions of the policy; NaN if unknown.
    """

    command: Array = field(metadata={"unit": "m/s or rad/s"})
    seed: int
    fall: Diagnostic | None
    duration: float = field(metadata={"unit": "s"})
    velocity: Array = field(metadata={"unit": "m/s"})
    turning: float = field(metadata={"unit": "rad/s"})
    tracks: bool
    torque_rms: Array = field(metadata={"unit": EFFORT_UNIT})
    torque_peak: Array = field(metadata={"unit": EFFORT_UNIT})
    at_limit: Array = field(metadata={"unit": "1"})
    region_peak: Array = field(metadata={"unit": "1"})
    beyond_region: Array = field(metadata={"unit": "1"})
    speed_peak: Array = field(metadata={"unit": VELOCITY_UNIT})
    power: float = field(metadata={"unit": "W"})
    transport: float | None = field(metadata={"unit": "1"})
    duty: Mapping[str, float] = field(metadata={"unit": "1"})
    touching: tuple[str, ...]
    static: Array | None = field(metadata={"unit": EFFORT_UNIT})
    roll: float = field(metadata={"unit": "rad"})
    pitch: float = field(metadata={"unit": "rad"})
    bounce: float = field(metadata={"unit": "m"})
    margin: float = field(metadata={"unit": "1"})
    motion_time: Array = field(metadata={"unit": "s"})
    motion: Array = field(metadata={"unit": "m, 1 (quaternion) and rad"})
    torque_time: Array = field(metadata={"unit": "s"})
    torques: Array = field(metadata={"unit": EFFORT_UNIT})
    energy: MotorEnergy | None = None
    largest_action: float = field(default=math.nan, metadata={"unit": "1"})


@dataclass(frozen=True)
class FallTest(Result):
    """Repetition of a run that falls, with a single changed quantity.

    Attributes:
        quantity: ``command``, ``delay``, or a factor of ``strength``, ``friction``, ``kp``, ``kd``.
        value: Factor of the quantity; 0 for a command of zero, and without delay.
        falls: True if the robot also falls with this change.
        duration: Time until the fall, or until the end.
    """

    quantity: str
    value: float = field(metadata={"unit": "1"})
    falls: bool
    duration: float = field(metadata={"unit": "s"})


@dataclass(frozen=True, eq=False)
class Walk(Result):
    """Gaits of a policy on a robot: an evaluated run per seed.

    Attributes:
        name: Name of the robot.
        policy: File name of the policy.
        contract: Contract of the policy.
        joints: Joint names, in actuator order.
        limits: Torque limit of each motor, shape (nu,); infinite without a limit.
        torque_units: (nu,) unit of the torque of each motor: N m for a hinge, N for a slide.
        mass: Mass of the robot.
        gaits: A gait per seed; the first run starts in the default pose at rest.
        integrator: MuJoCo's integrator.
        timestep: Time step of the simulation.
        rate: Simulated rate of the policy; the period is a whole number of time steps.
        warm_up: Duration of the warm-up.
        remarks: Errors and assumptions of the robot's files and the deployment behind the result.
        evidence: ``simulated``; ``traced`` if the policy was also compared with a recorded trace.
        trace: Comparison with a recorded trace; None without.
        motors: {joint: name of the assigned motor}.
        fall_tests: Repetitions of the first run that falls, each with a single changed quantity.
            Empty if not requested, or if no run falls.
    """

    name: str
    policy: str
    contract: PolicyContract
    joints: tuple[str, ...]
    limits: Array = field(metadata={"unit": EFFORT_UNIT})
    torque_units: tuple[str, ...]
    mass: float = field(metadata={"unit": "kg"})
    gaits: tuple[Gait, ...]
    integrator: str
    timestep: float = field(metadata={"unit": "s"})
    rate: float = field(metadata={"unit": "Hz"})
    warm_up: float = field(metadata={"unit": "s"})
    remarks: tuple[Diagnostic, ...]
    evidence: str = SIMULATED
    trace: TraceCheck | None = None
    motors: dict[str, str] = field(default_factory=dict)
    fall_tests: tuple[FallTest, ...] = ()

    @property
    def beyond_region(self) -> Array:
        """Largest fraction of a run in which each motor is outside of the torque-speed region.

        Shape (nu,); NaN for a joint without assigned motor, for example.
        """
        largest: Array = np.fmax.reduce([gait.beyond_region for gait in self.gaits])
        return largest

    @property
    def within_region(self) -> bool:
        """Whether each assigned motor is almost always inside of the torque-speed region.

        A motor may be outside for a fraction of at most `MAX_BEYOND_FRACTION` of a run.
        """
        return not bool((self.beyond_region > MAX_BEYOND_FRACTION).any())

    @property
    def passed(self) -> bool:
        """Whether all runs track the command, with known masses and sufficient motors.

        No link mass may be unknown (`has_unknown_masses`), and the assigned motors must be able to
        exert the torques at the joint speeds (``within_region``).
        """
        tracks = all(gait.tracks for gait in self.gaits)
        return tracks and self.within_region and not has_unknown_masses(self.remarks)


def list_walk_remarks(robot: Robot) -> tuple[Diagnostic, ...]:
    """List the errors and assumptions of a robot's files that affect a walk."""
    masses = describe_missing_masses(robot)
    return (*(() if masses is None else (masses,)), *list_file_remarks(robot))


def has_unknown_masses(remarks: Iterable[Diagnostic]) -> bool:
    """Return True if a remark names links for which the files state no valid mass."""
    return any(remark.code == "link-masses-unknown" for remark in remarks)


def check_command(command: ArrayLike) -> Array:
    """Check a velocity command, and return an array of shape (3,) [m/s, m/s, rad/s].

    Raises:
        ConfigurationError: If the command cannot be converted to three finite numbers with
            magnitudes of at most 100.
    """
    try:
        checked = np.array(command, dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise ConfigurationError("command", diagnose("no-numbers", count=3)) from error
    if checked.shape != (3,) or not np.isfinite(checked).all():
        raise ConfigurationError("command", diagnose("no-numbers", count=3))
    largest = float(checked[np.abs(checked).argmax()])
    if abs(largest) > _MAX_COMMAND:
        problem = diagnose("not-between", given=largest, low=-_MAX_COMMAND, high=_MAX_COMMAND)
        raise ConfigurationError("command", problem)
    return checked


def parse_walking_command(text: str) -> Array:
    """Parse the text of a velocity command, ``0.5,0,0``, into an array of shape (3,).

    Args:
        text: Forward speed [m/s], speed to the left [m/s] and turning rate to the left [rad/s].

    Raises:
        ConfigurationError: If the text is not three numbers with magnitudes of at most 100.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 3:
        form = "FORWARD,LEFT,TURN (m/s, m/s, rad/s), e.g. 0.5,0,0"
        raise ConfigurationError("command", diagnose("not-of-the-form", given=text, form=form))
    return check_command(values)


def check_runs(seeds: int, seconds: float, warm_up: float) -> None:
    """Check the number of runs, the duration [s] and the warm-up [s] of walking simulations.

    Raises:
        ConfigurationError: Unless there are 1 to 1000 seeds, the runs take 3 to 600 s, and the
            warm-up is not negative and at least 1 s shorter than the runs.
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
    motors: Mapping[str, Motor] | None = None,
) -> Walk:
    """Simulate a policy on a robot in MuJoCo and evaluate the gait.

    If the policy states gains, the servos get the gains of the policy. The robot starts in the
    default pose of the policy, with the lowest foot on the ground. The command is constant.

    Args:
        robot: Robot.
        policy: Policy.
        command: Forward speed, speed to the left [m/s], and turning rate to the left [rad/s].
        seeds: Number of runs. The first run starts in the default pose at rest. The initial states
            of the other runs deviate by at most 0.05 rad (0.05 m) at each joint, and by at most
            0.05 m/s and 0.05 rad/s in each component of the base velocity.
        seconds: Duration of each run [s], 3 to 600.
        warm_up: Duration of the warm-up [s].
        workers: Number of threads; by default the number of cores.
        motors: {joint: motor}. The torques are compared with the torque-speed regions of
            ``motors``. The simulation does not limit torques by ``motors``.

    Raises:
        ConfigurationError: If an argument is out of range, the base is fixed, or the robot has no
            feet, for example.
        ModelError: If the policy does not fit the robot, or a number of a motor is unknown.
    """
    checked_command = check_command(command)
    check_runs(seeds, seconds, warm_up)
    stage = prepare_stage(robot, policy)
    cases = [stage.make_case(checked_command, seed) for seed in range(seeds)]
    runs = simulate_cases(stage, cases, seconds, warm_up, workers)
    gaits = tuple(measure_gait(stage, run, warm_up, motors) for run in runs)
    return Walk(
        name=robot.name,
        policy=policy.name,
        contract=policy.contract,
        joints=robot.joint_names,
        limits=stage.robot.effort_limits,
        torque_units=robot.compute_once(list_force_units),
        mass=robot.total_mass,
        gaits=gaits,
        integrator=mujoco.mjtIntegrator(int(stage.model.opt.integrator)).name[6:],
        timestep=stage.timestep,
        rate=1.0 / (stage.substeps * stage.timestep),
        warm_up=warm_up,
        remarks=(*list_walk_remarks(stage.robot), *policy.notes),
        motors={joint: motor.name for joint, motor in (motors or {}).items()},
    )


def joint_torques(stage: Stage, run: PolicyRun) -> Array:
    """Compute the motor torques [N m, N for slides] of a simulated run, shape (n, nu).

    Row k contains the torques at the recorded state k, with the controls of the next step. The last
    state has no row: n is the number of recorded states minus 1. The formula is MuJoCo's actuator
    law: clip(gain u + bias, force range) x gear. u is the clipped control, or the activation if the
    actuator has dynamics. The torque is 0 for joints without a motor.
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
    gear, bias = read_gears(model, motors), model.actuator_biasprm[motors]
    force = model.actuator_gainprm[motors, 0] * ctrl + bias[:, 0]
    force += gear * (bias[:, 1] * qpos + bias[:, 2] * qvel)
    limited = model.actuator_forcelimited[motors].astype(bool)
    force[:, limited] = np.clip(force[:, limited], *model.actuator_forcerange[motors[limited]].T)
    torques = np.zeros((len(before), stage.robot.nu))
    torques[:, driven] = gear * force
    return torques


@dataclass(frozen=True, eq=False)
class Tracking:
    """Mean velocity and turning rate of a run, compared with the command.

    Attributes:
        velocity: Mean velocity forward and to the left, shape (2,) [m/s].
        turning: Mean turning rate about the vertical [rad/s].
        tracks: Whether the robot does not fall, and both errors are within the tolerances.
        speed_margin: 1 - speed error / tolerance; negative if the velocity is not tracked,
            -infinite if unknown.
        turning_margin: 1 - error of the turning rate / tolerance; negative if the turning rate is
            not tracked, -infinite if unknown.
        failure: First criterion that is violated: ``falls``, ``speed`` or ``turning``; empty if the
            command is tracked.
    """

    velocity: Array
    turning: float
    tracks: bool
    speed_margin: float
    turning_margin: float
    failure: str


def evaluate_tracking(stage: Stage, run: PolicyRun, warm_up: float) -> Tracking:
    """Decide whether a run tracks the velocity command, from the motion after the warm-up [s].

    The run tracks if the robot does not fall, and the errors of the mean velocity and of the mean
    turning rate are within the tolerances (`SPEED_RTOL`, `SPEED_ATOL`, `TURN_ATOL`,
    `MIN_FOLLOWED_FRACTION`). A run with fewer than two states after the warm-up, or with a state
    that is not finite, counts as a fall.
    """
    start = round(warm_up / stage.timestep)
    index = stage.robot.mj_convention.qpos_index
    states = run.states[start:]
    if len(states) < 2 or not np.isfinite(states).all():
        return Tracking(np.zeros(2), 0.0, False, -math.inf, -math.inf, "falls")
    base_rotations = rotations_from_quaternions(states[:, 1 + index[3:7]])
    heading = np.unwrap(np.arctan2(base_rotations[:, 1, 0], base_rotations[:, 0, 0]))
    time = (len(states) - 1) * stage.timestep
    steps = np.diff(states[:, 1 + index[:2]], axis=0)
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
    speed_error = float(np.linalg.norm(velocity - command[:2]))
    margins = []
    for error, slack, commanded in (
        (speed_error, SPEED_ATOL, float(np.linalg.norm(command[:2]))),
        (abs(turning - command[2]), TURN_ATOL, abs(command[2])),
    ):
        max_error = (1 - MIN_FOLLOWED_FRACTION) * commanded if commanded else math.inf
        tolerance = min(SPEED_RTOL * commanded + slack, max_error)
        # Compared as errors: the margin of an error equal to the tolerance may be rounded.
        margins.append((1.0 - error / tolerance, error <= tolerance))
    (speed_margin, has_speed), (turning_margin, has_turning) = margins
    failure = "" if has_speed and has_turning else "turning" if has_speed else "speed"
    failure = "falls" if run.fallen else failure
    return Tracking(velocity, turning, not failure, speed_margin, turning_margin, failure)


def measure_gait(
    stage: Stage, run: PolicyRun, warm_up: float, motors: Mapping[str, Motor] | None = None
) -> Gait:
    """Compute the gait of a run after the warm-up [s]: tracking, torques, power and contacts.

    The torques are compared with the torque-speed regions of ``motors``, {joint: motor}.
    """
    robot, step = stage.robot, stage.timestep
    first = min(round(warm_up / step), max(0, len(run.states) - 2))
    torques, rates = _measure_motors(stage, run, first)
    limits, has_torques = robot.effort_limits, len(torques) > 0
    unknown = np.full((1, robot.nu), np.nan)
    known_torques, known_rates = (torques, rates) if has_torques else (unknown, unknown)
    saturated = np.abs(known_torques) >= LIMIT_FRACTION * limits
    regions = compute_motor_utilisation(motors or {}, robot.joint_names, known_torques, known_rates)
    assigned = ~np.isnan(regions).any(axis=0)
    tracking = evaluate_tracking(stage, run, warm_up)
    power = float(np.maximum(known_torques * known_rates, 0.0).sum(axis=1).mean())
    speed = float(np.linalg.norm(tracking.velocity))
    sampled_states = run.states[first :: stage.substeps]
    sampled_states = sampled_states[np.isfinite(sampled_states).all(axis=1)]
    samples, touching = sample_ground_support(
        stage, run.case.model, sampled_states, statics=not run.case.seed
    )
    duty = {
        foot: sum(foot in sample.feet for sample in samples) / max(1, len(samples))
        for foot in robot.feet
    }
    roll, pitch, bounce = _compute_base_deviations(stage, sampled_states)
    motion_states = run.states[:: max(1, round(_MOTION_PERIOD / step))]
    motion_states = motion_states[np.isfinite(motion_states).all(axis=1)]
    torque_samples = round(1.0 / step)
    times = run.states[first:-1, 0]
    return Gait(
        command=run.case.command,
        seed=run.case.seed,
        fall=describe_run_failure(stage, run, len(run.states) * step) if run.fallen else None,
        duration=len(run.states) * step,
        velocity=tracking.velocity,
        turning=tracking.turning,
        tracks=tracking.tracks,
        torque_rms=_compute_root_mean_square(known_torques),
        torque_peak=np.abs(known_torques).max(axis=0),
        at_limit=np.where(np.isfinite(limits) & has_torques, saturated.mean(axis=0), np.nan),
        region_peak=regions.max(axis=0),
        beyond_region=np.where(assigned, (regions > 1.0 + _REGION_RTOL).mean(axis=0), np.nan),
        speed_peak=np.abs(known_rates).max(axis=0),
        power=power,
        energy=_compute_run_energy(stage, torques, run.states[first:], motors or {}),
        largest_action=run.largest_action,
        transport=power / (robot.weight * speed) if speed > SPEED_ATOL else None,
        duty=duty,
        touching=touching,
        static=_compute_root_mean_square(np.array([sample.static for sample in samples]))
        if samples and not run.case.seed
        else None,
        roll=roll,
        pitch=pitch,
        bounce=bounce,
        margin=_compute_fall_margin(stage, run),
        motion_time=motion_states[:, 0].copy(),
        motion=np.round(motion_states[:, 1 + robot.mj_convention.qpos_index], 5),
        torque_time=times[-torque_samples:].copy(),
        torques=np.round(torques[-torque_samples:], 5),
    )


def _measure_motors(stage: Stage, run: PolicyRun, first: int) -> tuple[Array, Array]:
    """Return torques [N m, N] and joint rates [rad/s, m/s] from the state ``first`` on.

    The shapes are (n, nu). The last state has no row; values that are not finite are replaced.
    """
    torques = joint_torques(stage, run)[first:]
    columns = 1 + stage.model.nq + stage.robot.mj_convention.qvel_index[6:]
    rates = run.states[first:-1, columns]
    return np.nan_to_num(torques, nan=0.0), np.nan_to_num(rates, nan=0.0)


def _compute_base_deviations(stage: Stage, states: Array) -> tuple[float, float, float]:
    """Compute the standard deviations of roll [rad], pitch [rad] and height [m] of the base.

    ``states`` are full physics states of MuJoCo, shape (n, size).
    """
    columns = 1 + stage.robot.mj_convention.qpos_index
    rotations = rotations_from_quaternions(states[:, columns[3:7]])
    roll = np.arctan2(rotations[:, 2, 1], rotations[:, 2, 2])
    pitch = np.arcsin(np.clip(-rotations[:, 2, 0], -1, 1))
    return float(np.std(roll)), float(np.std(pitch)), float(np.std(states[:, columns[2]]))


def _compute_fall_margin(stage: Stage, run: PolicyRun) -> float:
    """Compute the unused fraction of the limits of tilt and height loss [1]; 0 after a fall."""
    if run.fallen:
        return 0.0
    height_limit = (1 - FALLEN_HEIGHT_RATIO) * stage.upright.com_height
    used_fraction = max(run.lean / FALLEN_TILT, run.lost / height_limit, 0.0)
    return max(0.0, 1.0 - used_fraction)


def _compute_run_energy(
    stage: Stage, torques: Array, states: Array, motors: Mapping[str, Motor]
) -> MotorEnergy | None:
    """Compute the electrical energy of the motors in n steps; None without motors or finite steps.

    ``torques`` are those at the start of each step, shape (n, nu) [N m, N for slides]; ``states``
    have the shape (n + 1, size). Steps after a state that is not finite are ignored.
    """
    finite = np.isfinite(states).all(axis=1)
    count = len(states) if finite.all() else int(np.argmin(finite))
    if not motors or count < 2:
        return None
    robot, model, convention = stage.robot, stage.model, stage.robot.mj_convention
    speeds = states[:count, 1 + model.nq + convention.qvel_index[6:]]
    driven = convention.actuator_index >= 0
    actuators = convention.actuator_index[driven]
    kd, ranges = np.zeros(robot.nu), np.tile([-np.inf, np.inf], (robot.nu, 1))
    kd[driven] = -model.actuator_biasprm[actuators, 2] * read_gears(model, actuators) ** 2
    ranges[driven] = read_torque_ranges(model, actuators)
    applied = integrate_servo_damping(model, kd, torques[: count - 1], speeds, ranges)
    return compute_motor_energy(motors, robot.joint_names, applied, speeds, stage.timestep)


def describe_run_failure(stage: Stage, run: PolicyRun, duration: float) -> Diagnostic:
    """Create the message of a fall, or of a diverged simulation, after ``duration`` [s]."""
    time, end = Quantity(duration, "s"), run.states[-1]
    if not np.isfinite(end).all() or end[0] < duration - 0.5 * stage.timestep:
        return diagnose("walk-diverged", time=time)
    tilt = Quantity(stage.upright.tilt(end), "rad")
    height = Quantity(float(end[1 + stage.robot.mj_convention.qpos_index[2]]), "m")
    return diagnose("fell-over", tilt=tilt, height=height, time=time)


class GroundSupport(NamedTuple):
    """Feet on the ground, and motor torques that would hold the same pose without motion.

    The static torques, shape (nu,) [N m, N for slides], balance vertical forces at the contact
    points that carry the weight. The centre of pressure is as close as possible to the projected
    centre of mass. The static torques are zero if `sample_ground_support` does not compute them.
    """

    feet: tuple[str, ...]
    static: Array


def sample_ground_support(
    stage: Stage, model: mujoco.MjModel, states: Array, *, statics: bool
) -> tuple[list[GroundSupport], tuple[str, ...]]:
    """Find the feet on the ground for each state, and bodies that touch the ground otherwise.

    The states have the shape (n, size). Static torques are zero without ``statics``.

    Returns:
        A sample per state, and the names of bodies that touch the ground in any state with a geom
        of no foot.
    """
    robot, data = stage.robot, mujoco.MjData(model)
    samples, other_bodies = [], set()
    for state in states:
        mujoco.mj_setState(model, data, state, STATE_SPEC)
        if statics:
            data.qvel[:] = 0.0
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
        else:
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
        near = np.flatnonzero(find_acting_contacts(data))
        pairs = data.contact.geom[near]
        bodies = model.geom_bodyid[pairs]
        geoms = np.where(bodies[:, 0] == 0, pairs[:, 1], pairs[:, 0])
        feet = [robot.foot_geoms.get(int(geom)) for geom in geoms]
        ground = (bodies == 0).any(axis=1) & np.array([foot is not None for foot in feet], bool)
        touching_names = {str(feet[index]) for index in np.flatnonzero(ground)}
        touching = tuple(foot for foot in robot.feet if foot in touching_names)
        torques = np.zeros(robot.nu)
        if statics:
            points, bodies_of_points = (
                data.contact.pos[near[ground]],
                model.geom_bodyid[geoms[ground]],
            )
            torques = _compute_static_torques(stage, model, data, points, bodies_of_points)
        samples.append(GroundSupport(touching, torques))
        other_bodies |= bodies_on_ground(model, data, robot.foot_geoms)
    return samples, tuple(sorted(other_bodies))


_SUM_WEIGHT, _REGULARISATION = 1e3, 1e-5
"""Weights [m] of two residuals in the least-squares problem of static contact forces. `_SUM_WEIGHT`
multiplies the residual (sum of the force fractions) - 1. `_REGULARISATION` multiplies each
fraction. The third residual, the distance [m] from the centre of pressure to the projected CoM, has
weight 1. Chosen, not tuned.
"""


def _compute_static_torques(
    stage: Stage, model: mujoco.MjModel, data: mujoco.MjData, points: Array, bodies: NDArray[Any]
) -> Array:
    """Return the motor torques of a static pose, shape (nu,) [N m, N for slides].

    Vertical contact forces at the ``points`` p, shape (m, 3) [m], carry the weight; without points
    there are no contact forces. The fractions n of the weight approximately minimise
    |sum n p - c|^2 with sum n = 1 and n >= 0 (least squares), where c is the horizontal position of
    the CoM. ``bodies``, shape (m,), are the bodies of the points.
    """
    from scipy.optimize import nnls  # takes a quarter of a second

    generalised_forces = data.qfrc_bias - data.qfrc_passive
    weight = float(generalised_forces[stage.robot.mj_convention.qvel_index[2]])
    if len(points):
        com = data.subtree_com[stage.model.body(stage.robot.mj_base).id, :2]
        offsets = (points[:, :2] - com).T
        rows = np.vstack(
            [offsets, np.full(len(points), _SUM_WEIGHT), _REGULARISATION * np.eye(len(points))]
        )
        shares, _ = nnls(rows, np.r_[0.0, 0.0, _SUM_WEIGHT, np.zeros(len(points))])
        jacobian = np.empty((3, model.nv))
        for point, body, share in zip(points, bodies, shares, strict=True):
            mujoco.mj_jac(model, data, jacobian, None, point, int(body))
            generalised_forces = generalised_forces - weight * share * jacobian[2]
    torques: Array = generalised_forces[stage.robot.mj_convention.qvel_index[6:]]
    return torques


def _compute_root_mean_square(values: Array) -> Array:
    """Return the root mean square of each column, over the first axis of (n, nu) values."""
    return np.asarray(np.sqrt((values**2).mean(axis=0)))
