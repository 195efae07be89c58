"""Simulate a stand with twelve nudges of the base, and report the first failure.

A nudge is an initial velocity. A simulation ends at the first failure, at the end of the time, or
once no failure is expected for the remaining time. For this decision the remaining motion is
bounded from speeds and growing modes, or predicted by the linearised step
(`_NudgedEvaluation.will_hold`). Failures are saturated motors, slipping or lifted feet, large joint
deviations, joint limits, other parts on the ground, shaking that does not decay, and divergence.
`simulate_large_nudges` looks for shaking after larger nudges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.results import Result
from pupper_analysis.robot import contact
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import find_footless_joints
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import resolve_servo_gains
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.causes import MAX_CREEP_SPEED, compute_creep_speeds
from pupper_analysis.simulation.growth import find_dof_unit
from pupper_analysis.simulation.linear import LinearStep
from pupper_analysis.simulation.rollout import (
    STATE_SPEC,
    StandStart,
    check_duration,
    make_stand_start,
    roll_out,
    simulate_in_intervals,
    with_stand_contacts,
)
from pupper_analysis.simulation.settling import LARGE_NUDGE_SPEED
from pupper_analysis.simulation.shaking import RECORD_INTERVAL, SHAKING_SECONDS, ShakingRecord
from pupper_analysis.simulation.stability import evaluate_spectrum
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation

BASE_NUDGE_SPEED = 0.01
"""Initial speed of the base [m/s] in a nudged simulation. For a horizontal nudge the speed is
multiplied by `_HORIZONTAL_FACTOR`. For a yaw rotation the angular speed is (this speed) / (CoM
height). Chosen, not tuned."""

_HORIZONTAL_NUDGES = 8
"""Number of horizontal nudges, at equal angles; the first is along world x. Chosen, not tuned."""

_HORIZONTAL_FACTOR = 1 / math.cos(math.pi / _HORIZONTAL_NUDGES)
"""Factor [1] on ``BASE_NUDGE_SPEED`` for horizontal nudges. Derived: the nudge velocities are the
corners of a polygon that contains the circle with radius ``BASE_NUDGE_SPEED``. A stand that
survives two neighbouring nudges is assumed to survive smaller nudges between them.
"""

MAX_JOINT_DEVIATION = 0.1
"""Upper bound of the deviation of a joint from the stand after a nudge [rad, m]. If a joint
deviates more, the stand has buckled. Chosen below the deviations of robots that have buckled, for
example 0.3 rad."""

MAX_FOOT_SLIP = 5e-3
"""Upper bound of the displacement of a contact point after a nudge [m], perpendicular to the
lift-off direction (`Stand.lift_directions`) and without creep. If the displacement is larger, the
foot has slid. Chosen larger than the displacement of rolling feet."""

MAX_FOOT_LIFT = 2e-3
"""Upper bound of the rise of a contact point along the lift-off direction after a nudge [m]. If a
foot without ground contact rises more, the foot has lifted. Chosen, not tuned."""

_MIN_MARGIN_RATIO, _MAX_UTILISATION, _MIN_LIMIT_DISTANCE = 5.0, 0.9, 0.02
"""Bounds with which `is_near_limit` decides. A stand beyond a bound requires nudged simulations.

- First: lower bound of the CoM margin, divided by the CoM displacement by a nudge [1].
- Second: upper bound of the utilisation of motors and friction [1].
- Third: lower bound of the distance of a joint from its limits [rad, m].

