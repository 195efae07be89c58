"""The ways in which the legs can be bent: branches of their inverse kinematics.

A foot's place under the base leaves a leg of three joints a few configurations: knee forward or
back, hip turned this way or that. With the base in its place the limbs do not know of each other,
so that each limb's branches are found on its own; which of them go together is a choice per limb.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_SAMPLES = 32
"""Starts per limb, a power of two as Sobol's sequence likes it. For 800 random goals of v3's and
original's legs, 32 find all branches but one that 256 do."""

_ITERATIONS = 14
"""Of Levenberg and Marquardt's method: it converges in 6 to 10 where a foot is in reach."""

_FEW_ITERATIONS = 5
"""Of them where a branch is followed: what is not nearly there then is out of reach."""

_BRANCH_DISTANCE = 0.05
"""Joint positions that are no further from each other belong to one branch (rad, or m)."""

_MISSED_ALIKE, _NEAR_ALIKE = 1e-6, 1e-3
"""Feet that miss by as much (m), and joints that are as near to others (rad, or m), do so alike."""

_MOST_BRANCHES = 6
"""The most branches that are kept of a limb: of a redundant one there is a continuum."""

_DAMPING = 1e-3  # m^2 per rad^2: where it begins; a leg's Jacobian squared is 1e-2 to 1e-1
_LEAST_DAMPING, _MOST_DAMPING = 1e-12, 1e3
_ARRIVED = 1e-4  # rad: a start whose limbs all step by less has converged: PlaCo does the rest


@dataclass(frozen=True, eq=False)
class Limb:
    """The joints that move some feet against the base, and move no others.

    Attributes:
        feet: The feet; more than one if they share a joint, as a waist.
        joints: (n,) numbers of the joints, in actuator order.
    """

    feet: tuple[str, ...]
    joints: IntArray


@dataclass(frozen=True, eq=False)
class Branch:
    """One way to bend a limb.

    Attributes:
        positions: (n,) of the limb's joints (rad).
        foot_error: How far its feet are from their places (m), 0 where they are in reach.
    """

    positions: Array
    foot_error: float


def find_limbs(robot: Robot) -> tuple[Limb, ...]:
    """Returns the robot's limbs; joints that move no foot, a head's, are in none."""
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
        Limb(
            feet=tuple(foot for foot in robot.contact_points if foot in feet),
            joints=np.array(sorted(joints), dtype=np.int64),
        )
        for feet, joints in groups
    )


def find_branches(
    robot: Robot, qpos: Array, targets: Mapping[str, Array], lower: Array, upper: Array
) -> dict[Limb, tuple[Branch, ...]]:
    """Finds each limb's branches, for a base that stays where it is.

    Bounded Levenberg-Marquardt steps from many starts, for all limbs at once: one configuration
    carries one start of each limb.

    Args:
        robot: The robot.
        qpos: (nq,) whose base counts; joints that move no foot stay as they are here.
        targets: {foot: (3,) where its centre shall be (m)}.
        lower: (nu,) joint limits (rad).
        upper: (nu,) likewise.

    Returns:
        {limb: its branches}, those that miss least first; a whole turn of a joint without limits
        makes no other one. A target that is out of reach has
        branches too: where the foot comes nearest to it.

    Raises:
        ModelError: If a joint's lower limit is above its upper one.
    """
    if not robot.feet:
        return {}
    for name, least, most in zip(robot.joint_names, lower, upper, strict=True):
        if least > most:
            crossed = diagnose(
                "joint-limits-crossed",
                subject=("joint", name),
                least=float(least),
                most=float(most),
            )
            raise ModelError(robot.description.urdf_source, crossed)
    low = np.where(np.isfinite(lower), lower, -math.pi)
    high = np.where(np.isfinite(upper), upper, math.pi)
    starts = np.random.default_rng(0).uniform(low, high, (_SAMPLES, robot.nu))
    positions, misses = _Descent(robot, qpos, targets, lower, upper).run(starts, np.zeros(3))
    turning = robot.pin_convention.unbounded
    positions[:, turning] = _turned(positions[:, turning])
    positions = _unwound(robot, positions, lower, upper)
    kept = {
        limb: _kept(positions[:, limb.joints], missed, turning[limb.joints])
        for limb, missed in misses.items()
    }
    return {limb: _in_order(robot, qpos, limb, branches) for limb, branches in kept.items()}


