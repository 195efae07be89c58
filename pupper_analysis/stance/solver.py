"""A stand task solved by PlaCo: a sequence of quadratic programmes on the whole body."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import placo
from numpy.typing import NDArray

from pupper_analysis.errors import ConfigurationError
from pupper_analysis.results import Result
from pupper_analysis.robot.configuration import UP
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.clearance import Clearance, Shapes
from pupper_analysis.stance.footholds import fixing
from pupper_analysis.stance.problem import Goal
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.support_polygon import support_polygon

Array = NDArray[np.float64]


Step = tuple[Array, float]
"""PlaCo's q after a step, and the step's length squared (rad^2, m^2)."""


@dataclass(frozen=True, eq=False)
class Point:
    """Where a sequence of programmes has ended."""

    qpos: Array
    miss: float
    iterations: int


TASK_TOLERANCE = 1e-9
"""Error up to which a task counts as satisfied (m, rad)."""

TOUCHING = 1e-6
"""How much nearer than allowed parts may come (m): rounding."""

_STEP_TOLERANCE = 1e-13
"""Longest step (rad, m) that is not taken any more. The last one is not taken to find that out: a
step is followed by one that is smaller by the same factor at least, where steps converge at all."""

_STRAIGHT, _QUICKLY = 8, 1 / 16
"""Steps that are not looked at, as long as the square of each is so much less than that of the one
before: where steps converge as these do, the last of eight is below all rounding."""

_MAX_ITERATIONS = 200

_TRIGGER = 0.02  # m: links that are further than this from their least distance are left alone

_APART_WEIGHT = 1e3  # of links staying apart, against feet

_INSIDE_WEIGHT = 1e3  # of the com staying inside the support polygon, likewise

_TRUST_RADIUS = 0.5  # rad per joint and iteration

_SIZE = 10.0  # of the robot, in heights of its stand: no foot moves by more for a radian per joint

_SETTLED = 1e-11  # m: feet that are off by less twice are in place, though the com may drift

_SLOW = 2  # iterations in a row at a pace that leads nowhere


@dataclass(frozen=True, eq=False)
class Stand(Result):
    """A solved stand. Its errors are Pinocchio's, computed anew from ``qpos``.

    Attributes:
        task: The task, with its height and com filled in.
        qpos: (nq,) the configuration.
        foot_targets: {foot: (3,)} where the centre of each foot's sphere shall be (m).
        depths: {foot that carries: how deep it has sunk into the ground (m)}; 0 on rigid ground.
        stance_feet: The feet that carry.
        normals: {foot that carries: (3,) direction out of the ground}.
        contact_points: {foot that carries: (3,) where it touches the ground (m)}.
        foot_error: The largest distance of a foot from its target (m).
        orientation_error: Angle between the base's orientation and the task's (rad).
        height_error: Of the base frame (m).
        com_error: Horizontal distance of the com from where it shall be (m); with an offset, of the
            base frame.
        com_margin: Distance of the com's projection from the support polygon's edge (m); negative
            outside.
        ground_clearance: How high the lowest part other than the feet is above the ground, by the
            URDF's shapes; None if it has none.
        self_clearance: The least distance between links that are not neighbours; None if it was
            not asked for.
        iterations: Quadratic programmes solved.
        robot: Whose stand it is: the ``fingerprint`` of the robot.
    """

    task: StandTask
    qpos: Array
    foot_targets: dict[str, Array]
    depths: dict[str, float]
    stance_feet: tuple[str, ...]
    normals: dict[str, Array]
    contact_points: dict[str, Array]
    foot_error: float
    orientation_error: float
    height_error: float
    com_error: float
    com_margin: float
    ground_clearance: Clearance | None
    self_clearance: Clearance | None
    iterations: int
    robot: str

    @property
    def blocked(self) -> tuple[str, ...]:
        """What comes nearer to the ground, to another link or to tipping than the task allows."""
        found = []
        if self.com_short > TASK_TOLERANCE:
            inside = (
                f"{1e3 * abs(self.com_margin):.1f} mm {'in' if self.com_margin >= 0 else 'out'}side"
            )
            found.append(f"the com is {inside} the support polygon")
        near, least = self.ground_clearance, self.task.ground_clearance
        if near is not None and near.distance < least - TOUCHING:
            found.append(f"{near.links[0]} is {_distance(near, 'above', 'in')} the ground")
        near, least = self.self_clearance, self.task.self_clearance or 0.0
        if near is not None and near.distance < least - TOUCHING:
            found.append(f"{near.links[0]} is {_distance(near, 'from', 'in')} {near.links[1]}")
        return tuple(found)

    @property
    def com_short(self) -> float:
        """How much nearer than asked the com is to the support polygon's edge (m).

        With an offset only, and a margin that was asked for: the com is then a result. Otherwise it
        is where it was asked to be.
        """
        if self.task.offset is None or self.task.com_margin == 0.0:
            return 0.0
        return max(0.0, self.task.com_margin - self.com_margin)

    @property
    def room(self) -> float:
        """How much nearer than allowed anything is, negative (m)."""
        least = -self.com_short
        if self.ground_clearance is not None:
            least = min(least, self.ground_clearance.distance - self.task.ground_clearance)
        if self.self_clearance is not None:
            least = min(least, self.self_clearance.distance - (self.task.self_clearance or 0.0))
        return least

    @property
    def solved(self) -> bool:
        """Whether the feet are where they shall be, and nothing is in the way."""
        return self.foot_error < TASK_TOLERANCE and not self.blocked

    def check(self, robot: Robot) -> None:
        """Checks that it is a robot's stand.

        Raises:
            ConfigurationError: If it is another robot's.
        """
        if self.robot.rpartition(" ")[2] != robot.fingerprint.rpartition(" ")[2]:
            whose = self.robot.rpartition(" ")[0]
            raise ConfigurationError(
                "stand", f"it is a stand of {whose}, as that was loaded; solve it for {robot.name}"
            )

    def joint_positions(self, robot: Robot) -> Array:
        """Returns the joints' part (nu,) of ``qpos`` (rad)."""
        return self.qpos[robot.nq - robot.nu :]


