"""Search for a stand that meets numeric targets (`StandTargets`), from several initial guesses.

`search_stand` tries, in this order: PlaCo's IK from the default joint positions (the task's
``ik_seed``, home, middle of the ranges); IK from combinations of the legs' IK branches; and in some
cases, for example with a free CoM, the nonlinear program of all constraints (`stance.programme`)
from several initial configurations. The result is a solved stand, or the best failure.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from itertools import islice
from operator import itemgetter

import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.frozen import freeze_arrays
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.branches import (
    Branch,
    IndependentLimb,
    combine_branches,
    find_branches,
    follow_branches,
)
from pupper_analysis.stance.clearance import ClearanceShapes
from pupper_analysis.stance.constraints import TASK_TOLERANCE, make_constraints
from pupper_analysis.stance.judge import Stand, evaluate_stand, is_base_in_ground
from pupper_analysis.stance.problem import StandTargets, has_redundant_joints
from pupper_analysis.stance.programme import StanceProgram
from pupper_analysis.stance.solver import SearchContext, SolverResult

_MAX_COMBINATIONS_PER_ROUND = 256
"""Upper bound of the number of combinations of IK branches that are tried as initial guesses in a
round (see `_BRANCH_ROUNDS`). Derived from four legs with four branches each."""

_BRANCH_ROUNDS = 4
"""Upper bound of the number of rounds of a stand search. A round determines the IK branches of the
limbs for the base pose of the best configuration, and tries combinations of these branches. Chosen,
not tuned."""

_CLOSE_MISS = 3e-3
"""Foot error [m] of the best stand so far, below which a search also tries initial guesses with a
displaced base, since a clearance may be the obstacle. Chosen, not tuned."""

_MAX_DISPLACED_GUESSES = 32
"""Upper bound of the number of initial guesses with a displaced base. Chosen, not tuned."""

_MISS_TOLERANCE = 0.1
"""Largest relative excess of a foot error over the smallest foot error, with which both count as
equal (see `_MIN_AGREEING_GUESSES`). Chosen, not tuned."""

_MIN_AGREEING_GUESSES = 8
"""Number of initial guesses of the nonlinear program that agree on the smallest foot error (within
`_MISS_TOLERANCE`), with which the search usually ends. Measured on 400 stands, most at the limit
of reach: 399 stands were found before two guesses agreed, the remaining stand after four."""

_NUM_RANDOM_GUESSES = 32
"""Number of random initial guesses for robots with a sole on a leg of fewer than six joints.
Measured on 48 stands of six bipeds: the guesses found one additional stand."""

CLEARANCE_NAMES = ("ground-clearance", "self-clearance")
"""Names of the clearance constraints, which searches for the smallest foot error omit."""


def search_stand(
    context: SearchContext,
    targets: StandTargets,
    *,
    default_guesses_only: bool = False,
    com_at_centre_only: bool = False,
) -> Stand:
    """Search for a stand from several initial guesses; return the stand, or else the best failure.

    Args:
        context: Search context of the robot.
        targets: Targets and limits of the stand (`StandTargets`).
        default_guesses_only: If True, use only IK from `default_initial_guesses`.
        com_at_centre_only: If True, omit the search by the nonlinear program, so that a free CoM is
            usually above the centre of the feet.

    Returns:
        A solved stand, or the best failure (`Stand.solved` is False).
    """
    there = _StandSearch(context, targets)
    found = there.try_initial_guesses(default_initial_guesses(context.robot, targets))
    if found is not None or default_guesses_only:
        return found or there.best_stand()
    found = there.try_branches()
    if found is not None or com_at_centre_only:
        return found or there.best_stand()
    return there.try_program()


def search_near_stand(context: SearchContext, targets: StandTargets, near: Stand) -> Stand | None:
    """Search for a stand that meets the targets, with a nearby stand as the only initial guess.

    None if no stand is found, which does not prove that no stand exists.

    Args:
        context: Search context of the robot.
        targets: Targets and limits of the stand (`StandTargets`).
        near: Stand of a similar task.
    """
    found = search_from_joints(context, targets, near.joint_positions(context.robot))
    if found is None and targets.com_is_free:
        found, _ = solve_constraints(context, targets, near.qpos)
    return found


def search_from_joints(
    context: SearchContext, targets: StandTargets, joints: Array
) -> Stand | None:
    """Search for a stand that meets the targets by IK from an initial guess of the joint positions.

    Args:
        context: Search context of the robot.
        targets: Targets and limits of the stand (`StandTargets`).
        joints: Initial joint positions, shape (nu,) [rad, m].

    Returns:
        Solved stand; None if IK does not reach a stand.
    """
    return _StandSearch(context, targets).add(context.solver.solve_from_joints(targets, joints))


def solve_constraints(
    context: SearchContext, targets: StandTargets, qpos: Array
) -> tuple[Stand | None, float]:
    """Search for a stand by the nonlinear program, from an initial configuration.

    Args:
        context: Search context of the robot.
        targets: Targets and limits of the stand (`StandTargets`).
        qpos: Initial configuration, shape (nq,).

    Returns:
        Solved stand, or None; and smallest foot error [m], 0 if it was not minimised.
    """
    there, programme = _StandSearch(context, targets), StanceProgram(context.shapes, targets)
    stand = there.solve_program(programme, qpos) or there.solve_from_minimum(programme, qpos)
    return stand if stand is not None and stand.solved else None, min(there.misses, default=0.0)


def search_from_configuration(
    context: SearchContext, targets: StandTargets, qpos: Array
) -> Stand | None:
    """Search for a stand that meets the targets by IK from a nearby configuration.

    Args:
        context: Search context of the robot.
        targets: Targets and limits of the stand (`StandTargets`).
        qpos: Initial configuration, shape (nq,).

    Returns:
        Solved stand; None if IK does not reach a stand.
    """
    return _StandSearch(context, targets).add(
        context.solver.solve_from_configuration(targets, qpos)
    )


class _StandSearch:
    """State of a search for a stand: results of the solvers so far, and stands with feet in place.

    Args:
        context: Search context of the robot.
        targets: Targets and limits of the stand (`StandTargets`).

    Attributes:
        iterations: Number of quadratic programs so far.
        closest: Stand with the smallest minimised foot error; None before a minimisation.
        misses: Minimised foot errors [m] (`minimise_foot_errors`), one per initial configuration.
        points: Results of the IK solver that were added by `add`.
        reached: Stands with the feet in place, or nearly in place.
        found: IK branches of each limb in the last round.
    """

    def __init__(self, context: SearchContext, targets: StandTargets) -> None:
        self.context, self.shapes, self.robot = context, context.shapes, context.robot
        self.targets, self.iterations = targets, 0
        self.closest: Stand | None = None
        self.misses: list[float] = []
        self.points: list[SolverResult] = []
        self.reached: list[Stand] = []
        self.found: dict[IndependentLimb, tuple[Branch, ...]] = {}

    @cached_property
    def _is_base_in_ground(self) -> bool:
        """Whether the required base pose violates the ground clearance (`is_base_in_ground`)."""
        return is_base_in_ground(self.shapes, self.targets)

    def try_initial_guesses(self, joints: Iterable[Array]) -> Stand | None:
        """Solve IK from one initial guess after another, and return the first stand.

        If the required base pose violates the ground clearance, the stand may violate it, too.

        Args:
            joints: Initial guesses of the joint positions, shape (nu,) [rad, m] each.

        Returns:
            Stand; None if no guess leads to a stand.
        """
        for start in joints:
            stand = self.add(self.context.solver.solve_from_joints(self.targets, start))
            if stand is None and self.reached and self._is_base_in_ground:
                stand = self.reached[0]
            if stand is not None:
                return stand
        return None

    def try_branches(self) -> Stand | None:
        """Solve IK from combinations of the legs' IK branches, as in `try_initial_guesses`.

        Returns:
            Stand; None if no combination leads to a stand.
        """
        robot, targets = self.robot, self.targets
        for _ in range(_BRANCH_ROUNDS):
            nearest = self._get_nearest_result()
            self.found = find_branches(
                robot, nearest.qpos, targets.foot_targets, targets.lower, targets.upper
            )
            reach = 0.0 if targets.by_base else bound_com_shift(robot, nearest.qpos, self.found)
            found = self.try_initial_guesses(
                branch_initial_guesses(
                    robot, targets, self.found, reach, _MAX_COMBINATIONS_PER_ROUND
                )
            )
            if found is not None:
                return found
            # With a much smaller error, legs may have additional branches.
            if self.reached or self._get_nearest_result().foot_error > nearest.foot_error / 2:
                break
        return None

    def try_program(self) -> Stand:
        """Search by the nonlinear program from several initial configurations, if it can help.

        Returns:
            Solved stand, or else the best stand of the search, which may violate the targets.
        """
        best = self.best_stand()
        if best.solved or (self._is_base_in_ground and self.reached):
            return best
        if not self.targets.com_is_free and not (self.reached and has_redundant_joints(self.robot)):
            return best
        if self.targets.com_is_free:
            reach = support_radius(self.targets) + bound_com_shift(
                self.robot, best.qpos, self.found
            )
            if any(branches[0].foot_error > reach for branches in self.found.values()):
                return best  # no CoM displacement can compensate
        without = CLEARANCE_NAMES if self._is_base_in_ground else ()
        programme = StanceProgram(self.shapes, self.targets, without=without)
        for qpos in self._generate_initial_configurations(best):
            stand = self.solve_program(programme, qpos) or self.solve_from_minimum(programme, qpos)
            if stand is not None and (stand.solved or self._is_base_in_ground):
                return stand
            if self._have_guesses_converged() and not self._is_underactuated:
                break
        return self.best_stand()

    @cached_property
    def _is_underactuated(self) -> bool:
        """Whether a sole is on a leg with fewer than six joints, which may tilt the sole."""
        return has_underactuated_feet(self.robot)

    def _have_guesses_converged(self) -> bool:
        """Return True if `_MIN_AGREEING_GUESSES` guesses ended near the smallest foot error."""
        least = min(self.misses, default=0.0)
        bound = (1 + _MISS_TOLERANCE) * least
        return sum(error <= bound for error in self.misses) >= _MIN_AGREEING_GUESSES

    def _generate_initial_configurations(self, best: Stand) -> Iterator[Array]:
        """Yield initial configurations (nq,) of the nonlinear program, first from ``best``."""
        robot, targets = self.robot, self.targets
        yield best.qpos
        if not targets.com_is_free:
            # A copy of the list, which grows meanwhile.
            yield from [stand.qpos for stand in self.reached if stand is not best]
            return
        for joints in default_initial_guesses(robot, targets):
            yield make_initial_configuration(robot, targets, joints, targets.centre[:2])
        if self._is_underactuated:
            yield from (
                make_initial_configuration(robot, targets, joints, targets.centre[:2])
                for joints in random_postures(targets, _NUM_RANDOM_GUESSES)
            )
        closest = self.best_stand()
        if closest.foot_error < _CLOSE_MISS:  # with a larger error, no clearance is the obstacle
            yield from islice(
                displaced_initial_guesses(self.shapes, targets, closest.qpos),
                _MAX_DISPLACED_GUESSES,
            )

    def solve_from_minimum(self, programme: StanceProgram, qpos: Array) -> Stand | None:
        """Minimise the foot error from a configuration (nq,), then solve a stand from there.

        None if no stand with the feet in place is found. Also None, without a minimisation, if the
        CoM is not free or such a stand was found before.
        """
        if not self.targets.com_is_free or self.reached:
            return None
        closest = minimise_foot_errors(self.context, self.targets, qpos, self.iterations)
        self.misses.append(closest.foot_error)
        if self.closest is None or closest.foot_error < self.closest.foot_error:
            self.closest = closest
        if closest.foot_error >= NEAR_MISS:
            return None
        return self.solve_program(programme, closest.qpos) or self._remove_foot_errors(closest.qpos)

    def _get_nearest_result(self) -> SolverResult:
        """Return the IK result of this search with the smallest foot error."""
        return min(self.points, key=lambda point: point.foot_error)

    def add(self, point: SolverResult) -> Stand | None:
        """Register an IK result in this search; return the stand if solved, else None.

        A stand with feet that are only nearly in place, or with slightly tilted soles, is also
        added to ``reached``.
        """
        self.points.append(point)
        self.iterations += point.iterations
        targets = self.targets
        if not point.converged:
            targets = relax_foot_orientation(self.robot, targets, point)
        if point.foot_error >= 2 * TASK_TOLERANCE and targets is self.targets:
            return None
        stand = self._make_stand(point, targets)
        if targets is not self.targets:
            stand = flatten_soles(self.context, self.targets, stand)
        self.reached.append(stand)
        return stand if stand.solved else None

    def solve_program(self, programme: StanceProgram, qpos: Array) -> Stand | None:
        """Solve a nonlinear program from a configuration (nq,), and refine the result by IK.

        Returns:
            Stand with the feet in place, which may violate clearances or the CoM margin; None on
            failure.
        """
        found = programme.solve(qpos)
        return None if found.violation > NEAR_MISS else self._remove_foot_errors(found.qpos)

    def _remove_foot_errors(self, qpos: Array) -> Stand | None:
        """Remove the foot errors of a configuration (nq,) by IK; return the stand or None."""
        targets = self.targets
        if targets.com_is_free:
            targets = replace(targets, place=Configuration(self.robot, qpos).center_of_mass()[:2])
        point = self.context.solver.solve_from_configuration(targets, qpos)
        self.iterations += point.iterations
        stand = self._make_stand(point, relax_foot_orientation(self.robot, targets, point))
        if stand.foot_error >= TASK_TOLERANCE:
            return None
        self.reached.append(stand)
        return stand

    def best_stand(self) -> Stand:
        """Return the best stand of the search so far, which may violate the targets."""
        if self.reached:
            return max(self.reached, key=lambda stand: (stand.solved, stand.constraint_slack))
        return self.closest or self._make_stand(self._get_nearest_result())

    def _make_stand(self, point: SolverResult, targets: StandTargets | None = None) -> Stand:
        """Create the `Stand` of an IK result, with errors for ``targets`` (default: own)."""
        return evaluate_stand(self.shapes, targets or self.targets, point.qpos, self.iterations)


def default_initial_guesses(robot: Robot, targets: StandTargets) -> Iterator[Array]:
    """Yield the default initial guesses of the joint positions, shape (nu,) [rad, m].

    In this order: ``ik_seed`` of the task, if present; the robot's home position; the middle of the
    targets' joint limits (zero for a joint without a lower or an upper limit).
    """
    if targets.task.ik_seed is not None:
        yield np.array(targets.task.ik_seed)
    yield robot.home[7:]
    bounded = np.isfinite(targets.lower) & np.isfinite(targets.upper)
    middle = (np.where(bounded, targets.lower, 0) + np.where(bounded, targets.upper, 0)) / 2
    yield np.where(bounded, middle, 0.0)


def minimise_foot_errors(
    context: SearchContext, targets: StandTargets, qpos: Array, iterations: int = 0
) -> Stand:
    """Minimise the sum of the squared distances of the feet from their targets; return the `Stand`.

    The minimum may be local. Clearances are ignored.

    Args:
        context: Search context of the robot.
        targets: Targets and limits of the stand (`StandTargets`).
        qpos: Initial configuration, shape (nq,).
        iterations: Number of quadratic programs solved before, stored in the returned stand.
    """
    feet = StanceProgram(context.shapes, targets, without=(*CLEARANCE_NAMES, "footholds"))
    return evaluate_stand(context.shapes, targets, feet.minimise_foot_distances(qpos), iterations)


def flatten_soles(context: SearchContext, targets: StandTargets, stand: Stand) -> Stand:
    """Reduce the tilt of soles on legs with fewer than six joints, by moving the CoM.

    IK may tilt the soles of such legs to bring the CoM to ``targets.place``. In a simulation,
    servos would press tilted soles flat, with torques that the static balance does not contain.

    Args:
        context: Search context of the robot.
        targets: Targets and limits of the stand (`StandTargets`).
        stand: Stand with tilted soles.

    Returns:
        A stand with smaller foot errors, since the tilt causes foot errors; the unchanged stand,
        for example, if the tilt cannot be reduced.
    """
    robot = context.robot
    if not targets.com_is_free:
        return stand

    def foot_error(tried: Stand) -> float:
        """Return the largest distance of a loaded contact point from its target in a stand [m]."""
        places = Configuration(robot, tried.qpos).foot_positions()
        return max(
            float(np.linalg.norm(places[f] - targets.foot_targets[f])) for f in targets.stance_feet
        )

    closest = minimise_foot_errors(context, targets, stand.qpos, stand.iterations)
    at = replace(targets, place=Configuration(robot, closest.qpos).center_of_mass()[:2])
    point = SolverResult(closest.qpos, closest.foot_error, stand.iterations)
    at = relax_foot_orientation(robot, at, point)
    other = evaluate_stand(context.shapes, at, point.qpos, stand.iterations)
    return min(other, stand, key=foot_error) if other.solved else stand


MAX_SOLE_ERROR = 5e-5
"""Upper bound of the foot error [m] with which a sole on a leg of fewer than six joints is accepted
as in place. Chosen below the usual penetration of feet into MuJoCo's ground."""

