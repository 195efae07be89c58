"""What searches for stands of one robot use again and again: PlaCo's robot, tasks and shapes."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import placo
from numpy.typing import NDArray

from pupper_analysis.robot.lent import lend
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.clearance import ClearanceShapes
from pupper_analysis.stance.wrappers import Wrapper

if TYPE_CHECKING:
    from pupper_analysis.stance.tasks import Tasks

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Begun:
    """Where a search has begun last: with the base at the origin.

    Attributes:
        joints: (nu,) the joint positions that were asked for (rad); a list is compared in no time.
        limits: The goal's limits, lower and upper.
        turn: Its turn of the base.
        by_base: Whether it puts the base in its place, and not the com.
        q: PlaCo's.
        over: x and y of what shall be over a place (m).
    """

    joints: list[float]
    limits: tuple[Array, Array]
    turn: tuple[float, float, float, float]
    by_base: bool
    q: Array
    over: tuple[float, float]


class Context:
    """A robot that is asked for stands; it belongs to one search at a time.

    Args:
        robot: The robot.

    Attributes:
        robot: The robot.
        shapes: Its shapes, and where com and feet are.
        engine: PlaCo's robot, lent.
        tasks: PlaCo's tasks, {whether the base is put in its place: they}; they are aimed anew.
        begun: Where the last search began.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.shapes, self.engine = robot, ClearanceShapes(robot), Wrapper(robot)
        self.tasks: dict[bool, Tasks] = {}
        self.begun: Begun | None = None

    @property
    def wrapper(self) -> placo.RobotWrapper:
        """PlaCo's robot: for as long as this object is held."""
        return self.engine.placo


def context_of(robot: Robot) -> AbstractContextManager[Context]:
    """Lends a robot's context to one search, or to many one after the other."""
    return lend(robot, Context)
