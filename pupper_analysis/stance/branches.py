"""Branches of a leg's inverse kinematics (IK): leg postures with the same foot position.

A leg with three joints reaches a foot position with a few postures, for example knee forward or
backward. With a fixed base the limbs are independent. Therefore the branches of each limb are found
separately, by Levenberg-Marquardt iterations from many initial guesses. A configuration of the
robot combines one branch per limb.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array, BoolArray, IntArray
from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.units import select_joint_units
from pupper_analysis.robot.joints import is_slide
from pupper_analysis.robot.robot import Robot

_NUM_STARTS = 32
"""Number of random initial guesses of the inverse kinematics of a limb. Measured on 800 random foot
targets of three-joint legs: 32 guesses find all but one of the IK branches that 256 guesses find.
"""

_MAX_ITERATIONS = 14
"""Upper bound of the number of Levenberg-Marquardt iterations from one initial guess. Chosen, not
tuned."""

_MAX_FOLLOW_ITERATIONS = 5
"""Upper bound of the number of Levenberg-Marquardt iterations that adapt a known IK branch to
another base position. Chosen, not tuned."""

_BRANCH_DISTANCE = 0.05
"""Largest difference between joint positions [rad or m], up to which two solutions count as the
same branch. Chosen, not tuned."""

_FOOT_ERROR_STEP = 1e-6
"""Step [m] to which foot errors are rounded before branches are sorted, so that the order rarely
depends on rounding errors. Chosen, not tuned."""

_JOINT_DISTANCE_STEP = 1e-3
"""Step [rad or m] to which joint distances of combined IK branches are rounded before sorting, so
that the order rarely depends on rounding errors. Chosen, not tuned.
"""

_MAX_BRANCHES = 6
"""Upper bound of the number of IK branches that are kept per limb: those with the smallest foot
errors. The bound is needed since a redundant limb has a continuum of solutions. Chosen, not
tuned."""

_INITIAL_DAMPING = 1e-3
"""Initial damping of the Levenberg-Marquardt iterations [m^2/rad^2]: a number that is added to the
diagonal of J^T J. The diagonal elements of J^T J are about 1e-2 for Pupper v3. Chosen, not
tuned."""

_MIN_DAMPING = 1e-12
"""Lower bound of the Levenberg-Marquardt damping after reductions [m^2/rad^2]. Chosen, not
tuned."""

_MAX_DAMPING = 1e3
"""Upper bound of the Levenberg-Marquardt damping after increases [m^2/rad^2]. Chosen, not
tuned."""

_CONVERGED_STEP = 1e-4
"""Largest displacement of a joint in an iteration [rad or m], up to which the Levenberg-Marquardt
iterations end. In a stand search PlaCo's IK removes the remaining error. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class IndependentLimb:
    """Limb: joints on the chains of links from the base to one or more feet, and to no other feet.

    Attributes:
        feet: Contact points at the ends of the chains. Feet that share a joint, such as a waist,
            belong to the same limb.
        joints: Indices of the joints in actuator order, shape (n,).
    """

    feet: tuple[str, ...]
    joints: IntArray


@dataclass(frozen=True, eq=False)
class Branch:
    """Posture of a limb: one solution of the inverse kinematics for the limb's feet.

    Attributes:
        positions: Joint positions, shape (n,) [rad, m].
        foot_error: Largest distance of a contact point from the target [m]. For reachable targets
            mostly small, but not zero, since the iterations end early (`_CONVERGED_STEP`).
    """

    positions: Array
    foot_error: float


def find_limbs(robot: Robot) -> tuple[IndependentLimb, ...]:
    """Find the limbs of a robot: contact points, with the joints between the base and the points.

    Contact points that share a joint belong to one limb.
    """
    model = robot.pin_model
    groups: list[tuple[set[str], set[int]]] = []
    for foot, frame in robot.contact_frames.items():
        joint = model.frames[model.getFrameId(frame, pin.FrameType.BODY)].parentJoint
        names = {model.names[index] for index in model.supports[joint]}
        joints = {robot.joint_names.index(name) for name in names if name in robot.joint_names}
        feet = {foot}
        for group in [g for g in groups if g[1] & joints]:
            groups.remove(group)
            feet, joints = feet | group[0], joints | group[1]
        groups.append((feet, joints))
    return tuple(
        IndependentLimb(
            feet=tuple(foot for foot in robot.contact_points if foot in feet),
            joints=np.array(sorted(joints), dtype=np.int64),
        )
        for feet, joints in groups
    )


