"""Constraints of a stand, with residual, violation and, for most constraints, Jacobian.

`make_constraints` lists the constraints of a stand. PlaCo's tasks (`stance.solver`), the nonlinear
program (`stance.programme`) and the evaluation of a stand (`stance.judge`) use this list.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from operator import sub
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array
from pupper_analysis.robot.closure import Closure
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.structure import Kinematics
from pupper_analysis.stance.clearance import NUM_NEAREST_PAIRS, Clearance, ClearanceShapes
from pupper_analysis.stance.problem import StandTargets
from pupper_analysis.statics.support_polygon import SIDES, margin_of_position, polygon_sides

TASK_TOLERANCE = 1e-9
"""Residual [m, rad] below which a requirement of a stand task counts as satisfied. Clearances have
another tolerance (`CLEARANCE_TOLERANCE`). Chosen, not tuned: far below any manufacturing
tolerance."""

CLEARANCE_TOLERANCE = 1e-6
"""Largest violation of a required clearance [m] that is accepted as rounding. Chosen, not tuned."""


class Constraint:
    """Equation or inequality that a stand must satisfy, with residual, violation and Jacobian.

    Args:
        shapes: Robot with collision shapes.
        targets: Targets and limits of the stand (`StandTargets`).

    Attributes:
        name: Name of the constraint, which is the value of ``constraint`` in
            ``stance/fields.toml``. A constraint without a field in this file, such as ``loops``,
            has another name.
        is_equality: Whether the residual must be zero; otherwise it must not be negative.
        is_presatisfied: Whether the nonlinear program satisfies the constraint at each
            configuration that it evaluates (base height and orientation).
    """

    name: ClassVar[str]
    is_equality: ClassVar[bool] = False
    is_presatisfied: ClassVar[bool] = False

    # A stand is evaluated in 50 us, so the constructor computes nothing.
    def __init__(self, shapes: ClearanceShapes, targets: StandTargets) -> None:
        self._shapes, self._targets = shapes, targets

    def residual(self, targets: StandTargets, at: Kinematics) -> Array:
        """Return the residual of this constraint, shape (n,) [m, rad].

        An equality is satisfied if all elements are zero, an inequality if no element is negative.

        Args:
            targets: Targets of the constructor, or a copy with relaxed values, such as foot
                targets, base pose, CoM target or margins.
            at: Kinematics of the configuration.
        """
        raise NotImplementedError

    def jacobian(self, targets: StandTargets, at: Configuration) -> Array:
        """Return the Jacobian of the residual by qvel, shape (n, nv).

        Constraints with ``is_presatisfied`` have no Jacobian: the call raises NotImplementedError.

        Args:
            targets: Targets of the constructor, or a copy with relaxed values.
            at: Configuration.
        """
        raise NotImplementedError

    def violation(self, targets: StandTargets, at: Kinematics) -> float:
        """Return the largest violation of this constraint [m, rad]; 0 if it is satisfied."""
        left = self.residual(targets, at)
        return float((np.abs(left) if self.is_equality else -left).max(initial=0.0))


class BaseHeight(Constraint):
    """Constraint: the base frame has the required height."""

    name, is_equality, is_presatisfied = "base-height", True, True

    def residual(self, targets: StandTargets, at: Kinematics) -> Array:
        """Return the height of the base frame in the world minus the required height, (1,) [m]."""
        return at.qpos[2:3] - targets.height

    def violation(self, targets: StandTargets, at: Kinematics) -> float:
        """Return the distance of the base frame from the required height [m], at least 0."""
        return abs(float(at.qpos[2]) - targets.height)


class BaseOrientation(Constraint):
    """Constraint: the base has the required orientation."""

    name, is_equality, is_presatisfied = "base-orientation", True, True

    def residual(self, targets: StandTargets, at: Kinematics) -> Array:
        """Return the angle between base orientation and required one, 0 to pi, shape (1,) [rad]."""
        return np.array([self.violation(targets, at)])

    def violation(self, targets: StandTargets, at: Kinematics) -> float:
        """Return the angle between base orientation and required orientation, 0 to pi [rad]."""
        return angle_between(targets.base_quaternion, at.qpos[3:7].tolist())


def angle_between(first: Sequence[float], second: Sequence[float]) -> float:
    """Return the angle of the rotation between two orientations, 0 to pi [rad].

    Args:
        first: Unit quaternion (w, x, y, z).
        second: Unit quaternion (w, x, y, z).
    """
    (a, b, c, d), (w, x, y, z) = first, second
    return 2 * math.atan2(
        math.hypot(
            a * x - b * w - c * z + d * y,
            a * y + b * z - c * w - d * x,
            a * z - b * y + c * x - d * w,
        ),
        abs(a * w + b * x + c * y + d * z),
    )


class Footholds(Constraint):
    """Constraint: the centres of all contact spheres are at their targets."""

    name, is_equality = "footholds", True

    def residual(self, targets: StandTargets, at: Kinematics) -> Array:
        """Return the positions of all contact points minus the targets, (3 n,) [m], world frame."""
        feet = at.feet
        apart = [feet[foot] - there for foot, there in targets.foot_targets.items()]
        return np.concatenate([*apart, np.zeros(0)])

    def jacobian(self, targets: StandTargets, at: Configuration) -> Array:
        """Return the Jacobian of the contact points' world positions by qvel, shape (3 n, nv)."""
        jacobians = at.foot_jacobians()
        return np.concatenate(
            [*map(jacobians.__getitem__, targets.foot_targets), np.zeros((0, at.robot.nv))]
        )

    def violation(self, targets: StandTargets, at: Kinematics) -> float:
        """Return the largest distance [m] between a contact point and its target position."""
        feet = at.feet
        apart = [
            math.dist(feet[foot], there.tolist()) for foot, there in targets.foot_targets.items()
        ]
        return max(apart, default=0.0)


