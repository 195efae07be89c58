"""What a stand must fulfil, as constraints: each has a residual, its derivative, and a judgement.

PlaCo's tasks (``solver``), the programme of the search and of a refusal (``programme``) and the
judge (``judge``) all go by this one list.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from operator import sub
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.closure import Closure
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.structure import Kinematics
from pupper_analysis.stance.clearance import Clearance, ClearanceShapes
from pupper_analysis.stance.problem import Goal
from pupper_analysis.statics.support_polygon import SIDES, margin_of_place, polygon_sides

Array = NDArray[np.float64]

TASK_TOLERANCE = 1e-9
"""Error up to which a task counts as satisfied (m, rad)."""

CLEARANCE_TOLERANCE = 1e-6
"""How much nearer than allowed parts may come (m): rounding. A search
aims within half of it: at the end of reach it is all that there is."""

_PAIRS = 12
"""Pairs of links that are looked at, the nearest: of a quadruped's 300 no more touch at once."""


class Constraint:
    """Something that a stand of a goal must fulfil.

    Attributes:
        name: As ``stance/fields.toml`` has it.
        is_equality: Whether the residual shall be zero; otherwise it shall not be negative.
        is_presatisfied: Whether each tested configuration fulfils the constraint (base height and
            orientation).
    """

    name: ClassVar[str]
    is_equality: ClassVar[bool] = False
    is_presatisfied: ClassVar[bool] = False

    # A stand is measured in 50 us: nothing is made here that only a search or a refusal asks for.
    def __init__(self, shapes: ClearanceShapes, goal: Goal) -> None:
        self._shapes, self._begun = shapes, goal

    def residual(self, goal: Goal, at: Kinematics) -> Array:
        """Returns what shall be zero, or not negative (n,) (m, rad).

        Args:
            goal: The goal, or one of which some numbers are others.
            at: Where the robot is: the shapes' kinematics.
        """
        raise NotImplementedError

    def jacobian(self, goal: Goal, at: Configuration) -> Array:
        """Returns the derivative (n, nv) of the residual by the robot's motion."""
        raise NotImplementedError

    def violation(self, goal: Goal, at: Kinematics) -> float:
        """Returns by how much it is not fulfilled, at most (m, rad)."""
        left = self.residual(goal, at)
        return float((np.abs(left) if self.is_equality else -left).max(initial=0.0))


class BaseHeight(Constraint):
    """The base frame is as high as it shall be."""

    name, is_equality, is_presatisfied = "base-height", True, True

    def residual(self, goal: Goal, at: Kinematics) -> Array:
        """See ``Constraint``."""
        return at.qpos[2:3] - goal.height

    def violation(self, goal: Goal, at: Kinematics) -> float:
        """See ``Constraint``."""
        return abs(float(at.qpos[2]) - goal.height)


class BaseOrientation(Constraint):
    """The base is turned as it shall be."""

    name, is_equality, is_presatisfied = "base-orientation", True, True

    def residual(self, goal: Goal, at: Kinematics) -> Array:
        """See ``Constraint``: the angle that is left."""
        return np.array([self.violation(goal, at)])

    def violation(self, goal: Goal, at: Kinematics) -> float:
        """See ``Constraint``."""
        return angle_between(goal.base_quaternion, at.qpos[3:7].tolist())


def angle_between(one: Sequence[float], other: Sequence[float]) -> float:
    """Returns the angle (rad) between the turns of two unit quaternions (w, x, y, z)."""
    (a, b, c, d), (w, x, y, z) = one, other
    return 2 * math.atan2(
        math.hypot(
            a * x - b * w - c * z + d * y,
            a * y + b * z - c * w - d * x,
            a * z - b * y + c * x - d * w,
        ),
        abs(a * w + b * x + c * y + d * z),
    )


class Footholds(Constraint):
    """The feet's centres are in their places."""

    name, is_equality = "footholds", True

    def residual(self, goal: Goal, at: Kinematics) -> Array:
        """See ``Constraint``: of a sole, its points' follow from each other."""
        feet = at.feet
        apart = [feet[foot] - there for foot, there in goal.targets.items()]
        return np.concatenate([*apart, np.zeros(0)])

    def jacobian(self, goal: Goal, at: Configuration) -> Array:
        """See ``Constraint``."""
        jacobians = at.foot_jacobians()
        return np.concatenate(
            [*map(jacobians.__getitem__, goal.targets), np.zeros((0, at.robot.nv))]
        )

    def violation(self, goal: Goal, at: Kinematics) -> float:
        """See ``Constraint``: the greatest distance of all contact points, pinned or not."""
        feet = at.feet
        apart = [math.dist(feet[foot], there.tolist()) for foot, there in goal.targets.items()]
        return max(apart, default=0.0)