Measured on 80 random robots with 50 to 97 % of their payloads: robots that fell after a nudge had a
CoM margin below 3 displacements."""

_MIN_LOAD_RATIO = 0.02
"""Lower bound [1] of the ratio (load of a foot) / (mean load of the feet), below which a nudge may
lift the foot. On unequal slopes, contact forces with minimum tangential forces may load two of four
feet with only 1/10,000 of the weight. Chosen, not tuned.
"""

_MIN_SATURATION_DEVIATION = 1e-3
"""Lower bound of the joint deviation [rad, m] that saturates the motor: (distance of the static
torque from the nearer effort limit) / kp. With a smaller deviation, a small nudge may saturate the
motor; a saturated motor has no stiffness. Measured on a quadruped with 8.4 kg and a nudge of 0.05
m/s: the robot overturns with a hip that saturates at 1e-5 rad, and stands with 7e-5 rad.
"""

_LIMIT_ATOL = 1e-6
"""Tolerance of joint positions [rad, m], for joints that rest on a limit or have no range. Chosen
as the rounding of configurations in files.
"""

_SAMPLE_TIME = 0.05
"""Time between the states of a nudged simulation that are tested for a failure [s]. Chosen, not
tuned.
"""

_CHECK_INTERVAL = 0.5
"""Simulated time [s] between two tests whether a nudged simulation may end, rounded to whole
samples (`_SAMPLE_TIME`). Chosen, not tuned."""

_MAX_REMAINING_MOTION = 1e-3
"""Upper bound of the motion of a coordinate [m, rad] in the remaining time, with which a nudged
simulation may end early. For motion that is predicted by the linearised step, the bound applies to
the part beyond the range of the motion so far. Chosen as a hundredth of `MAX_JOINT_DEVIATION`.
"""

_SPEED_FACTOR = 1.5
"""Safety factor [1] on measured speeds, in the upper bound of the motion in the remaining time of a
nudged simulation. An oscillation may be slower while the speed is measured. Chosen, not tuned.
"""

_PREDICTION_FACTOR = 1.25
"""Safety factor [1] on the displacements that the linearised MuJoCo step predicts for the remaining
time of a nudged simulation. Chosen, not tuned."""

_MAX_GROWTH_EXPONENT = 20.0
"""Upper bound [1] of the product (growth rate of a mode) * (remaining time) with which the
remaining motion can be bounded. A larger product is growth by a factor of more than 4.8e8. Chosen,
not tuned.
"""

_CLEARANCE_FACTOR = 2.0
"""Factor [1] on the largest remaining motion of a coordinate, in the test if a part other than a
foot could reach the ground. Chosen, not tuned: the motion of the base is counted once, and the
motion of the joints once.
"""


class Failure(StrEnum):
    """Cause of the first failure of a nudged stand, or of a stand whose payload grows."""

    MOTOR = "a motor saturates"
    SLIDING = "a foot slides"
    TIPPING = "the robot tips"
    BUCKLING = "loses static stability: servo stiffness too low"
    SHAKING = "shakes on its servos"
    JOINT = "a joint comes to its limit"
    GROUND = "another part comes to the ground"
    COMMAND = "a servo cannot be commanded so far"
    REACH = "the loaded stance is out of reach"
    SIMULATED = "does not hold in the simulation"
    UNLOADED = "does not hold without payload either"
    NOTHING = "nothing that was looked at"


@dataclass(frozen=True, eq=False)
class NudgeTrial(Result):
    """Result of simulations of a stand after nudges (initial velocities) of the base.

    Attributes:
        survived: Whether the stand survived all nudges.
        failure: Earliest failure; None if there was none.
        failing_parts: Motors, joints, contact points or bodies of the failure; empty if the
            simulation diverged.
        time: Simulated time of the failure (s); 0 if the simulation diverged; None without a
            failure.
        failed_nudges: Number of nudges that ended in a failure.
        nudges: Number of simulated nudges.
        duration: Time after each nudge for which the outcome holds (s).
        simulated: Simulated time of all nudges (s); less than ``nudges * duration`` if simulations
            were decided earlier.
        shaking_speed: Largest speed in the last second (m/s or rad/s) if ``failure`` is
            ``SHAKING``; otherwise None.
        shaking_unit: Unit of ``shaking_speed``: rad/s for a rotation, m/s for a translation.
    """

    survived: bool
    failure: Failure | None
    failing_parts: tuple[str, ...]
    time: float | None = field(metadata={"unit": "s"})
    failed_nudges: int
    nudges: int
    duration: float = field(metadata={"unit": "s"})
    simulated: float = field(metadata={"unit": "s"})
    shaking_speed: float | None = field(metadata={"unit": "m/s or rad/s"})
    shaking_unit: str


def simulate_nudges(
    robot: Robot,
    stand: Stand,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    duration: float = HOLD_DURATION,
    until_failure: bool = False,
) -> NudgeTrial:
    """Simulate a stand after twelve nudges (initial velocities of the base) to find failures.

    The nudges are: `BASE_NUDGE_SPEED` up and down; a slightly larger speed in eight horizontal
    directions (`_HORIZONTAL_FACTOR`); a rotation about the base's z axis in both senses.

    A stand that only dry friction holds may survive; ``growth.confirm_growth`` tests such stands
    with a larger nudge.

    A simulation ends early at a failure, or if no failure is expected in the remaining time.
    A contact point with a predicted load below ``monitor.LIGHT_FOOT_LOAD`` may lift during the
    simulation.

    Args:
        robot: Robot, with the payload and a free base.
        stand: Stand, solved for the simulated ground.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own by default.
        duration: Time after each nudge for which the result holds [s], 2 to 600.
        until_failure: Whether all simulations end once the earliest failure is known. If True,
            ``failed_nudges`` is a lower bound.

    Returns:
        Whether the stand survives all nudges; otherwise the earliest failure, with its time [s].

    Raises:
        ConfigurationError: If an argument is out of range, or the stand belongs to another robot,
            for example.
        ModelError: If the servo gains of a joint are unknown, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    robot = with_stand_contacts(robot, stand)
    check_duration(duration)
    held = make_stand_start(robot, stand, kp=kp, kd=kd)
    robot, model, ctrl = held.robot, held.drive.model, held.ctrl
    starts = np.tile(held.start, (_HORIZONTAL_NUDGES + 4, 1))
    columns = 1 + model.nq + robot.mj_convention.qvel_index
    starts[:, columns] = make_nudge_velocities(robot, stand)
    timestep = float(model.opt.timestep)
    steps, stride = max(2, round(duration / timestep)), max(1, round(_SAMPLE_TIME / timestep))
    interval = max(1, round(_CHECK_INTERVAL / _SAMPLE_TIME)) * stride
    conditions = _FailureConditions(held, stand)
    runs = [_NudgedEvaluation(conditions, start) for start in starts]
    workers, simulated = [mujoco.MjData(model) for _ in range(2)], 0
    for begin in range(0, steps, interval):
        running = [run for run in runs if not run.is_decided]
        if not running or (until_failure and _is_earliest_known(runs)):
            break
        count = min(interval, steps - begin)
        first = np.array([run.state for run in running])
        rollouts = roll_out(model, workers, first, np.tile(ctrl, (1, count, 1)))
        simulated += count * len(running)
        for run, states in zip(running, rollouts, strict=True):
            run.advance(states, stride, remaining=(steps - begin - count) * timestep)
    failed = [(run.failure, run) for run in runs if run.failure is not None]
    (time, failure, failing_parts), first_run = min(
        failed, key=_order_failure, default=((None, None, ()), runs[0])
    )
    shakes = failure is Failure.SHAKING
    return NudgeTrial(
        survived=not failed,
        failure=failure,
        failing_parts=failing_parts,
        time=time,
        failed_nudges=len(failed),
        nudges=len(runs),
        duration=duration,
        simulated=simulated * timestep,
        shaking_speed=first_run.shaking.speed if shakes else None,
        shaking_unit=f"{find_dof_unit(model, first_run.shaking.fastest_dof)}/s",
    )