_NUM_POSE_JOINTS = 6
"""Smallest number of joints with which a leg can place its sole in any pose: six, the degrees of
freedom of a pose."""


def has_underactuated_feet(robot: Robot) -> bool:
    """Return True if a sole (several contact points) is on a leg with fewer than six joints.

    Such a leg cannot reach every pose of the sole, and IK may leave the sole tilted.
    """
    return bool(count_joints_of_short_legs(robot))


def count_joints_of_short_legs(robot: Robot) -> dict[str, int]:
    """Return {foot: number of joints} of the legs with a sole and fewer than six joints."""
    counts = {
        foot: _count_leg_joints(robot, points[0])
        for foot, points in robot.feet.items()
        if len(points) > 1
    }
    return {foot: count for foot, count in counts.items() if count < _NUM_POSE_JOINTS}


def describe_mechanism_limit(robot: Robot, targets: StandTargets) -> Diagnostic | None:
    """Explain by the robot's mechanism why no stand was found; None if it is no probable reason.

    Reasons are closed loops that open under the load, and flat feet to be moved on legs with fewer
    than six joints.
    """
    task = targets.task
    if targets.loop_opening is not None and targets.loop_opening.any():
        return diagnose(
            "loops-give-way", most=Quantity(abs(targets.loop_opening).max(), "rad or m")
        )
    moved = {*task.swing, *task.foot_offsets}
    short = {
        sole: count
        for sole, count in count_joints_of_short_legs(robot).items()
        if {sole, *robot.feet[sole]} & moved
    }
    if not short:
        return None
    sole = min(short, key=short.__getitem__)
    return diagnose("sole-needs-six-joints", subject=("foot", sole), joints=short[sole])