def _in_order(
    robot: Robot, qpos: Array, limb: Limb, branches: tuple[Branch, ...]
) -> tuple[Branch, ...]:
    """Returns branches that miss alike with the joints that are furthest back first.

    So legs that may as well be bent either way are all bent the same way.
    """
    model, data = robot.pin_model, robot.pin_model.createData()
    numbers = [model.getJointId(robot.joint_names[joint]) for joint in limb.joints]

    def key(branch: Branch) -> tuple[int, float]:
        bent = qpos.copy()
        bent[robot.nq - robot.nu + limb.joints] = branch.positions
        pin.forwardKinematics(model, data, robot.pin_convention.q(bent))
        forward = data.oMi[1].rotation[:, 0]
        places = [float(forward @ data.oMi[number].translation) for number in numbers]
        return round(branch.foot_error / _MISSED_ALIKE), sum(places)

    return tuple(sorted(branches, key=key))


def follow_branches(
    robot: Robot,
    qpos: Array,
    targets: Mapping[str, Array],
    lower: Array,
    upper: Array,
    found: Mapping[Limb, tuple[Branch, ...]],
    moves: Array,
) -> dict[Limb, list[tuple[Branch, ...]]]:
    """Follows the limbs' branches to other places of the base, all at once.

    Args:
        robot: The robot.
        qpos: As in ``find_branches``.
        targets: As there.
        lower: As there.
        upper: As there.
        found: The branches with the base where ``qpos`` has it.
        moves: (n, 3) by how much it is moved (m).

    Returns:
        {limb: its branches in each of the n places}.
    """
    count = max(map(len, found.values()))
    starts = np.tile(qpos[robot.nq - robot.nu :], (count, 1))
    for limb, branches in found.items():
        for row in range(count):
            starts[row, limb.joints] = branches[row % len(branches)].positions
    descent = _Descent(robot, qpos, targets, lower, upper)
    shifts = np.repeat(moves, count, axis=0)
    positions, misses = descent.run(np.tile(starts, (len(moves), 1)), shifts, _FEW_ITERATIONS)
    turning = robot.pin_convention.unbounded
    return {
        limb: [
            _kept(joints, off, turning[limb.joints])
            for joints, off in zip(
                np.split(positions[:, limb.joints], len(moves)),
                np.split(missed, len(moves)),
                strict=True,
            )
        ]
        for limb, missed in misses.items()
    }


def _kept(positions: Array, missed: Array, turns: BoolArray) -> tuple[Branch, ...]:
    """Returns the branches among positions (k, n) of a limb whose feet miss by (k,) (m)."""
    kept: list[Branch] = []
    for index in np.argsort(missed, kind="stable"):
        away = [positions[index] - branch.positions for branch in kept]
        if all(np.abs(np.where(turns, _turned(a), a)).max() > _BRANCH_DISTANCE for a in away):
            kept.append(Branch(positions[index], float(missed[index])))
        if len(kept) == _MOST_BRANCHES:
            break
    return tuple(kept)


def _unwound(robot: Robot, positions: Array, lower: Array, upper: Array) -> Array:
    """Returns positions (k, nu) of joints less the whole turns that take them from home (rad).

    Limits that leave more than a turn are a motor's; the leg is the same after each.
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


def _turned(angle: Array) -> Array:
    """Returns angles less whole turns: in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


