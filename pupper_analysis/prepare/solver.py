"""MuJoCo's constraint solver, where a model is more than it solves as it is set."""

from __future__ import annotations

import mujoco

from pupper_analysis.robot.build import rebuilt
from pupper_analysis.robot.exactness import INEXACT, left_out
from pupper_analysis.robot.robot import Robot

_INTO_GROUND = 1e-3  # m: where feet that just touch push


def inexact(robot: Robot) -> float | None:
    """Returns what the solver leaves out, in parts of the weight, if it is too much."""
    model, base = robot.mj_model, robot.mj_model.body(robot.mj_base).id
    data = mujoco.MjData(model)
    qpos = robot.home.copy()
    qpos[2] -= _INTO_GROUND
    robot.mj_convention.set_state(data, qpos)
    share = left_out(model, data, base)
    return share if share > INEXACT else None


def solvable(robot: Robot, notes: list[str]) -> Robot:
    """Gives a robot dense matrices if MuJoCo's solver is exact with these alone.

    Args:
        robot: The robot, with a free base.
        notes: To say so in, or that nothing helps.
    """
    share = inexact(robot)
    if share is None:
        return robot
    said = (
        f"MuJoCo's solver, as the MJCF sets it, leaves forces of {100 * share:.2g} % of the weight "
        "out of the equation of motion"
    )
    if mujoco.mj_isSparse(robot.mj_model):
        spec = robot.description.mjcf.copy()
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        dense = rebuilt(robot, mjcf=spec)
        if inexact(dense) is None:
            notes.append(f'{said}: jacobian="dense", with which it does not, was taken')
            return dense
    notes.append(
        f"{said}: how the robot moves is not to be trusted; give <option> more iterations and "
        "ls_iterations, or another solver"
    )
    return robot
