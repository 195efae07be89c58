"""A stand task solved by PlaCo: a sequence of quadratic programmes on the whole body."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import placo
from numpy.typing import NDArray

from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.configuration import UP
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.branches import find_limbs
from pupper_analysis.stance.clearance import ClearanceShapes
from pupper_analysis.stance.constraints import (
    TASK_TOLERANCE,
    BaseHeight,
    BaseOrientation,
    Constraint,
    Footholds,
    Loops,
    constraints_of,
)
from pupper_analysis.stance.problem import Goal

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Point:
    """Where a sequence of programmes has ended."""

    qpos: Array
    miss: float
    iterations: int

    @property
    def exact(self) -> bool:
        """Whether the feet are in place, also by a measure that differs in the last digits."""
        return self.miss < _IN_PLACE


_IN_PLACE = TASK_TOLERANCE / 2
"""Feet that miss by less are in place: PlaCo's miss and that which is measured afterwards differ in
the last digits."""

_STEP_TOLERANCE = 1e-13
"""Longest step (rad, m) that is not taken any more. The last one is not taken to find that out: a
step is followed by one that is smaller by the same factor at least, where steps converge at all."""

_STRAIGHT, _QUICKLY = 8, 1 / 16
"""Steps that are not looked at, as long as the square of each is so much less than that of the one
before: where steps converge as these do, the last of eight is below all rounding."""

_NEXT = 1e-10
"""Square of a first step that may be the only one: it is looked whether it has led there."""

_EXACT = 1e-14
"""Root of the sum of squares of what feet and com are off (m) that is rounding: a leg whose joints
move its foot by a centimetre a radian has them within 1e-12."""

_MAX_ITERATIONS = 200

_TRUST_RADIUS = 0.5  # rad per joint and iteration

_SIZE = 10.0  # of the robot, in heights of its stand: no foot moves by more for a radian per joint

_ANYWHERE = 1e3  # rad, m: beyond it no joint without limits turns, and rounding is a picometre's

_SLOW = 2  # iterations in a row at a pace that leads nowhere


@dataclass(frozen=True, eq=False)
class _Begun:
    """Where a search has begun last: with the base at the origin.

    Attributes:
        asked: Joint positions (rad), the goal's turn, and whether it puts the base in its place,
            and not the com; lists are compared in no time.
        lower: The goal's limits.
        upper: Likewise.
        q: PlaCo's.
        over: x and y of what shall be over a place (m).
    """

    asked: tuple[list[float], tuple[float, float, float, float], bool]
    lower: Array
    upper: Array
    q: Array
    over: tuple[float, float]


class _Tasks:
    """A stand's equalities as PlaCo's tasks, aimed at one goal after another of a kind.

    The base's orientation and height and the com's place are hard constraints, which the free base
    can always satisfy; the feet are the objective. The com is over the goal's place, also where it
    may be anywhere inside. What keeps parts off each other or off the ground is left to others.

    Args:
        shapes: The robot with its shapes.
        wrapper: PlaCo's robot.
        goal: The goal.

    Attributes:
        solver: PlaCo's.
        feet: (contact point, its task).
    """

    def __init__(self, shapes: ClearanceShapes, wrapper: placo.RobotWrapper, goal: Goal) -> None:
        self._robot, self._goal = shapes.robot, goal
        solver = self.solver = placo.KinematicsSolver(wrapper)
        solver.enable_joint_limits(True)
        wrapper.set_velocity_limits(1.0)
        solver.enable_velocity_limits(True)
        self.feet: list[tuple[str, placo.PositionTask]] = []
        self._loops: placo.JointSpaceHalfSpacesConstraint | None = None
        for constraint in constraints_of(shapes, goal):
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
        """Takes a goal's numbers."""
        if goal is self._goal:
            return
        before, self._goal = self._goal, goal
        if goal.targets is not before.targets:
            for point, task in self.feet:
                task.target_world = goal.targets[point]
        if goal.turn != before.turn:
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
        worst: float = max([foot.error_norm() for _, foot in self.feet], default=0.0)
        return worst

    def error(self) -> float:
        """Returns the sum of squares of what feet and com, or base, are off (m^2), likewise."""
        error: float = sum([foot.error_norm() ** 2 for _, foot in self.feet])
        return error + float(self._place.error_norm() ** 2)


