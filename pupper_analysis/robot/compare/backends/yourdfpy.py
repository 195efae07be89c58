"""yourdfpy's evaluation of a robot's URDF: its kinematics."""

from __future__ import annotations

import io

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.models.xml import parse_text, to_text
from pupper_analysis.robot.compare.backends.quantities import Evaluation, state_quantities
from pupper_analysis.robot.compare.states import States
from pupper_analysis.robot.robot import Robot


def yourdfpy_evaluation(robot: Robot, states: States) -> Evaluation:
    """Returns the feet's positions by yourdfpy's forward kinematics of the URDF."""
    import yourdfpy  # slow to import

    file = io.BytesIO(_with_unit_axes(robot.description.urdf))
    urdf = yourdfpy.URDF.load(file, build_scene_graph=True, load_meshes=False)
    order = [robot.joint_names.index(name) for name in urdf.actuated_joint_names]
    rows = []
    for qpos in states.qpos:
        urdf.update_cfg(qpos[robot.nq - robot.nu :][order])
        base = _base(robot, qpos)
        origin, rotation = base.translation, base.rotation
        rows.append(
            np.array(
                [
                    origin + rotation @ urdf.get_transform(frame, robot.base)[:3, 3]
                    for frame in robot.contact_frames.values()
                ]
            )
        )
    return state_quantities(robot, {"foot positions": rows})


def _with_unit_axes(text: str) -> bytes:
    """Returns a URDF whose axes are of length 1.

    The engines take an axis for a direction; yourdfpy moves a slide by its length times q.
    """
    root = parse_text(text)
    for axis in root.iter("axis"):
        direction = np.array([float(word) for word in str(axis.get("xyz", "1 0 0")).split()])
        unit = direction / np.linalg.norm(direction)
        axis.set("xyz", " ".join(map(repr, unit.tolist())))
    return to_text(root).encode()


def _base(robot: Robot, qpos: NDArray[np.float64]) -> pin.SE3:
    """Returns where the base's frame is in the world, which takes no kinematics."""
    model = robot.pin_model
    frame = model.frames[model.getFrameId(robot.base, pin.FrameType.BODY)]
    if not robot.floating:
        return frame.placement
    return pin.SE3(rotation_from_quaternion(qpos[3:7]), qpos[:3]) * frame.placement
