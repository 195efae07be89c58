"""The worst posture of each motor: searched for, and bounded from above for all."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from pupper_analysis.arguments import check_arguments
from pupper_analysis.diagnostics import Diagnostic, diagnose
from pupper_analysis.posture.gravity_tree import GravityTree, describes_load
from pupper_analysis.posture.posture import Posture, check_held, joint_ranges
from pupper_analysis.results import Tabular
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool

Array = NDArray[np.float64]

_STARTS = 12
"""Random postures that a search begins from, besides the one that is asked about."""

_CLOSE = 2e-3
"""A search ends when it is so near to what cannot be exceeded, in parts of it."""

_AGREED = 3
"""Searches that end at the same torque, and then no other is begun."""

_SAME = 1e-9  # in parts of the torque

_SWEEPS = 30
_GAIN = 1e-12  # of a sweep, in parts of the torque: less is rounding

_SAMPLES = 40
"""Looks along a joint that others follow, where torques are no single wave."""

_CHECKED = 8
"""Random postures in which gravity on the tree is compared with what motors and springs hold."""

_ROUNDING = 1e-8
"""N m per N of weight: by which both may differ there."""


class Everywhere(StrEnum):
    """Whether a motor holds in every posture."""

    HOLDS = "holds everywhere"
    FAILS = "does not hold everywhere"
    OPEN = "not decided"


@dataclass(frozen=True, eq=False)
class WorstPostures(Tabular):
    """The posture in which gravity asks most of each motor.

    Attributes:
        joint_names: In actuator order.
        joint_torques: (nu,) the greatest found, with its sign (N m, N).
        postures: (nu, nu) where; a row for each motor (rad, m).
        bounds: (nu,) what no posture exceeds, either way (N m, N); infinite where none is known.
        limits: (nu,) of the motors (N m, N).
        utilisation: (nu,) the greatest found / limit.
        everywhere: (nu,) whether the motor holds in every posture; by the bound if it does, by the
            posture if it does not.
        unproven: Why there is no bound; None if there is.
    """

    joint_names: tuple[str, ...]
    joint_torques: Array
    postures: Array
    bounds: Array
    limits: Array
    utilisation: Array
    everywhere: tuple[Everywhere, ...]
    unproven: Diagnostic | None

    def _columns(self) -> dict[str, ArrayLike]:
        return {
            "joint": self.joint_names,
            "torque": self.joint_torques,
            "bound": self.bounds,
            "utilisation": self.utilisation,
            "everywhere": [one.value for one in self.everywhere],
        }


@check_arguments
def worst_postures(
    robot: Robot, posture: Posture, tool: Tool, *, payload: float = 0.0
) -> WorstPostures:
    """Finds for each motor the posture in which gravity asks most of it.

    A torque is a + b cos q + c sin q of each joint's angle q with the others where they are
    (a + b q of a slide), so that three looks give its greatest along a joint in closed form; a
    search goes from joint to joint, from several postures. That no posture exceeds what is found by
    much says the bound of ``GravityTree.greatest``.

    Args:
        robot: A robot whose base is held.
        posture: Where joints are that do not matter.
        tool: Where the payload is.
        payload: A mass at the tool (kg).

    Raises:
        ConfigurationError: If the base is free.
    """
    check_held(robot)
    ways = Ways.of(robot, posture)
    unproven = ways.unproven
    bounds = np.full((robot.nu, 2), math.inf)
    if unproven is None:
        bounds = torque_bounds(robot, ways, tool, payload)
    search = _Search(robot, ways, tool, payload)
    starts = ways.random(_STARTS)
    torques, postures = np.zeros(robot.nu), np.tile(posture.qpos, (robot.nu, 1))
    for joint in range(robot.nu):
        for column, sign in enumerate((1.0, -1.0)):
            goal = bounds[joint, column]
            if goal <= abs(torques[joint]):
                continue
            found, at = search.highest(joint, sign, [posture.qpos, *starts], goal)
            if found > abs(torques[joint]):
                torques[joint], postures[joint] = sign * found, at
    most, limits = np.abs(torques), robot.effort_limits
    either = np.maximum(bounds.max(axis=1), most)  # a bound is one up to rounding
    with np.errstate(divide="ignore", invalid="ignore"):
        used = np.where(most > 0, most / limits, 0.0)
    return WorstPostures(
        joint_names=robot.joint_names,
        joint_torques=torques,
        postures=postures,
        bounds=either,
        limits=limits,
        utilisation=used,
        everywhere=tuple(
            Everywhere.HOLDS
            if bound <= limit
            else Everywhere.FAILS
            if found > limit
            else Everywhere.OPEN
            for found, bound, limit in zip(most, either, limits, strict=True)
        ),
        unproven=unproven,
    )


@dataclass(frozen=True, eq=False)
class Ways:
    """The ways in which a robot's joints move: those that follow others, with them.

    Attributes:
        robot: The robot.
        origin: (nu,) a posture.
        free: Numbers of the joints that follow none.
        steps: (nu, n) how all joints move with each of these.
        ranges: (nu, 2) of the joints (rad, m); of those that turn freely, a turn.
        shares: (nu, nu) what motors hold of each joint's load.
        unproven: Why no bound over all postures can be had; None if it can.
    """

    robot: Robot
    origin: Array
    free: tuple[int, ...]
    steps: Array
    ranges: Array
    shares: Array
    unproven: Diagnostic | None

    @staticmethod
    def of(robot: Robot, posture: Posture) -> Ways:
        """Returns the ways of a robot, through a posture."""
        ranges = joint_ranges(robot)
        endless = ~np.isfinite(ranges)
        tree = GravityTree.of(robot, ranges)
        unproven = None
        if (endless.any(axis=1) & tree.slides).any():
            unproven = diagnose("slide-not-limited")
        turns = np.where(endless, posture.qpos[:, None] + (-math.pi, math.pi), ranges)
        steps, shares, free = np.eye(robot.nu), np.eye(robot.nu), tuple(range(robot.nu))
        closure = robot.closure
        if closure is not None:
            rows, following = closure.rows(posture.qpos), closure.following
            free = tuple(joint for joint in free if joint not in following)
            steps = steps[:, list(free)]
            steps[following] = -np.linalg.lstsq(
                rows[:, following], rows[:, list(free)], rcond=None
            )[0]
            shares = shares - closure.push(posture.qpos)
        ways = Ways(robot, posture.qpos, free, steps, turns, shares, unproven)
        return replace(ways, unproven=unproven or ways._why_not(tree))

    def random(self, count: int) -> list[Array]:
        """Returns random postures (nu,): the same ones each time."""
        random, found = np.random.default_rng(0), []
        for _ in range(count):
            qpos = self.origin.copy()
            for way in range(len(self.free)):
                low, high = self.span(qpos, way)
                qpos = self.along(qpos, way, float(random.uniform(low, high)))
            found.append(qpos)
        return found

    def span(self, qpos: Array, way: int) -> tuple[float, float]:
        """Returns how far (rad, m) joints can go along a way from a posture, back and forth."""
        step = self.steps[:, way]
        moving = np.abs(step) > 1e-9
        ends = (self.ranges[moving] - qpos[moving, None]) / step[moving, None]
        ends.sort(axis=1)
        return min(float(ends[:, 0].max()), 0.0), max(float(ends[:, 1].min()), 0.0)

    def along(self, qpos: Array, way: int, length: float) -> Array:
        """Returns the posture (nu,) that is so far along a way (rad, m)."""
        moved: Array = qpos + length * self.steps[:, way]
        return moved

    def _why_not(self, tree: GravityTree) -> Diagnostic | None:
        """Says why torques are not those of gravity on a tree of joints that move as they do."""
        closure, samples = self.robot.closure, [self.origin, *self.random(_CHECKED)]
        if closure is not None:
            for qpos in samples:
                if closure.open_by(qpos) > 1e-6:
                    return diagnose("loops-bend-ways")
                if np.abs(np.eye(len(qpos)) - closure.push(qpos) - self.shares).max() > 1e-6:
                    return diagnose("loops-bend-ways")
        weight = self.robot.total_mass * float(np.linalg.norm(self.robot.gravity))
        if not describes_load(self.robot, tree, samples, _ROUNDING * weight):
            return diagnose("springs-act-at-rest")
        return None


def torque_bounds(robot: Robot, ways: Ways, tool: Tool, payload: float) -> Array:
    """Returns what no posture exceeds (nu, 2): each motor's torque, and its negative (N m, N)."""
    tree = GravityTree.of(robot, joint_ranges(robot)).with_mass(robot, tool, payload)
    most = tree.greatest()
    ahead, back = np.maximum(ways.shares, 0.0), np.maximum(-ways.shares, 0.0)
    return np.column_stack(
        [ahead @ most[:, 0] + back @ most[:, 1], ahead @ most[:, 1] + back @ most[:, 0]]
    )