class Solver:
    """PlaCo's robot and tasks, which solve one goal after another, from any start.

    The base's orientation and height and the com's place are hard constraints, which the free base
    can always satisfy; the feet are the objective, which vanishes if the stance is in reach. A com
    that may be anywhere inside is where the goal has its place.

    Args:
        shapes: The robot with its shapes.

    Attributes:
        engine: PlaCo's robot, lent.
    """

    def __init__(self, shapes: ClearanceShapes) -> None:
        robot = shapes.robot
        self.engine, self._shapes, self._robot = Wrapper(robot), shapes, robot
        self._size = _SIZE * robot.stand_height
        if robot.closure is not None:
            joints = [limb.joints for limb in find_limbs(robot)]
            placing = np.concatenate([*joints, np.zeros(0, dtype=np.int64)])  # no limb, none
            self._readiness = robot.closure.readiness(placing)
        self._kept: dict[bool, _Tasks] = {}  # by whether the base is put in its place
        self._limits: tuple[Array, Array] | None = None
        self._begun: _Begun | None = None

    def run(self, goal: Goal, joints: Array) -> Point:
        """Solves from joint positions (nu,); the base begins where it puts the com in its place."""
        self._aim(goal)
        return self._solved(self.begin(goal, joints))

    def go_on(self, goal: Goal, qpos: Array) -> Point:
        """Solves from a configuration (nq,) that is next to the goal's, as far as can be foreseen.

        The base begins there, with the turn and the height that it shall have.
        """
        self._aim(goal)
        q = self._bent(goal, qpos[7:])
        q[0], q[1], q[2] = qpos[0], qpos[1], goal.height
        self._put(q)
        return self._solved(q)

    def _aim(self, goal: Goal) -> None:
        """Gives PlaCo's robot and tasks the goal's numbers."""
        kept, wrapper, by_base = self._kept, self.engine.placo, goal.by_base
        if by_base not in kept:
            kept[by_base] = _Tasks(self._shapes, wrapper, goal)
        limits, given = (goal.lower, goal.upper), self._limits
        if given is None or limits[0] is not given[0] or limits[1] is not given[1]:
            self._limits = limits
            for joint in np.flatnonzero(~self._robot.pin_convention.unbounded):
                name, low, high = self._robot.joint_names[joint], limits[0][joint], limits[1][joint]
                if math.isfinite(low) and math.isfinite(high):
                    wrapper.set_joint_limits(name, low, high)
                elif given is not None:  # it may have been in a posture
                    wrapper.set_joint_limits(name, -_ANYWHERE, _ANYWHERE)
        self._goal, self.tasks = goal, kept[by_base]
        self.tasks.aim(goal)

    def _solved(self, q: Array) -> Point:
        if self._robot.closure is not None:
            if not self._closes(q):
                return Point(self._robot.pin_convention.qpos(q), math.inf, 0)
            return self._watched(self.engine.placo.state.q.copy())
        return self._straight() or self._watched(q)

    def _straight(self) -> Point | None:
        """Takes full steps for as long as they converge quickly.

        What is ever less of a step leads somewhere, and whether the feet are in place there is
        looked at when it has come there. None where that is not the way, or not the place.
        """
        tasks, wrapper = self.tasks, self.engine.placo
        solve, move = tasks.solver.solve, wrapper.update_kinematics
        tasks.solver.dt = _TRUST_RADIUS
        last = math.inf
        for taken in range(1, _STRAIGHT + 1):
            try:
                step = solve(True)
            except RuntimeError:
                return None
            move()
            moved = float(step.dot(step))
            if _arrives(moved, last) or (moved < _NEXT and last == math.inf and self._exact()):
                point = self._point(wrapper.state.q, taken)
                return point if point.exact else None
            if moved > _QUICKLY * last:
                return None
            last = moved
        return None

    def _exact(self) -> bool:
        """Whether feet and com are in place to rounding."""
        self.tasks.look()
        return self.tasks.error() < _EXACT**2

    def _watched(self, q: Array) -> Point:
        """Takes steps from a q in a trust region, looking at the tasks after each.

        Where a step makes things worse it is undone, and the next one is shorter.
        """
        wrapper, tasks = self.engine.placo, self.tasks
        convention = self._robot.pin_convention
        radius, iterations, slow = _TRUST_RADIUS, 0, 0
        error, last = math.inf, math.inf
        self._put(q)
        while iterations < _MAX_ITERATIONS and radius > _STEP_TOLERANCE and slow < _SLOW:
            iterations += 1
            left = _MAX_ITERATIONS - iterations
            if radius * self._size * left < math.sqrt(error) / 2 < math.inf:
                break  # too far for all steps that are left, though the feet are not in place
            tasks.solver.dt = radius
            tasks.bind(convention.qpos(q), q)
            try:
                step = tasks.solver.solve(True)
            except RuntimeError:
                # An infeasible programme: within a shorter step it may be feasible.
                radius /= 4
                self._put(q)
                continue
            wrapper.update_kinematics()
            closes = self._closes(wrapper.state.q)
            after, moved = wrapper.state.q.copy(), float(step.dot(step))
            tasks.look()
            new_error = tasks.error() if closes else math.inf
            if new_error > error and new_error > TASK_TOLERANCE**2:
                radius, last = radius / 4, math.inf
                self._put(q)
                continue
            nearer = math.sqrt(error) - math.sqrt(new_error)
            hopeless = new_error > TASK_TOLERANCE**2 and nearer * left < math.sqrt(new_error) / 2
            slow = slow + 1 if hopeless else 0
            error, q = new_error, after
            if _arrives(moved, last):
                break
            last = moved
        return self._point(wrapper.state.q, iterations)

    def _point(self, q: Array, iterations: int) -> Point:
        """Returns where PlaCo's robot is, at its q."""
        miss = self.tasks.miss()
        if miss >= _IN_PLACE:  # it may be what it was before the last step
            self.tasks.look()
            miss = self.tasks.miss()
        return Point(self._robot.pin_convention.qpos(q), miss, iterations)

    def _closes(self, q: Array) -> bool:
        """Closes the loops of PlaCo's robot, which is at q; tells if it can."""
        robot = self._robot
        if robot.closure is None:
            return True
        qpos = robot.pin_convention.qpos(q)
        closed = robot.closure.closed(qpos, self._readiness, self._goal.give)
        if closed is None:
            return False
        joints = closed[robot.nq - robot.nu :]
        beyond = np.maximum(self._goal.lower - joints, joints - self._goal.upper)
        if beyond.max(initial=0.0) > TASK_TOLERANCE:
            return False
        self._put(robot.pin_convention.with_joints(q, joints))
        return True

    def _put(self, q: Array) -> None:
        wrapper = self.engine.placo
        wrapper.state.q = q
        wrapper.update_kinematics()

    def begin(self, goal: Goal, joints: Array) -> Array:
        """Puts PlaCo's robot as a goal turns it, its com or base over its place.

        Returns:
            Its q.
        """
        begun, asked = self._begun, (joints.tolist(), goal.turn, goal.by_base)
        # Searches begin at home, as a rule; and with it the com is where it was under the base.
        if (
            begun is None
            or begun.asked != asked
            or begun.lower is not goal.lower
            or begun.upper is not goal.upper
        ):
            q, over = self._bent(goal, joints), (0.0, 0.0)  # with the base at the origin
            if not goal.by_base:
                self._put(q)
                x, y, _ = self.engine.placo.com_world().tolist()
                over = x, y
            begun = self._begun = _Begun(asked, goal.lower, goal.upper, q, over)
        q = begun.q.copy()
        x, y = goal.place.tolist()
        q[0], q[1], q[2] = x - begun.over[0], y - begun.over[1], goal.height
        self._put(q)
        return q

    def _bent(self, goal: Goal, joints: Array) -> Array:
        """Returns q with the base at the origin and turned as it shall be, joints inside limits."""
        qpos = np.empty(7 + len(joints))
        qpos[:7] = 0.0, 0.0, 0.0, *goal.turn
        np.maximum(joints, goal.lower, qpos[7:])
        np.minimum(qpos[7:], goal.upper, qpos[7:])
        return self._robot.pin_convention.unit_q(qpos)


