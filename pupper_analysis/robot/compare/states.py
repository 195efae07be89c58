"""Random states to compare models at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class States:
    """States and motor torques.

    Attributes:
        qpos: (n, nq).
        qvel: (n, nv).
        torques: (n, nu) (N m).
    """

    qpos: Array
    qvel: Array
    torques: Array


MOST = 100_000
"""Configurations that are compared: more find nothing, and fill the memory."""


def check_states(count: int, seed: int) -> None:
    """Checks what random states are asked for.

    Raises:
        ConfigurationError: If there are none or too many, or the seed is not a whole number from 0.
    """
    if count < 1:
        raise ConfigurationError("configurations", diagnose("less-than", value=count, least=1))
    if count > MOST:
        raise ConfigurationError("configurations", diagnose("more-than", value=count, most=MOST))
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ConfigurationError("seed", diagnose("no-whole-number", value=repr(seed)))


_LARGEST_ANGLE = 1e3
"""rad or m. Files state limits like 1e16 for none; such an angle has no digit after the point."""

_STRONG = 1e6
"""N m or N. Likewise."""


def random_states(robot: Robot, count: int, seed: int) -> States:
    """Draws states: joints inside their limits, the base anywhere, with velocities and torques."""
    rng = np.random.default_rng(seed)
    lower = np.where(np.isfinite(robot.lower_limits), robot.lower_limits, -np.pi)
    upper = np.where(np.isfinite(robot.upper_limits), robot.upper_limits, np.pi)
    # A file may have them the wrong way round; that is for the comparison to find.
    ends = np.clip(
        [np.minimum(lower, upper), np.maximum(lower, upper)], -_LARGEST_ANGLE, _LARGEST_ANGLE
    )
    qpos = rng.uniform(ends[0], ends[1], (count, robot.nu))
    if robot.floating:
        quaternion = rng.normal(size=(count, 4))
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        qpos = np.concatenate([rng.uniform(-1, 1, (count, 3)), quaternion, qpos], axis=1)
    efforts = np.where(np.isfinite(robot.effort_limits), robot.effort_limits, 1.0)
    efforts = np.clip(efforts, -_STRONG, _STRONG)
    return States(
        qpos=qpos,
        qvel=rng.normal(size=(count, robot.nv)),
        torques=rng.uniform(-np.abs(efforts), np.abs(efforts), (count, robot.nu)),
    )
