"""What acts in MuJoCo at rest and a URDF cannot state: springs, gravity compensation."""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand


def passive_forces(robot: Robot, stand: Stand, least: float) -> str | None:
    """Says what springs and the like do at rest, if it is more than a force (N or N m)."""
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_forward(model, data)
    most = int(np.argmax(np.abs(data.qfrc_passive)))
    force = float(data.qfrc_passive[most])
    if not abs(force) > least:
        return None
    return (
        f"the MJCF has springs or gravity compensation, up to {force:+.3g} N or N m, at joint "
        f"{model.joint(int(model.dof_jntid[most])).name!r}: a URDF cannot state them, and the "
        "prediction is without"
    )
