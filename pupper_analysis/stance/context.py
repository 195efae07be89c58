"""What searches for stands of one robot use again and again: PlaCo's robot, tasks and shapes."""

from __future__ import annotations

from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.clearance import ClearanceShapes
from pupper_analysis.stance.solver import Solver


class Context:
    """A robot that is asked for stands; it belongs to one search at a time, which has it lent.

    Args:
        robot: The robot.

    Attributes:
        robot: The robot.
        shapes: Its shapes, and where com and feet are.
        solver: PlaCo's robot and tasks.

    Raises:
        ModelError: If a body of the robot has no mass or inertia that can be.
    """

    def __init__(self, robot: Robot) -> None:
        robot.check_bodies()
        self.robot, self.shapes = robot, ClearanceShapes(robot)
        self.solver = Solver(self.shapes)
