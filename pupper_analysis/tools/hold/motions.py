"""How joints of a robot whose base is held move: alone, with others, in loops."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.closure import Closure
from pupper_analysis.robot.joints import joint_ranges
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.posture import Posture

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_OPEN = 1e-6
"""Joints that follow in proportion leave their loop open by no more, wherever they are (m, rad)."""

_UNMOVED = 1e-9
"""A joint that moves by less of what leads it does not follow it (rad/rad)."""

_SHARES = (0.29, 0.71, 1.0)
"""Parts of a range, either way, at which it is seen whether joints follow in proportion."""

_SAMPLES = 24
"""Looks along a joint that others follow in proportion, where torques are no single wave."""

_PLACES = 25
"""Of a joint that leads a loop, which takes 15 ms to close: 3 degrees apart for a gripper."""

_FEWER = 9
"""Of each of several joints that lead one loop, which is closed at their combinations."""

_BEYOND = 1e-6
"""How far joints of a closed loop may be beyond their limits, by rounding (rad, m)."""


class JointMotions:
    """Independent joint motions of a robot with a fixed base, including coupled joints.

    A motion is that of one independent (leading) joint, and of the joints that loops and couplings
    make follow it.

    Args:
        robot: Robot with a fixed base.
        posture: Posture.

    Attributes:
        origin: Joint positions of the posture, shape (nu,) [rad, m].
        free: Indices of the n independent joints, one for each motion.
        steps: Movement of all joints per movement of the leading joint, near the posture, shape
            (nu, n).
        moved: For each motion, the indices of the joints that move.
        bent: Whether joints follow the motion nonlinearly (in a closed loop), shape (n,).
        ranges: Limits of the joints, shape (nu, 2) [rad, m]; one turn for joints without limits.
        shares: Fraction of each joint's load that each motor holds in the posture, shape (nu, nu).
        constant: Whether these fractions are equal in all postures, shape (nu,).
        slides: Whether the joint is a slide, shape (nu,).
        endless: Whether a slide has no limits.
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
        self.bent = np.zeros(count, dtype=bool)
        self.moved = [np.array([joint]) for joint in self.free]
        self._loop = [np.array([joint]) for joint in self.free]
        self._closed: dict[tuple[float, ...], Array | None] = {}
        if self._closure is not None:
            self._bind(self._closure)

    def random(self, count: int) -> list[Array]:
        """Return random postures, shape (nu,) [rad, m] each, with closed loops.

        The seed of the generator is fixed, so that each call returns the same postures.

        Args:
            count: Number of postures.
        """
        random, found = np.random.default_rng(0), []
        for _ in range(count):
            qpos = self.origin.copy()
            for way in range(len(self.free)):
                share, (low, high) = random.uniform(), self.span(qpos, way)
                if self.bent[way]:
                    last = self.places(way) - 1
                    share = round(share * last) / last
                there = self.along(qpos, way, low + share * (high - low))
                qpos = qpos if there is None else there
            found.append(qpos)
        return found

    def span(self, qpos: Array, way: int) -> tuple[float, float]:
        """Return the range of a motion from a posture, within the joint limits.

        Args:
            qpos: Posture, shape (nu,) [rad, m].
            way: Index of the motion.

        Returns:
            Smallest and largest displacement of the leading joint [rad, m].
        """
        moving, lead = self.moved[way], self.free[way]
        if self.bent[way]:  # closing the loop shows how far the joints that follow let it go
            low, high = self.ranges[lead] - qpos[lead]
            return float(low), float(high)
        ends = (self.ranges[moving] - qpos[moving, None]) / self.steps[moving, way, None]
        ends.sort(axis=1)
        return min(float(ends[:, 0].max()), 0.0), max(float(ends[:, 1].min()), 0.0)

    def places(self, way: int) -> int:
        """Return the number of samples along a motion. Loops are closed once at each sample."""
        if not self.bent[way]:
            return _SAMPLES
        return _PLACES if len(np.intersect1d(self._loop[way], self.free)) == 1 else _FEWER

    def along(self, qpos: Array, way: int, length: float) -> Array | None:
        """Return the posture after a displacement along a motion, with closed loops.

        Args:
            qpos: Posture, shape (nu,) [rad, m].
            way: Index of the motion.
            length: Displacement of the leading joint [rad, m].

        Returns:
            Posture, shape (nu,). None if the loop cannot be closed, or if closing the loop moves
            other joints beyond their ranges.
        """
        if not self.bent[way]:
            moved: Array = qpos + length * self.steps[:, way]
            return moved
        assert self._closure is not None
        bent, loop = qpos.copy(), self._loop[way]
        bent[self.free[way]] += length
        following = np.intersect1d(loop, self._closure.following)
        leading = np.setdiff1d(loop, following)
        key = (*leading.tolist(), *bent[leading].round(9).tolist())
        if key not in self._closed:  # once for all searches
            moving = np.isin(np.arange(len(qpos)), following).astype(np.float64)
            closed, own = self._closure.closed(bent, moving), None
            if closed is not None:
                low, high = self.ranges[following].T
                near = np.clip(closed[following], low, high)
                own = near if (np.abs(near - closed[following]) <= _BEYOND).all() else None
            self._closed[key] = own
        followed = self._closed[key]
        if followed is None:
            return None
        bent[following] = followed
        return bent

    def _bind(self, closure: Closure) -> None:
        """Takes loops and couplings into account."""
        count, following = len(self.origin), closure.following
        rows = closure.rows(self.origin)
        self.free = tuple(joint for joint in range(count) if joint not in following)
        self.steps = np.eye(count)[:, list(self.free)]
        held = np.linalg.lstsq(rows[:, following], rows[:, list(self.free)], rcond=None)[0]
        self.steps[following] = np.where(np.abs(held) > _UNMOVED, -held, 0.0)
        self.moved = [np.flatnonzero(np.abs(step) > _UNMOVED) for step in self.steps.T]
        self.shares = np.eye(count) - closure.push(self.origin)
        self.bent = np.zeros(len(self.free), dtype=bool)
        loops = group_coupled_joints(closure, self.origin)
        self._loop = [
            next((one for one in loops if lead in one), np.array([lead])) for lead in self.free
        ]
        for way, loop in enumerate(self._loop):
            if len(loop) > 1 and self._opens(closure, way):
                self.bent |= [lead in loop for lead in self.free]
                self.constant[loop] = False
        for way in np.flatnonzero(self.bent).tolist():
            self.moved[way] = self._loop[way]

    def _opens(self, closure: Closure, way: int) -> bool:
        """Tells whether joints that follow a way in proportion leave its loop open somewhere."""
        ends = np.array(self.span(self.origin, way))
        return any(
            closure.open_by(self.origin + share * end * self.steps[:, way]) > _OPEN
            for share in _SHARES
            for end in ends
        )


def group_coupled_joints(closure: Closure, qpos: Array) -> list[IntArray]:
    """Return groups of joints that loops and couplings connect near a posture.

    Args:
        closure: Loops and couplings of the robot.
        qpos: Posture, shape (nu,) [rad, m].

    Returns:
        Sorted joint indices of each group.
    """
    random, count = np.random.default_rng(0), len(qpos)
    near = [qpos, *(qpos + random.uniform(-0.1, 0.1, count) for _ in range(2))]
    binds = np.any([np.abs(closure.rows(one)) > _UNMOVED for one in near], axis=0)
    sets: list[set[int]] = []
    for equation in binds:
        joints = set(np.flatnonzero(equation).tolist())
        for other in [one for one in sets if one & joints]:
            sets.remove(other)
            joints |= other
        sets += [joints] if joints else []
    return [np.array(sorted(one)) for one in sets]