class Loops(Constraint):
    """Constraint: loops and joint couplings are closed, up to a given static deflection.

    Args:
        shapes: Robot with collision shapes.
        targets: Targets and limits of the stand (`StandTargets`).
        closure: Closed loops and couplings of the robot.
    """

    name, is_equality = "loops", True

    def __init__(self, shapes: ClearanceShapes, targets: StandTargets, closure: Closure) -> None:
        super().__init__(shapes, targets)
        self._closure = closure

    def residual(self, targets: StandTargets, at: Kinematics) -> Array:
        """Return the openings of closed loops and joint couplings, shape (m,) [m, rad].

        An opening is the violation of one equation of a loop or coupling, minus its static
        deflection.
        """
        left = self._closure.residual(at.qpos)
        return left if targets.loop_opening is None else left - targets.loop_opening

    def jacobian(self, _: StandTargets, at: Configuration) -> Array:
        """Return the Jacobian (m, nv) by qvel of the residuals of m loop or coupling equations."""
        rows = self._closure.jacobian(at.qpos)
        return np.hstack([np.zeros((len(rows), at.robot.nv - at.robot.nu)), rows])

    def violation(self, targets: StandTargets, at: Kinematics) -> float:
        """Return the largest deviation of loops and couplings from the static deflection [m, rad].

        Infinite if a loop is assembled in another way than in the reference configuration, for
        example with crossed rods.
        """
        if not self._closure.has_reference_assembly(at.qpos):
            return math.inf
        return self._closure.violation_error(at.qpos, targets.loop_opening)


class PlaceConstraint(Constraint):
    """Constraint: CoM (base if ``StandTargets.by_base``) has the required horizontal position."""

    name, is_equality = "com-place", True

    def residual(self, targets: StandTargets, at: Kinematics) -> Array:
        """Return the horizontal position minus the target, (2,) [m], in the world frame.

        The position of the CoM, or of the base if ``StandTargets.by_base``, is constrained.
        """
        return (at.qpos[:2] if targets.by_base else np.array(at.com[:2])) - targets.place

    def jacobian(self, targets: StandTargets, at: Configuration) -> Array:
        """Return the Jacobian of the horizontal position of CoM or base by qvel, shape (2, nv)."""
        return np.eye(2, at.robot.nv) if targets.by_base else at.com_jacobian()[:2]

    def violation(self, targets: StandTargets, at: Kinematics) -> float:
        """Return the horizontal distance [m] of CoM (base if ``by_base``) and target."""
        here = at.qpos[:2].tolist() if targets.by_base else at.com[:2]
        return math.dist(here, targets.place.tolist())


class BasePlace(PlaceConstraint):
    """Constraint: the base has the required horizontal position."""

    name = "base-place"


