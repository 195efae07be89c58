"""Find the tasks and joint limits that prevent a task of a posture from reaching its target.

The input is the configuration with the smallest residuals that a solver found. The output is a
`PostureConflict`. Let this configuration be a minimum of the weighted squared residuals. A step
that reduces the residual of the task then increases residuals of other tasks or moves joints beyond
their limits. In the third case, no step has a first-order effect. The gradients of the weighted
squared residuals, by central finite differences, show which tasks and limits oppose the task. This
follows from the Karush-Kuhn-Tucker conditions of the least-squares problem of `stance.whole_body`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.sag.equilibrium import integrate_step

_DIFFERENCE_STEP = 1e-5
"""Step of the finite differences [rad, m]. Chosen, not tuned: much smaller than the lengths of
links, about 0.1 m, over which squared residuals vary."""

_LIMIT_TOLERANCE = 1e-6
"""Distance from a joint limit [rad, m] below which a joint counts as being at the limit. Chosen,
not tuned."""

_MIN_SHARE = 0.01
"""Smallest effect of an opposing task or limit that is reported, relative to the gradient of the
failed task (formulas in `find_conflict`). Chosen, not tuned: rounding, and tasks that are nearly
satisfied, have smaller effects."""

_MIN_RATE = 1e-3
"""Smallest norm of the derivative of the failed task's residual by displacements of base or joints
(m and rad mixed) with which these displacements have an effect on the task. Smaller, for example,
for a stretched limb. Chosen, not tuned: the levers of joints usually exceed 1 cm."""


class PostureConflict(NamedTuple):
    """Reasons why a task of a posture misses its target.

    Attributes:
        tasks: Indices of the tasks whose residuals increase if the residual of the failed task
            decreases; empty if ``out_of_reach``.
        at_limit: {joint: limit [rad, m]} of all joints at a limit.
        blocking: {joint: limit [rad, m]} of the joints that would have to move beyond their limit;
            empty if ``out_of_reach``.
        out_of_reach: Whether no motion of joints or base reduces the residual to first order, even
            without the other tasks and the limits: for example a stretched limb.
    """

    tasks: tuple[int, ...]
    at_limit: dict[str, float]
    blocking: dict[str, float]
    out_of_reach: bool


def find_conflict(
    robot: Robot,
    qpos: Array,
    limits: tuple[Array, Array],
    residuals: Callable[[Array], Array],
    weights: Sequence[float],
    failed: int,
) -> PostureConflict:
    """Find the tasks and joint limits that prevent a task of a posture from reaching its target.

    The gradient of task i is g_i = w_i r_i dr_i/dv, with weight w_i, residual r_i and displacement
    v. A task i opposes the failed task f if -g_i g_f > `_MIN_SHARE` |g_f|^2, for displacements of
    the base or of the joints (separately, because the base has longer levers). A limit opposes the
    task f if the descent direction -dr_f/dv of a joint at the limit points beyond the limit, by
    more than `_MIN_SHARE` |dr_f/dv|.

    Args:
        robot: Robot.
        qpos: Configuration with the smallest residuals that was found, shape (nq,).
        limits: Lower and upper joint limits, shape (nu,) each [rad, m].
        residuals: Function that returns the residual of each task at a configuration, shape (n,)
            [m, rad].
        weights: Weights of the squared residuals of the n tasks; 0 for a task that may miss its
            target.
        failed: Index of the task that misses its target; weight and residual must be positive.
    """
    gradients = np.empty((len(weights), robot.nv))
    for column, step in enumerate(_DIFFERENCE_STEP * np.eye(robot.nv)):
        # Squares, because a residual has a kink at zero, and may be smaller than the step.
        more = residuals(integrate_step(qpos, step)) ** 2
        less = residuals(integrate_step(qpos, -step)) ** 2
        gradients[:, column] = np.asarray(weights) * (more - less) / (4 * _DIFFERENCE_STEP)
    own = gradients[failed]
    rates = own / (weights[failed] * residuals(qpos)[failed])
    rate = float(np.linalg.norm(rates))
    out_of_reach = rate < _MIN_RATE
    base, opposing = robot.nv - robot.nu, np.zeros(len(weights), dtype=bool)
    for part in (slice(0, base), slice(base, robot.nv)):
        if np.linalg.norm(rates[part]) >= _MIN_RATE:
            share = _MIN_SHARE * float(own[part] @ own[part])
            opposing |= -gradients[:, part] @ own[part] > share
    tasks = () if out_of_reach else tuple(np.flatnonzero(opposing).tolist())
    at_limit, blocking = dict[str, float](), dict[str, float]()
    descent = -rates[base:]
    positions = qpos[robot.nq - robot.nu :]
    for joint, (value, low, high) in enumerate(zip(positions, *limits, strict=True)):
        if min(value - low, high - value) < _LIMIT_TOLERANCE:
            name, is_low = robot.joint_names[joint], bool(value - low < high - value)
            at_limit[name] = float(low if is_low else high)
            outward = -descent[joint] if is_low else descent[joint]
            if outward > _MIN_SHARE * rate and not out_of_reach:
                blocking[name] = at_limit[name]
    return PostureConflict(tasks, at_limit, blocking, out_of_reach)
