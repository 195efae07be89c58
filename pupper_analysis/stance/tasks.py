"""PlaCo's solver with a stand's tasks: what a programme is to satisfy, and how much it weighs."""

from __future__ import annotations

import math

import numpy as np
import placo
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import UP
from pupper_analysis.stance.clearance import Shapes
from pupper_analysis.stance.footholds import fixing
from pupper_analysis.stance.problem import Goal
from pupper_analysis.statics.support_polygon import support_polygon

Array = NDArray[np.float64]

TASK_TOLERANCE = 1e-9
"""Error up to which a task counts as satisfied (m, rad)."""

_TRIGGER = 0.02  # m: links that are further than this from their least distance are left alone

_APART_WEIGHT = 1e3  # of links staying apart, against feet

_INSIDE_WEIGHT = 1e3  # of the com staying inside the support polygon, likewise


class Tasks:
    """PlaCo's solver with a stand's tasks, which may be aimed at other goals of the same kind.

    Args:
        shapes: The robot with its shapes.
        goal: The goal.
        inside: As in ``Solver``.
        firmly: Likewise.
        apart: Likewise.

    Attributes:
        solver: PlaCo's.
        feet: (contact point, its task).
    """

    def __init__(
        self, shapes: Shapes, goal: Goal, *, inside: bool, firmly: bool = False, apart: bool
    ) -> None:
        robot, wrapper = shapes.robot, shapes.wrapper
        # Not the shapes, which keep their tasks: a circle would hold PlaCo's robot back for long.
        self._robot, self._engine, self._goal = robot, shapes.engine, goal
        solver = self.solver = placo.KinematicsSolver(wrapper)
        solver.enable_joint_limits(True)
        wrapper.set_velocity_limits(1.0)
        solver.enable_velocity_limits(True)
        self.feet: list[tuple[str, placo.PositionTask]] = []
        for points in robot.soles.values():
            pins = fixing([goal.targets[point] for point in points])
            for count, (number, axes) in zip((3, 2, 1), pins, strict=False):
                point = points[number]
                task = solver.add_position_task(robot.foot_frames[point], goal.targets[point])
                if count < 3:
                    task.mask.set_axises("xyz"[:count], "custom")
                    task.mask.R_custom_world = axes
                task.configure(point, "soft", 1.0)
                self.feet.append((point, task))
        self._orientation = solver.add_orientation_task(robot.base, goal.task.rotation())
        self._orientation.configure("orientation", "hard")
        self._height = solver.add_position_task(robot.base, goal.height * UP)
        self._height.mask.set_axises("z")
        self._height.configure("height", "hard")
        self._place = None
        if inside:
            corners = list(support_polygon(goal.contacts)[::-1])  # clockwise
            margin = goal.task.com_margin + (TASK_TOLERANCE if firmly else 0.0)  # by rounding
            polygon = solver.add_com_polygon_constraint(corners, margin)
            polygon.configure("inside", "hard" if firmly else "soft", _INSIDE_WEIGHT)
        else:
            where = np.array([*goal.place, 0.0])
            if goal.by_base:
                self._place = solver.add_position_task(robot.base, where)
            else:
                self._place = solver.add_com_task(where)
            self._place.mask.set_axises("xy")
            self._place.configure("place", "hard")
        if apart:
            least = goal.task.self_clearance or 0.0
            avoid = solver.add_avoid_self_collisions_constraint()
            avoid.self_collisions_margin = least
            avoid.self_collisions_trigger = least + _TRIGGER
            avoid.configure("apart", "soft", _APART_WEIGHT)
        self._loops = None
        if robot.closure is not None:
            nothing = np.zeros((0, robot.nq)), np.zeros(0)
            self._loops = solver.add_joint_space_half_spaces_constraint(*nothing)
            self._loops.configure("loops", "hard")
        # Decides between configurations that place the feet equally well; too small to move a foot.
        solver.add_regularization_task(1e-9)

    def aim(self, goal: Goal) -> None:
        """Takes the goal's numbers, and its joint limits, which are the wrapper's."""
        limits, given = (goal.lower, goal.upper), self._engine.limits
        if given is None or limits[0] is not given[0] or limits[1] is not given[1]:
            joints, self._engine.limits = self._robot.joint_names, limits
            for name, low, high in zip(joints, *limits, strict=True):
                if math.isfinite(low) and math.isfinite(high):
                    self._engine.placo.set_joint_limits(name, low, high)
        if goal is self._goal:
            return
        before, self._goal = self._goal, goal
        if goal.targets is not before.targets:
            for point, task in self.feet:
                task.target_world = goal.targets[point]
        if goal.turn is not before.turn:
            self._orientation.R_world_frame = goal.task.rotation()
        if goal.height != before.height:
            self._height.target_world = np.array([0.0, 0.0, goal.height])
        if self._place is not None and goal.place is not before.place:
            self._place.target_world = np.array([*goal.place.tolist(), 0.0])

    def bind(self, qpos: Array, q: Array) -> None:
        """Keeps loops and couplings of joints as they are at a configuration, to first order."""
        robot = self._robot
        if self._loops is None or robot.closure is None:
            return
        rows, convention = robot.closure.bound(qpos)[0], robot.pin_convention
        whole = np.zeros((len(rows), convention.nq))
        whole[:, convention.q_index] = rows
        here = whole @ q
        # PlaCo has inequalities alone: A q <= b and -A q <= -b.
        self._loops.A, self._loops.b = np.vstack([whole, -whole]), np.concatenate([here, -here])

    def look(self) -> None:
        """Has the tasks look at where PlaCo's robot is: of itself each does before a programme."""
        for _, foot in self.feet:
            foot.update()
        if self._place is not None:
            self._place.update()

    def miss(self) -> float:
        """Returns how far the feet are from where they shall be, at most (m), by the last look."""
        worst: float = max([foot.error_norm() for _, foot in self.feet])
        return worst

    def error(self) -> float:
        """Returns the sum of squares of what feet and com, or base, are off (m^2), likewise."""
        error: float = sum([foot.error_norm() ** 2 for _, foot in self.feet])
        if self._place is not None:
            error += self._place.error_norm() ** 2
        return error