class _Descent:
    """Levenberg and Marquardt's method from many starts, each limb with a damping of its own.

    Args: as ``find_branches``.
    """

    def __init__(
        self, robot: Robot, qpos: Array, targets: Mapping[str, Array], lower: Array, upper: Array
    ) -> None:
        model = robot.pin_model
        self._robot, self._model, self._data = robot, model, model.createData()
        self._q = robot.pin_convention.q(qpos)
        self._rest = qpos[robot.nq - robot.nu :]
        self._lower, self._upper = lower, upper
        self._targets = np.array([targets[foot] for foot in robot.contact_points])
        names = [robot.contact_frames[foot] for foot in robot.contact_points]
        frames = [model.frames[model.getFrameId(name, pin.FrameType.BODY)] for name in names]
        joints = [frame.parentJoint for frame in frames]
        last, self._rows = np.unique(joints, return_inverse=True)
        self._last = last.tolist()
        self._points = np.array([frame.placement.translation for frame in frames])[..., None]
        above = [{model.names[one] for one in model.supports[joint]} for joint in joints]
        self._limbs = find_limbs(robot)
        self._joints = np.concatenate([limb.joints for limb in self._limbs])  # what moves a foot
        names = [robot.joint_names[joint] for joint in self._joints]
        self._moves = np.array([[name in own for name in names] for own in above])
        limbs = range(len(self._limbs))
        self._limb = np.repeat(limbs, [len(limb.joints) for limb in self._limbs])
        within = [[foot in limb.feet for limb in self._limbs] for foot in robot.contact_points]
        self._feet = np.argmax(within, axis=1)

    def run(
        self, starts: Array, moves: Array, iterations: int = _ITERATIONS
    ) -> tuple[Array, dict[Limb, Array]]:
        """Returns joint positions (k, nu), and how far each limb's feet miss (k,) (m).

        Args:
            starts: (k, nu) where to start.
            moves: (k, 3), or (3,), by how much the base is moved for each (m).
            iterations: How many at most.
        """
        targets = self._targets - np.broadcast_to(moves, (len(starts), 3))[:, None]
        low, high = self._lower[self._joints], self._upper[self._joints]
        joints = np.clip(starts[:, self._joints], low, high)
        errors, jacobians = self._evaluate(joints, targets)
        damping = np.full((len(joints), len(self._limbs)), _DAMPING)
        active = np.arange(len(joints))
        for _ in range(iterations):
            now, error, jacobian = joints[active], errors[active], jacobians[active]
            step = self._step(error, jacobian, now, damping[active][:, self._limb])
            tried = np.clip(now + step, low, high)
            moving = np.abs(tried - now).max(axis=1) > _ARRIVED
            active, now, tried, error = active[moving], now[moving], tried[moving], error[moving]
            if not len(active):
                break
            new_error, new_jacobian = self._evaluate(tried, targets[active])
            better = self._squares(new_error) < self._squares(error)  # (k, limbs)
            feet = better[:, self._feet, None]
            joints[active] = np.where(better[:, self._limb], tried, now)
            errors[active] = np.where(feet, new_error, error)
            jacobians[active] = np.where(feet[..., None], new_jacobian, jacobian[moving])
            changed = damping[active] * np.where(better, 0.1, 8.0)
            damping[active] = np.clip(changed, _LEAST_DAMPING, _MOST_DAMPING)
        away = np.linalg.norm(errors, axis=2)
        return self._all(joints), {
            limb: away[:, self._feet == number].max(axis=1)
            for number, limb in enumerate(self._limbs)
        }

    def _all(self, joints: Array) -> Array:
        """Returns the positions (k, nu) of all joints with those of the limbs (k, n) in them."""
        every = np.tile(self._rest, (len(joints), 1))
        every[:, self._joints] = joints
        return every

    def _squares(self, errors: Array) -> Array:
        """Returns the sum of each limb's squared errors (k, limbs)."""
        squares: Array = (errors**2).sum(axis=2) @ (self._feet[:, None] == range(len(self._limbs)))
        return squares

    def _step(self, errors: Array, jacobians: Array, joints: Array, damping: Array) -> Array:
        """Returns damped steps (k, n); joints that would leave their range stay at its end."""
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

    def _evaluate(self, joints: Array, targets: Array) -> tuple[Array, Array]:
        """Returns the feet's errors (k, f, 3) and their Jacobians (k, f, 3, n)."""
        convention, model, data = self._robot.pin_convention, self._model, self._data
        ends = np.empty((len(joints), len(self._last), 3, 4))
        columns = np.empty((len(joints), 1, 6, len(self._joints)))
        own = convention.v_index[self._joints]
        for index, row in enumerate(self._all(joints)):
            pin.computeJointJacobians(model, data, convention.with_joints(self._q, row))
            columns[index] = data.J.reshape(6, -1)[:, own]
            for end, joint in enumerate(self._last):
                ends[index, end] = data.oMi[joint].homogeneous[:3]
        placed = ends[:, self._rows]  # (k, f, 3, 4) the frames of the last joints above the feet
        places = (placed[..., :3] @ self._points + placed[..., 3:])[..., 0]
        # Pinocchio's columns are of the point at the world's origin: v = v_0 + omega x p.
        rates = columns[:, :, :3] - cross_matrices(places) @ columns[:, :, 3:]
        return places - targets, rates * self._moves[:, None]


def combine_branches(found: Mapping[Limb, tuple[Branch, ...]], near: Array) -> Iterator[Array]:
    """Yields joint positions (nu,) for every choice of one branch per limb.

    Args:
        found: {limb: its branches}.
        near: (nu,) joint positions, which count for joints that are in no limb; of choices whose
            feet miss equally little, the one nearest to it comes first.
    """
    groups = list(found)
    costs = []
    for limb in groups:
        away = [np.abs(branch.positions - near[limb.joints]).sum() for branch in found[limb]]
        misses = [max(0.0, branch.foot_error - 1e-6) for branch in found[limb]]
        # A micrometre weighs as much as a radian: what is in reach comes first.
        costs.append(np.array(misses) * 1e6 + np.array(away))
    grid = np.zeros(1)
    for cost in costs:
        grid = (grid[:, None] + cost[None, :]).ravel()
    grid = np.round(grid / _NEAR_ALIKE)  # which of equals comes first is not rounding's to say
    shape = [len(found[limb]) for limb in groups]
    for choice in np.argsort(grid, kind="stable"):
        joints = near.copy()
        for limb, number in zip(groups, np.unravel_index(choice, shape), strict=True):
            joints[limb.joints] = found[limb][int(number)].positions
        yield joints