def find_branches(
    robot: Robot, qpos: Array, foot_targets: Mapping[str, Array], lower: Array, upper: Array
) -> dict[IndependentLimb, tuple[Branch, ...]]:
    """Find the postures (IK branches) of each limb with the feet at targets, for a base pose.

    Bounded Levenberg-Marquardt iterations run from `_NUM_STARTS` random initial guesses, for all
    limbs at once.

    Args:
        robot: Robot with a free base.
        qpos: Configuration, shape (nq,), with the pose of the base and the positions of joints
            outside of limbs.
        foot_targets: {contact point: target of its sphere centre, shape (3,) [m], in the world
            frame}.
        lower: Lower joint limits, shape (nu,) [rad, m].
        upper: Upper joint limits, shape (nu,) [rad, m].

    Returns:
        {limb: at most `_MAX_BRANCHES` branches}; empty for a robot without feet. The branch with
        the smallest foot error (rounded to `_FOOT_ERROR_STEP`) is first.

    Raises:
        ModelError: If the robot has feet, and the lower limit of a joint is above its upper limit.
    """
    if not robot.feet:
        return {}
    for name, least, most in zip(robot.joint_names, lower, upper, strict=True):
        if least > most:
            unit = select_joint_units(slides=is_slide(robot, name)).position
            crossed = diagnose(
                "joint-limits-crossed",
                subject=("joint", name),
                least=Quantity(float(least), unit),
                most=Quantity(float(most), unit),
            )
            raise ModelError(robot.description.urdf_source, crossed)
    low = np.where(np.isfinite(lower), lower, -math.pi)
    high = np.where(np.isfinite(upper), upper, math.pi)
    starts = np.random.default_rng(0).uniform(low, high, (_NUM_STARTS, robot.nu))
    positions, misses = _Descent(robot, qpos, foot_targets, lower, upper).run(starts, np.zeros(3))
    turning = robot.pin_convention.unbounded
    positions[:, turning] = _wrap_angle(positions[:, turning])
    positions = _remove_turns(robot, positions, lower, upper)
    kept = {
        limb: _distinct_branches(positions[:, limb.joints], missed, turning[limb.joints])
        for limb, missed in misses.items()
    }
    return {limb: _sort_branches(robot, qpos, limb, branches) for limb, branches in kept.items()}


def _sort_branches(
    robot: Robot, qpos: Array, limb: IndependentLimb, branches: tuple[Branch, ...]
) -> tuple[Branch, ...]:
    """Sort a limb's IK branches by foot error; then rearmost first, so that legs bend alike."""
    model, data = robot.pin_model, robot.pin_model.createData()
    numbers = [model.getJointId(robot.joint_names[joint]) for joint in limb.joints]

    def sort_key(branch: Branch) -> tuple[int, float]:
        """Return the rounded foot error, and the sum of the joint origins along base x [m]."""
        bent = qpos.copy()
        bent[robot.nq - robot.nu + limb.joints] = branch.positions
        pin.forwardKinematics(model, data, robot.pin_convention.q(bent))
        forward = data.oMi[1].rotation[:, 0]
        places = [float(forward @ data.oMi[number].translation) for number in numbers]
        return round(branch.foot_error / _FOOT_ERROR_STEP), sum(places)

    return tuple(sorted(branches, key=sort_key))


