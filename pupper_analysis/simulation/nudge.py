"""Does a stand come to rest again when it is nudged?"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.results import Result
from pupper_analysis.models.mjcf import scalar_joints
from pupper_analysis.robot.fall import NUDGE, nudge_velocity
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.rollout import simulate

Array = NDArray[np.float64]

LEFT = 1e-2
"""A joint that is further from where it was before the nudge has left it (rad, m)."""

_DECAYING = 0.9
"""Motion in the last third of the time is at most this part of that in the second third: what
swings on, or in a cycle of its own, is as fast in both."""

_GONE = 1e-2
"""Part of the nudge below which motion is what contacts and the solver make: it has decayed."""


@dataclass(frozen=True, eq=False)
class Nudge(Result):
    """What became of a nudge.

    Attributes:
        speed: Of the nudge (m/s, rad/s), in each coordinate up to this.
        time: When it was given (s).
        duration: What was simulated of it (s).
        motion: Greatest speed in the second third of that time, by creep apart (m/s, rad/s).
        left: The same in the last third.
        moved: The greatest way of a joint from where it was before, in the last third, beyond what
            it had crept already (rad, m).
        farthest: The same at any time after the nudge: what comes back has left all the same.
        farthest_joint: Which joint that is; "" if it has no name.
        farthest_time: When, after the nudge (s).
        decayed: Whether the motion ``left`` is less, or nothing to speak of.
    """

    speed: float
    time: float
    duration: float
    motion: float
    left: float
    moved: float
    farthest: float
    farthest_joint: str
    farthest_time: float
    decayed: bool

    @property
    def stays(self) -> bool:
        """Whether no joint ever left where it was."""
        return self.farthest < LEFT


def simulate_nudge(model: mujoco.MjModel, state: Array, ctrl: Array, duration: float) -> Array:
    """Simulates what becomes of a state when everything is nudged, base and joints.

    Args:
        model: The model.
        state: The state (mjSTATE_FULLPHYSICS) at rest.
        ctrl: (nu,) what is commanded.
        duration: s.

    Returns:
        (n, size) the states after each step.
    """
    start, first = state.copy(), 1 + model.nq
    start[first : first + model.nv] += nudge_velocity(model)
    steps = max(3, round(duration / model.opt.timestep))
    return simulate(model, start, np.tile(ctrl, (steps, 1)))


@np.errstate(invalid="ignore", over="ignore")  # of what has diverged: it has not decayed
def measure_response(
    model: mujoco.MjModel, before: Array, states: Array, creep: Array | None = None
) -> Nudge:
    """Measures what became of a nudge.

    Feet creep on MuJoCo's friction, at a speed that hardly changes: only what differs from a
    straight line in time is motion.

    Args:
        model: The model.
        before: (size,) the state before it.
        states: (n, size) those after it.
        creep: (n, size) states before it, over which feet creep: what goes on at most so fast is
            not the nudge's.
    """
    third, timestep = len(states) // 3, float(model.opt.timestep)
    windows = states[third : 2 * third], states[-third:]
    motion, left = (_swinging(rows[:, 1 + model.nq : 1 + model.nq + model.nv]) for rows in windows)
    whole = not monitor.has_diverged(states, timestep)
    joints = scalar_joints(model)
    hinges = model.jnt_qposadr[joints]
    distances = np.abs(states[:, 1 + hinges] - before[1 + hinges])
    if creep is not None:
        rates = np.abs(creep[-1] - creep[0])[1 + hinges] / (creep[-1, 0] - creep[0, 0])
        distances = np.maximum(distances - np.outer(states[:, 0] - before[0], rates), 0.0)
    when, joint = (
        np.unravel_index(np.argmax(distances), distances.shape) if distances.size else (0, None)
    )
    gone = left <= max(_DECAYING * motion, _GONE * NUDGE)
    return Nudge(
        speed=NUDGE,
        time=float(before[0]),
        duration=len(states) * timestep,
        motion=motion,
        left=left,
        moved=float(distances[-third:].max(initial=0.0)),
        farthest=float(distances.max(initial=0.0)),
        farthest_joint="" if joint is None else model.joint(joints[joint]).name,
        farthest_time=timestep * (int(when) + 1),
        decayed=bool(whole and gone),
    )


def _swinging(rates: Array) -> float:
    """Returns the greatest deviation of rates (n, nv) from straight lines in time."""
    time = np.linspace(-1.0, 1.0, len(rates))
    rates_found = (time @ rates) / (time @ time)
    return float(np.abs(rates - rates.mean(axis=0) - np.outer(time, rates_found)).max(initial=0.0))
