"""Closed loops and couplings of an MJCF, which push joints in a simulation, in words."""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand


def closed_loops(robot: Robot, stand: Stand, least: float) -> str | None:
    """Says what equality constraints do in a stand, if it is more than a force (N or N m)."""
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
    return (
        f"the MJCF closes loops or couples joints: {kind} {name} and others push by up to "
        f"{abs(pushed[most]):.3g} N or N m, at joint {joint!r}; the URDF is a tree, and the "
        "prediction is without them"
    )
