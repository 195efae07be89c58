"""Motions of a robot with a fixed base with closed loops and joint couplings.

`JointMotions` defines a motion per independent joint. With a linear coupling, the dependent joints
move in proportion to the independent joint. In a loop, they move so that the loop stays closed.
Searches over postures and samples of random postures use these motions.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.robot.closure import Closure
from pupper_analysis.robot.joints import joint_ranges
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.posture import Posture

_MAX_LINEAR_OPENING = 1e-6
"""Largest opening of a loop [m, rad] when its joints are moved in proportion
(`_TESTED_RANGE_FRACTIONS`), with which a motion of the loop is computed as proportional. With a
larger opening, the loop is closed numerically at each sample of a motion. Chosen, not tuned.
"""

_MIN_COUPLING_RATIO = 1e-9
"""Smallest ratio of joint velocities, or element of the loops' Jacobian (rad and m mixed), that
couples two joints. A smaller value is a rounding error. Chosen, not tuned.
"""

_TESTED_RANGE_FRACTIONS = (0.29, 0.71, 1.0)
"""Test points for the proportional motion of a loop: fractions [1] of the distance from the posture
to each end of the joint range. Chosen, not tuned.
"""

_NUM_LINEAR_SAMPLES = 24
"""Number of positions of an independent joint at which a torque is sampled to find its maximum, if
all dependent joints move in proportion. Chosen, not tuned.
"""

_NUM_LOOP_SAMPLES = 25
"""Number of positions of an independent joint at which a loop is closed, if the loop has one
independent joint. The number bounds the computing time. Chosen, not tuned.
"""

_NUM_COMBINED_SAMPLES = 9
"""Number of positions of each independent joint at which a loop is closed, if the loop has several
independent joints. Smaller than `_NUM_LOOP_SAMPLES`, since the loop must be closed at each
combination of the positions.
"""

_LIMIT_ATOL = 1e-6
"""Largest distance [rad, m] of a dependent joint beyond its limits at which a posture is accepted.
Such a distance is a rounding error. Chosen, not tuned.
"""


class JointMotions:
    """Motions of the independent joints of a robot, with the dependent joints.

    Args:
        robot: Robot with a fixed base.
        posture: Posture of the robot, with closed loops.

    Attributes:
        origin: Joint positions of the posture, shape (nu,) [rad, m].
        free: Indices of the independent joints, a joint per motion; n is the number of motions.
        steps: Velocities of all joints per velocity of each independent joint, at the posture,
            shape (nu, n).
        moved: Indices of the joints that move with each motion; for a nonlinear motion, all joints
            that are coupled to the independent joint.
        nonlinear: True if the motion is part of a loop with joints that do not move in proportion,
            shape (n,).
        ranges: Joint ranges, shape (nu, 2) [rad, m]. An infinite limit is replaced by the posture
            -+ pi.
        shares: Motor torques per load of the joints, shape (nu, nu), at the posture.
        constant: True for a joint whose row of ``shares`` is assumed constant over all postures,
            shape (nu,). False for joints of nonlinear motions.
        slides: True for a slide, shape (nu,).
        endless: True if a slide lacks a limit.

    Raises:
        ConfigurationError: If a closed loop is singular in the posture.
    """

    def __init__(self, robot: Robot, posture: Posture) -> None:
        self.origin, self._closure = posture.qpos, robot.closure
        ranges, count = joint_ranges(robot), robot.nu
        unlimited = ~np.isfinite(ranges)
        self.ranges = np.where(unlimited, self.origin[:, None] + (-math.pi, math.pi), ranges)
        model = robot.mj_model
        kinds = np.array([model.joint(name).type[0] for name in robot.joint_names])
        self.slides = kinds == mujoco.mjtJoint.mjJNT_SLIDE.value
        self.endless = bool((unlimited.any(axis=1) & self.slides).any())
        self.free = tuple(range(count))
        self.steps = self.shares = np.eye(count)
        self.constant = np.ones(count, dtype=bool)
        self.nonlinear = np.zeros(count, dtype=bool)
        self.moved = [np.array([joint]) for joint in self.free]
        # Per motion: all joints that are coupled to the independent joint, including that joint.
        self._coupled_joints = [np.array([joint]) for joint in self.free]
        # {indices of the independent joints of a loop, then their positions: positions of the
        # dependent joints, or None if the loop cannot be closed within the joint ranges}.
        self._closed_positions: dict[tuple[float, ...], Array | None] = {}
        if self._closure is not None:
            self._add_couplings(self._closure)

    def draw_postures(self, count: int) -> list[Array]:
        """Draw random postures within the joint ranges, with closed loops, (nu,) [rad, m] each.

        The random seed is fixed.
        """
        random, postures = np.random.default_rng(0), []
        for _ in range(count):
            qpos = self.origin.copy()
            for motion in range(len(self.free)):
                fraction, (low, high) = random.uniform(), self.find_range(qpos, motion)
                if self.nonlinear[motion]:
                    last = self.count_samples(motion) - 1
                    fraction = round(fraction * last) / last
                moved = self.move_along(qpos, motion, low + fraction * (high - low))
                qpos = qpos if moved is None else moved
            postures.append(qpos)
        return postures

    def find_range(self, qpos: Array, motion: int) -> tuple[float, float]:
        """Return the range of displacements along a motion that joint limits permit.

        A displacement is the displacement of the independent joint from the posture ``qpos``,
        (nu,). For a nonlinear motion, `move_along` checks the ranges of the dependent joints. The
        range of a linear motion contains 0, even if the posture exceeds a limit.

        Returns:
            Lower bound; upper bound [rad, m].
        """
        moving, lead = self.moved[motion], self.free[motion]
        if self.nonlinear[motion]:
            low, high = self.ranges[lead] - qpos[lead]
            return float(low), float(high)
        ends = (self.ranges[moving] - qpos[moving, None]) / self.steps[moving, motion, None]
        ends.sort(axis=1)
        return min(float(ends[:, 0].max()), 0.0), max(float(ends[:, 1].min()), 0.0)

    def count_samples(self, motion: int) -> int:
        """Return the number of joint positions that are tested along a motion."""
        if not self.nonlinear[motion]:
            return _NUM_LINEAR_SAMPLES
        # Equal spacing over the joint range: each closed position is computed once, then cached.
        return (
            _NUM_LOOP_SAMPLES
            if len(np.intersect1d(self._coupled_joints[motion], self.free)) == 1
            else _NUM_COMBINED_SAMPLES
        )

    def move_along(self, qpos: Array, motion: int, length: float) -> Array | None:
        """Displace an independent joint by ``length`` [rad, m], and move its dependent joints.

        ``motion`` is the index of the independent joint in ``free``; ``qpos`` has the shape (nu,).

        Returns:
            Displaced posture, shape (nu,). None if the motion is nonlinear, and the loop cannot be
            closed within the ranges of the dependent joints. Other joint ranges are not checked.
        """
        if not self.nonlinear[motion]:
            moved: Array = qpos + length * self.steps[:, motion]
            return moved
        assert self._closure is not None
        posture, loop = qpos.copy(), self._coupled_joints[motion]
        posture[self.free[motion]] += length
        following = np.intersect1d(loop, self._closure.dependent_joints)
        leading = np.setdiff1d(loop, following)
        key = (*leading.tolist(), *posture[leading].round(9).tolist())
        if key not in self._closed_positions:  # the cache is shared by all searches
            moving = np.isin(np.arange(len(qpos)), following).astype(np.float64)
            closed, positions = self._closure.close_loops(posture, moving), None
            if closed is not None:
                low, high = self.ranges[following].T
                near = np.clip(closed[following], low, high)
                positions = (
                    near if (np.abs(near - closed[following]) <= _LIMIT_ATOL).all() else None
                )
            self._closed_positions[key] = positions
        followed = self._closed_positions[key]
        if followed is None:
            return None
        posture[following] = followed
        return posture

    def _add_couplings(self, closure: Closure) -> None:
        """Set the motions of the independent (free) joints of a robot with loops or couplings.

        Motions that open a loop if its joints move in constant proportions are marked as nonlinear.
        """
        count, following = len(self.origin), closure.dependent_joints
        rows = closure.jacobian(self.origin)
        self.free = tuple(joint for joint in range(count) if joint not in following)
        self.steps = np.eye(count)[:, list(self.free)]
        ratios = np.linalg.lstsq(rows[:, following], rows[:, list(self.free)], rcond=None)[0]
        self.steps[following] = np.where(np.abs(ratios) > _MIN_COUPLING_RATIO, -ratios, 0.0)
        self.moved = [np.flatnonzero(np.abs(step) > _MIN_COUPLING_RATIO) for step in self.steps.T]
        self.shares = np.eye(count) - closure.load_transfer(self.origin)
        self.nonlinear = np.zeros(len(self.free), dtype=bool)
        loops = group_coupled_joints(closure, self.origin)
        self._coupled_joints = [
            next((loop for loop in loops if lead in loop), np.array([lead])) for lead in self.free
        ]
        for motion, loop in enumerate(self._coupled_joints):
            if len(loop) > 1 and self._opens_loop(closure, motion):
                self.nonlinear |= [lead in loop for lead in self.free]
                self.constant[loop] = False
        for motion in np.flatnonzero(self.nonlinear).tolist():
            self.moved[motion] = self._coupled_joints[motion]

    def _opens_loop(self, closure: Closure, motion: int) -> bool:
        """Return True if a loop opens when its joints move in proportion along a motion."""
        ends = np.array(self.find_range(self.origin, motion))
        return any(
            closure.violation_error(self.origin + fraction * end * self.steps[:, motion])
            > _MAX_LINEAR_OPENING
            for fraction in _TESTED_RANGE_FRACTIONS
            for end in ends
        )


def group_coupled_joints(closure: Closure, qpos: Array) -> list[IntArray]:
    """Return groups of joints that loops and couplings connect, as sorted joint indices.

    Two joints are connected if the same constraint depends on both, at ``qpos``, shape (nu,), or at
    random postures nearby. Elements of the Jacobian may vanish in a singular posture.
    """
    random, count = np.random.default_rng(0), len(qpos)
    near = [qpos, *(qpos + random.uniform(-0.1, 0.1, count) for _ in range(2))]
    depends = np.any(
        [np.abs(closure.jacobian(sample)) > _MIN_COUPLING_RATIO for sample in near], axis=0
    )
    sets: list[set[int]] = []
    for equation in depends:
        joints = set(np.flatnonzero(equation).tolist())
        for connected in [members for members in sets if members & joints]:
            sets.remove(connected)
            joints |= connected
        sets += [joints] if joints else []
    return [np.array(sorted(members)) for members in sets]