def _distance(near: Clearance, apart: str, inside: str) -> str:
    return f"{1e3 * abs(near.distance):.1f} mm {apart if near.distance >= 0 else inside}"


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
        self._shapes, self._goal = shapes, goal
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
        # Decides between configurations that place the feet equally well; too small to move a foot.
        solver.add_regularization_task(1e-9)

    def aim(self, goal: Goal) -> None:
        """Takes the goal's numbers, and its joint limits, which are the wrapper's."""
        limits, given = (goal.lower, goal.upper), self._shapes.limits
        if given is None or limits[0] is not given[0] or limits[1] is not given[1]:
            joints, self._shapes.limits = self._shapes.robot.joint_names, limits
            for name, low, high in zip(joints, *limits, strict=True):
                if math.isfinite(low) and math.isfinite(high):
                    self._shapes.wrapper.set_joint_limits(name, low, high)
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

    def miss(self) -> float:
        """Returns how far the feet are from where they shall be, at most (m)."""
        return max([foot.error_norm() for _, foot in self.feet])

    def error(self) -> float:
        """Returns the sum of squares of what feet and com, or base, are off (m^2)."""
        error: float = sum([foot.error_norm() ** 2 for _, foot in self.feet])
        if self._place is not None:
            error += self._place.error_norm() ** 2
        return error


