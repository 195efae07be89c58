"""A stand task solved by PlaCo: a sequence of quadratic programmes on the whole body."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.arrays import angle_between
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.branches import limbs
from pupper_analysis.stance.clearance import Clearance, Shapes
from pupper_analysis.stance.problem import Goal
from pupper_analysis.stance.task import StandTask
from pupper_analysis.stance.tasks import TASK_TOLERANCE, Tasks
from pupper_analysis.statics.support_polygon import com_margin

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Point:
    """Where a sequence of programmes has ended."""

    qpos: Array
    miss: float
    iterations: int


TOUCHING = 1e-6
"""How much nearer than allowed parts may come (m): rounding."""

_STEP_TOLERANCE = 1e-13
"""Largest step (rad, m) that is not taken any more. The last one is not taken to find that out: a
step is followed by one that is smaller by the same factor at least, where steps converge at all."""

_MAX_ITERATIONS = 200

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
        foot_error: The largest distance of a foot from its target (m), or by how much a closed loop
            or a coupling of joints is open, if that is more (m, rad).
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
        robot = shapes.robot
        if robot.closure is not None:
            placing = np.concatenate([limb.joints for limb in limbs(robot)])
            self._readiness = robot.closure.readiness(placing)
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
        wrapper, convention = self.shapes.wrapper, self.shapes.robot.pin_convention
        tasks = self.tasks
        tasks.aim(self.goal)
        q = self.begin(joints, self.goal.place if place is None else place)
        if not self._closes(q):
            return Point(convention.qpos(q), math.inf, 0)
        q = wrapper.state.q.copy()
        # A trust region: where a step makes things worse it is undone, and the next one is shorter.
        radius, iterations, slow = _TRUST_RADIUS, 0, 0
        error, last = math.inf, 0.0
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
                wrapper.state.q = q
                wrapper.update_kinematics()
                continue
            wrapper.update_kinematics()
            closes = self._closes(wrapper.state.q)
            new_error = tasks.error() if closes else math.inf
            if new_error > error and new_error > TASK_TOLERANCE**2:
                radius, last = radius / 4, 0.0
                wrapper.state.q = q
                wrapper.update_kinematics()
                continue
            nearer = math.sqrt(error) - math.sqrt(new_error)
            settled = self.inside and max(error, new_error) < _SETTLED**2
            hopeless = new_error > TASK_TOLERANCE**2 and nearer * left < math.sqrt(new_error) / 2
            slow = slow + 1 if hopeless else 0
            error, q = new_error, wrapper.state.q.copy()
            moved = max(map(abs, step.tolist()))
            following = moved * min(1.0, moved / last) if last else moved
            if settled or following < _STEP_TOLERANCE:
                break
            last = moved
        miss = max([foot.error_norm() for _, foot in tasks.feet])
        return Point(convention.qpos(wrapper.state.q), miss, iterations)

    def _closes(self, q: Array) -> bool:
        """Closes the loops of PlaCo's robot, which is at q; tells if it can."""
        robot, wrapper = self.shapes.robot, self.shapes.wrapper
        if robot.closure is None:
            return True
        qpos = robot.pin_convention.qpos(q)
        closed = robot.closure.closed(qpos, self._readiness, self.goal.give)
        if closed is None:
            return False
        joints = closed[robot.nq - robot.nu :]
        beyond = np.maximum(self.goal.lower - joints, joints - self.goal.upper)
        if beyond.max(initial=0.0) > TASK_TOLERANCE:
            return False
        wrapper.state.q = robot.pin_convention.with_joints(q, joints)
        wrapper.update_kinematics()
        return True

    def begin(self, joints: Array, place: Array) -> Array:
        """Puts PlaCo's robot upright, its com or base over a place (2,) (m); returns its q."""
        convention, goal = self.shapes.robot.pin_convention, self.goal
        wrapper = self.shapes.wrapper
        w, i, j, k = goal.turn
        base = (*place.tolist(), goal.height, w, i, j, k)
        bent = np.minimum(np.maximum(joints, goal.lower), goal.upper)
        q = convention.unit_q(np.concatenate([base, bent]))
        wrapper.state.q = q
        wrapper.update_kinematics()
        if not goal.by_base:
            q[:2] += place - wrapper.com_world()[:2]
            wrapper.state.q = q
            wrapper.update_kinematics()
        return q


def measure(shapes: Shapes, goal: Goal, qpos: Array, iterations: int) -> Stand:
    """Returns the stand at a configuration, with its errors and clearances."""
    robot, task = shapes.robot, goal.task
    config = Configuration(robot, qpos)
    com = config.center_of_mass()
    at = config.qpos if goal.by_base else com
    # Who changes a stand changes that alone: goals share their arrays.
    targets = {foot: target.copy() for foot, target in goal.targets.items()}
    contacts = dict(zip(goal.stance_feet, goal.contacts.copy(), strict=True))
    missed = [
        math.dist(position.tolist(), targets[foot].tolist())
        for foot, position in config.foot_positions().items()
    ]
    if robot.closure is not None:
        missed.append(robot.closure.open_by(config.qpos, goal.give))
    above = shapes.above_ground(config.qpos, task.ground, targets, goal.depths)
    apart = None if task.self_clearance is None else shapes.between_links(config.qpos)
    return Stand(
        task=task,
        qpos=config.qpos.copy(),
        foot_targets=targets,
        depths=goal.depths,
        stance_feet=goal.stance_feet,
        normals=dict.fromkeys(goal.stance_feet, task.ground.normal()),
        contact_points=contacts,
        foot_error=max(missed),
        orientation_error=angle_between(goal.turn, config.qpos[3:7].tolist()),
        height_error=abs(float(config.qpos[2]) - goal.height),
        com_error=math.dist(at[:2].tolist(), goal.place.tolist()),
        com_margin=com_margin(com, contacts),
        ground_clearance=above,
        self_clearance=apart,
        iterations=iterations,
        robot=robot.fingerprint,
    )