def _arrives(moved: float, last: float) -> bool:
    """Whether no step need follow one, by its length squared, and that of the one before."""
    following = moved * min(1.0, moved / last) if last < math.inf else moved
    return following < _STEP_TOLERANCE**2


_spare: dict[Hashable, list[placo.RobotWrapper]] = {}
"""{structure: PlaCo's robots that nobody uses}. They are never let go: that would free nothing."""


class Wrapper:
    """PlaCo's robot with a robot's numbers; it belongs to its holder alone, in one thread.

    What PlaCo makes of a URDF it never gives back: a ``RobotWrapper`` keeps its 375 kB for good,
    and reading takes milliseconds. Robots whose joints and links hang together in the same way, as
    the thousand designs of a study do, differ in numbers alone: these are set in place.

    Whoever uses ``placo`` holds this: when it goes, another robot may have PlaCo's.

    Attributes:
        placo: PlaCo's robot, without shapes.
    """

    def __init__(self, robot: Robot) -> None:
        self._spare = _spare.setdefault(_structure(robot.pin_model), [])
        try:
            self.placo = self._spare.pop()
        except IndexError:
            self.placo = _load(robot)
        _take_numbers(self.placo.model, robot.pin_model)

    def __del__(self) -> None:
        if hasattr(self, "placo"):
            self._spare.append(self.placo)


