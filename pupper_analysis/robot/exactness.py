"""Whether MuJoCo solves a model: accelerations that obey its equation of motion.

With sparse matrices, which MuJoCo takes from 60 degrees of freedom on, its Newton solver may end
where M qacc is not what acts: rods of 3e-9 kg m^2, welded firmly, in ToddlerBot's knees are enough,
and the robot, whose constraint forces are right, hangs in the air and cannot be pushed. With dense
matrices, and with the other solvers, the same model moves as it should.
"""

from __future__ import annotations

import mujoco
import numpy as np

INEXACT = 0.01
"""Of a robot's weight: what is left out of its equation of motion is to be below what simulations
are compared to."""

_PUSH = 0.1
"""Of the weight: at rest constraints balance what acts, and nothing shows."""

_SOLVES = 20
"""Solvers of few iterations begin where they ended before, as they do from step to step."""

_EARTH = 9.81  # m/s^2: what weighs nothing is pushed with a tenth of its weight there


def left_out(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> float:
    """Returns how much of the weight is missing in M qacc = f when a free base is pushed.

    Args:
        model: The model.
        data: Its state; the base is pushed, and what follows of it computed.
        base: The body with the free joint.

    Returns:
        The largest of the base's three forces that is left out, in parts of the robot's weight.
    """
    gravity = float(np.linalg.norm(model.opt.gravity)) or _EARTH
    weight = float(model.body_subtreemass[base]) * gravity
    first = int(model.body_dofadr[base])
    data.xfrc_applied[base, :3] = _PUSH * weight
    for _ in range(_SOLVES):
        mujoco.mj_forward(model, data)
    data.xfrc_applied[base] = 0.0
    moved = np.zeros(model.nv)
    mujoco.mj_mulM(model, data, moved, data.qacc)
    missing = (moved - data.qfrc_smooth - data.qfrc_constraint)[first : first + 3]
    return float(np.abs(missing).max()) / weight