def simulate_large_nudges(
    robot: Robot,
    stand: Stand,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> NudgeTrial:
    """Simulate a stand after large nudges of the base, to detect shaking that does not decay.

    A nudge is an initial velocity; a large nudge may lift a sole, which may then chatter. The base
    starts with `LARGE_NUDGE_SPEED` along +x, -x, +y or -y of the world, or rotates about its z axis
    with `LARGE_NUDGE_SPEED` / CoM height.

    Failures are shaking without decay and divergence; the trial ends at the first failure. A robot
    that leaves the stand without shaking is no failure here: `simulate_nudges` detects this.

    Args:
        robot: Robot, with a free base.
        stand: Stand, solved for the simulated ground.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own by default.

    Returns:
        Outcome; ``nudges`` is the number of simulated nudges.

    Raises:
        ConfigurationError: If an argument is out of range, or the stand belongs to another robot,
            for example.
        ModelError: If the servo gains of a joint are unknown, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    robot = with_stand_contacts(robot, stand)
    held = make_stand_start(robot, stand, kp=kp, kd=kd)
    robot, model = held.robot, held.drive.model
    timestep = float(model.opt.timestep)
    velocities = np.zeros((5, robot.nv))
    velocities[:4, :2] = LARGE_NUDGE_SPEED * np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])
    velocities[4, 5] = LARGE_NUDGE_SPEED / com_height_above_contacts(robot, stand)
    columns = 1 + model.nq + robot.mj_convention.qvel_index
    interval = max(2, round(RECORD_INTERVAL / timestep))
    steps = round(HOLD_DURATION / RECORD_INTERVAL) * interval
    simulated, nudges, record = 0, 0, ShakingRecord(model)
    event: _Event | None = None
    for velocity in velocities:
        nudges += 1
        start = held.start.copy()
        start[columns] = velocity
        record = ShakingRecord(model)
        for states in simulate_in_intervals(model, start, held.ctrl, steps, interval):
            simulated += len(states)
            if monitor.has_diverged(states, timestep):
                event = 0.0, Failure.BUCKLING, ()
                break
            record.add(states)
            if record.is_calm:
                break
        else:
            event = _find_shaking(model, record, HOLD_DURATION)
        if event is not None:
            break
    time, failure, failing_parts = event or (None, None, ())
    return NudgeTrial(
        survived=event is None,
        failure=failure,
        failing_parts=failing_parts,
        time=time,
        failed_nudges=int(event is not None),
        nudges=nudges,
        duration=HOLD_DURATION,
        simulated=simulated * timestep,
        shaking_speed=record.speed if failure is Failure.SHAKING else None,
        shaking_unit=f"{find_dof_unit(model, record.fastest_dof)}/s",
    )


def is_near_limit(
    robot: Robot,
    stand: Stand,
    statics: GravityCompensation,
    kp: ArrayLike | None = None,
) -> bool:
    """Return True if a stand is so near a limit that a small nudge may cause a failure.

    A nudge with speed v moves a CoM at height h by about v sqrt(h/g). The CoM margin, the
    utilisation of motors and friction, the loads of feet, the saturation of servos and the joint
    positions are compared with bounds, for example `_MIN_MARGIN_RATIO`. The result is False without
    a CoM margin, and for a base that no nudge moves.

    Args:
        robot: Robot, with the payload.
        stand: Stand, solved for the simulated ground.
        statics: Statics of the stand.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
    """
    if statics.com_margin is None or robot.is_base_fixed:  # a base that no nudge moves
        return False
    com_displacement = BASE_NUDGE_SPEED * math.sqrt(
        com_height_above_contacts(robot, stand) / float(np.linalg.norm(robot.gravity))
    )
    angles = stand.qpos[7:]
    limit_distances = np.minimum(angles - robot.lower_limits, robot.upper_limits - angles)
    is_free = np.isin(robot.joint_names, find_footless_joints(robot)) & (
        limit_distances < _LIMIT_ATOL
    )
    is_locked = robot.upper_limits - robot.lower_limits <= _LIMIT_ATOL
    loads = [
        float(load.force @ stand.normals[robot.feet[foot][0]])
        for foot, load in statics.foot_loads.items()
    ]
    return bool(
        statics.com_margin < _MIN_MARGIN_RATIO * com_displacement
        or (not robot.fixed_parts and min(loads) < _MIN_LOAD_RATIO * sum(loads) / len(loads))
        or bool((statics.motor_utilisation > _MAX_UTILISATION).any())
        or saturates_after_nudge(robot, statics, kp)
        or max(statics.friction_utilisation.values(), default=0.0) > _MAX_UTILISATION
        or bool((limit_distances[~(is_free | is_locked)] < _MIN_LIMIT_DISTANCE).any())
    )


def saturates_after_nudge(robot: Robot, statics: GravityCompensation, kp: ArrayLike | None) -> bool:
    """Return True if the static torque of a servo is near an effort limit, above or below it.

    The tolerance is `_MIN_SATURATION_DEVIATION` times the servo stiffness ``kp`` [N m/rad, N/m],
    scalar or shape (nu,); that of the model if None.
    """
    stiffness = resolve_servo_gains(robot, kp, None if kp is None else 0.0).kp
    distances = np.abs(robot.effort_ranges - statics.joint_torques[:, None]).min(axis=1)
    return bool((distances < _MIN_SATURATION_DEVIATION * stiffness).any())


def _find_failure_limits(robot: Robot, stand: Stand) -> tuple[Array, Array]:
    """Return lower and upper joint positions, shape (nu,) [rad, m], beyond which a stand fails.

    A limit is infinite if the joint rests on it in the stand: a nudge presses such a joint into
    MuJoCo's soft limit. Both limits of a joint without a range are infinite.
    """
    angles = stand.qpos[7:]
    locked = robot.upper_limits - robot.lower_limits <= _LIMIT_ATOL
    at_lower = locked | (angles < robot.lower_limits + _LIMIT_ATOL)
    at_upper = locked | (angles > robot.upper_limits - _LIMIT_ATOL)
    return np.where(at_lower, -np.inf, robot.lower_limits), np.where(
        at_upper, np.inf, robot.upper_limits
    )


def com_height_above_contacts(robot: Robot, stand: Stand) -> float:
    """Return the height [m] of a stand's CoM above the mean of its contact points.

    For a robot with welds or grips, the result is `Robot.stand_height`.
    """
    if robot.fixed_parts:
        return robot.stand_height
    com = Configuration(robot, stand.qpos).center_of_mass()
    return float(com[2] - np.mean(list(stand.contact_points.values()), axis=0)[2])


def make_nudge_velocities(robot: Robot, stand: Stand) -> Array:
    """Create the initial velocities [m/s, rad/s] of the nudges of `simulate_nudges`, (12, nv).

    Rows: eight horizontal nudges, up, down, and rotations about the base's z axis in both senses.
    The columns are in the order of qvel; joint velocities are zero.
    """
    speeds = np.zeros((_HORIZONTAL_NUDGES + 4, robot.nv))
    angles = 2 * np.pi * np.arange(_HORIZONTAL_NUDGES) / _HORIZONTAL_NUDGES
    speeds[:_HORIZONTAL_NUDGES, :2] = (
        _HORIZONTAL_FACTOR * BASE_NUDGE_SPEED * np.column_stack([np.cos(angles), np.sin(angles)])
    )
    speeds[_HORIZONTAL_NUDGES : _HORIZONTAL_NUDGES + 2, 2] = BASE_NUDGE_SPEED, -BASE_NUDGE_SPEED
    # The base frame may be at ground height; the CoM is above.
    height = com_height_above_contacts(robot, stand)
    speeds[_HORIZONTAL_NUDGES + 2 :, 5] = BASE_NUDGE_SPEED / height, -BASE_NUDGE_SPEED / height
    return speeds


_Event = tuple[float, Failure, tuple[str, ...]]
"""Failure in a simulation: time [s], kind, and motors, joints, contact points or bodies."""


class _FailureConditions:
    """Limits and reference state by which simulations after nudges are judged.

    Args:
        held: Initial state, with the servo commands.
        stand: The stand.

    Attributes:
        growth_rate: Largest growth rate [1/s] of a mode in all spectra (eigenvalues of the
            simulation step) so far; at least 0.
    """

    def __init__(self, held: StandStart, stand: Stand) -> None:
        robot = held.robot
        self.held, self.stand, self.robot = held, stand, robot
        self.timestep = float(held.drive.model.opt.timestep)
        self.data = mujoco.MjData(held.drive.model)
        creeps = compute_creep_speeds(robot, stand, held.prediction)
        self.efforts = robot.effort_ranges * (1 - 1e-9)
        self.names = np.array(robot.joint_names)
        self.lower, self.upper = _find_failure_limits(robot, stand)
        self.normals = stand.lift_directions(robot)
        self.foot_normals = np.array([self.normals[foot] for foot in stand.stance_feet])
        self.foot_normals = self.foot_normals.reshape(-1, 3)
        self.foot_creeps = [min(creeps[foot], MAX_CREEP_SPEED) for foot in stand.stance_feet]
        self.stance_feet = tuple(robot.foot_of(foot) for foot in stand.stance_feet)
        self.carrying = set(robot.feet_with(stand.stance_feet))
        forces = {
            foot: float(held.prediction.contact_forces[foot] @ self.normals[foot])
            for foot in stand.stance_feet
        }
        min_force = monitor.LIGHT_FOOT_LOAD * sum(forces.values())
        self.light = {foot for foot, force in forces.items() if force < min_force}
        self.growth_rate = 0.0
        self._linear: LinearStep | None = None
        self._linear_time = math.nan

    def bound_motion(self, speed: float, remaining: float) -> float:
        """Compute an upper bound of the motion of a coordinate [m, rad] in the remaining time.

        The bound is ``_SPEED_FACTOR`` v (exp(r T) - 1) / r, with v = ``speed`` [m/s, rad/s], r =
        ``growth_rate`` [1/s] and T = ``remaining`` [s]; infinite if r T is too large.
        """
        growth = self.growth_rate * remaining
        if growth > _MAX_GROWTH_EXPONENT:
            return math.inf
        return (
            _SPEED_FACTOR * speed * (math.expm1(growth) / self.growth_rate if growth else remaining)
        )

    def predict_motion(self, states: Array, remaining: float) -> tuple[Array, Array] | None:
        """Predict the motion in the remaining time [s] with the linearised simulation step.

        ``states`` are those after successive steps, shape (n, size).

        Returns:
            Displacements from the last of ``states`` at m later times, multiplied by
            ``_PREDICTION_FACTOR``, shape (m, nv) [m, rad]; and velocities, shape (m, nv) [m/s,
            rad/s]. None if the linear model is no basis for a prediction; for example, a mode
            grows.
        """
        if self.growth_rate:
            return None
        model = self.held.drive.model
        if self._linear_time != remaining:
            self.sample(states[-1])
            mujoco.mj_forward(model, self.data)
            self._linear = LinearStep(model, self.data)
            self._linear_time = remaining
        assert self._linear is not None
        if not self._linear.reproduces(states):
            return None
        predicted = self._linear.predict(states[-2], states[-1], remaining)
        if not np.isfinite(predicted).all():
            return None
        velocity = states[-1, 1 + model.nq : 1 + model.nq + model.nv]
        displacements, changes = predicted[:, : model.nv], predicted[:, model.nv : 2 * model.nv]
        return _PREDICTION_FACTOR * displacements, velocity + changes

    def displacement(self, state: Array) -> Array:
        """Compute the displacement (nv,) [m, rad] of a state from the stand's initial state."""
        model, displacement = self.held.drive.model, np.empty(self.held.drive.model.nv)
        ends = slice(1, 1 + model.nq)
        mujoco.mj_differentiatePos(model, displacement, 1.0, self.held.start[ends], state[ends])
        return displacement

    def sample(self, state: Array) -> tuple[set[str], set[str], Array]:
        """Find the feet and other bodies on the ground, and the motor torques, at a state.

        No contact forces are computed, which saves most of the time.

        Returns:
            Names of the feet on the ground; names of swing feet and other bodies on the ground;
            motor torques, shape (nu,) [N m, N].
        """
        model, data = self.held.drive.model, self.data
        mujoco.mj_setState(model, data, state, STATE_SPEC)
        data.ctrl[:] = self.held.ctrl
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        feet, bodies = contact.find_ground_contacts(model, data, self.robot.foot_geoms)
        torques = data.qfrc_actuator[self.robot.mj_convention.qvel_index[6:]]
        return feet, bodies | (feet - self.carrying), torques

    def joint_positions(self, states: Array) -> Array:
        """Extract joint positions, shape (..., nu) [rad, m], from states, shape (..., size)."""
        positions: Array = states[..., 1 + self.robot.mj_convention.qpos_index[7:]]
        return positions

    def locate_feet(self) -> Array:
        """Return the centres of the contact points at the last sampled state, (points, 3) [m]."""
        centres = monitor.foot_centres(self.robot, self.data)
        return np.array([centres[foot] for foot in self.stand.stance_feet]).reshape(-1, 3)


class _NudgedEvaluation:
    """Search for failures in a simulation after one nudge, interval by interval.

    Attributes:
        state: Last simulated state (mjSTATE_FULLPHYSICS), shape (size,).
        failure: First failure; None without a failure so far.
        saturated: First saturation of a motor; None if no motor has saturated. A saturation becomes
            the failure if a motor is saturated at the end, or before a failure of `_find_failure`.
        is_decided: Whether the simulation needs no more steps.
        shaking: Speeds since the nudge.
    """

    def __init__(self, conditions: _FailureConditions, start: Array) -> None:
        self._conditions = conditions
        self.state, self.is_decided = start, False
        self.shaking = ShakingRecord(conditions.held.drive.model)
        self.failure: _Event | None = None
        self.saturated: _Event | None = None
        self._lifted: _Event | None = None
        self._is_saturated = False
        self._initial_centres: Array | None = None
        self._slips: dict[str, float] = {}
        displacement = conditions.displacement(start)
        self._lowest, self._highest = displacement, displacement

    def advance(self, states: Array, stride: int, remaining: float) -> None:
        """Evaluate the states of the next interval; update ``failure`` and ``is_decided``.

        ``states`` after each step have the shape (n, size); every ``stride``-th is evaluated.
        ``remaining`` is the simulated time after the interval [s].
        """
        conditions = self._conditions
        successive, before = np.concatenate([self.state[None], states]), self._slips
        self.state = states[-1]
        if monitor.has_diverged(successive, conditions.timestep):
            self.failure = 0.0, Failure.BUCKLING, ()
        else:
            self.failure = self._find_failure(states[::stride])
            self.shaking.add(states)
            displacements = [conditions.displacement(state) for state in states[::stride]]
            self._lowest = np.minimum(self._lowest, np.min(displacements, axis=0))
            self._highest = np.maximum(self._highest, np.max(displacements, axis=0))
        if self.failure is None and not remaining:
            self.failure = self.saturated if self._is_saturated else self._lifted
            elapsed = float(self.state[0] - conditions.held.start[0])
            self.failure = self.failure or _find_shaking(
                conditions.held.drive.model, self.shaking, elapsed
            )
        self.is_decided = (
            self.failure is not None
            or not remaining
            or self.will_hold(states, len(states) * conditions.timestep, before, remaining)
        )

    def _find_failure(self, samples: Array) -> _Event | None:
        """Return the first failure in successive states, shape (n, size); None without a failure.

        If a motor saturated before or with the failure, the first saturation is returned instead.
        """
        conditions = self._conditions
        robot, feet = conditions.robot, tuple(conditions.stand.stance_feet)
        feet_on_ground, touching, torques, centres = [], [], [], []
        for sample in samples:
            grounded, touching_bodies, motor_torques = conditions.sample(sample)
            feet_on_ground.append(grounded)
            touching.append(sorted(touching_bodies))
            torques.append(motor_torques)
            centres.append(conditions.locate_feet())
        if self._initial_centres is None:
            self._initial_centres = centres[0]
        moved, normals = np.array(centres) - self._initial_centres, conditions.foot_normals
        raised = np.einsum("nfi,fi->nf", moved, normals)
        along = np.linalg.norm(moved - raised[..., None] * normals, axis=-1)
        slips = along - np.outer(samples[:, 0], conditions.foot_creeps)
        is_lifted = np.array(
            [
                [foot not in grounded for foot in conditions.stance_feet]
                for grounded in feet_on_ground
            ],
            dtype=bool,
        ).reshape(raised.shape) & (raised > MAX_FOOT_LIFT)
        is_lifted &= not robot.fixed_parts
        efforts, torques_of_samples = conditions.efforts, np.array(torques)
        is_saturated = (torques_of_samples < efforts[:, 0]) | (torques_of_samples > efforts[:, 1])
        angles = conditions.joint_positions(samples)
        is_limited = (angles < conditions.lower) | (angles > conditions.upper)
        is_buckled = np.abs(angles - conditions.stand.qpos[7:]) > MAX_JOINT_DEVIATION
        is_sliding = slips > MAX_FOOT_SLIP
        names = np.array(feet)
        for index, time in enumerate(samples[:, 0].tolist()):
            self._is_saturated = bool(is_saturated[index].any())
            if self._is_saturated and self.saturated is None:
                saturated_joints = conditions.names[is_saturated[index]].tolist()
                self.saturated = time, Failure.MOTOR, tuple(saturated_joints)
            raised_feet = names[is_lifted[index]].tolist()
            self._lifted = (time, Failure.TIPPING, tuple(raised_feet)) if raised_feet else None
            failures = {
                Failure.GROUND: touching[index],
                Failure.JOINT: conditions.names[is_limited[index]].tolist(),
                Failure.TIPPING: [foot for foot in raised_feet if foot not in conditions.light],
                Failure.SLIDING: names[is_sliding[index]].tolist(),
                Failure.BUCKLING: conditions.names[is_buckled[index]].tolist(),
            }
            for failure, where in failures.items():
                if where:
                    return self.saturated or (time, failure, tuple(where))
        self._slips = dict(zip(feet, slips[-1].tolist(), strict=True))
        return None

    def will_hold(
        self, states: Array, interval: float, slips: dict[str, float], remaining: float
    ) -> bool:
        """Return True if no failure is expected in the remaining time [s] of this simulation.

        The conditions of a failure are evaluated with the bounded or predicted remaining motion.
        ``interval`` is the duration [s] of the last interval, with ``states`` of shape (n, size);
        ``slips`` are those of the contact points at the interval's start [m].
        """
        conditions, drive = self._conditions, self._conditions.held.drive
        model, robot, stand = drive.model, conditions.robot, conditions.stand
        first = 1 + model.nq + model.nv
        speed = float(np.abs(states[:, 1 + model.nq : first]).max(initial=0.0))
        filtered = states[:, first : first + model.na]
        if model.na:
            speed = max(speed, float(np.abs(filtered[-1] - filtered[0]).max()) / interval)
        if self._is_saturated or self._lifted or not slips or not self.shaking.is_calm:
            return False
        motion, speeds = self._bound_motion(states, speed, remaining)
        if motion is None:
            return False
        spectrum = evaluate_spectrum(drive, self.state, conditions.held.ctrl, settle=0.0)
        rates = [math.log1p(mode.growth) / conditions.timestep for mode in spectrum.unstable]
        conditions.growth_rate = max(conditions.growth_rate, *rates, 0.0)
        motion, speeds = self._bound_motion(states, speed, remaining)
        if motion is None:
            return False
        feet, _, torques = conditions.sample(self.state)
        if not conditions.carrying <= feet and not robot.fixed_parts:
            return False
        angles = conditions.joint_positions(self.state)
        dofs = robot.mj_convention.qvel_index[6:]
        torque_changes = drive.kp * motion[dofs] + drive.kd * speeds[dofs]
        joint_motion = motion[dofs]
        slip_rates = {
            foot: max(slip - slips[foot], 0.0) / interval for foot, slip in self._slips.items()
        }
        return not (
            ((torques - torque_changes < conditions.efforts[:, 0]).any())
            or ((torques + torque_changes > conditions.efforts[:, 1]).any())
            or (
                (angles - joint_motion < conditions.lower)
                | (angles + joint_motion > conditions.upper)
            ).any()
            or (np.abs(angles - stand.qpos[7:]) + joint_motion > MAX_JOINT_DEVIATION).any()
            or any(
                slip + conditions.bound_motion(slip_rates[foot], remaining) > MAX_FOOT_SLIP
                for foot, slip in self._slips.items()
            )
            or self._reaches_ground(_CLEARANCE_FACTOR * float(motion.max()))
        )

    def _bound_motion(
        self, states: Array, speed: float, remaining: float
    ) -> tuple[Array | None, Array]:
        """Estimate bounds of motion [m, rad] and speeds [m/s, rad/s], shape (nv,), until the end.

        ``speed`` is the largest speed in the last interval. The motion is None if no useful bound
        is known.
        """
        conditions, nv = self._conditions, self._conditions.held.drive.model.nv
        motion, speeds = conditions.bound_motion(speed, remaining), np.full(nv, speed)
        if motion <= _MAX_REMAINING_MOTION:
            return np.full(nv, motion), speeds
        if self.saturated is not None:
            return None, speeds
        predicted = conditions.predict_motion(states, remaining)
        if predicted is None:
            return None, speeds
        displacements, velocities = predicted
        positions = conditions.displacement(self.state) + displacements
        exceeds = (positions > self._highest + _MAX_REMAINING_MOTION) | (
            positions < self._lowest - _MAX_REMAINING_MOTION
        )
        elapsed = float(self.state[0] - conditions.held.start[0])
        slip = max(self._slips.values(), default=0.0)
        if exceeds.any() or slip * (1 + remaining / elapsed) > MAX_FOOT_SLIP:
            return None, speeds
        return np.abs(displacements).max(axis=0), np.abs(velocities).max(axis=0)

    def _reaches_ground(self, distance: float) -> bool:
        """Return True if a body or swing foot would touch the ground with a lowered base.

        The base is moved by ``distance`` [m] against the lift-off directions of the stance feet.
        """
        conditions = self._conditions
        columns = 1 + conditions.robot.mj_convention.qpos_index[:3]
        for normal in np.unique(np.round(list(conditions.normals.values()), 6), axis=0):
            lowered = self.state.copy()
            lowered[columns] -= distance * normal
            if conditions.sample(lowered)[1]:
                return True
        return False


def _find_shaking(model: mujoco.MjModel, shaking: ShakingRecord, elapsed: float) -> _Event | None:
    """Return the failure "shaking" if a robot shakes without decay at the end of a simulation.

    The speeds are compared in three windows at the end of the simulated time ``elapsed`` [s]. A
    window is about a quarter of this time, in whole seconds, at least 1 s. None without such
    shaking.
    """
    window = max(1, round(elapsed) // (SHAKING_SECONDS + 1))
    if not shaking.is_sustained_over(window):
        return None
    joint = int(model.dof_jntid[shaking.fastest_dof])
    name = model.joint(joint).name or model.body(int(model.jnt_bodyid[joint])).name
    return elapsed, Failure.SHAKING, (name,)


def _order_failure(failed: tuple[_Event, _NudgedEvaluation]) -> tuple[float, float]:
    """Return the key that sorts failed runs by time [s]; of shaking runs, the fastest is first."""
    (time, failure, _), run = failed
    return time, -run.shaking.speed if failure is Failure.SHAKING else -math.inf


def _is_earliest_known(runs: list[_NudgedEvaluation]) -> bool:
    """Return True if a run has failed, and no undecided run can have an earlier failure.

    A failure after a saturation has the time of the saturation. A divergence, with time 0, is not
    considered.
    """
    times = [run.failure[0] for run in runs if run.failure is not None]
    if not times:
        return False
    pending = [run.saturated[0] for run in runs if not run.is_decided and run.saturated]
    return all(time >= min(times) for time in pending)