def follow_branches(
    robot: Robot,
    qpos: Array,
    foot_targets: Mapping[str, Array],
    lower: Array,
    upper: Array,
    found: Mapping[IndependentLimb, tuple[Branch, ...]],
    moves: Array,
) -> dict[IndependentLimb, list[tuple[Branch, ...]]]:
    """Compute how known IK branches of all limbs change if the base moves and the feet do not.

    Args:
        robot: Robot.
        qpos: Configuration, shape (nq,), with the base pose of ``found``; joints outside of limbs
            keep these positions.
        foot_targets: {contact point: target of its sphere centre, shape (3,) [m], in the world
            frame}.
        lower: Lower joint limits, shape (nu,) [rad, m].
        upper: Upper joint limits, shape (nu,) [rad, m].
        found: {limb: branches at the base pose of ``qpos``}.
        moves: Displacements of the base, shape (n, 3) [m], in the world frame.

    Returns:
        {limb: list of the limb's branches at each of the n base positions}; empty for a robot
        without feet.
    """
    if not found:
        return {}
    count = max(map(len, found.values()))
    starts = np.tile(qpos[robot.nq - robot.nu :], (count, 1))
    for limb, branches in found.items():
        for row in range(count):
            starts[row, limb.joints] = branches[row % len(branches)].positions
    descent = _Descent(robot, qpos, foot_targets, lower, upper)
    shifts = np.repeat(moves, count, axis=0)
    positions, misses = descent.run(
        np.tile(starts, (len(moves), 1)), shifts, _MAX_FOLLOW_ITERATIONS
    )
    turning = robot.pin_convention.unbounded
    return {
        limb: [
            _distinct_branches(joints, off, turning[limb.joints])
            for joints, off in zip(
                np.split(positions[:, limb.joints], len(moves)),
                np.split(missed, len(moves)),
                strict=True,
            )
        ]
        for limb, missed in misses.items()
    }


def _distinct_branches(positions: Array, missed: Array, turns: BoolArray) -> tuple[Branch, ...]:
    """Select up to `_MAX_BRANCHES` different branches of a limb from k solutions, best first.

    Args:
        positions: Joint positions of the solutions, shape (k, n) [rad, m].
        missed: Foot errors of the solutions, shape (k,) [m].
        turns: Mask of continuous joints, shape (n,).
    """
    kept: list[Branch] = []
    for index in np.argsort(missed, kind="stable"):
        away = [positions[index] - branch.positions for branch in kept]
        gaps = [np.abs(np.where(turns, _wrap_angle(a), a)).max(initial=0.0) for a in away]
        if all(gap > _BRANCH_DISTANCE for gap in gaps):  # a foot on the base has one branch
            kept.append(Branch(positions[index], float(missed[index])))
        if len(kept) == _MAX_BRANCHES:
            break
    return tuple(kept)


def _remove_turns(robot: Robot, positions: Array, lower: Array, upper: Array) -> Array:
    """Subtract whole turns from positions (k, nu) [rad] of hinges, towards home.

    Positions stay within the limits. Continuous joints are left unchanged.
    """
    model, convention = robot.pin_model, robot.pin_convention
    sliding = [
        model.joints[model.getJointId(name)].shortname().startswith("JointModelP")
        for name in robot.joint_names
    ]
    turns = np.round((positions - robot.home[robot.nq - robot.nu :]) / (2 * math.pi))
    nearer = positions - 2 * math.pi * turns
    kept = np.array(sliding) | convention.unbounded | (nearer < lower) | (nearer > upper)
    unwound: Array = np.where(kept, positions, nearer)
    return unwound


