"""How the joints of a robot whose base is held move: alone, with others, or in loops."""

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

_PLACES = 25
"""Positions of a joint that leads a loop, in which this is closed, once for all searches: between
two of them, 3 degrees apart for a gripper, a torque is off its peak by some 1e-4."""

_FEWER = 9
"""Of each of several joints that lead one loop, which is closed at their combinations."""

_BEYOND = 1e-6
"""How far joints of a closed loop may be beyond their limits, by rounding (rad, m)."""


class Ways:
    """The ways in which a robot's joints move: those that follow others, with them.

    Args:
        robot: A robot whose base is held.
        posture: One of its postures.

    Attributes:
        origin: (nu,) the posture.
        free: Numbers of the joints that follow none; there is a way for each of these.
        steps: (nu, n) how all joints move with each, near the posture.
        moved: Numbers of the joints that move with each.
        bent: (n,) whether joints follow it otherwise than in proportion: in a loop.
        ranges: (nu, 2) of the joints (rad, m); of those that turn freely, a turn.
        shares: (nu, nu) what motors hold of each joint's load, in the posture.
        constant: (nu,) whether that is the same in every posture.
        slides: (nu,) whether a joint slides.
        endless: Whether one does so without limits.
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
        self._loop = [np.zeros(0, dtype=np.int64) for _ in self.free]
        self._closed: dict[tuple[float, ...], Array | None] = {}
        if self._closure is not None:
            self._bind(self._closure)

    def random(self, count: int, *, between: bool = False) -> list[Array]:
        """Returns random postures (nu,), their loops closed: the same ones each time.

        Args:
            count: How many.
            between: Also between the places at which loops are closed once for all.
        """
        random, found = np.random.default_rng(0), []
        for _ in range(count):
            qpos = self.origin.copy()
            for way, bends in enumerate(self.bent):
                share = random.uniform()
                if bends:
                    place = self._place(qpos, way, round(share * (self._places(way) - 1)))
                    qpos = qpos if place is None else place
                    low, high = self.ranges[self.free[way]]
                    near = self.bend(qpos, way, low + share * (high - low)) if between else None
                    qpos = qpos if near is None else near
                else:
                    low, high = self.span(qpos, way)
                    qpos = self.along(qpos, way, low + share * (high - low))
            found.append(qpos)
        return found

    def span(self, qpos: Array, way: int) -> tuple[float, float]:
        """Returns how far (rad, m) joints can go along a way from a posture, back and forth."""
        step, lead = self.steps[:, way], self.free[way]
        moving = self.moved[way]
        if len(moving) == 1 and step[lead] == 1.0:
            low, high = self.ranges[lead] - qpos[lead]
            return min(float(low), 0.0), max(float(high), 0.0)
        moving = moving[np.abs(step[moving]) > _UNMOVED]  # near the posture, of one that bends
        ends = (self.ranges[moving] - qpos[moving, None]) / step[moving, None]
        ends.sort(axis=1)
        return min(float(ends[:, 0].max()), 0.0), max(float(ends[:, 1].min()), 0.0)

    def along(self, qpos: Array, way: int, length: float) -> Array:
        """Returns the posture (nu,) that is so far along a way, which does not bend (rad, m)."""
        moved: Array = qpos + length * self.steps[:, way]
        return moved

    def places(self, qpos: Array, way: int) -> list[Array]:
        """Returns postures (nu,) along a way that bends, over its range, with loops closed."""
        found = [self._place(qpos, way, number) for number in range(self._places(way))]
        return [place for place in found if place is not None]

    def closed_before(self, qpos: Array, way: int) -> list[Array]:
        """Returns postures (nu,) with the loop of a way, which bends, as it was closed so far."""
        loop, found = self._loop[way], []
        leading = np.intersect1d(loop, self.free)
        for key, own in self._closed.items():
            numbers, positions = key[: len(leading)], key[len(leading) :]
            if own is not None and numbers == tuple(leading.tolist()):
                moved = qpos.copy()
                moved[leading], moved[self._followers(way)] = positions, own
                found.append(moved)
        return found

    def around(self, qpos: Array, way: int) -> tuple[float, float]:
        """Returns positions a place before and after that of the joint of a way (rad, m)."""
        low, high = self.ranges[self.free[way]]
        here, apart = float(qpos[self.free[way]]), float(high - low) / (self._places(way) - 1)
        return max(float(low), here - apart), min(float(high), here + apart)

    def bend(self, qpos: Array, way: int, position: float) -> Array | None:
        """Returns the posture (nu,) with the joint of a way, which bends, elsewhere (rad, m).

        None if its loop does not close there, or takes others beyond their ranges.
        """
        assert self._closure is not None
        moved, followers = qpos.copy(), self._followers(way)
        moved[self.free[way]] = position
        moving = np.isin(np.arange(len(qpos)), followers).astype(np.float64)
        closed = self._closure.closed(moved, moving)
        if closed is None:
            return None
        low, high = self.ranges[followers].T
        own = closed[followers]
        if ((own < low - _BEYOND) | (own > high + _BEYOND)).any():
            return None
        moved[followers] = np.clip(own, low, high)
        return moved

    def _place(self, qpos: Array, way: int, number: int) -> Array | None:
        """Returns the posture in which a joint is at one of its places; None if no loop closes."""
        loop, lead, moved = self._loop[way], self.free[way], qpos.copy()
        low, high = self.ranges[lead]
        moved[lead] = low + (high - low) * number / (self._places(way) - 1)
        leading = np.setdiff1d(loop, self._following)
        key = tuple(np.concatenate([leading, moved[leading].round(9)]).tolist())
        followers = self._followers(way)
        if key not in self._closed:
            closed = self.bend(moved, way, float(moved[lead]))
            self._closed[key] = None if closed is None else closed[followers]
        own = self._closed[key]
        if own is None:
            return None
        moved[followers] = own
        return moved

    def _followers(self, way: int) -> IntArray:
        """Returns the joints of the loop of a way that follow."""
        return np.intersect1d(self._loop[way], self._following)

    def _places(self, way: int) -> int:
        """Returns at how many positions of the joint of a way its loop is closed."""
        return _PLACES if len(np.intersect1d(self._loop[way], self.free)) == 1 else _FEWER

    @property
    def _following(self) -> IntArray:
        return np.setdiff1d(np.arange(len(self.origin)), self.free)

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
        loops = bound_together(closure, self.origin)
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
            closure.open_by(self.along(self.origin, way, float(share * end))) > _OPEN
            for share in _SHARES
            for end in ends
        )


def bound_together(closure: Closure, qpos: Array) -> list[IntArray]:
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
