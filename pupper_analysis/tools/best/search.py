"""The search for the best stance: a smooth programme, from many starts."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    NoEquilibriumError,
    StaticsInfeasibleError,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.robot.tool import Place, find_place
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.equilibrium import peak_utilisation
from pupper_analysis.tools.best.first_order import SmallPayload, largest_feasible_mass
from pupper_analysis.tools.best.space import JOINT_LIMIT_OVERSHOOT, StanceSlack, StanceSpace

Array = NDArray[np.float64]
_SAMPLES = 128
_STARTS = 16
"""Of the samples, besides the nominal stand. With 3 v3-long-leg's payload may be 10.6 kg and not
14.1, by the last digits of a number; from 8 on it is 14.1. The nominal stand, by symmetry, is a
saddle, which a descent leaves to where rounding sends it."""

_FIRST = 8  # iterations of a first descent, which tells from where it is worth going on
_FINALISTS = 6
"""The best of those, from which descents are begun anew as long as they gain: with one from each
start, which stopped in a kink, v3's least utilisation was 5.569 or 5.588 %, by how many processors
the linear algebra used; now it is 5.569 % with one and with two. v3-heavy's payload wants three;
with four, v3-long-leg's utilisation on three feet is greater by 3e-4 of it. From the end of each
the feet then go apart: of 24 random robots, where only the very best did so, four were 1.4 to 7.6 %
worse than the best that thirty random descents more found."""

_DESCENT = 25  # iterations of one descent
_APART = 10  # iterations with all coordinates free, each of which takes a dozen stances
_WORTHWHILE = 3e-4  # of the value: a gain for which it goes on
_CONVERGED = 1e-5  # of the nominal value: a gain in one iteration that ends a descent
_DIFFERENCE_STEP = 1e-6  # of the bounds' distance: of the differences that gradients are taken from
_INSIDE = 1e-6  # of what may not be used up: where descents stop short, so that they end inside
_UNREACHED = 10.0  # what is missing where there is no stance, in parts of the nominal value


class Objective(StrEnum):
    """What the best stance has the best of.

    UTILISATION: the least peak motor utilisation.
    MARGIN: the largest distance of the com's projection from the support polygon's edge.
    PAYLOAD: the largest payload at a point (``payload_limit``).
    """

    UTILISATION = "utilisation"
    MARGIN = "margin"
    PAYLOAD = "payload"


@dataclass(frozen=True, eq=False)
class EvaluatedStance:
    """A stance that was evaluated.

    Attributes:
        coordinates: In the space of stances.
        stand: Its stand.
        level: The objective's level, in parts of the nominal one: less is better.
        rows: (k, 2): a + b level >= 0 are the constraints that make the level what it is, and the
            room.
        allowed: Whether nothing is used up.
    """

    coordinates: Array
    stand: Stand
    level: float
    rows: Array
    allowed: bool


_NEXT_LEVEL = 0.2
"""Smallest difference between two stances that are simulated one after the other until one holds,
in parts of the improvement that the search found: at most five are simulated. Chosen."""


class StanceSearch:
    """The search; ``best`` is the best stance so far."""

    def __init__(
        self,
        robot: Robot,
        objective: Objective,
        task: StandTask | None = None,
        point: Place = (0.0, 0.0, 0.0),
        kp: ArrayLike | None = None,
    ) -> None:
        self.robot, self.objective = robot, objective
        self.point = find_place(robot, point)
        self.limits = robot.effort_limits
        self.bears = np.isfinite(self.limits)
        self.evaluations = 0
        if objective is not Objective.MARGIN and robot.floating:
            self._check_limits()  # before the space is measured, which takes seconds
        self.space = StanceSpace(robot, task or StandTask())
        if objective is Objective.PAYLOAD:
            stiffness = model_with_servos(robot, kp, None if kp is None else 0.0).kp
            self.payload = SmallPayload(robot, self.point, stiffness)
        self.scale = 1.0
        first = self.stance(self.space.start, self.space.nominal)
        self.scale = abs(first.level) or robot.stand_height
        self.nominal = self.best = self.stance(self.space.start, self.space.nominal)
        self.known: dict[tuple[float, ...], EvaluatedStance | None] = {}

    def _check_limits(self) -> None:
        robot = self.robot
        if not self.bears.any():
            message = diagnose("no-effort-limits", robot=robot.name)
            raise ConfigurationError("objective", message)
        none = np.flatnonzero(self.limits <= 0)
        if len(none):
            message = diagnose("effort-limit-is-zero", joint=robot.joint_names[none[0]])
            raise ConfigurationError("objective", message)

    def value(self, stand: Stand) -> float:
        """Returns the utilisation, or the margin (m), of a stand."""
        statics = stand_statics(self.robot, stand)
        assert statics.com_margin is not None
        if self.objective is Objective.MARGIN:
            return statics.com_margin
        return peak_utilisation(statics.motor_utilisation)

    def evaluate(self, coordinates: Array, near: Stand | None = None) -> EvaluatedStance | None:
        """Returns a stance, or None if there is none; remembers the best that is allowed.

        Args:
            coordinates: In the space of stances.
            near: See ``StanceSpace.stand``.
        """
        key = tuple(coordinates.tolist())
        if key not in self.known:
            self.evaluations += 1
            self.known[key] = None
            with suppress(StaticsInfeasibleError, NoEquilibriumError, ConfigurationError):
                stand = self.space.stand(coordinates, near)
                if stand is not None:
                    self.known[key] = self.stance(coordinates, stand)
        found = self.known[key]
        if found is not None and found.allowed and found.level < self.best.level:
            self.best = found
        return found

    def next_best(self) -> Iterator[EvaluatedStance]:
        """Yield allowed stances that are worse than the best, then the task as it was given.

        Each is at least ``_NEXT_LEVEL`` worse than the previous one, in parts of the way from the
        best level to that of the task.
        """
        allowed = [stance for stance in self.known.values() if stance and stance.allowed]
        step = _NEXT_LEVEL * (self.nominal.level - self.best.level)
        level = self.best.level
        for stance in sorted(allowed, key=lambda stance: stance.level):
            if level + step <= stance.level < self.nominal.level:
                level = stance.level
                yield stance
        yield self.nominal

    def stance(self, coordinates: Array, stand: Stand) -> EvaluatedStance:
        """Evaluates a stand."""
        room = self.space.room(stand)
        level, rows = self._level(stand, room)
        left = room.less(_INSIDE)
        allowed = bool(
            room.singular_values.min() >= 0
            and room.joints.min() >= -JOINT_LIMIT_OVERSHOOT
            and room.edges.min() >= 0
            and room.touching >= 0
        )
        kept = np.column_stack([left, np.zeros(len(left))])
        return EvaluatedStance(coordinates, stand, level, np.concatenate([rows, kept]), allowed)

    def _level(self, stand: Stand, room: StanceSlack) -> tuple[float, Array]:
        """Returns the level, and the rows (k, 2) of which it is the least that satisfies all."""
        if self.objective is Objective.PAYLOAD:
            return self._payload_level(stand)
        if self.objective is Objective.MARGIN:
            inside = (room.edges + stand.task.com_margin) / self.scale
            return -float(inside.min()), np.column_stack([inside, np.ones(len(inside))])
        torques = stand_statics(self.robot, stand).joint_torques
        use = torques[self.bears] / self.limits[self.bears] / self.scale
        both = np.concatenate([use, -use])
        return float(both.max()), np.column_stack([-both, np.ones(len(both))])

    def _payload_level(self, stand: Stand) -> tuple[float, Array]:
        """Returns the same for a payload, of mass -scale * level."""
        rows = self.payload.rows(stand)
        if rows is None:
            raise NoEquilibriumError(None, diagnose("servos-too-soft-unloaded"))
        return -largest_feasible_mass(rows) / self.scale, rows * (1.0, -self.scale)

    def run(self) -> None:
        """Searches, with the feet together first, and then with each free."""
        space = self.space
        if not (space.high > space.low).any():
            return
        joined = Subspace(space, space.start, space.directions())
        samples = _samples(joined.size)
        tried = [self.evaluate(joined.at(sample)) for sample in samples]
        order = np.argsort([self.merit(stance) for stance in tried], kind="stable")
        starts = (joined.start, *samples[order[:_STARTS]])
        ends = [self._descend(joined, start, _FIRST) for start in starts]
        order = np.argsort([level for level, _ in ends], kind="stable")
        for number in order[:_FINALISTS]:
            level, share = ends[number]
            before = np.inf
            while before - level > _WORTHWHILE * abs(level):  # a kink may stop a descent short
                before = level
                level, share = self._descend(joined, share, _DESCENT)
            if np.isfinite(level):
                self._descend_apart(joined.at(share), _APART)
        before = np.inf
        while before - self.best.level > _WORTHWHILE * abs(self.best.level):
            before = self.best.level
            self._descend_apart(self.best.coordinates, _DESCENT)

    def _descend_apart(self, coordinates: Array, most: int) -> None:
        """Goes down with all coordinates free, in at most so many iterations."""
        apart = Subspace(self.space, coordinates, np.eye(len(coordinates)))
        self._descend(apart, apart.start, most)

    def merit(self, stance: EvaluatedStance | None) -> float:
        """Returns the level, worse by what is used up more than there is; infinite for none."""
        if stance is None:
            return np.inf
        room = stance.rows[stance.rows[:, 1] == 0, 0]  # rows that do not depend on the level
        return stance.level - _UNREACHED * float(np.minimum(room, 0).sum())

    def _descend(self, subspace: Subspace, start: Array, iterations: int) -> tuple[float, Array]:
        """Goes down to a local best in (shares, level), as SLSQP finds it.

        Returns:
            The least level that is allowed, and its shares; infinite, and the start, if none is.
        """
        from scipy import optimize  # slow to import

        first = self.evaluate(subspace.at(start))
        best = np.inf, start
        if first is None:
            return best
        missing = first.rows - np.array([_UNREACHED, 0.0])

        def rows(share: Array) -> Array:
            nonlocal best
            stance = self.evaluate(subspace.at(share))
            if stance is not None and stance.allowed and stance.level < best[0]:
                best = stance.level, share.copy()
            return missing if stance is None else stance.rows

        def derivative(values: Array) -> Array:
            share, level = values[:-1], values[-1]
            here, at = rows(share), self.evaluate(subspace.at(share))
            near = None if at is None else at.stand
            columns = []
            for index in range(len(share)):
                step = np.zeros(len(share))
                step[index] = (
                    _DIFFERENCE_STEP if share[index] + _DIFFERENCE_STEP <= 1 else -_DIFFERENCE_STEP
                )
                ahead = self.evaluate(subspace.at(share + step), near)
                if ahead is None:
                    step = -step
                    ahead = self.evaluate(subspace.at(share + step), near)
                change = np.zeros_like(here) if ahead is None else ahead.rows - here
                columns.append((change @ (1.0, level)) / step[index])
            return np.column_stack([*columns, here[:, 1]])

        optimize.minimize(
            lambda values: values[-1],
            np.append(start, first.level),
            jac=lambda values: np.eye(len(values))[-1],
            method="SLSQP",
            bounds=[(0.0, 1.0)] * len(start) + [(None, None)],
            constraints={
                "type": "ineq",
                "fun": lambda values: rows(values[:-1]) @ (1.0, values[-1]),
                "jac": derivative,
            },
            options={"maxiter": iterations, "ftol": _CONVERGED},
        )
        return best


def _samples(size: int) -> Array:
    """Returns samples (n, size) of shares, one in each of n layers of every coordinate.

    Source: McKay, Beckman and Conover, "A comparison of three methods for selecting values of
    input variables", 1979. SciPy's sequences are as good, and take half a second to import.
    """
    random = np.random.default_rng(0)
    layers = np.array([random.permutation(_SAMPLES) for _ in range(size)]).T
    samples: Array = (layers + random.random((_SAMPLES, size))) / _SAMPLES
    return samples


class Subspace:
    """Stances along some directions, as shares from 0 to 1 of the way between the bounds."""

    def __init__(self, space: StanceSpace, origin: Array, directions: Array) -> None:
        low, high = [], []
        for column in directions.T:
            moved = column != 0
            ends = np.sort(
                [(limit - origin)[moved] / column[moved] for limit in (space.low, space.high)],
                axis=0,
            )
            low.append(ends[0].max())
            high.append(ends[1].min())
        movable = np.array(high) > np.array(low)
        self.origin, self.directions = origin, directions[:, movable]
        self.low, self.width = np.array(low)[movable], (np.array(high) - np.array(low))[movable]
        self.size = int(movable.sum())
        self.start = np.clip(-self.low / self.width, 0, 1)

    def at(self, share: Array) -> Array:
        """Returns the coordinates of shares (size,)."""
        way = self.low + np.clip(share, 0, 1) * self.width
        coordinates: Array = self.origin + self.directions @ way
        return coordinates
