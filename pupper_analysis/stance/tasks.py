"""A stand's constraints as PlaCo's tasks: what it is to satisfy, and how much each weighs."""

from __future__ import annotations

import math

import numpy as np
import placo
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import UP
from pupper_analysis.stance.constraints import (
    BaseHeight,
    BaseOrientation,
    Constraint,
    Footholds,
    Loops,
    constraints_of,
)
from pupper_analysis.stance.context import Context
from pupper_analysis.stance.problem import Goal

Array = NDArray[np.float64]


class Tasks:
    """PlaCo's solver with the equalities of a stand, aimed at one goal after another of a kind.

    The base's orientation and height and the com's place are hard constraints, which the free base
    can always satisfy; the feet are the objective. The com is over the goal's place, also where it
    may be anywhere inside. What keeps parts off each other or off the ground is left to others.

    Args:
        context: The robot's.
        goal: The goal.

    Attributes:
        solver: PlaCo's.
        feet: (contact point, its task).
    """

    def __init__(self, context: Context, goal: Goal) -> None:
        # Not the context, which keeps its tasks: a circle would hold PlaCo's robot back for long.
        self._robot, self._engine, self._goal = context.robot, context.engine, goal
        solver = self.solver = placo.KinematicsSolver(context.wrapper)
        solver.enable_joint_limits(True)
        context.wrapper.set_velocity_limits(1.0)
        solver.enable_velocity_limits(True)
        self.feet: list[tuple[str, placo.PositionTask]] = []
        self._loops: placo.JointSpaceHalfSpacesConstraint | None = None
        for constraint in constraints_of(context.shapes, goal):
            self._pose(constraint)
        place = np.array([*goal.place, 0.0])
        self._place = (
            solver.add_position_task(self._robot.base, place)
            if goal.by_base
            else solver.add_com_task(place)
        )
        self._place.mask.set_axises("xy")
        self._place.configure("place", "hard")
        # Decides between configurations that place the feet equally well; too small to move a foot.
        solver.add_regularization_task(1e-9)

    def _pose(self, constraint: Constraint) -> None:
        """Tells PlaCo of a constraint, if it is one of those that are its own."""
        robot, goal, solver = self._robot, self._goal, self.solver
        if isinstance(constraint, BaseHeight):
            self._height = solver.add_position_task(robot.base, goal.height * UP)
            self._height.mask.set_axises("z")
            self._height.configure("height", "hard")
        elif isinstance(constraint, BaseOrientation):
            self._orientation = solver.add_orientation_task(robot.base, goal.task.rotation())
            self._orientation.configure("orientation", "hard")
        elif isinstance(constraint, Footholds):
            for foot, frame in robot.contact_frames.items():
                task = solver.add_position_task(frame, goal.targets[foot])
                task.configure(foot, "soft", 1.0)
                self.feet.append((foot, task))
        elif isinstance(constraint, Loops):
            nothing = np.zeros((0, robot.nq)), np.zeros(0)
            loops = self._loops = solver.add_joint_space_half_spaces_constraint(*nothing)
            loops.configure("loops", "hard")

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
        if goal.place is not before.place:
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
        self._place.update()

    def miss(self) -> float:
        """Returns how far the feet are from where they shall be, at most (m), by the last look."""
        worst: float = max([foot.error_norm() for _, foot in self.feet])
        return worst

    def error(self) -> float:
        """Returns the sum of squares of what feet and com, or base, are off (m^2), likewise."""
        error: float = sum([foot.error_norm() ** 2 for _, foot in self.feet])
        return error + float(self._place.error_norm() ** 2)