class SupportMargin(Constraint):
    """Constraint: the projected CoM has the required distance from the support polygon's edge."""

    name = "support-margin"

    def residual(self, targets: StandTargets, at: Kinematics) -> Array:
        """Return the CoM's distances from the sides of the support polygon minus the margin.

        Shape (m,) [m], horizontal, positive inside; the value of the last side may be repeated. All
        values are >= 0 if the required margin is kept.
        """
        sides, com = self._polygon_sides(targets), np.array(at.com[:2])
        inside: Array = sides[:, :2] @ com + sides[:, 2]
        return inside - targets.task.com_margin

    def jacobian(self, targets: StandTargets, at: Configuration) -> Array:
        """Return the Jacobian (m, nv) of the CoM's distances from the support polygon's sides.

        Rows as in ``residual``, columns in the order of qvel. The polygon is treated as constant.
        """
        jacobian: Array = self._polygon_sides(targets)[:, :2] @ at.com_jacobian()[:2]
        return jacobian

    def _polygon_sides(self, targets: StandTargets) -> Array:
        """Return the sides of the support polygon, shape (m, 3): inward normal, offset [m]."""
        corners = np.array(targets.corners)  # on several planes their number may change
        return polygon_sides(corners, SIDES if self._targets.task.ground.planes else len(corners))

    def violation(self, targets: StandTargets, at: Kinematics) -> float:
        """Return the required CoM margin minus the actual margin [m]; 0 if the margin is kept.

        The margin is the horizontal distance of the CoM from the edge of the support polygon.
        """
        x, y, _ = at.com
        return max(0.0, targets.task.com_margin - margin_of_position((x, y), targets.corners))