class _Search:
    """Climbs from posture to posture to where a motor holds most."""

    def __init__(self, robot: Robot, ways: Ways, tool: Tool, payload: float) -> None:
        self._robot, self._ways, self._tool, self._payload = robot, ways, tool, payload
        self._slides = GravityTree.of(robot, ways.ranges).slides
        model = robot.structure.model
        numbers = [robot.structure.joints[name] for name in robot.joint_names]
        carried = np.array([[other in model.supports[one] for other in numbers] for one in numbers])
        self._matters = carried | carried.T

    def highest(
        self, joint: int, sign: float, starts: list[Array], goal: float
    ) -> tuple[float, Array]:
        """Returns the most that a motor holds with a sign (N m, N), and where, from some postures.

        A search of it ends near what no posture exceeds, or where several end alike.
        """
        ends: list[tuple[float, Array]] = []
        for start in starts:
            ends.append(self.climb(joint, sign, start))
            best = max(ends, key=lambda end: end[0])
            alike = sum(end[0] >= best[0] - _SAME * abs(best[0]) for end in ends)
            if best[0] >= (1 - _CLOSE) * goal or alike >= _AGREED:
                break
        return best

    def climb(self, joint: int, sign: float, qpos: Array) -> tuple[float, Array]:
        """Returns the most that a motor holds with a sign (N m, N), and where, near a posture."""
        ways, best = self._ways, self._torque(joint, sign, qpos)
        loads = np.abs(ways.shares[joint]) > 1e-12
        for _ in range(_SWEEPS):
            before = best
            for way, step in enumerate(ways.steps.T):
                moved = np.flatnonzero(np.abs(step) > 1e-9)
                if not self._matters[np.ix_(loads, moved)].any():
                    continue
                low, high = ways.span(qpos, way)

                def at(length: float, way: int = way, qpos: Array = qpos) -> float:
                    return self._torque(joint, sign, ways.along(qpos, way, length))

                length = self._highest(at, moved, best, low, high)
                found = at(length)
                if found > best:
                    best, qpos = found, ways.along(qpos, way, length)
            if best - before <= _GAIN * abs(best):
                break
        return best, qpos

    def _highest(
        self,
        at: Callable[[float], float],
        moved: NDArray[np.int64],
        here: float,
        low: float,
        high: float,
    ) -> float:
        """Returns where along a way a torque is greatest."""
        if len(moved) > 1:
            looks = np.linspace(low, high, _SAMPLES)
            top = int(np.argmax([at(look) for look in looks]))
            ends = looks[max(top - 1, 0)], looks[min(top + 1, _SAMPLES - 1)]
            if ends[1] - ends[0] < 1e-12:
                return float(looks[top])
            found = optimize.minimize_scalar(
                lambda length: -at(length), bounds=ends, method="bounded", options={"xatol": 1e-10}
            )
            return float(max((found.x, looks[top]), key=at))
        if self._slides[moved[0]]:
            return max((low, high), key=at)
        third = 2 * math.pi / 3
        ahead, behind = at(third), at(-third)
        mean = (here + ahead + behind) / 3
        peak = math.atan2((ahead - behind) / math.sqrt(3), here - mean)
        turns = [peak + turn for turn in (-2 * math.pi, 0.0, 2 * math.pi)]
        inside = [turn for turn in turns if low <= turn <= high]
        return inside[0] if inside else max((low, high), key=at)

    def _torque(self, joint: int, sign: float, qpos: Array) -> float:
        config = Configuration(self._robot, qpos)
        load = config.load()
        if self._payload:
            pull = self._payload * self._robot.gravity
            load = load - self._tool.jacobian(config).T @ pull
        if self._ways.unproven is None:  # then the shares are the same everywhere
            return sign * float(self._ways.shares[joint] @ load)
        return sign * float(config.by_motors(load)[joint])
