"""Compute the external forces on a tool that the motors withstand in a posture.

The motors withstand an external force f on the tool if ``|l - J^T f| <= limits``. l is the static
load, J the Jacobian of the tool, shape (3, nu), and ``limits`` are the effort limits. If the robot
has loops or couplings, l and J^T f are the loads that these transfer to the motors. These forces
form a convex polytope (`statics.polytope`), which may be unbounded. `tool_force` returns the extent
along the world axes, in three plane sections, and in the weakest direction.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.results import Tabular
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool
from pupper_analysis.stance.posture import Posture
from pupper_analysis.statics.polytope import (
    MIN_LEVER_ARM,
    force_inequalities,
    force_limits_along,
)

_NUM_SECTION_DIRECTIONS = 72
"""Number of directions in a section of the polytope, every 5 degrees. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class ToolForce(Tabular):
    """Largest external forces on a tool that the motors withstand in a posture.

    The motors withstand a force if ``|l - J^T f| <= limits`` (see the module). If the static load
    alone exceeds the limit of a motor, all forces are 0, even in directions that would relieve that
    motor. A force is NaN instead if a motor that bears the force has an unknown limit.

    Attributes:
        directions: (6, 3) directions +x, -x, +y, -y, +z, -z of the force, in world axes.
        forces: (6,) largest force in each direction (N); NaN if a motor that bears the force has an
            unknown limit. Otherwise 0 if the static load alone exceeds a limit, and infinite if no
            motor bears the force.
        joints: (6,) joint of the first motor that reaches the effort limit; "" if the force is
            infinite or NaN.
        weakest: Smallest force, over all directions, that brings a motor to its effort limit (N).
            Infinite if no motor bears forces. NaN if a motor that bears forces has an unknown
            limit, except if the static load alone exceeds another limit.
        weakest_direction: (3,) direction of the smallest force, a unit vector in world axes; zero
            if this force is infinite or NaN, or if the static load alone exceeds a limit.
        weakest_joint: Joint of the motor at the effort limit under the smallest force; "" if this
            force is infinite or NaN.
        angles: (n,) angles of the directions in the sections, from the first axis of a section
            towards the second axis (rad).
        horizontal: (n,) largest forces in the x-y section (N); infinite or NaN as for ``forces``.
        sagittal: (n,) largest forces in the x-z section (N).
        frontal: (n,) largest forces in the y-z section (N).
    """

    _units_of_columns: ClassVar[dict[str, str]] = {"direction": "1", "force": "N"}

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

    def _columns(self) -> dict[str, object]:  # type: ignore[override]  # directions are tuples
        """Return {column: values} of a table with a row per direction.

        The columns are direction (x, y, z) in world axes, force [N] and joint.
        """
        return {
            "direction": [tuple(direction) for direction in self.directions.tolist()],
            "force": self.forces,
            "joint": self.joints,
        }


@check_arguments
def tool_force(robot: Robot, posture: Posture, tool: Tool) -> ToolForce:
    """Compute the largest external forces [N] on a tool that the motors withstand in a posture.

    The directions are, in world axes: +-x, +-y, +-z; all directions in the x-y, x-z and y-z planes
    (every 5 degrees); and the weakest direction, in which the smallest force brings a motor to its
    limit.

    Args:
        robot: Robot with a fixed base.
        posture: Posture of the robot.
        tool: Point of application of the force.

    Raises:
        ConfigurationError: If a closed loop is singular in the posture.
    """
    rows, margins = force_inequalities(Configuration(robot, posture.qpos), tool)
    directions = np.concatenate([np.stack([axis, -axis]) for axis in np.eye(3)])
    forces, limiting = force_limits_along(rows, margins, directions)
    angles = 2 * np.pi * np.arange(_NUM_SECTION_DIRECTIONS) / _NUM_SECTION_DIRECTIONS
    plane_directions = np.column_stack([np.cos(angles), np.sin(angles)])
    sections = [
        force_limits_along(rows, margins, plane_directions @ np.eye(3)[list(axes)])[0]
        for axes in ((0, 1), (0, 2), (1, 2))
    ]
    weakest, direction, joint = _find_weakest_direction(rows, margins)
    return ToolForce(
        directions=directions,
        forces=forces,
        joints=tuple(robot.joint_names[index] if index >= 0 else "" for index in limiting),
        weakest=weakest,
        weakest_direction=direction,
        weakest_joint=robot.joint_names[joint] if joint >= 0 else "",
        angles=angles,
        horizontal=sections[0],
        sagittal=sections[1],
        frontal=sections[2],
    )


def _find_weakest_direction(rows: Array, margins: Array) -> tuple[float, Array, int]:
    """Find the smallest force on a tool with which a motor reaches its effort limit.

    The motors withstand a force f [N] if ``rows @ f <= margins``, which is a polytope. The smallest
    force that reaches a limit is the shortest vector from zero to a face of the polytope.

    Args:
        rows: Rows of `force_inequalities`, shape (2 nu, 3) [m, or 1 for a slide].
        margins: Slack of `force_inequalities`, shape (2 nu,) [N m, or N for a slide].

    Returns:
        Magnitude of the force [N], NaN if unknown, infinite without a limit; its direction in world
        axes, shape (3,), or zeros; index of the joint of the motor, or -1.
    """
    if margins.min() < 0:
        return 0.0, np.zeros(3), int(margins.argmin()) % (len(rows) // 2)
    lengths = np.linalg.norm(rows, axis=1)
    if (lengths[np.isinf(margins)] > MIN_LEVER_ARM).any():  # a limit is unknown
        return float("nan"), np.zeros(3), -1
    distances = np.where(
        lengths > MIN_LEVER_ARM, margins / np.maximum(lengths, MIN_LEVER_ARM), np.inf
    )
    nearest = int(distances.argmin())
    if not np.isfinite(distances[nearest]):
        return float("inf"), np.zeros(3), -1
    normal = rows[nearest] / lengths[nearest]
    return float(distances[nearest]), normal, nearest % (len(rows) // 2)