class JointLimits(Constraint):
    """Constraint: all joints are within their limits, reduced by the margin of the task."""

    name = "joint-limits"

    def residual(self, targets: StandTargets, at: Kinematics) -> Array:
        """Return the distances of the joints from the finite limits in ``targets``, (n,) [rad, m].

        First the distances from lower limits, then from upper limits; negative beyond a limit.
        """
        joints, low, high = at.qpos[-len(targets.lower) :], *self._has_limits
        return np.concatenate([(joints - targets.lower)[low], (targets.upper - joints)[high]])

    def jacobian(self, _: StandTargets, at: Configuration) -> Array:
        """Return the Jacobian by qvel of the n distances to finite joint limits, shape (n, nv)."""
        rows = np.eye(at.robot.nu, at.robot.nv, k=at.robot.nv - at.robot.nu)
        low, high = self._has_limits
        return np.concatenate([rows[low], -rows[high]])

    def violation(self, targets: StandTargets, at: Kinematics) -> float:
        """Return the largest excess of a joint position beyond the limits [rad, m]."""
        joints = at.qpos[-len(targets.lower) :].tolist()  # lists are faster for a dozen numbers
        below = map(sub, targets.lower.tolist(), joints)
        above = map(sub, joints, targets.upper.tolist())
        return float(max(0.0, *below, *above))

    @cached_property
    def _has_limits(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Two masks (nu,): joints with a finite lower limit, joints with a finite upper limit."""
        return np.isfinite(self._targets.lower), np.isfinite(self._targets.upper)


class GroundClearance(Constraint):
    """Constraint: the required height of ``ClearanceShapes.parts`` (no feet) above the ground."""

    name = "ground-clearance"

    def residual(self, targets: StandTargets, at: Kinematics) -> Array:
        """Return the heights of n shapes above the ground minus the required clearance, (n,) [m].

        A residual >= 0 satisfies the constraint. The shapes are ``ClearanceShapes.parts``, in that
        order. Half of `CLEARANCE_TOLERANCE` is added, so that a solver's small errors do not
        violate the constraint.
        """
        heights = self._shapes.measure_part_heights(
            at, targets.task.ground, targets.rigid_targets, targets.depths
        )
        return np.array(heights) - targets.task.ground_clearance + CLEARANCE_TOLERANCE / 2

    def jacobian(self, targets: StandTargets, at: Configuration) -> Array:
        """Return the Jacobian by qvel of the heights of n collision shapes, shape (n, nv)."""
        return self._shapes.height_jacobian(at, targets.task.ground, targets.rigid_targets)

    def smallest_clearance(self, targets: StandTargets, at: Kinematics) -> Clearance | None:
        """Return the lowest shape in ``ClearanceShapes.parts``: height above ground [m], link.

        None without such shapes, or without ground.
        """
        return self._shapes.find_lowest_part(
            at, targets.task.ground, targets.rigid_targets, targets.depths
        )


class SelfClearance(Constraint):
    """Constraint: links that are not neighbours have the required distance."""

    name = "self-clearance"

    def residual(self, targets: StandTargets, at: Kinematics) -> Array:
        """Return the distances of the nearest shape pairs minus the required distance, (n,) [m].

        A residual >= 0 satisfies the constraint. Half of `CLEARANCE_TOLERANCE` is added, so that a
        solver's small errors do not violate the constraint.
        """
        pairs = self._shapes.find_nearest_pairs(at.qpos, NUM_NEAREST_PAIRS)
        least = (targets.task.self_clearance or 0.0) - CLEARANCE_TOLERANCE / 2
        return np.array([pair.distance for pair in pairs]) - least

    def jacobian(self, _: StandTargets, at: Configuration) -> Array:
        """Return the Jacobian by qvel of the n smallest distances of shapes, shape (n, nv)."""
        return self._shapes.distance_jacobian(at, NUM_NEAREST_PAIRS)

    def smallest_clearance(self, _: StandTargets, at: Kinematics) -> Clearance | None:
        """Return the smallest distance [m] of links that are not neighbours, with both links.

        None without such links with collision shapes.
        """
        return self._shapes.find_closest_links(at.qpos)


def _has_fixed_com_on_planes(targets: StandTargets) -> bool:
    """Return True if the task has a CoM target, and a foot or hand has a separate plane.

    A CoM margin of 0 is then not a constraint, since the support region is slow to compute.
    """
    return bool(targets.task.ground.planes) and targets.task.com != "inside"


_CLEARANCE_TYPES = (GroundClearance, SelfClearance)
"""Constraint types whose smallest distance is part of a stand's result. A tuple, because a union
expression in ``isinstance`` would be slower."""


class ConstraintEvaluation(NamedTuple):
    """Violations and clearances of a configuration.

    Attributes:
        violation: {constraint name: violation} [m, rad], without clearances and CoM margin;
            infinite for loops in another assembly.
        com_margin: Distance of the CoM from the edge of the support polygon [m]; negative outside;
            infinite for a welded robot.
        nearest: {clearance name: smallest clearance} of the ground clearance and, if requested, the
            self clearance; None without such parts or ground.
    """

    violation: dict[str, float]
    com_margin: float
    nearest: dict[str, Clearance | None]


def evaluate_constraints(
    shapes: ClearanceShapes, targets: StandTargets, at: Kinematics
) -> ConstraintEvaluation:
    """Compute the clearances of a configuration, and its violations of a task's requirements.

    Args:
        shapes: Robot with collision shapes.
        targets: Targets and limits of the stand (`StandTargets`).
        at: Kinematics of the configuration.

    Returns:
        Violations [m, rad], CoM margin [m], and smallest clearances.
    """
    violation: dict[str, float] = {}
    near: dict[str, Clearance | None] = {}
    for constraint in make_constraints(shapes, targets):
        if isinstance(constraint, _CLEARANCE_TYPES):
            near[constraint.name] = constraint.smallest_clearance(targets, at)
        elif not isinstance(constraint, SupportMargin):  # the CoM margin is a result
            violation[constraint.name] = constraint.violation(targets, at)
    x, y, _ = at.com
    margin = math.inf if shapes.robot.is_welded else margin_of_position((x, y), targets.corners)
    return ConstraintEvaluation(violation, margin, near)


def make_constraints(shapes: ClearanceShapes, targets: StandTargets) -> Iterator[Constraint]:
    """Yield the constraints that a stand task imposes, such as base height and joint limits."""
    closure = shapes.robot.closure
    yield BaseHeight(shapes, targets)
    yield BaseOrientation(shapes, targets)
    yield Footholds(shapes, targets)
    if closure is not None:
        yield Loops(shapes, targets, closure)
    if targets.by_base:
        yield BasePlace(shapes, targets)
    elif targets.task.com != "inside":
        yield PlaceConstraint(shapes, targets)
    limits_com = targets.task.com_margin > 0.0 or not (
        targets.by_base or _has_fixed_com_on_planes(targets)
    )
    if limits_com and not shapes.robot.is_welded:
        yield SupportMargin(shapes, targets)
    yield JointLimits(shapes, targets)
    yield GroundClearance(shapes, targets)
    if targets.task.self_clearance is not None:
        yield SelfClearance(shapes, targets)