def _count_leg_joints(robot: Robot, point: str) -> int:
    """Count the joints between a contact point and the base."""
    model = robot.pin_model
    frame = model.getFrameId(robot.contact_frames[point], pin.FrameType.BODY)
    above = model.supports[model.frames[frame].parentJoint]
    return sum(model.names[joint] in robot.joint_names for joint in above)


def relax_foot_orientation(
    robot: Robot, targets: StandTargets, point: SolverResult
) -> StandTargets:
    """Replace foot targets by the positions that IK reached, if a leg cannot lay its sole flat.

    Args:
        robot: Robot.
        targets: Targets with the foot targets to replace.
        point: Result of the IK solver, with the reached configuration.

    Returns:
        Targets; unchanged if IK converged, or the feet are not nearly in place, for example.
    """
    if point.converged or point.foot_error >= MAX_SOLE_ERROR or not has_underactuated_feet(robot):
        return targets
    places = Configuration(robot, point.qpos).foot_positions()
    return replace(
        targets, foot_targets=freeze_arrays({foot: places[foot] for foot in targets.foot_targets})
    )


NEAR_MISS = 1e-3
"""Largest foot error [m], or constraint violation of the nonlinear program [m, rad], with which IK
refines a configuration. A small displacement of the CoM may bring the feet to their targets. Also a
reserve in other searches, for example in `bound_com_shift`. Chosen, not tuned."""