def _load(robot: Robot) -> placo.RobotWrapper:
    """Has PlaCo read a robot's URDF, without shapes: no file is needed."""
    tree = UrdfTree.of(robot.description.urdf)
    tree.remove_shapes()
    wrapper = placo.RobotWrapper("", placo.Flags.ignore_collisions, to_text(tree.root))
    _leave_names_to_links(wrapper.model)
    return wrapper


def _leave_names_to_links(model: pin.Model) -> None:
    """Renames frames of joints that are named like a link: PlaCo asks for names alone."""
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    taken = {frame.name for frame in model.frames}
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY and frame.name in links:
            while frame.name in taken:
                frame.name += " (joint)"
            taken.add(frame.name)


def _structure(model: pin.Model) -> Hashable:
    """Returns what cannot be changed in place: joints, their axes and order, and links' names."""
    axes = tuple(tuple(joint.createData().S.ravel().tolist()) for joint in list(model.joints)[1:])
    kinds = tuple(joint.shortname() for joint in list(model.joints)[1:])
    links = tuple(
        (frame.name, int(frame.parentJoint))
        for frame in model.frames
        if frame.type == pin.FrameType.BODY
    )
    return tuple(model.names), tuple(model.parents), kinds, axes, links


def _take_numbers(model: pin.Model, given: pin.Model) -> None:
    """Gives a model the numbers of another one of its structure, in place."""
    for joint in range(given.njoints):
        model.inertias[joint] = given.inertias[joint]
        model.jointPlacements[joint] = given.jointPlacements[joint]
    places = {f.name: f.placement for f in given.frames if f.type == pin.FrameType.BODY}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.name in places:
            frame.placement = places[frame.name]
    model.lowerPositionLimit = given.lowerPositionLimit
    model.upperPositionLimit = given.upperPositionLimit


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
