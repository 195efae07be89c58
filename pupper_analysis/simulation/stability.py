"""Whether servos are too stiff to be simulated, in words."""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servo_stability import servo_stability
from pupper_analysis.robot.servos import Servos
from pupper_analysis.stance.stand import Stand


def too_stiff(robot: Robot, stand: Stand, drive: Servos) -> list[str]:
    """Says whether the servos alone are too stiff for the time step, and which would do.

    Args:
        robot: The robot.
        stand: Where it stands.
        drive: Its servos.
    """
    model, data = drive.model, mujoco.MjData(drive.model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_forward(model, data)
    stiffness, damping = np.zeros(model.nv), np.zeros(model.nv)
    dofs = robot.mj_convention.qvel_index[robot.nv - robot.nu :]
    stiffness[dofs], damping[dofs] = drive.kp, drive.kd
    found = servo_stability(model, data, stiffness, damping, np.array(model.dof_damping))
    if found is None or found.ratio <= 1:
        return []
    worst = robot.joint_names[int(np.argmax(found.shares[dofs]))]
    other = "" if drive.implicit else ", or the integrator implicitfast"
    return [
        f"the servos are {found.ratio:.3g} times beyond the limit of stability "
        f"({drive.integrator}, {1e3 * model.opt.timestep:g} ms), most of all at {worst}: a time "
        f"step of {1e3 * found.timestep:.2g} ms is stable{other}, or less kp and kd"
    ]
