"""yourdfpy's evaluation of a robot's URDF: its kinematics."""

from __future__ import annotations

import io

import numpy as np

from pupper_analysis.checks.backends.quantities import Evaluation, state_quantities
from pupper_analysis.checks.states import States
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot


def yourdfpy_evaluation(robot: Robot, states: States) -> Evaluation:
    """Returns the feet's positions by yourdfpy's forward kinematics of the URDF."""
    import yourdfpy  # slow to import

    urdf = yourdfpy.URDF.load(
        io.BytesIO(robot.description.urdf.encode()), build_scene_graph=True, load_meshes=False
    )
    order = [robot.joint_names.index(name) for name in urdf.actuated_joint_names]
    rows = []
    for qpos in states.qpos:
        urdf.update_cfg(qpos[robot.nq - robot.nu :][order])
        config = Configuration(robot, qpos)
        origin, rotation = config.frame_position(robot.base), config.base_rotation()
        rows.append(
            np.array(
                [
                    origin + rotation @ urdf.get_transform(frame, robot.base)[:3, 3]
                    for frame in robot.foot_frames.values()
                ]
            )
        )
    return state_quantities(robot, {"foot positions": rows})