_MAX_BASE_SHIFT = 0.75
"""Largest displacement of the base in x and in y, in stand heights, of the initial guesses with a
displaced base. Chosen, not tuned."""

_NUM_SHIFTS = 11
"""Number of displaced base positions along x and along y that are tried as initial guesses. The
positions are 20 mm apart for Pupper v3. Measured: with 5, a stand was missed."""

_MAX_TRIED_COMBINATIONS = 64
"""Upper bound of the number of combinations of IK branches that are evaluated per displaced base
position. Measured: with 16, a stand of a Mini Cheetah on a slope of 62 deg was missed."""

_GUESSES_PER_BASE_POSITION = 4
"""Upper bound of the number of initial guesses per displaced base position. The guesses with the
smallest constraint violation are kept. Chosen, not tuned."""

_MAX_REACH_ERROR = 5e-3
"""Upper bound of the foot error [m] of IK branches at a displaced base that are used in initial
guesses. Chosen, not tuned."""

_SHIFT_SAFETY_FACTOR = 1.5
"""Safety factor [1] on the base displacement that `bound_com_shift` estimates for a change of IK
branches. If the estimate is too small, branches that are in reach are rejected. Chosen, not
tuned."""


def random_postures(targets: StandTargets, count: int) -> Iterator[Array]:
    """Yield random joint positions, shape (nu,) [rad, m], usually within joint limits and +-pi.

    The seed of the generator is fixed.
    """
    low, high = np.maximum(targets.lower, -np.pi), np.minimum(targets.upper, np.pi)
    random = np.random.default_rng(0)
    yield from random.uniform(low, np.maximum(low, high), (count, len(low)))


