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

from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ModelError
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_SAMPLES = 32
"""Starts per limb, a power of two as Sobol's sequence likes it. For 800 random goals of v3's and
original's legs, 32 find all branches but one that 256 do."""

_ITERATIONS = 14
"""Of Levenberg and Marquardt's method: it converges in 6 to 10 where a foot is in reach."""

_FEW = 5
"""Of them where a branch is followed: what is not nearly there then is out of reach."""

_SAME = 0.05
"""Joint positions that are no further from each other belong to one branch (rad, or m)."""

_MOST = 6
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
        miss: How far its feet are from their places (m), 0 where they are in reach.
    """

    positions: Array
    miss: float


def find_limbs(robot: Robot) -> tuple[Limb, ...]:
    """Returns the robot's limbs; joints that move no foot, a head's, are in none."""
    model = robot.pin_model
    groups: list[tuple[set[str], set[int]]] = []
    for foot, frame in robot.foot_frames.items():
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
            feet=tuple(foot for foot in robot.feet if foot in feet),
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
    positions, misses = _Solver(robot, qpos, targets, lower, upper).run(starts, np.zeros(3))
    turning = robot.pin_convention.unbounded
    positions[:, turning] = _turned(positions[:, turning])
    positions = _unwound(robot, positions, lower, upper)
    return {
        limb: _kept(positions[:, limb.joints], missed, turning[limb.joints])
        for limb, missed in misses.items()
    }


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
    for limb, ways in found.items():
        for row in range(count):
            starts[row, limb.joints] = ways[row % len(ways)].positions
    solver = _Solver(robot, qpos, targets, lower, upper)
    shifts = np.repeat(moves, count, axis=0)
    positions, misses = solver.run(np.tile(starts, (len(moves), 1)), shifts, _FEW)
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
        if all(np.abs(np.where(turns, _turned(a), a)).max() > _SAME for a in away):
            kept.append(Branch(positions[index], float(missed[index])))
        if len(kept) == _MOST:
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


@dataclass(frozen=True, eq=False)
class _Alike:
    """Limbs with as many feet and joints as each other, whose steps are taken together.

    Attributes:
        limbs: The l limbs.
        joints: (l, n) numbers of their joints.
        frames: (l, f) Pinocchio's numbers of their feet's frames.
        targets: (l, f, 3) where these shall be (m).
    """

    limbs: tuple[Limb, ...]
    joints: IntArray
    frames: IntArray
    targets: Array


class _Solver:
    """Levenberg and Marquardt's method on all limbs and starts at once."""

    def __init__(
        self, robot: Robot, qpos: Array, targets: Mapping[str, Array], lower: Array, upper: Array
    ) -> None:
        self.robot, self.model = robot, robot.pin_model
        self.data = self.model.createData()
        self.q = robot.pin_convention.q(qpos)
        self.rest = qpos[robot.nq - robot.nu :]
        self.lower, self.upper = lower, upper
        shapes: dict[tuple[int, int], list[Limb]] = {}
        for limb in find_limbs(robot):
            shapes.setdefault((len(limb.feet), len(limb.joints)), []).append(limb)
        self.groups = []
        for alike in shapes.values():
            frames = [
                [self.model.getFrameId(robot.foot_frames[f], pin.FrameType.BODY) for f in limb.feet]
                for limb in alike
            ]
            self.groups.append(
                _Alike(
                    limbs=tuple(alike),
                    joints=np.array([limb.joints for limb in alike]),
                    frames=np.array(frames),
                    targets=np.array([[targets[foot] for foot in limb.feet] for limb in alike]),
                )
            )

    def run(
        self, starts: Array, moves: Array, iterations: int = _ITERATIONS
    ) -> tuple[Array, dict[Limb, Array]]:
        """Returns joint positions (k, nu), and how far each limb's feet miss (k,) (m).

        Args:
            starts: (k, nu) where to start.
            moves: (k, 3), or (3,), by how much the base is moved for each (m).
            iterations: How many at most.
        """
        moves = np.broadcast_to(moves, (len(starts), 3))
        joints = np.clip(starts, self.lower, self.upper)
        moved = np.concatenate([group.joints.ravel() for group in self.groups])
        resting = np.setdiff1d(np.arange(self.robot.nu), moved)
        joints[:, resting] = self.rest[resting]
        errors, jacobians = self._evaluate(joints, moves)
        damping = [np.full((len(joints), len(group.limbs)), _DAMPING) for group in self.groups]
        active = np.arange(len(joints))
        for _ in range(iterations):
            now = joints[active]
            tried = now.copy()
            for number, group in enumerate(self.groups):
                step = self._step(
                    errors[number][active],
                    jacobians[number][active],
                    now[:, group.joints],
                    group,
                    damping[number][active],
                )
                tried[:, group.joints] += step
            tried = np.clip(tried, self.lower, self.upper)
            moving = np.abs(tried - now).max(axis=1) > _ARRIVED
            active, tried = active[moving], tried[moving]
            if not len(active):
                break
            new_errors, new_jacobians = self._evaluate(tried, moves[active])
            for number, group in enumerate(self.groups):
                old, new = errors[number][active], new_errors[number]
                better = (new**2).sum(axis=2) < (old**2).sum(axis=2)  # (k, l)
                rows, ways = np.nonzero(better)
                joints[active[rows][:, None], group.joints[ways]] = tried[
                    rows[:, None], group.joints[ways]
                ]
                errors[number][active[rows], ways] = new[better]
                jacobians[number][active[rows], ways] = new_jacobians[number][better]
                factor = np.where(better, 0.1, 8.0)
                damping[number][active] = np.clip(
                    damping[number][active] * factor, _LEAST_DAMPING, _MOST_DAMPING
                )
        misses: dict[Limb, Array] = {}
        for group, error in zip(self.groups, errors, strict=True):
            away = np.linalg.norm(error.reshape(*error.shape[:2], -1, 3), axis=3).max(axis=2)
            misses |= {limb: away[:, way] for way, limb in enumerate(group.limbs)}
        return joints, misses

    def _step(
        self, error: Array, jacobian: Array, joints: Array, group: _Alike, damping: Array
    ) -> Array:
        """Returns damped steps (k, l, n); joints that would leave their range stay at its end."""
        gradient = np.einsum("klij,kli->klj", jacobian, error)
        at_low = (joints <= self.lower[group.joints]) & (gradient > 0)
        at_high = (joints >= self.upper[group.joints]) & (gradient < 0)
        free = ~(at_low | at_high)
        jacobian = jacobian * free[:, :, None, :]
        normal = np.einsum("klij,klim->kljm", jacobian, jacobian)
        diagonal = np.arange(normal.shape[2])
        normal[:, :, diagonal, diagonal] += damping[:, :, None]
        step: Array = -np.linalg.solve(normal, (gradient * free)[..., None])[..., 0]
        return step

    def _evaluate(self, joints: Array, moves: Array) -> tuple[list[Array], list[Array]]:
        """Returns per group the errors (k, l, 3 f) and their Jacobians (k, l, 3 f, n)."""
        convention, model, data = self.robot.pin_convention, self.model, self.data
        frames = [int(frame) for group in self.groups for frame in group.frames.ravel()]
        places = np.empty((len(joints), len(frames), 3))
        columns = np.empty((len(joints), 6, len(convention.v_index)))
        for index, row in enumerate(joints):
            pin.computeJointJacobians(model, data, convention.with_joints(self.q, row))
            pin.updateFramePlacements(model, data)
            columns[index] = data.J.reshape(6, -1)[:, convention.v_index]
            for number, frame in enumerate(frames):
                places[index, number] = data.oMf[frame].translation
        errors, jacobians, first = [], [], 0
        for group in self.groups:
            at = places[:, first : first + group.frames.size]
            at = at.reshape(len(joints), *group.frames.shape, 3)
            first += group.frames.size
            # Feet go with a base that is moved.
            off = at + moves[:, None, None] - group.targets
            errors.append(off.reshape(*at.shape[:2], -1))
            # Pinocchio's columns are of the point at the world's origin: v = v_0 + omega x p.
            own = columns[:, :, group.joints][:, :, :, None]  # (k, 6, l, 1, n)
            x, y, z = (at[..., axis, None] for axis in range(3))  # (k, l, f, 1)
            turning = (
                own[:, 4] * z - own[:, 5] * y,
                own[:, 5] * x - own[:, 3] * z,
                own[:, 3] * y - own[:, 4] * x,
            )
            velocity = np.stack([own[:, axis] + turning[axis] for axis in range(3)], axis=3)
            jacobians.append(velocity.reshape(*at.shape[:2], -1, group.joints.shape[1]))
        return errors, jacobians


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
        misses = [max(0.0, branch.miss - 1e-6) for branch in found[limb]]
        # A micrometre weighs as much as a radian: what is in reach comes first.
        costs.append(np.array(misses) * 1e6 + np.array(away))
    grid = np.zeros(1)
    for cost in costs:
        grid = (grid[:, None] + cost[None, :]).ravel()
    shape = [len(found[limb]) for limb in groups]
    for choice in np.argsort(grid, kind="stable"):
        joints = near.copy()
        for limb, number in zip(groups, np.unravel_index(choice, shape), strict=True):
            joints[limb.joints] = found[limb][int(number)].positions
        yield joints
