"""What must not be exceeded along a path: torques, speeds, friction, loads that feet keep."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.path.effort import Effort, load_to_pass, path_effort
from pupper_analysis.stance.path.geometry import PathPlace
from pupper_analysis.stance.path.pyramid import is_pyramid
from pupper_analysis.statics.cone_program import ForceBounds

Array = NDArray[np.float64]


ROUND = math.sqrt(0.5)
"""Of the friction coefficient, where MuJoCo's cone is a pyramid: that of the round cone inside it,
which a force may use in any direction. (|f_x| + |f_y| <= mu f_n is the pyramid.)"""


class PathLimit(StrEnum):
    """What can bind the speed of a path."""

    TORQUE = "motor torque"
    VELOCITY = "motor velocity"
    FRICTION = "friction"
    LIFTING = "a foot that lifts"
    PASSING = "a foot that gives its load away, or takes it"
    JERK = "the acceleration's rise"


class PathLimits:
    """What a robot must not exceed along a path, a reserve left.

    Args:
        robot: The robot.
        reserve: Share that is left of each limit, and of a foot's load at rest.

    Attributes:
        robot: The robot.
        reserve: See there.
        weight: N.
        friction: {foot: coefficient}.
        torques: (nu,) N m; infinite for a motor without a limit.
        velocities: (nu,) rad/s.
    """

    def __init__(self, robot: Robot, reserve: float) -> None:
        self.robot, self.reserve = robot, reserve
        self.weight = robot.total_mass * float(np.linalg.norm(robot.gravity))
        share = 1.0 - reserve
        self.friction = {
            foot: share * (ROUND if is_pyramid(robot, foot) else 1.0) * contact.sliding_friction
            for foot, contact in robot.contacts.items()
        }
        self.torques: Array = share * robot.effort_limits
        self.velocities: Array = share * robot.velocity_limits
        self._rest: dict[tuple[int, float], Effort] = {}

    def narrowed(self, share: float) -> PathLimits:
        """Returns limits of which this share is left, too."""
        other = PathLimits(self.robot, self.reserve + (1.0 - self.reserve) * share)
        other._rest = self._rest
        return other

    def at_rest(self, place: PathPlace) -> Effort:
        """Returns what a sample takes at rest, its friction and the loads of feet apart."""
        key = (place.number, place.progress)
        if key not in self._rest:
            feet = place.stand.stance_feet
            most = np.array([load_to_pass(self.robot, place, foot) for foot in feet])
            free = ForceBounds(np.full(len(feet), -np.inf), most, np.full(self.robot.nu, np.inf))
            self._rest[key] = path_effort(self.robot, place, 0.0, 0.0, bounds=free)
        return self._rest[key]

    def check_rest(self, place: PathPlace) -> None:
        """Checks that a sample can be held at rest.

        Raises:
            StaticsInfeasibleError: If it cannot.
        """
        rest, bounds = self.at_rest(place), self.bounds(place, place.stand.stance_feet)
        sliding = max(rest.friction.values(), default=0.0) > 1.0 - self.reserve
        if sliding or (np.abs(rest.torques) > bounds.torques).any():
            path_effort(self.robot, place, 0.0, 0.0, friction=self.friction, bounds=bounds)

    def bounds(self, place: PathPlace, feet: Sequence[str]) -> ForceBounds:
        """Returns the bounds on forces and torques at a sample, in the feet's order.

        Each foot keeps a share of its load at rest.
        """
        rest = self.at_rest(place)
        least, most = [], []
        for foot in feet:
            force = rest.forces.get(foot)
            load = 0.0 if force is None else float(force @ place.stand.normals[foot])
            most.append(load_to_pass(self.robot, place, foot))
            least.append(min(self.reserve * load, most[-1]))
        return ForceBounds(np.array(least), np.array(most), self.torques)
