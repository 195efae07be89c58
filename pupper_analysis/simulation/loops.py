"""Closed loops and couplings of an MJCF: what they do that is not as predicted."""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.soft_ground import open_loops
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation

_OPEN = 1e-5  # m or rad: what gives way by less is not why something is off


def give_way(robot: Robot, stand: Stand, prediction: GravityCompensation) -> Diagnostic | None:
    """Says by how much loops and couplings open under a load, if a stand has them closed."""
    if robot.closure is None:
        return None
    most = float(np.abs(open_loops(robot, stand, prediction.contact_forces)).max(initial=0.0))
    if robot.closure.open_by(stand.qpos) > most / 2 or most < _OPEN:
        return None
    return diagnose("loops-are-soft", bonds=robot.closure.bonds, most=most)


def closed_loops(robot: Robot, stand: Stand, least: float) -> Diagnostic | None:
    """Says what equality constraints do in a stand, if it is more than a force (N or N m).

    Those that are not predicted: what holds the robot in the world, say.
    """
    if robot.closure is not None:
        return None
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_forward(model, data)
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY.value
    forces = np.where(rows, data.efc_force, 0.0)
    pushed = np.zeros(model.nv)
    mujoco.mj_mulJacTVec(model, data, pushed, forces)
    most = int(np.argmax(np.abs(pushed)))
    if not abs(pushed[most]) > least:
        return None
    strongest = int(data.efc_id[int(np.argmax(np.abs(forces)))])
    kind = mujoco.mjtEq(int(model.eq_type[strongest])).name.removeprefix("mjEQ_").lower()
    name = model.equality(strongest).name or f"#{strongest}"
    joint = model.joint(int(model.dof_jntid[most])).name
    return diagnose(
        "constraints-not-predicted",
        subject=("equality", name),
        kind=kind,
        force=abs(pushed[most]),
        joint=joint,
    )
