"""MuJoCo's constraint solver, where a model is more than it solves as it is set."""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.units import EARTH
from pupper_analysis.models.additions import Options
from pupper_analysis.robot.build import equipped_robot
from pupper_analysis.robot.robot import Robot

INEXACT = 0.01
"""Of a robot's weight: what is left out of its equation of motion is to be below what simulations
are compared to."""

_PUSH = 0.1
"""Of the weight: at rest constraints balance what acts, and nothing shows."""

_SOLVES = 20
"""Solvers of few iterations begin where they ended before, as they do from step to step."""


def left_out(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> float:
    """Returns how much of the weight is missing in M qacc = f when a free base is pushed.

    Args:
        model: The model.
        data: Its state; the base is pushed, and what follows of it computed.
        base: The body with the free joint.

    Returns:
        The largest of the base's three forces that is left out, in parts of the robot's weight.
    """
    # What weighs nothing is pushed with a tenth of its weight on Earth.
    gravity = float(np.linalg.norm(model.opt.gravity)) or EARTH
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


_INTO_GROUND = 1e-3  # m: where feet that just touch push


def solver_error(robot: Robot) -> float | None:
    """Returns what the solver leaves out, in parts of the weight, if it is too much."""
    model, base = robot.mj_model, robot.mj_model.body(robot.mj_base).id
    data = mujoco.MjData(model)
    qpos = robot.home.copy()
    qpos[2] -= _INTO_GROUND
    robot.mj_convention.set_state(data, qpos)
    share = left_out(model, data, base)
    return share if share > INEXACT else None


def choose_exact_solver(robot: Robot) -> tuple[Robot, list[Diagnostic]]:
    """Gives a robot dense matrices if MuJoCo's solver is exact with these alone.

    Args:
        robot: The robot, with a free base.

    Returns:
        The robot, and that it was done, or that nothing helps.
    """
    part = solver_error(robot)
    if part is None:
        return robot, []
    share = Quantity(part, "1")
    if mujoco.mj_isSparse(robot.mj_model):
        message = diagnose("solver-made-dense", share=share)
        dense = equipped_robot(robot, Options(message, {"jacobian": "dense"}))
        if solver_error(dense) is None:
            return dense, [message]
    return robot, [diagnose("solver-inexact", share=share)]
