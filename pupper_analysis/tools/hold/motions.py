"""How joints of a robot whose base is held move: alone, with others, along tendons, in loops."""

from __future__ import annotations

import itertools
import math
from typing import TypeGuard

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.closure import Closure
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tendons import tendon_ranges
from pupper_analysis.stance.posture import AT_END, Posture, joint_ranges

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


class JointMotions:
    """The ways in which a robot's joints move: those that follow others, with them.

    Args:
        robot: A robot whose base is held.
        posture: One of its postures.

    Attributes:
        origin: (nu,) the posture.
        free: Numbers of the joints that lead ways: those that follow none, each by itself, and
            then of each two on a tendon one, which move so that it keeps its length.
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
        self._tendons = tendon_ranges(robot)
        if self._closure is not None:
            self._bind(self._closure)
        self._go_along_tendons()

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
                    qpos = place if self._kept(place) else qpos
                    low, high = self.ranges[self.free[way]]
                    near = self.bend(qpos, way, low + share * (high - low)) if between else None
                    qpos = near if self._kept(near) else qpos
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
            ends = self.ranges[[lead]] - qpos[lead]
        else:
            moving = moving[np.abs(step[moving]) > _UNMOVED]  # near the posture, of one that bends
            ends = (self.ranges[moving] - qpos[moving, None]) / step[moving, None]
        tendons = self._tendons
        rates = tendons.coefficients @ step
        pulled = np.abs(rates) > _UNMOVED
        room = tendons.room(qpos).reshape(2, -1)[:, pulled] / rates[pulled]
        ends = np.vstack([ends, np.column_stack([-room[0], room[1]])])
        ends.sort(axis=1)
        return min(float(ends[:, 0].max()), 0.0), max(float(ends[:, 1].min()), 0.0)

    def along(self, qpos: Array, way: int, length: float) -> Array:
        """Returns the posture (nu,) that is so far along a way, which does not bend (rad, m)."""
        moved: Array = qpos + length * self.steps[:, way]
        return moved

    def places(self, qpos: Array, way: int) -> list[Array | None]:
        """Returns postures (nu,) along a way that bends, over its range, with loops closed.

        None where one does not close, or takes others, or tendons, beyond their ranges.
        """
        found = [self._place(qpos, way, number) for number in range(self._places(way))]
        return [place if self._kept(place) else None for place in found]

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
        return [place for place in found if self._kept(place)]

    def around(self, qpos: Array, way: int) -> tuple[float, float]:
        """Returns positions a place before and after that of the joint of a way (rad, m)."""
        low, high = self.ranges[self.free[way]]
        here, apart = float(qpos[self.free[way]]), float(high - low) / (self._places(way) - 1)
        return max(float(low), here - apart), min(float(high), here + apart)

    def bend(self, qpos: Array, way: int, position: float) -> Array | None:
        """Returns the posture (nu,) with the joint of a way, which bends, elsewhere (rad, m).

        None if its loop does not close there, or takes others, or tendons, beyond their ranges.
        """
        moved = self._bent(qpos, way, position)
        return moved if self._kept(moved) else None

    def _bent(self, qpos: Array, way: int, position: float) -> Array | None:
        """Returns the same, wherever that takes tendons."""
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
            closed = self._bent(moved, way, float(moved[lead]))
            self._closed[key] = None if closed is None else closed[followers]
        own = self._closed[key]
        if own is None:
            return None
        moved[followers] = own
        return moved

    def _kept(self, qpos: Array | None) -> TypeGuard[Array]:
        """Tells whether there is a posture (nu,), with tendons in their ranges."""
        return qpos is not None and bool((self._tendons.room(qpos) >= -AT_END).all())

    def _go_along_tendons(self) -> None:
        """Adds the ways of two joints on one tendon: at its end neither has a way of its own."""
        rates = self._tendons.coefficients @ self.steps
        for row in rates:
            pulled = [way for way in np.flatnonzero(row).tolist() if not self.bent[way]]
            for one, other in itertools.combinations(pulled, 2):
                step = self.steps[:, one] - self.steps[:, other] * row[one] / row[other]
                self.steps = np.column_stack([self.steps, step])
                self.free += (self.free[one],)
                self.moved.append(np.flatnonzero(np.abs(step) > _UNMOVED))
                self.bent = np.append(self.bent, False)
                self._loop.append(np.zeros(0, dtype=np.int64))

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
        loops = bound_in_common(closure, self.origin)
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
