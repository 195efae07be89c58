"""What motors hold over the reach of a tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.results import Tabular
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool
from pupper_analysis.stance.posture import Posture, check_held
from pupper_analysis.tools.hold.ways import Ways

Array = NDArray[np.float64]

_POSTURES = 600
"""Random postures: a section of an arm's reach is seen in some hundred points."""


@dataclass(frozen=True, eq=False)
class ReachLoad(Tabular):
    """What motors hold in random postures, by where the tool is.

    Attributes:
        distances: (n,) of the tool from the vertical through the chain's first joint (m).
        heights: (n,) of the tool in the world (m).
        utilisation: (n,) of the motor that is nearest to its limit; 0 where none has one.
    """

    distances: Array
    heights: Array
    utilisation: Array

    def _columns(self) -> dict[str, ArrayLike]:
        return {
            "distance": self.distances,
            "height": self.heights,
            "utilisation": self.utilisation,
        }


@check_arguments
def reach_load(robot: Robot, posture: Posture, tool: Tool) -> ReachLoad:
    """Finds what motors hold over the reach of a tool, in random postures.

    Args:
        robot: A robot whose base is held.
        posture: One of its postures.
        tool: Its tool.

    Raises:
        ConfigurationError: If the base is free.
    """
    check_held(robot)
    found, limits = [], robot.effort_limits
    limited = np.isfinite(limits) & (limits > 0)
    for qpos in Ways(robot, posture).random(_POSTURES):
        config = Configuration(robot, qpos)
        place = tool.position(config)
        middle = config.joint_position(tool.chain[0]) if tool.chain else np.zeros(3)
        held = np.abs(config.by_motors(config.load()))
        most = float(np.max(held[limited] / limits[limited], initial=0.0))
        found.append((float(np.hypot(*(place - middle)[:2])), float(place[2]), most))
    distances, heights, utilisation = np.array(found).T
    return ReachLoad(distances, heights, utilisation)
