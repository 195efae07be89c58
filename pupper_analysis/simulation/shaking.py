"""Decide from the speeds of a simulated robot if the robot shakes (oscillates) without decay.

Slow motion of a robot, such as creep, is removed: a straight line in time is subtracted from each
velocity.
"""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.simulation.stability import measure_speed_deviations

RECORD_INTERVAL = 0.25
"""Length [s] of the intervals of simulated time of which a `ShakingRecord` contains the largest
speed. Chosen, not tuned: longer than the flight of a foot that bounces."""

SHAKING_SECONDS = 3
"""Number of successive windows of simulated time (by default 1 s each). A robot that shakes in all
these windows without a clear decrease of speed shakes without decay. Chosen, not tuned."""

MIN_SHAKING_SPEED = 1e-2
"""Upper bound of the speed [m/s, rad/s] of a robot that does not shake. Speeds are taken without
the linear trend within each `RECORD_INTERVAL`. Chosen as ten times ``fall.NUDGE_SPEED``, and twice
``stability.MAX_RESTING_SPEED``."""

_MIN_SHAKING_RATIO = 0.92
"""Lower bound [1] of the ratio (largest speed in a window) / (largest speed in the earlier windows)
of sustained shaking. The `SHAKING_SECONDS` last windows are compared. Derived from
`measure_response`: there a motion has decayed if the speeds in successive thirds have a ratio of at
most 0.9. A decay to 0.92 in 2 s gives the ratio 0.907 in a nudged simulation of 7 s."""

INTERVALS_PER_SECOND = round(1 / RECORD_INTERVAL)
"""Number of intervals of length `RECORD_INTERVAL` in a second [1]."""


class ShakingRecord:
    """Record of how fast a simulated robot shakes, to decide if the shaking decays.

    The record contains the largest speed in each interval of `RECORD_INTERVAL`. Slow motion such as
    creep is removed.

    Args:
        model: MuJoCo model that is simulated.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._velocities = slice(1 + model.nq, 1 + model.nq + model.nv)
        self._interval = max(2, round(RECORD_INTERVAL / float(model.opt.timestep)))
        self._speeds: list[float] = []
        self._dof = 0

    @np.errstate(invalid="ignore", over="ignore")  # diverged values: not sustained
    def add(self, states: Array) -> None:
        """Record the largest speed in each interval of further states, shape (n, size).

        The states (mjSTATE_FULLPHYSICS) follow after successive steps. Each call begins a new
        interval; an incomplete interval at the end is ignored.
        """
        for begin in range(0, len(states) - self._interval + 1, self._interval):
            rows = states[begin : begin + self._interval, self._velocities]
            speeds = measure_speed_deviations(rows)
            self._speeds.append(float(speeds.max(initial=0.0)))
            self._dof = int(speeds.argmax()) if len(speeds) else 0

    @property
    def fastest_dof(self) -> int:
        """Index in qvel of the degree of freedom with the largest speed in the last interval."""
        return self._dof

    @property
    def speed(self) -> float:
        """Largest speed of a coordinate in the last second [m/s, rad/s], without slow motion.

        0 if nothing is recorded.
        """
        return max(self._speeds[-INTERVALS_PER_SECOND:], default=0.0)

    @property
    def is_calm(self) -> bool:
        """Whether all speeds in the last recorded interval were at most `MIN_SHAKING_SPEED`.

        At least one interval must be recorded.
        """
        return self._speeds[-1] <= MIN_SHAKING_SPEED

    @property
    def is_shaking(self) -> bool:
        """Whether a speed above `MIN_SHAKING_SPEED` was recorded within the last second."""
        return self.speed > MIN_SHAKING_SPEED

    @property
    def is_sustained(self) -> bool:
        """Whether the robot shakes, and has hardly become slower in `SHAKING_SECONDS` seconds."""
        return self.is_sustained_over(1)

    def is_sustained_over(self, seconds: int) -> bool:
        """Return True if the robot shakes, and has hardly become slower over successive windows.

        The last `SHAKING_SECONDS` windows, each of ``seconds`` [s], are compared
        (`_MIN_SHAKING_RATIO`). The result is False if the record is too short.
        """
        count = SHAKING_SECONDS * seconds * INTERVALS_PER_SECOND
        if not self.is_shaking or len(self._speeds) < count:
            return False
        largest = np.max(np.reshape(self._speeds[-count:], (SHAKING_SECONDS, -1)), axis=1)
        earlier = np.maximum.accumulate(largest)[:-1]
        return bool((largest[1:] >= _MIN_SHAKING_RATIO * earlier).all())
