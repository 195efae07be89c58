"""Does a robot come to rest where it stands: simulated no longer than it takes to know.

`verify_stand` tells what a stand is, over 12 s; this tells yes or no, of many servos.
"""

from __future__ import annotations

import math
from collections import deque

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.causes import find_instability
from pupper_analysis.simulation.monitor import LAST
from pupper_analysis.simulation.rollout import (
    STATE,
    Standing,
    begin_stand,
    simulate,
)
from pupper_analysis.simulation.stability import measure_response, simulate_nudge, stability_after
from pupper_analysis.simulation.verify import NUDGED, SETTLED_DRIFT
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]

STILL = 2e-4
"""Height of the base that is at rest deviates by no more than this in a second (m)."""

STAYED = 5e-3
"""Feet of a robot that does not shake have moved by no more than this (m)."""

UPRIGHT = 0.1
"""A robot that leans by more on its servos is not held up by them (rad)."""

_SURE = 0.25
"""What is below this part of each bound for a second is at rest; the spectrum says whether it stays
so."""

_LOST = 2.0
"""What has gone so many times as far as its bound does not come back within it: feet are held there
by friction, and from rest a base overshoots to twice the lean that it comes to at the most."""

_LOOK = 0.25
"""How often that is looked for (s): longer than a foot that is thrown up stays off the ground."""

_FORGOTTEN = 3.0
"""Time constants of the slowest swing in which it is seen that a nudge is forgotten: a twentieth is
left."""

_BRIEF = 1.5
"""Time that is looked at after a nudge, at least (s): what leaves its place at a nudge of 1 mm/s
does so within a second."""

_SAMPLE_TIME = 0.02  # s between the states at whose feet is looked


def comes_to_rest(
    robot: Robot,
    stand: Stand,
    *,
    feedforward: bool = True,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> bool:
    """Tells whether a robot comes to rest where it stands, and again after a nudge.

    It settles for as long as ``verify_stand`` lets it, or until it is at rest for sure, or lost;
    then no mode of the step's spectrum may grow within ``HOLD_DURATION``, and a nudge must
    be forgotten.

    Args:
        robot: The robot.
        stand: How it stands.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.

    Raises:
        ConfigurationError: If an argument is out of its range.
        ModelError: If the model has no servos and no gains are given.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    held = begin_stand(robot, stand, feedforward=feedforward, kp=kp, kd=kd)
    upright = monitor.Upright.of(held.robot, held.stand.qpos, held.stand.task.rotation())
    last = _settled(held, upright)
    if last is None:
        return False
    model, state = held.drive.model, last[-1]
    judged = stability_after(held.drive, held.start, state, held.ctrl)
    if not judged.lasts():
        return False
    slowest = judged.least_damped
    forgotten = _FORGOTTEN * (0.0 if slowest is None else slowest.time_constant)
    later = simulate_nudge(
        model, state, held.ctrl, min(max(forgotten, _BRIEF), NUDGED * HOLD_DURATION)
    )
    if monitor.has_diverged(later, float(model.opt.timestep)):
        return False
    nudge = measure_response(model, state, later, last)
    if find_instability(judged, nudge) or _falls(upright, later[-1]):
        return False
    touching = monitor.Watcher(held.robot, model).touching(later[-1])
    return upright.check_stand(later[-1], touching).stands


def _settled(held: Standing, upright: monitor.Upright) -> Array | None:
    """Simulates a stand until it is at rest; returns its last second, None if it comes to none."""
    model, state = held.drive.model, held.start
    timestep = float(model.opt.timestep)
    ctrl = np.tile(held.ctrl, (max(2, round(_LOOK / timestep)), 1))
    data, spans = mujoco.MjData(model), deque[tuple[Array, Array]](maxlen=round(LAST / _LOOK))
    second, last = None, math.inf
    for _ in range(round((1 - NUDGED) * HOLD_DURATION / _LOOK)):
        states = simulate(model, state, ctrl)
        state = states[-1]
        if monitor.has_diverged(states, timestep):
            return None
        spans.append((states, _ways(held, data, states)))
        lost = _farthest(spans[-1][1]) > _LOST * STAYED
        if lost or _falls(upright, state, _LOST * UPRIGHT):
            return None
        if len(spans) == spans.maxlen:
            second = np.concatenate([one for one, _ in spans])
            last = _unrest(held, second, np.mean([ways for _, ways in spans], axis=0))
            if last <= _SURE:
                return second
    return second if last <= 1.0 else None


def _unrest(held: Standing, states: Array, ways: Array) -> float:
    """Returns how far from rest a second is, in parts of the bounds; feet went ways (feet, 3)."""
    heights = monitor.base_heights(held.robot, states)
    duration = float(held.drive.model.opt.timestep) * (len(states) - 1)
    drift = abs(float(heights[-1] - heights[0])) / duration
    return max(float(heights.std()) / STILL, drift / SETTLED_DRIFT, _farthest(ways) / STAYED)


def _farthest(ways: Array) -> float:
    """Returns the greatest way of a foot over the ground (m)."""
    return float(np.linalg.norm(ways[:, :2], axis=1).max())


def _ways(held: Standing, data: mujoco.MjData, states: Array) -> Array:
    """Returns the way (feet, 3) of each foot from its target, on average (m)."""
    seen, stand = [], held.stand
    for state in states[:: -max(1, round(_SAMPLE_TIME / held.drive.model.opt.timestep))]:
        mujoco.mj_setState(held.drive.model, data, state, STATE)
        mujoco.mj_kinematics(held.drive.model, data)
        centres = monitor.foot_centres(held.robot, data)
        seen.append([centres[foot] for foot in stand.stance_feet])
    targets = np.array([stand.foot_targets[foot] for foot in stand.stance_feet])
    ways: Array = targets - np.mean(seen, axis=0)
    return ways


def _falls(upright: monitor.Upright, state: Array, most: float = UPRIGHT) -> bool:
    turned = monitor.turned_by(upright.robot, upright.rotation, state)
    return turned > most or upright.has_collapsed(state)
