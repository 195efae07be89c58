"""Does a robot come to rest where it stands: simulated no longer than it takes to know.

`verify_stand` tells what a stand is, over 12 s; this tells yes or no, of many servos.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.stability import LASTING, Stability
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


@dataclass(frozen=True, eq=False)
class _Span:
    """A part of a simulation.

    Attributes:
        states: (n, size) after each step.
        slips: (feet, 3) the way of each foot from its target, on average (m).
    """

    states: Array
    slips: Array

    @property
    def slip(self) -> float:
        """The greatest way of a foot over the ground (m)."""
        return float(np.linalg.norm(self.slips[:, :2], axis=1).max())

    @staticmethod
    def of(spans: Sequence[_Span]) -> _Span:
        """Returns spans of the same length as one."""
        states = np.concatenate([span.states for span in spans])
        return _Span(states, np.mean([span.slips for span in spans], axis=0))

    def rests(self, held: Standing, share: float = 1.0) -> bool:
        """Tells whether the base's height and all feet stay, within a share of each bound."""
        heights = monitor.base_heights(held.robot, self.states)
        duration = float(held.drive.model.opt.timestep) * (len(self.states) - 1)
        drift = float(heights[-1] - heights[0]) / duration
        return (
            float(heights.std()) < share * STILL
            and abs(drift) <= share * SETTLED_DRIFT
            and self.slip <= share * STAYED
        )


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
    then no mode of the step's spectrum may grow within ``LASTING``, and a nudge must be forgotten.

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
    model, state = held.drive.model, last.states[-1]
    judged = stability_after(held.drive, held.start, state, held.ctrl)
    if not judged.lasts():
        return False
    later = simulate_nudge(model, state, held.ctrl, _time_to_forget(judged))
    if monitor.has_diverged(later, float(model.opt.timestep)):
        return False
    nudge = measure_response(model, state, later, last.states)
    return not find_instability(judged, nudge) and not _falls(upright, later[-1])


def _time_to_forget(stability: Stability) -> float:
    """Returns for how long a nudge is looked at (s)."""
    slowest = stability.least_damped
    constant = 0.0 if slowest is None else slowest.time_constant
    return min(max(_FORGOTTEN * constant, _BRIEF), NUDGED * LASTING)


def _settled(held: Standing, upright: monitor.Upright) -> _Span | None:
    """Simulates a stand until it is at rest; returns its last second, None if it comes to none."""
    model, state = held.drive.model, held.start
    timestep = float(model.opt.timestep)
    ctrl = np.tile(held.ctrl, (max(2, round(_LOOK / timestep)), 1))
    data, spans, second = mujoco.MjData(model), deque[_Span](maxlen=round(LAST / _LOOK)), None
    for _ in range(round((1 - NUDGED) * LASTING / _LOOK)):
        states = simulate(model, state, ctrl)
        state = states[-1]
        if monitor.has_diverged(states, timestep):
            return None
        spans.append(_looked_at(held, data, states))
        if spans[-1].slip > _LOST * STAYED or _falls(upright, state, _LOST * UPRIGHT):
            return None
        if len(spans) == spans.maxlen:
            second = _Span.of(spans)
            if second.rests(held, _SURE):
                return second
    return second if second is not None and second.rests(held) else None


def _looked_at(held: Standing, data: mujoco.MjData, states: Array) -> _Span:
    robot, stand, model = held.robot, held.stand, held.drive.model
    evaluations, seen = states[:: -max(1, round(_SAMPLE_TIME / model.opt.timestep))], []
    for state in evaluations:
        mujoco.mj_setState(model, data, state, STATE)
        mujoco.mj_kinematics(model, data)
        centres = monitor.foot_centres(robot, data)
        seen.append([centres[foot] for foot in stand.stance_feet])
    targets = np.array([stand.foot_targets[foot] for foot in stand.stance_feet])
    return _Span(states, targets - np.mean(seen, axis=0))


def _falls(upright: monitor.Upright, state: Array, most: float = UPRIGHT) -> bool:
    turned = monitor.turned_by(upright.robot, upright.rotation, state)
    return turned > most or upright.has_collapsed(state)
