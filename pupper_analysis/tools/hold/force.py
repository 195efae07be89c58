"""The forces at the tool that the motors of a posture withstand: a polytope."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.results import Tabular
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool
from pupper_analysis.stance.posture import Posture

Array = NDArray[np.float64]

_AROUND = 72
"""Directions in a section: every 5 degrees."""

_IDLE = 1e-9
"""m: a force on a shorter lever turns no joint."""


@dataclass(frozen=True, eq=False)
class ToolForce(Tabular):
    """How hard a tool can be pushed, each way, before a motor gives in.

    With l what the motors hold in the posture, and J the tool's Jacobian, a force f from outside
    leaves l - J^T f to the motors: the forces that they withstand, |l - J^T f| <= limits, are a
    polytope. Along a unit vector d its edge is where the first motor is at its limit. Where gravity
    alone is beyond a motor's limit nothing is withstood: all is 0, by that motor.

    Attributes:
        directions: (6, 3) of the force: along +x, -x, +y, -y, +z, -z of the world.
        forces: (6,) the greatest (N); infinite if no motor bears it, not a number if a motor that
            bears it has an unknown limit.
        joints: (6,) whose motor then is at its limit; "" if none is.
        weakest: The least force of all directions that is not withstood (N); not a number if a
            motor that bears a force has an unknown limit.
        weakest_direction: (3,) a unit vector; zero if every force is withstood, or none.
        weakest_joint: Whose motor gives in.
        angles: (n,) about the sections' normals, from their first axis to their second (rad).
        horizontal: (n,) the greatest forces in the section of x and y (N).
        sagittal: (n,) in that of x and z.
        frontal: (n,) in that of y and z.
    """

    directions: Array = field(metadata={"unit": "1"})
    forces: Array = field(metadata={"unit": "N"})
    joints: tuple[str, ...]
    weakest: float = field(metadata={"unit": "N"})
    weakest_direction: Array = field(metadata={"unit": "1"})
    weakest_joint: str
    angles: Array = field(metadata={"unit": "rad"})
    horizontal: Array = field(metadata={"unit": "N"})
    sagittal: Array = field(metadata={"unit": "N"})
    frontal: Array = field(metadata={"unit": "N"})

    def _columns(self) -> dict[str, object]:  # type: ignore[override]  # one is a list of tuples
        return {
            "direction": [tuple(one) for one in self.directions.tolist()],
            "force": self.forces,
            "joint": self.joints,
        }


@check_arguments
def tool_force(robot: Robot, posture: Posture, tool: Tool) -> ToolForce:
    """Compute the largest external forces on a tool that the motors withstand in a posture.

    The forces are computed along the axes of the world frame, over three sections, and in the
    weakest direction. Each is added to the load of gravity.

    Args:
        robot: Robot with a fixed base.
        posture: Posture.
        tool: Point on which the force acts.
    """
    rows, room = force_polytope(robot, posture, tool)
    directions = np.concatenate([np.stack([axis, -axis]) for axis in np.eye(3)])
    forces, numbers = force_limits_along(rows, room, directions)
    angles = 2 * np.pi * np.arange(_AROUND) / _AROUND
    round_about = np.column_stack([np.cos(angles), np.sin(angles)])
    sections = [
        force_limits_along(rows, room, round_about @ np.eye(3)[list(axes)])[0]
        for axes in ((0, 1), (0, 2), (1, 2))
    ]
    weakest, way, joint = _weakest(rows, room)
    return ToolForce(
        directions=directions,
        forces=forces,
        joints=tuple(robot.joint_names[number] if number >= 0 else "" for number in numbers),
        weakest=weakest,
        weakest_direction=way,
        weakest_joint=robot.joint_names[joint] if joint >= 0 else "",
        angles=angles,
        horizontal=sections[0],
        sagittal=sections[1],
        frontal=sections[2],
    )


def force_limits_along(
    rows: Array, room: Array, directions: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Compute the largest forces in a polytope rows f <= room along given directions.

    Args:
        rows: Normals of the faces, shape (2 nu, 3), from `force_polytope`.
        room: Right-hand side, shape (2 nu,) [N m], from `force_polytope`.
        directions: Unit vectors, shape (n, 3), in the world frame.

    Returns:
        Forces, shape (n,) [N]: infinite if no motor bears the force, NaN if a motor that bears it
        has an unknown limit, 0 if a motor is overloaded without the force; and the index of the
        motor at its limit, shape (n,), -1 for infinity and NaN.
    """
    along = directions @ rows.T
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.where(along > _IDLE, room / along, np.inf)
    if room.min() < 0:  # a force that would relieve that motor is none that is withstood from rest
        ends[:, room < 0] = 0.0
    nearest = ends.argmin(axis=1)
    forces = ends[np.arange(len(ends)), nearest]
    forces[(np.abs(along[:, np.isinf(room)]) > _IDLE).any(axis=1)] = np.nan  # an unknown limit
    return forces, np.where(np.isfinite(forces), nearest % (len(rows) // 2), -1)


def force_polytope(robot: Robot, posture: Posture, tool: Tool) -> tuple[Array, Array]:
    """Return the polytope of external forces f on a tool that the motors withstand at rest.

    With the load l of the motors and the Jacobian J of the tool, |l - J^T f| <= limits is written
    as rows f <= room.

    Args:
        robot: Robot with a fixed base.
        posture: Posture.
        tool: Point on which the force acts.

    Returns:
        rows, shape (2 nu, 3) [m], and room, shape (2 nu,) [N m], for f in world axes [N]; the lower
        limits of all motors, then the upper limits.
    """
    config, limits = Configuration(robot, posture.qpos), robot.effort_limits
    load = config.by_motors(config.load())
    rows = config.by_motors(tool.jacobian(config).T)
    room = np.concatenate([limits + load, limits - load])
    return np.concatenate([rows, -rows]), room


def _weakest(rows: Array, room: Array) -> tuple[float, Array, int]:
    """Returns the distance of the nearest face of a polytope, the way to it, and which it is."""
    if room.min() < 0:
        return 0.0, np.zeros(3), int(room.argmin()) % (len(rows) // 2)
    lengths = np.linalg.norm(rows, axis=1)
    if (lengths[np.isinf(room)] > _IDLE).any():  # an unknown limit
        return float("nan"), np.zeros(3), -1
    distances = np.where(lengths > _IDLE, room / np.maximum(lengths, _IDLE), np.inf)
    nearest = int(distances.argmin())
    if not np.isfinite(distances[nearest]):
        return float("inf"), np.zeros(3), -1
    way = rows[nearest] / lengths[nearest]
    return float(distances[nearest]), way, nearest % (len(rows) // 2)
