"""Test if a robot comes to rest in a stand, with a simulation as short as possible.

`comes_to_rest` simulates a stand with given servos until base and feet are at rest, nudges the
robot (adds a small velocity), and evaluates the growing modes. The result is True or False. A
simulation ends as soon as the robot has left the stand, shakes without decay, or rests with
displaced feet. This function tests many servos or stands; `verify_stand` simulates 12 s by default
and returns all quantities. `calms_after_base_nudges` tests larger nudges of the base.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.array_types import Array
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.stability import HOLD_DURATION, Mode
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.causes import find_instability, lacks_decay
from pupper_analysis.simulation.growth import confirm_growth
from pupper_analysis.simulation.monitor import MEASURING_TIME
from pupper_analysis.simulation.rollout import (
    STATE_SPEC,
    StandStart,
    make_stand_start,
    simulate_commands,
    simulate_in_intervals,
)
from pupper_analysis.simulation.shaking import (
    INTERVALS_PER_SECOND,
    RECORD_INTERVAL,
    ShakingRecord,
)
from pupper_analysis.simulation.stability import (
    count_nudged_steps,
    find_final_spectrum,
    is_solver_error,
    measure_response,
    moves_equally_without_nudge,
    nudge_state,
)
from pupper_analysis.simulation.verify import NUDGED_FRACTION, SETTLED_DRIFT
from pupper_analysis.stance.stand import Stand

MAX_HEIGHT_DEVIATION = 2e-4
"""Upper bound of the standard deviation of the base's height within a second [m] with which a robot
counts as at rest. Chosen, not tuned."""

MAX_FOOT_DISPLACEMENT = 5e-3
"""Upper bound of the horizontal distance of a contact point from its target [m] with which a stand
counts as at rest. Chosen, not tuned."""

MAX_STAND_ROTATION = 0.1
"""Upper bound of the rotation of the base from the orientation in the stand [rad]. With a larger
rotation, the robot has left the stand. Chosen, not tuned."""

_RESTING_RATIO = 0.25
"""Upper bound [1] of three ratios with which a settling simulation ends early: height deviation /
`MAX_HEIGHT_DEVIATION`, height drift / `SETTLED_DRIFT`, and foot displacement /
`MAX_FOOT_DISPLACEMENT`. Chosen, not tuned.
"""

_LOST_RATIO = 2.0
"""Upper bound [1] of foot displacement / `MAX_FOOT_DISPLACEMENT` and of base rotation /
`MAX_STAND_ROTATION` in a simulation of a robot that may come to rest. Chosen: an undamped
oscillation of a base that starts at rest overshoots to twice the final tilt.
"""

_CHECK_INTERVAL = RECORD_INTERVAL
"""Simulated time between two tests whether the robot is at rest or has left the stand [s]."""

_DECAY_TIME_CONSTANTS = 3.0
"""Duration of the nudged simulation, within bounds, in time constants of the least damped mode.
Chosen: 5 % of the nudge remains after three time constants.
"""

_MIN_NUDGE_TIME = 1.5
"""Shortest simulated time after a nudge [s]. Measured: robots whose stand did not survive a nudge
of 1 mm/s left the stand within a second."""

MIN_ABSENT_DOUBLINGS = 10
"""Lower bound [1] of the ratio (simulated time after a nudge) / (doubling time of a growing mode)
with which a decaying nudge refutes the mode. In this time the mode would grow by a factor of about
1000. Chosen, not tuned."""

_SAMPLE_TIME = 0.02
"""Time between the states at which foot positions are evaluated [s]. Chosen, not tuned."""

LARGE_NUDGE_SPEED = 0.05
"""Initial speed of the base [m/s] in simulations with a large nudge. Chosen, not tuned. Measured
for the reduced Talos with added servos at a time step of 2 ms: its soles chatter without end after
this nudge, at 0.1 to 0.7 rad/s. After the smaller nudge of ``nudge_state``, the soles are at rest.
"""

_MAX_BASE_NUDGE_TIME = 6.0
"""Longest simulated time after a nudge of the base [s]. Chosen as twice ``SHAKING_SECONDS``."""

_DISPLACEMENT_RATE_FACTOR = 2.0
"""Safety factor [1] on the speed at which a displaced foot approached its target in the last
second, to predict the distance at the end of the settling simulation. Chosen, not tuned.
"""


def comes_to_rest(
    robot: Robot,
    stand: Stand,
    *,
    feedforward: bool = True,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> bool:
    """Return True if a robot comes to rest in a stand, and again after a nudge.

    The following conditions must hold:

    1. In a settling simulation of at most 5 s (the default of `verify_stand`), base and feet come
       to rest near the stand.
    2. After a nudge (a small velocity of all coordinates) the motion decays. The robot then stands
       only on the feet.
    3. No mode of the linearised step grows within ``HOLD_DURATION`` (12 s), unless the nudged
       simulations refute the mode.

    Args:
        robot: Robot.
        stand: Stand, with at least one stance foot.
        feedforward: Whether ctrl = q* + tau / kp (joint positions plus static torques); otherwise
            ctrl = q*.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own by default.

    Raises:
        ConfigurationError: If an argument is out of range, or the stand belongs to another robot,
            for example.
        ModelError: If the servo gains of a joint are unknown, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    held = make_stand_start(robot, stand, feedforward=feedforward, kp=kp, kd=kd)
    reference = monitor.StandReference.from_configuration(
        held.robot, held.stand.qpos, held.stand.task.rotation()
    )
    shaking = ShakingRecord(held.drive.model)
    last_second = _simulate_until_rest(held, reference, shaking)
    if last_second is None:
        return False
    model, state = held.drive.model, last_second[-1]
    spectrum, settled = find_final_spectrum(held.drive, held.start, state, held.ctrl)
    if not (spectrum.at_rest or spectrum.is_stable_for()):
        return False
    slowest = spectrum.least_damped
    decay_time = _DECAY_TIME_CONSTANTS * (0.0 if slowest is None else slowest.time_constant)
    nudge_time = min(max(decay_time, _MIN_NUDGE_TIME), NUDGED_FRACTION * HOLD_DURATION)
    nudged_states = _simulate_nudge(held, reference, state, nudge_time, shaking)
    if nudged_states is None:
        return False
    nudge = measure_response(model, state, nudged_states, last_second)
    response_alone = replace(spectrum, unstable=())
    is_harmless = lacks_decay(nudge) and (
        is_solver_error(model, state, held.ctrl, nudge, last_second)
        or moves_equally_without_nudge(model, state, held.ctrl, nudge, nudged_states)
    )
    if find_instability(response_alone, nudge, is_harmless=is_harmless) or _has_left_stand(
        reference, nudged_states[-1]
    ):
        return False
    touching = monitor.ContactSampler(held.robot, model).find_ground_bodies(nudged_states[-1])
    if not reference.check_stand(nudged_states[-1], touching).stands:
        return False
    duration = len(nudged_states) * float(model.opt.timestep)
    growing = spectrum.modes_growing_within()
    if growing and all(_is_refuted_by_nudge(mode, duration) for mode in growing):
        return True
    # The simulation of growing modes takes up to twice `LONGEST_TRIAL`, the nudge a few seconds.
    return confirm_growth(spectrum, model, settled, held.ctrl).is_stable_for()