def _wrap_angle(angle: Array) -> Array:
    """Wrap angles to [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


class _Descent:
    """Levenberg-Marquardt search for joint positions with the feet at targets, from many guesses.

    Each guess and limb has its own damping.

    Args:
        robot: Robot.
        qpos: Configuration, shape (nq,), with the pose of the base and the joints outside of limbs.
        foot_targets: {contact point: target of its sphere centre, shape (3,) [m]}.
        lower: Lower joint limits, shape (nu,) [rad, m].
        upper: Upper joint limits, shape (nu,) [rad, m].
    """

    def __init__(
        self,
        robot: Robot,
        qpos: Array,
        foot_targets: Mapping[str, Array],
        lower: Array,
        upper: Array,
    ) -> None:
        model = robot.pin_model
        self._robot, self._model, self._data = robot, model, model.createData()
        self._q = robot.pin_convention.q(qpos)
        self._rest = qpos[robot.nq - robot.nu :]
        self._lower, self._upper = lower, upper
        self._foot_targets = np.array([foot_targets[foot] for foot in robot.contact_points])
        names = [robot.contact_frames[foot] for foot in robot.contact_points]
        frames = [model.frames[model.getFrameId(name, pin.FrameType.BODY)] for name in names]
        joints = [frame.parentJoint for frame in frames]
        last, self._rows = np.unique(joints, return_inverse=True)
        self._last = last.tolist()
        self._points = np.array([frame.placement.translation for frame in frames])[..., None]
        above = [{model.names[i] for i in model.supports[joint]} for joint in joints]
        self._limbs = find_limbs(robot)
        self._joints = np.concatenate(
            [limb.joints for limb in self._limbs]
        )  # joints that move a foot
        names = [robot.joint_names[joint] for joint in self._joints]
        self._moves = np.array([[name in own for name in names] for own in above])
        limbs = range(len(self._limbs))
        self._limb = np.repeat(limbs, [len(limb.joints) for limb in self._limbs])
        within = [[foot in limb.feet for limb in self._limbs] for foot in robot.contact_points]
        self._feet = np.argmax(within, axis=1)

    def run(
        self, starts: Array, moves: Array, iterations: int = _MAX_ITERATIONS
    ) -> tuple[Array, dict[IndependentLimb, Array]]:
        """Reduce the foot errors from several initial guesses by Levenberg-Marquardt iterations.

        Args:
            starts: Initial joint positions, shape (k, nu) [rad, m].
            moves: Displacements of the base in the world, shape (k, 3) or (3,) [m].
            iterations: Upper bound of iterations.

        Returns:
            Joint positions, shape (k, nu) [rad, m]; {limb: foot errors, shape (k,) [m]}.
        """
        foot_targets = self._foot_targets - np.broadcast_to(moves, (len(starts), 3))[:, None]
        low, high = self._lower[self._joints], self._upper[self._joints]
        joints = np.clip(starts[:, self._joints], low, high)
        errors, jacobians = self._evaluate_position_errors(joints, foot_targets)
        damping = np.full((len(joints), len(self._limbs)), _INITIAL_DAMPING)
        active = np.arange(len(joints))
        for _ in range(iterations):
            now, error, jacobian = joints[active], errors[active], jacobians[active]
            step = self._compute_steps(error, jacobian, now, damping[active][:, self._limb])
            tried = np.clip(now + step, low, high)
            moving = np.abs(tried - now).max(axis=1) > _CONVERGED_STEP
            active, now, tried, error = active[moving], now[moving], tried[moving], error[moving]
            if not len(active):
                break
            new_error, new_jacobian = self._evaluate_position_errors(tried, foot_targets[active])
            better = self._squared_errors(new_error) < self._squared_errors(error)  # (k, limbs)
            feet = better[:, self._feet, None]
            joints[active] = np.where(better[:, self._limb], tried, now)
            errors[active] = np.where(feet, new_error, error)
            jacobians[active] = np.where(feet[..., None], new_jacobian, jacobian[moving])
            changed = damping[active] * np.where(better, 0.1, 8.0)
            damping[active] = np.clip(changed, _MIN_DAMPING, _MAX_DAMPING)
        away = np.linalg.norm(errors, axis=2)
        return self._all_joints(joints), {
            limb: away[:, self._feet == number].max(axis=1)
            for number, limb in enumerate(self._limbs)
        }

    def _all_joints(self, joints: Array) -> Array:
        """Return positions of all joints (k, nu) from positions (k, n) of the limb joints."""
        every = np.tile(self._rest, (len(joints), 1))
        every[:, self._joints] = joints
        return every

    def _squared_errors(self, errors: Array) -> Array:
        """Return the sum of squared errors of each limb, shape (k, limbs) [m^2]."""
        squares: Array = (errors**2).sum(axis=2) @ (self._feet[:, None] == range(len(self._limbs)))
        return squares

    def _compute_steps(
        self, errors: Array, jacobians: Array, joints: Array, damping: Array
    ) -> Array:
        """Return Levenberg-Marquardt steps of n limb joints in k configurations, (k, n) [rad, m].

        Joints at a bound do not move if the direction of descent is outward.

        Args:
            errors: Position errors of the f contact points, shape (k, f, 3) [m].
            jacobians: Their derivative by the limb joints, shape (k, f, 3, n).
            joints: Positions of the limb joints, shape (k, n) [rad, m].
            damping: Damping of each joint, shape (k, n).
        """
        low, high = self._lower[self._joints], self._upper[self._joints]
        rows = jacobians.reshape(len(joints), -1, joints.shape[1])
        gradient = np.einsum("kij,ki->kj", rows, errors.reshape(len(joints), -1))
        held = (joints <= low) & (gradient > 0) | (joints >= high) & (gradient < 0)
        rows = np.where(held[:, None], 0.0, rows)
        normal = rows.transpose(0, 2, 1) @ rows
        diagonal = np.arange(joints.shape[1])
        normal[:, diagonal, diagonal] += damping
        step: Array = -np.linalg.solve(normal, np.where(held, 0.0, gradient)[..., None])[..., 0]
        return step

    def _evaluate_position_errors(self, joints: Array, foot_targets: Array) -> tuple[Array, Array]:
        """Compute position errors of f contact points in k configurations, and their derivatives.

        Returns:
            Errors in world axes, shape (k, f, 3) [m]; derivatives by the j limb joints, shape (k,
            f, 3, j), zero for joints that do not move the point.
        """
        convention, model, data = self._robot.pin_convention, self._model, self._data
        ends = np.empty((len(joints), len(self._last), 3, 4))
        columns = np.empty((len(joints), 1, 6, len(self._joints)))
        own = convention.v_index[self._joints]
        for index, q in enumerate(convention.with_joints(self._q, self._all_joints(joints))):
            pin.computeJointJacobians(model, data, q)
            columns[index] = data.J.reshape(6, -1)[:, own]
            for end, joint in enumerate(self._last):
                ends[index, end] = data.oMi[joint].homogeneous[:3]
        placed = ends[:, self._rows]  # (k, f, 3, 4) poses of the last joints
        places = (placed[..., :3] @ self._points + placed[..., 3:])[..., 0]
        # Pinocchio's columns are for the point at the world's origin: v = v_0 + omega x p.
        rates = columns[:, :, :3] - cross_matrices(places) @ columns[:, :, 3:]
        return places - foot_targets, rates * self._moves[:, None]


def combine_branches(
    found: Mapping[IndependentLimb, tuple[Branch, ...]], near: Array
) -> Iterator[Array]:
    """Yield joint positions (nu,) [rad, m] of combinations of one IK branch per limb.

    The combination with the lowest cost, rounded to `_JOINT_DISTANCE_STEP`, comes first. The cost
    is a sum over limbs. The cost of a limb is the sum of absolute differences of joint positions
    from ``near`` [rad, m], plus 1 per um of foot error above 1 um.

    Args:
        found: {limb: its IK branches}.
        near: Joint positions, shape (nu,) [rad, m]; joints outside of limbs keep these positions.
    """
    groups = list(found)
    costs = []
    for limb in groups:
        away = [np.abs(branch.positions - near[limb.joints]).sum() for branch in found[limb]]
        misses = [max(0.0, branch.foot_error - 1e-6) for branch in found[limb]]
        # 1 um counts like 1 rad, so that reachable branches come first.
        costs.append(np.array(misses) * 1e6 + np.array(away))
    kept = _select_cheap_branches(costs)
    grid = np.zeros(1)
    for cost, numbers in zip(costs, kept, strict=True):
        grid = (grid[:, None] + cost[None, numbers]).ravel()
    grid = np.round(grid / _JOINT_DISTANCE_STEP)
    shape = [len(numbers) for numbers in kept]
    for choice in np.argsort(grid, kind="stable"):
        joints = near.copy()
        chosen = zip(groups, kept, np.unravel_index(choice, shape), strict=True)
        for limb, numbers, index in chosen:
            joints[limb.joints] = found[limb][numbers[int(index)]].positions
        yield joints


_MAX_SORTED_COMBINATIONS = 100_000
"""Upper bound of the number of combinations (an IK branch per limb) that are sorted by cost. Six
legs with six branches each have 46,656; twelve legs would have 2e9. Chosen, not tuned."""


def _select_cheap_branches(costs: Sequence[Array]) -> list[list[int]]:
    """Select the indices of each limb's cheapest branches, so that combinations can be sorted."""
    kept = [list(range(len(cost))) for cost in costs]
    excess = sorted(
        (
            (float(cost[number] - cost.min()), limb, number)
            for limb, cost in enumerate(costs)
            for number in range(len(cost))
        ),
        reverse=True,
    )
    for _, limb, number in excess:
        if math.prod(map(len, kept)) <= _MAX_SORTED_COMBINATIONS:
            break
        if len(kept[limb]) > 1:
            kept[limb].remove(number)
    return kept