def branch_initial_guesses(
    robot: Robot,
    targets: StandTargets,
    found: Mapping[IndependentLimb, tuple[Branch, ...]],
    reach: float,
    most: int,
) -> Iterator[Array]:
    """Yield initial guesses of the joint positions, (nu,) [rad, m]: combinations of IK branches.

    Combinations with small foot errors, near ``ik_seed`` of the task or else near home, come first.

    Args:
        robot: Robot.
        targets: Targets with the initial guess ``ik_seed`` of the task.
        found: {limb: IK branches of the limb}.
        reach: Upper bound of the base displacement [m] from the base pose for which the branches
            were computed. A displacement of the base by d changes a foot error by at most d.
            Therefore, branches with a foot error above ``reach + NEAR_MISS`` are omitted.
        most: Upper bound of the number of guesses.
    """
    near = robot.home[7:] if targets.task.ik_seed is None else np.array(targets.task.ik_seed)
    likely = {
        limb: tuple(branch for branch in branches if branch.foot_error <= reach + NEAR_MISS)
        for limb, branches in found.items()
    }
    yield from islice(combine_branches(likely, near), most)


def bound_com_shift(
    robot: Robot, qpos: Array, found: Mapping[IndependentLimb, tuple[Branch, ...]]
) -> float:
    """Estimate the largest base displacement [m] that a change of the IK branches may require.

    If branches change at a fixed CoM, the base must move. The estimate is ``_SHIFT_SAFETY_FACTOR *
    sum_limbs max_b |c_b - c_0| + NEAR_MISS``. c_b is the horizontal CoM [m] if the limb is in
    branch b, and c_0 if it is in its first branch.

    Args:
        robot: Robot.
        qpos: Configuration, shape (nq,), of the base and the other limbs.
        found: {limb: IK branches of the limb, at least 1}.
    """
    total = 0.0
    for limb, branches in found.items():
        coms = []
        for branch in branches:
            bent = qpos.copy()
            bent[robot.nq - robot.nu + limb.joints] = branch.positions
            coms.append(Configuration(robot, bent).center_of_mass()[:2])
        total += float(np.max(np.linalg.norm(np.array(coms) - coms[0], axis=1)))
    return _SHIFT_SAFETY_FACTOR * total + NEAR_MISS


