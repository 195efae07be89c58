"""MuJoCo's constraint solver, where a model is more than it solves as it is set."""

from __future__ import annotations

import mujoco

from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.exactness import INEXACT, left_out
from pupper_analysis.robot.robot import Robot

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
        spec = robot.description.mjcf.copy()
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        dense = rebuild_robot(robot, mjcf=spec)
        if solver_error(dense) is None:
            return dense, [diagnose("solver-made-dense", share=share)]
    return robot, [diagnose("solver-inexact", share=share)]