def calms_after_base_nudges(
    robot: Robot,
    stand: Stand,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> bool:
    """Return True if a robot stays in the stand after six base nudges, without lasting shaking.

    Each simulation starts in the stand, with feed-forward torques. The base has the velocity
    `LARGE_NUDGE_SPEED` along +x, -x, +y, -y, +z or -z of the world. The simulations last at most
    about 6 s (`_MAX_BASE_NUDGE_TIME`). Shaking that has not ended by then, but decays, is no
    failure.

    This test finds chatter that `comes_to_rest` may miss: the larger nudge may lift a sole.

    Args:
        robot: Robot, with a free base.
        stand: Stand, with at least one stance foot.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own by default.

    Raises:
        ConfigurationError: If an argument is out of range, or the stand belongs to another robot,
            for example.
        ModelError: If the servo gains of a joint are unknown, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    held = make_stand_start(robot, stand, kp=kp, kd=kd)
    reference = monitor.StandReference.from_configuration(
        held.robot, held.stand.qpos, held.stand.task.rotation()
    )
    model = held.drive.model
    base_velocity = 1 + model.nq + held.robot.mj_convention.qvel_index[:3]
    for axis in range(3):
        for speed in (LARGE_NUDGE_SPEED, -LARGE_NUDGE_SPEED):
            start = held.start.copy()
            start[base_velocity[axis]] += speed
            if not _calms_down(held, reference, start):
                return False
    return True


def _calms_down(held: StandStart, reference: monitor.StandReference, start: Array) -> bool:
    """Simulate a robot from a moving state; return True if it stays, without lasting shaking."""
    model, shaking = held.drive.model, ShakingRecord(held.drive.model)
    timestep = float(model.opt.timestep)
    interval = max(2, round(_CHECK_INTERVAL / timestep))
    num_steps = round(_MAX_BASE_NUDGE_TIME / _CHECK_INTERVAL) * interval
    for states in simulate_in_intervals(model, start, held.ctrl, num_steps, interval):
        if monitor.has_diverged(states, timestep) or _has_left_stand(
            reference, states[-1], _LOST_RATIO * MAX_STAND_ROTATION
        ):
            return False
        shaking.add(states)
        if shaking.is_sustained:
            return False
        if shaking.is_calm:
            return True
    return True


def _is_refuted_by_nudge(mode: Mode, duration: float) -> bool:
    """Return True if a decay over ``duration`` [s] after a nudge refutes a growing mode.

    The mode must be missing with the finite-difference step ``SECOND_STEP``, since
    ``DIFFERENCE_STEP`` may cross the kink of dry friction.
    """
    doubling_time = mode.doubling_time or math.inf
    return not mode.repeated_at_second_step and MIN_ABSENT_DOUBLINGS * doubling_time <= duration


def _simulate_until_rest(
    held: StandStart, reference: monitor.StandReference, shaking: ShakingRecord
) -> Array | None:
    """Simulate a stand until rest; return the states of the last second, shape (n, size).

    None if the robot does not come to rest in the stand. The simulated speeds are added to
    ``shaking``.
    """
    model, state = held.drive.model, held.start
    timestep = float(model.opt.timestep)
    ctrl = np.tile(held.ctrl, (max(2, round(_CHECK_INTERVAL / timestep)), 1))
    data, worker = mujoco.MjData(model), mujoco.MjData(model)
    intervals = deque[tuple[Array, Array]](maxlen=round(MEASURING_TIME / _CHECK_INTERVAL))
    last_second, ratio, displacement_ratios = None, math.inf, list[float]()
    num_intervals = round((1 - NUDGED_FRACTION) * HOLD_DURATION / _CHECK_INTERVAL)
    for number in range(num_intervals):
        states = simulate_commands(model, state, ctrl, worker)
        state = states[-1]
        if monitor.has_diverged(states, timestep):
            return None
        intervals.append((states, _mean_foot_displacements(held, data, states)))
        lost = _max_horizontal_norm(intervals[-1][1]) > _LOST_RATIO * MAX_FOOT_DISPLACEMENT
        if lost or _has_left_stand(reference, state, _LOST_RATIO * MAX_STAND_ROTATION):
            return None
        shaking.add(states)
        if shaking.is_sustained:
            return None
        if len(intervals) == intervals.maxlen:
            last_second = np.concatenate([states for states, _ in intervals])
            height_ratio = _compute_height_ratio(held, last_second)
            displacements = np.mean([displacements for _, displacements in intervals], axis=0)
            displacement_ratios.append(_max_horizontal_norm(displacements) / MAX_FOOT_DISPLACEMENT)
            ratio = max(height_ratio, displacement_ratios[-1])
            if ratio <= _RESTING_RATIO:
                return last_second
            remaining = (num_intervals - 1 - number) * _CHECK_INTERVAL
            if height_ratio <= _RESTING_RATIO and _stays_displaced(displacement_ratios, remaining):
                return None
    return last_second if ratio <= 1.0 else None


def _simulate_nudge(
    held: StandStart,
    reference: monitor.StandReference,
    state: Array,
    duration: float,
    shaking: ShakingRecord,
) -> Array | None:
    """Simulate ``duration`` [s] after a nudge of ``state``; return the states, shape (n, size).

    None if the robot leaves the stand, for example. The speeds are added to ``shaking``.
    """
    model = held.drive.model
    timestep = float(model.opt.timestep)
    intervals = []
    for states in simulate_in_intervals(
        model,
        nudge_state(model, state),
        held.ctrl,
        count_nudged_steps(model, duration),
        max(2, round(_CHECK_INTERVAL / timestep)),
    ):
        if monitor.has_diverged(states, timestep):
            return None
        if _has_left_stand(reference, states[-1], _LOST_RATIO * MAX_STAND_ROTATION):
            return None
        shaking.add(states)
        if shaking.is_sustained:
            return None
        intervals.append(states)
    nudged_states = np.concatenate(intervals)
    return None if monitor.has_diverged(nudged_states, timestep) else nudged_states


def _stays_displaced(ratios: Sequence[float], remaining: float) -> bool:
    """Return True if a foot is expected to be too far from its target at the end of a simulation.

    ``ratios`` are displacements relative to ``MAX_FOOT_DISPLACEMENT``, one per ``_CHECK_INTERVAL``,
    and ``remaining`` is the remaining time [s].
    """
    if len(ratios) <= INTERVALS_PER_SECOND:
        return False
    rate = max(ratios[-1 - INTERVALS_PER_SECOND] - ratios[-1], 0.0)  # 1/s
    return ratios[-1] - _DISPLACEMENT_RATE_FACTOR * rate * remaining > 1.0


def _compute_height_ratio(held: StandStart, states: Array) -> float:
    """Return the ratio [1] of the motion of the base height to the bounds for rest; 1 at a bound.

    ``states`` have the shape (n, size).
    """
    heights = monitor.base_heights(held.robot, states)
    duration = float(held.drive.model.opt.timestep) * (len(states) - 1)
    drift = abs(float(heights[-1] - heights[0])) / duration
    return max(float(heights.std()) / MAX_HEIGHT_DEVIATION, drift / SETTLED_DRIFT)


def _max_horizontal_norm(displacements: Array) -> float:
    """Return the largest horizontal norm of displacements (feet, 3) [m]."""
    return float(np.linalg.norm(displacements[:, :2], axis=1).max())


def _mean_foot_displacements(held: StandStart, data: mujoco.MjData, states: Array) -> Array:
    """Compute target minus mean position of the stance feet's contact points, (points, 3) [m].

    Positions are sphere centres in the world frame.
    """
    positions, stand = [], held.stand
    for state in states[:: -max(1, round(_SAMPLE_TIME / held.drive.model.opt.timestep))]:
        mujoco.mj_setState(held.drive.model, data, state, STATE_SPEC)
        mujoco.mj_kinematics(held.drive.model, data)
        centres = monitor.foot_centres(held.robot, data)
        positions.append([centres[foot] for foot in stand.stance_feet])
    targets = np.array([stand.foot_targets[foot] for foot in stand.stance_feet])
    displacements: Array = targets - np.mean(positions, axis=0)
    return displacements


def _has_left_stand(
    reference: monitor.StandReference, state: Array, max_rotation: float = MAX_STAND_ROTATION
) -> bool:
    """Return True if the base is rotated by more than ``max_rotation``, or the robot has collapsed.

    The rotation [rad] is measured from the reference; ``state`` is an mjSTATE_FULLPHYSICS.
    """
    rotation = monitor.rotation_angle(reference.robot, reference.rotation, state)
    return rotation > max_rotation or reference.has_collapsed(state)
