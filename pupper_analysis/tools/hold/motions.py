"""How joints of a robot whose base is held move: alone, with others.

Loops that others follow otherwise than in proportion stay as they are.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.closure import Closure
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.posture import Posture, joint_ranges

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_OPEN = 1e-6
"""Joints that follow in proportion leave their loop open by no more, wherever they are (m, rad)."""

_UNMOVED = 1e-9
"""A joint that moves by less of what leads it does not follow it (rad/rad)."""

_SHARES = (0.29, 0.71, 1.0)
"""Parts of a range, either way, at which it is seen whether joints follow in proportion."""


class JointMotions:
    """The ways in which a robot's joints move: those that follow others, with them.

    Args:
        robot: A robot whose base is held.
        posture: One of its postures.

    Attributes:
        origin: (nu,) the posture.
        free: Numbers of the joints that lead ways: those that follow none.
        steps: (nu, n) how all joints move with each, near the posture.
        moved: Numbers of the joints that move with each.
        ranges: (nu, 2) of the joints (rad, m); of those that turn freely, a turn.
        shares: (nu, nu) what motors hold of each joint's load.
        still: Numbers of the joints in loops that do not move in proportion, and stay.
        slides: (nu,) whether a joint slides.
        endless: Whether one does so without limits.
    """

    def __init__(self, robot: Robot, posture: Posture) -> None:
        self.origin = posture.qpos
        ranges, count = joint_ranges(robot), robot.nu
        unlimited = ~np.isfinite(ranges)
        self.ranges = np.where(unlimited, self.origin[:, None] + (-math.pi, math.pi), ranges)
        model = robot.mj_model
        kinds = np.array([model.joint(name).type[0] for name in robot.joint_names])
        self.slides = kinds == mujoco.mjtJoint.mjJNT_SLIDE.value
        self.endless = bool((unlimited.any(axis=1) & self.slides).any())
        self.free = tuple(range(count))
        self.steps = self.shares = np.eye(count)
        self.still: tuple[int, ...] = ()
        self.moved = [np.array([joint]) for joint in self.free]
        if robot.closure is not None:
            self._bind(robot.closure)

    def random(self, count: int) -> list[Array]:
        """Returns so many random postures (nu,): the same ones each time."""
        random, found = np.random.default_rng(0), []
        for _ in range(count):
            qpos = self.origin.copy()
            for way in range(len(self.free)):
                share, (low, high) = random.uniform(), self.span(qpos, way)
                qpos = self.along(qpos, way, low + share * (high - low))
            found.append(qpos)
        return found

    def span(self, qpos: Array, way: int) -> tuple[float, float]:
        """Returns how far (rad, m) joints can go along a way from a posture, back and forth."""
        moving = self.moved[way]
        ends = (self.ranges[moving] - qpos[moving, None]) / self.steps[moving, way, None]
        ends.sort(axis=1)
        return min(float(ends[:, 0].max()), 0.0), max(float(ends[:, 1].min()), 0.0)

    def along(self, qpos: Array, way: int, length: float) -> Array:
        """Returns the posture (nu,) that is so far along a way (rad, m)."""
        moved: Array = qpos + length * self.steps[:, way]
        return moved

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
        for loop in bound_in_common(closure, self.origin):
            leads = [way for way, lead in enumerate(self.free) if lead in loop]
            if any(self._opens(closure, way) for way in leads):
                self.still += tuple(loop.tolist())
        kept = [way for way, lead in enumerate(self.free) if lead not in self.still]
        self.free = tuple(self.free[way] for way in kept)
        self.steps, self.moved = self.steps[:, kept], [self.moved[way] for way in kept]

    def _opens(self, closure: Closure, way: int) -> bool:
        """Tells whether joints that follow a way in proportion leave its loop open somewhere."""
        ends = np.array(self.span(self.origin, way))
        return any(
            closure.open_by(self.origin + share * end * self.steps[:, way]) > _OPEN
            for share in _SHARES
            for end in ends
        )


def bound_in_common(closure: Closure, qpos: Array) -> list[IntArray]:
    """Returns the joints that loops and couplings bind to each other near a posture, by sets."""
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