class Loops(Constraint):
    """Loops and couplings of joints are closed as they are built, or as open as they give way."""

    name, is_equality = "loops", True

    def __init__(self, shapes: ClearanceShapes, goal: Goal, closure: Closure) -> None:
        super().__init__(shapes, goal)
        self._closure = closure

    def residual(self, goal: Goal, at: Kinematics) -> Array:
        """See ``Constraint``."""
        left = self._closure.residual(at.qpos)
        return left if goal.give is None else left - goal.give

    def jacobian(self, _: Goal, at: Configuration) -> Array:
        """See ``Constraint``."""
        rows = self._closure.rows(at.qpos)
        return np.hstack([np.zeros((len(rows), at.robot.nv - at.robot.nu)), rows])

    def violation(self, goal: Goal, at: Kinematics) -> float:
        """See ``Constraint``: infinite beyond a dead point, where loops are assembled otherwise."""
        if not self._closure.as_built(at.qpos):
            return math.inf
        return self._closure.open_by(at.qpos, goal.give)


class PlaceConstraint(Constraint):
    """The com, or the base with an offset, is over its place."""

    name, is_equality = "com-place", True

    def residual(self, goal: Goal, at: Kinematics) -> Array:
        """See ``Constraint``."""
        return (at.qpos[:2] if goal.by_base else np.array(at.com[:2])) - goal.place

    def jacobian(self, goal: Goal, at: Configuration) -> Array:
        """See ``Constraint``."""
        return np.eye(2, at.robot.nv) if goal.by_base else at.com_jacobian()[:2]

    def violation(self, goal: Goal, at: Kinematics) -> float:
        """See ``Constraint``."""
        here = at.qpos[:2].tolist() if goal.by_base else at.com[:2]
        return math.dist(here, goal.place.tolist())


class BasePlace(PlaceConstraint):
    """The base is aside by the task's offset."""

    name = "base-place"


class SupportMargin(Constraint):
    """The com is inside the support polygon by the task's margin."""

    name = "support-margin"

    def residual(self, goal: Goal, at: Kinematics) -> Array:
        """See ``Constraint``."""
        sides, com = self._sides(goal), np.array(at.com[:2])
        inside: Array = sides[:, :2] @ com + sides[:, 2]
        return inside - goal.task.com_margin

    def jacobian(self, goal: Goal, at: Configuration) -> Array:
        """See ``Constraint``."""
        jacobian: Array = self._sides(goal)[:, :2] @ at.com_jacobian()[:2]
        return jacobian

    def _sides(self, goal: Goal) -> Array:
        corners = np.array(goal.corners)  # on several planes of another number, now and then
        return polygon_sides(corners, SIDES if self._begun.task.ground.planes else len(corners))

    def violation(self, goal: Goal, at: Kinematics) -> float:
        """See ``Constraint``."""
        x, y, _ = at.com
        return max(0.0, goal.task.com_margin - margin_of_place((x, y), goal.corners))