class Solver:
    """PlaCo's tasks for one goal, solved from any start.

    The base's orientation and height and the com's place are hard constraints, which the free base
    can always satisfy; the feet are the objective, which vanishes if the stance is in reach. Where
    links shall stay apart, PlaCo's avoidance of self-collisions weighs more than the feet.

    Args:
        shapes: The robot with its shapes.
        goal: The goal.
        inside: The com may be anywhere in the support polygon with the task's margin, instead of
            at ``goal.place``.
        firmly: The com may not leave it on the way either, which it does where feet pull it out.
            It must begin inside.
        apart: Heed the task's least distance between links.

    Attributes:
        tasks: PlaCo's tasks, which other goals may have as well.
    """

    def __init__(
        self,
        shapes: Shapes,
        goal: Goal,
        *,
        inside: bool = False,
        firmly: bool = False,
        apart: bool = True,
    ) -> None:
        self.shapes, self.goal, self.inside = shapes, goal, inside
        self._size = _SIZE * shapes.robot.stand_height
        apart = apart and goal.task.self_clearance is not None
        if apart:
            shapes.pair()  # before the state is set: it moves the robot
        if inside or apart or len(shapes.robot.soles) < len(shapes.robot.feet):
            self.tasks = Tasks(shapes, goal, inside=inside, firmly=firmly, apart=apart)
        else:  # tasks that differ in numbers alone
            kept = shapes.tasks
            if goal.by_base not in kept:
                kept[goal.by_base] = Tasks(shapes, goal, inside=False, apart=False)
            self.tasks = kept[goal.by_base]

    def run(self, joints: Array, place: Array | None = None) -> Point:
        """Solves from joint positions (nu,); the base begins where it puts the com in its place.

        Args:
            joints: (nu,) where to start (rad).
            place: (2,) where the com, or the base, begins (m); by default where it shall be.
        """
        self.tasks.aim(self.goal)
        q = self.begin(joints, self.goal.place if place is None else place)
        if self.inside:
            return self._watched(q, [])
        steps: list[Step] = []
        return self._straight(steps) or self._watched(q, steps)

    def _straight(self, steps: list[Step]) -> Point | None:
        """Takes full steps for as long as they converge quickly; adds them to ``steps``.

        What is ever less of a step leads somewhere, and whether the feet are in place there is
        looked at when it has come there. None where that is not the way, or not the place.
        """
        tasks, wrapper = self.tasks, self.shapes.wrapper
        solve, move = tasks.solver.solve, wrapper.update_kinematics
        tasks.solver.dt = _TRUST_RADIUS
        last = math.inf
        for _ in range(_STRAIGHT):
            try:
                step = solve(True)
            except RuntimeError:
                return None
            move()
            moved = float(step.dot(step))
            q = wrapper.state.q.copy()
            steps.append((q, moved))
            if _arrives(moved, last):
                point = self._point(q, len(steps))
                return point if point.miss < TASK_TOLERANCE / 2 else None
            if moved > _QUICKLY * last:
                return None
            last = moved
        return None

    def _watched(self, q: Array, ahead: list[Step]) -> Point:
        """Takes steps that are forward: in a trust region, looking at the tasks after each.

        Where a step makes things worse it is undone, and the next one is shorter.

        Args:
            q: Where it begins.
            ahead: Full steps from there that have been taken already.
        """
        wrapper, tasks = self.shapes.wrapper, self.tasks
        radius, iterations, slow = _TRUST_RADIUS, 0, 0
        error, last = math.inf, math.inf
        self._put(q)
        while iterations < _MAX_ITERATIONS and radius > _STEP_TOLERANCE and slow < _SLOW:
            iterations += 1
            left = _MAX_ITERATIONS - iterations
            if radius * self._size * left < math.sqrt(error) / 2 < math.inf:
                break  # too far for all steps that are left, though the feet are not in place
            if ahead:
                after, moved = ahead.pop(0)
                self._put(after)
            else:
                tasks.solver.dt = radius
                try:
                    step = tasks.solver.solve(True)
                except RuntimeError:
                    # An infeasible programme: within a shorter step it may be feasible.
                    radius /= 4
                    self._put(q)
                    continue
                wrapper.update_kinematics()
                after, moved = wrapper.state.q.copy(), float(step.dot(step))
            new_error = tasks.error()
            if new_error > error and new_error > TASK_TOLERANCE**2:
                radius, last = radius / 4, math.inf
                ahead.clear()
                self._put(q)
                continue
            nearer = math.sqrt(error) - math.sqrt(new_error)
            settled = self.inside and max(error, new_error) < _SETTLED**2
            hopeless = new_error > TASK_TOLERANCE**2 and nearer * left < math.sqrt(new_error) / 2
            slow = slow + 1 if hopeless else 0
            error, q = new_error, after
            if settled or _arrives(moved, last):
                break
            last = moved
        return self._point(wrapper.state.q, iterations)

    def _point(self, q: Array, iterations: int) -> Point:
        """Returns where PlaCo's robot is, at its q."""
        return Point(self.shapes.robot.pin_convention.qpos(q), self.tasks.miss(), iterations)

    def _put(self, q: Array) -> None:
        wrapper = self.shapes.wrapper
        wrapper.state.q = q
        wrapper.update_kinematics()

    def begin(self, joints: Array, place: Array) -> Array:
        """Puts PlaCo's robot upright, its com or base over a place (2,) (m); returns its q."""
        convention, goal = self.shapes.robot.pin_convention, self.goal
        wrapper = self.shapes.wrapper
        qpos = np.empty(len(joints) + 7)
        qpos[:7] = *place.tolist(), goal.height, *goal.turn
        np.maximum(joints, goal.lower, qpos[7:])
        np.minimum(qpos[7:], goal.upper, qpos[7:])
        q = convention.unit_q(qpos)
        self._put(q)
        if not goal.by_base:
            q[:2] += place - wrapper.com_world()[:2]
            self._put(q)
        return q


def _arrives(moved: float, last: float) -> bool:
    """Whether no step need follow one, by its length squared, and that of the one before."""
    following = moved * min(1.0, moved / last) if last < math.inf else moved
    return following < _STEP_TOLERANCE**2