def support_radius(targets: StandTargets) -> float:
    """Return the largest horizontal distance [m] from the centre of the feet to a support corner.

    Without support corners, foot targets are used instead.
    """
    corners = targets.corners or [target[:2] for target in targets.foot_targets.values()]
    distances = [np.linalg.norm(corner - targets.centre[:2]) for corner in np.array(corners)]
    return float(max(distances, default=0.0))


def make_initial_configuration(
    robot: Robot, targets: StandTargets, joints: Array, place: Array
) -> Array:
    """Return a configuration, shape (nq,), with given joint and horizontal CoM positions.

    The base has the height and orientation of the targets.

    Args:
        robot: Robot.
        targets: Targets with height and orientation of the base, and joint limits.
        joints: Joint positions, shape (nu,) [rad, m]; clipped to the limits.
        place: Horizontal CoM position, shape (2,) [m], in the world frame.
    """
    bent = np.clip(joints, targets.lower, targets.upper)
    qpos = np.array([0.0, 0.0, targets.height, *targets.base_quaternion, *bent])
    qpos[:2] = place - Configuration(robot, qpos).center_of_mass()[:2]
    return qpos


def displaced_initial_guesses(
    shapes: ClearanceShapes, targets: StandTargets, qpos: Array
) -> Iterator[Array]:
    """Yield initial configurations (nq,) with a displaced base, from several IK branches.

    The cost of a configuration is the sum of the violations of all constraints except the foot
    positions [m and rad mixed]. Configurations are yielded in ascending order of cost.

    Args:
        shapes: Robot with collision shapes.
        targets: Targets with a free CoM (`StandTargets.com_is_free`).
        qpos: Configuration with feet near the targets, shape (nq,).
    """
    robot = shapes.robot
    found = find_branches(robot, qpos, targets.foot_targets, targets.lower, targets.upper)
    along = np.linspace(-_MAX_BASE_SHIFT, _MAX_BASE_SHIFT, _NUM_SHIFTS) * robot.stand_height
    moves = np.array([(x, y, 0.0) for x in along for y in along])
    followed = follow_branches(
        robot, qpos, targets.foot_targets, targets.lower, targets.upper, found, moves
    )
    constraints = [c for c in make_constraints(shapes, targets) if c.name != "footholds"]
    starts: list[tuple[float, Array]] = []
    for number, move in enumerate(moves):
        near = {
            limb: tuple(
                branch for branch in branches[number] if branch.foot_error < _MAX_REACH_ERROR
            )
            for limb, branches in followed.items()
        }
        here = []
        for joints in islice(combine_branches(near, qpos[-robot.nu :]), _MAX_TRIED_COMBINATIONS):
            start = np.concatenate([qpos[:3] + move, qpos[3:7], joints])
            at = shapes.move_to(start)
            here.append((sum(c.violation(targets, at) for c in constraints), start))
        starts += sorted(here, key=itemgetter(0))[:_GUESSES_PER_BASE_POSITION]
    yield from (start for _, start in sorted(starts, key=itemgetter(0)))