class JointLimits(Constraint):
    """Joints keep off their limits by the task's margin."""

    name = "joint-limits"

    def residual(self, goal: Goal, at: Kinematics) -> Array:
        """See ``Constraint``."""
        joints, low, high = at.qpos[-len(goal.lower) :], *self._limited
        return np.concatenate([(joints - goal.lower)[low], (goal.upper - joints)[high]])

    def jacobian(self, _: Goal, at: Configuration) -> Array:
        """See ``Constraint``."""
        each = np.eye(at.robot.nu, at.robot.nv, k=at.robot.nv - at.robot.nu)
        low, high = self._limited
        return np.concatenate([each[low], -each[high]])

    def violation(self, goal: Goal, at: Kinematics) -> float:
        """See ``Constraint``."""
        joints = at.qpos[-len(goal.lower) :].tolist()  # lists: of a dozen numbers quicker
        below, above = map(sub, goal.lower.tolist(), joints), map(sub, joints, goal.upper.tolist())
        return float(max(0.0, *below, *above))

    @cached_property
    def _limited(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        return np.isfinite(self._begun.lower), np.isfinite(self._begun.upper)


class GroundClearance(Constraint):
    """Every part but the feet is above the ground by the task's clearance."""

    name = "ground-clearance"

    def residual(self, goal: Goal, at: Kinematics) -> Array:
        """See ``Constraint``."""
        heights = self._shapes.part_heights(at, goal.task.ground, goal.rigid_targets, goal.depths)
        return np.array(heights) - goal.task.ground_clearance + CLEARANCE_TOLERANCE / 2

    def jacobian(self, goal: Goal, at: Configuration) -> Array:
        """See ``Constraint``."""
        return self._shapes.height_jacobian(at, goal.task.ground, goal.rigid_targets)

    def nearest(self, goal: Goal, at: Kinematics) -> Clearance | None:
        """Returns how high the lowest part is; None of a robot without any."""
        return self._shapes.lowest_part(at, goal.task.ground, goal.rigid_targets, goal.depths)


class SelfClearance(Constraint):
    """Links that are not neighbours are apart by the task's clearance."""

    name = "self-clearance"

    def residual(self, goal: Goal, at: Kinematics) -> Array:
        """See ``Constraint``."""
        pairs = self._shapes.nearest_pairs(at.qpos, _PAIRS)
        least = (goal.task.self_clearance or 0.0) - CLEARANCE_TOLERANCE / 2
        return np.array([pair.distance for pair in pairs]) - least

    def jacobian(self, _: Goal, at: Configuration) -> Array:
        """See ``Constraint``."""
        return self._shapes.distance_jacobian(at, _PAIRS)

    def nearest(self, _: Goal, at: Kinematics) -> Clearance | None:
        """Returns the least distance between links; None of a robot without such pairs."""
        return self._shapes.closest_links(at.qpos)


def _is_in_place(goal: Goal) -> bool:
    """Whether the com's place is given, and where it is in balance takes long to find.

    That the place is inside is then asked when the goal is made.
    """
    return bool(goal.task.ground.planes) and goal.task.com != "inside"


_CLEARANCES = (GroundClearance, SelfClearance)
"""Kinds: a union written where it is asked for would be made anew each time (4 us a stand)."""


class ConstraintEvaluation(NamedTuple):
    """How a configuration fulfils what a stand must.

    Attributes:
        violation: {constraint name: violation} [m, rad], without clearances and CoM margin.
        com_margin: Distance of the com from the support polygon's edge (m); negative outside.
        nearest: {clearance: what is nearest}, of those that are asked for.
    """

    violation: dict[str, float]
    com_margin: float
    nearest: dict[str, Clearance | None]


def evaluate_constraints(
    shapes: ClearanceShapes, goal: Goal, at: Kinematics
) -> ConstraintEvaluation:
    """Judges where a robot is by all that a stand of a goal must fulfil."""
    violation: dict[str, float] = {}
    near: dict[str, Clearance | None] = {}
    for one in make_constraints(shapes, goal):
        if isinstance(one, _CLEARANCES):
            near[one.name] = one.nearest(goal, at)
        elif not isinstance(one, SupportMargin):  # the com's margin is a result
            violation[one.name] = one.violation(goal, at)
    x, y, _ = at.com
    margin = math.inf if shapes.robot.welded else margin_of_place((x, y), goal.corners)
    return ConstraintEvaluation(violation, margin, near)


def make_constraints(shapes: ClearanceShapes, goal: Goal) -> Iterator[Constraint]:
    """Yields what a stand of a goal must fulfil, also where its numbers become others."""
    closure = shapes.robot.closure
    yield BaseHeight(shapes, goal)
    yield BaseOrientation(shapes, goal)
    yield Footholds(shapes, goal)
    if closure is not None:
        yield Loops(shapes, goal, closure)
    if goal.by_base:
        yield BasePlace(shapes, goal)
    elif goal.task.com != "inside":
        yield PlaceConstraint(shapes, goal)
    asked = goal.task.com_margin > 0.0 or not (goal.by_base or _is_in_place(goal))
    if asked and not shapes.robot.welded:
        yield SupportMargin(shapes, goal)
    yield JointLimits(shapes, goal)
    yield GroundClearance(shapes, goal)
    if goal.task.self_clearance is not None:
        yield SelfClearance(shapes, goal)
