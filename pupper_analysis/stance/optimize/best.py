"""The best stance: how high, how wide and how far forward a robot stands best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.errors import (
    ConfigurationError,
    NoEquilibriumError,
    StanceUnreachableError,
    StaticsInfeasibleError,
)
from pupper_analysis.results import Result
from pupper_analysis.robot.payload import point_on_base, with_payload
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import servos
from pupper_analysis.stance.optimize.space import JOINT_RESERVE, Room, StanceSpace
from pupper_analysis.stance.payload.first_order import FirstOrder
from pupper_analysis.stance.payload.limit import PayloadLimit, payload_limit
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.stance.workspace import Interval
from pupper_analysis.statics.equilibrium import ForceDistribution

Array = NDArray[np.float64]

_SAMPLES = 64  # a power of two, as Sobol's sequence likes it
_STARTS = 3  # of the samples, besides the nominal stand
_DESCENT = 25  # iterations of one descent
_LOOK = 4  # iterations with all coordinates free, each of which takes a dozen stances
_WORTHWHILE = 1e-3  # of the value: a gain for which it goes on
_CONVERGED = 1e-4  # of the nominal value: a gain in one iteration that ends a descent
_STEP = 1e-6  # of the bounds' distance: of the differences that gradients are taken from
_INSIDE = 1e-6  # of what may not be used up: where descents stop short, so that they end inside
_UNREACHED = 10.0  # what is missing where there is no stance, in parts of the nominal value
_AT_BOUND = 1e-2  # of the bounds' distance
_AT_LIMIT = 1e-2  # rad


class Objective(StrEnum):
    """What the best stance has the best of.

    UTILISATION: the least peak motor utilisation.
    MARGIN: the largest distance of the com's projection from the support polygon's edge.
    PAYLOAD: the largest payload at a point of the base (``payload_limit``).
    """

    UTILISATION = "utilisation"
    MARGIN = "margin"
    PAYLOAD = "payload"


@dataclass(frozen=True, eq=False)
class BestStance(Result):
    """The best stance found.

    Attributes:
        objective: What it is the best in.
        stand: How the robot stands in it.
        value: The objective's value there: peak torque / effort limit, margin (m), or payload (kg).
        nominal_value: That of the task as it was given (by default the nominal stand).
        nominal: The stand of the task as it was given.
        payload: Of ``stand``, with what binds it, if that is the objective.
        coordinates: {``height`` of the base (m); ``x``, ``y`` of the base from the centre of the
            feet (m); ``roll``, ``pitch``, ``yaw`` (rad); ``FR x``, ``FR y`` ...: each foot's way
            from where the task has it (m)} of the best stance, in world axes.
        bounds: Between which values of each coordinate it was sought.
        active: What it lies on, and what a better stance may be beyond: bounds, such as ``"height
            high"``; joint limits, such as ``"FL_KFE low"``; legs with no more than
            ``LEAST_SINGULAR_VALUE``, such as ``"FL stretched"`` (or folded up).
        evaluations: Stances tried.
    """

    objective: Objective
    stand: Stand
    value: float
    nominal_value: float
    nominal: Stand
    payload: PayloadLimit | None
    coordinates: dict[str, float]
    bounds: dict[str, Interval]
    active: tuple[str, ...]
    evaluations: int


def best_stance(
    robot: Robot,
    objective: Objective = Objective.UTILISATION,
    *,
    task: StandTask | None = None,
    point: tuple[float, float, float] = (0.0, 0.0, 0.0),
    distribution: ForceDistribution = ForceDistribution.MIN_TANGENTIAL,
    kp: ArrayLike | None = None,
) -> BestStance:
    """Searches for the best stance: the base's height, place and turn, and where each foot is.

    All else is the task's: its ground, lifted feet, margins and ik_seed; ``feet`` that it places
    stay there. The com is where the base takes it, inside the support polygon with at least
    ``com_margin``.

    The bounds are: of the height, the reachable ones less ``HEIGHT_RESERVE`` at either end; of the
    base's other coordinates, how far it can go from the task with the feet planted
    (``base_workspace``), turns by at most ``MOST_TURN``; of each foot, ``SPREAD`` of the greatest
    height outwards and no more than ``CLOSING`` of the least distance from the middle inwards. Legs
    keep ``LEAST_SINGULAR_VALUE``: stretched ones would win, needing no torque. A stance is also
    refused if it has parts touching each other or the ground (not: its steps) that do not in the
    task's.

    The best of a stance is the least of the greatest of many smooth functions: a kink, at which
    descents that see one number get stuck. So the common bound of all these functions is itself
    a variable, and they, and what may not be used up, are constraints of a smooth programme
    (SLSQP). It starts at the nominal stand and at the best of Sobol's samples, with the feet moving
    together (and, if nothing in the task tells left from right, without y, roll and yaw); from the
    best of these ends it goes on with all coordinates free. It is the same every time, and never
    worse than the nominal stand.

    Payload: the search goes by first order (``FirstOrder``): the least of the masses at which a
    motor saturates, a foot lets go, the servos buckle, and feet have sunk so deep that another part
    touches the ground, all in closed form. The stance found and the task's own then have their true
    limit found (``payload_limit``), and the better one is returned. Legs that are almost stretched
    need little torque, and buckle: for v3 the stance that the motors like best bears 3.7 kg, the
    nominal one 6.1.

    Args:
        robot: A robot with a floating base.
        objective: What shall be best.
        task: Where the search begins, and all that is not searched over; the nominal stand by
            default.
        point: Where the payload is, in the base's frame (m).
        distribution: Which contact forces the motors' utilisation is that of: by default
            ``MIN_TANGENTIAL``, what a simulator holds for good.
        kp: Servo stiffness for the payload (N m/rad), one or (nu,); the model's own by default.

    Returns:
        The best stance found.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand, or no
            motor has an effort limit that it could use, or one has a limit of zero.
        ModelError: If the payload is sought, the model has no position servos, and no kp is given.
        StanceUnreachableError: If the task itself is out of reach.
        StaticsInfeasibleError: If the task itself cannot be held.
        NoEquilibriumError: If the payload is sought, and servos do not hold the task itself.
    """
    search = StanceSearch(robot, _objective(objective), task, point, distribution, kp)
    search.run()
    space, best, payload = search.space, search.best, None
    if search.objective is Objective.PAYLOAD:
        nominal, payload = (
            payload_limit(robot, stand, point, kp=kp) for stand in (space.nominal, best.stand)
        )
        if payload.mass < nominal.mass:  # first order was wrong about it
            best, payload = search.nominal, nominal
        value, nominal_value = payload.mass, nominal.mass
    else:
        value, nominal_value = (search.value(stand) for stand in (best.stand, space.nominal))
    return BestStance(
        objective=search.objective,
        stand=best.stand,
        value=value,
        nominal_value=nominal_value,
        nominal=space.nominal,
        payload=payload,
        coordinates=dict(zip(space.names, best.coordinates.tolist(), strict=True)),
        bounds={
            name: Interval(float(low), float(high))
            for name, low, high in zip(space.names, space.low, space.high, strict=True)
        },
        active=_active(space, best),
        evaluations=search.evaluations,
    )


def _objective(value: str) -> Objective:
    try:
        return Objective(value)
    except ValueError as error:
        known = ", ".join(Objective)
        raise ConfigurationError("objective", f"{value!r} is none of {known}") from error


@dataclass(frozen=True, eq=False)
class _Stance:
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


class StanceSearch:
    """The search; ``best`` is the best stance so far."""

    def __init__(
        self,
        robot: Robot,
        objective: Objective,
        task: StandTask | None = None,
        point: Sequence[float] = (0.0, 0.0, 0.0),
        distribution: ForceDistribution = ForceDistribution.MIN_TANGENTIAL,
        kp: ArrayLike | None = None,
    ) -> None:
        self.robot, self.objective, self.distribution = robot, objective, distribution
        self.point = point_on_base(point)
        self.limits = robot.effort_limits
        self.bears = np.isfinite(self.limits)
        self.evaluations = 0
        self.space = StanceSpace(robot, task or StandTask())
        if objective is not Objective.MARGIN:
            self._check_limits()
        self.mass = robot.total_mass
        if objective is Objective.PAYLOAD:
            # Small: with one that tips the robot there is no line to follow.
            self.loaded = with_payload(robot, robot.total_mass / 10, self.point.tolist())
            self.kp = servos(robot, kp, None if kp is None else 0.0).kp
        self.scale = 1.0
        first = self.stance(self.space.start, self.space.nominal)
        self.scale = abs(first.level) or robot.stand_height
        self.nominal = self.best = self.stance(self.space.start, self.space.nominal)
        self.known: dict[bytes, _Stance | None] = {}

    def _check_limits(self) -> None:
        robot = self.robot
        if not self.bears.any():
            raise ConfigurationError("objective", f"no motor of {robot.name} has an effort limit")
        none = np.flatnonzero(self.limits <= 0)
        if len(none):
            raise ConfigurationError(
                "objective",
                f"the effort limit of {robot.joint_names[none[0]]} is 0 N m, no part of which can "
                "be used; give the URDF limits > 0",
            )

    def value(self, stand: Stand) -> float:
        """Returns the utilisation, or the margin (m), of a stand."""
        statics = stand_statics(self.robot, stand, distribution=self.distribution)
        assert statics.com_margin is not None
        if self.objective is Objective.MARGIN:
            return statics.com_margin
        return float(statics.motor_utilisation.max())

    # ---------------------------------------------------------------------------- one stance

    def evaluate(self, coordinates: Array) -> _Stance | None:
        """Returns a stance, or None if there is none; remembers the best that is allowed."""
        key = coordinates.tobytes()
        if key not in self.known:
            self.evaluations += 1
            try:
                stand = solve_stand(self.robot, self.space.task(coordinates), explain=False)
                self.known[key] = self.stance(coordinates, stand)
            except (
                StanceUnreachableError,
                StaticsInfeasibleError,
                NoEquilibriumError,
                ConfigurationError,
            ):
                self.known[key] = None
        found = self.known[key]
        if found is not None and found.allowed and found.level < self.best.level:
            self.best = found
        return found

    def stance(self, coordinates: Array, stand: Stand) -> _Stance:
        """Evaluates a stand."""
        room = self.space.room(stand)
        level, rows = self._level(stand, room)
        left = room.less(_INSIDE)
        allowed = bool(
            room.singular_values.min() >= 0
            and room.joints.min() >= -JOINT_RESERVE
            and room.edges.min() >= 0
            and room.touching >= 0
        )
        kept = np.column_stack([left, np.zeros(len(left))])
        return _Stance(coordinates, stand, level, np.concatenate([rows, kept]), allowed)

    def _level(self, stand: Stand, room: Room) -> tuple[float, Array]:
        """Returns the level, and the rows (k, 2) of which it is the least that satisfies all."""
        if self.objective is Objective.PAYLOAD:
            return self._payload_level(stand)
        if self.objective is Objective.MARGIN:
            inside = (room.edges + stand.task.com_margin) / self.scale
            return -float(inside.min()), np.column_stack([inside, np.ones(len(inside))])
        torques = stand_statics(self.robot, stand, distribution=self.distribution).joint_torques
        use = torques[self.bears] / self.limits[self.bears] / self.scale
        both = np.concatenate([use, -use])
        return float(both.max()), np.column_stack([-both, np.ones(len(both))])

    def _payload_level(self, stand: Stand) -> tuple[float, Array]:
        """Returns the same for a payload, of mass -scale * level."""
        first = FirstOrder.of(self.robot, self.loaded, stand, self.kp)
        if first is None:
            raise NoEquilibriumError(0.0, "the servos are too soft for the stand without payload")
        loads, limits = first.loads, self.limits[self.bears]
        torque, rate = loads.torques[self.bears] / limits, loads.torque_rates[self.bears] / limits
        weight = self.mass * float(np.linalg.norm(self.robot.gravity))
        light = np.isfinite(first.strongest)
        sinking = first.strongest[light] - loads.normals[light]
        # Rows room + slope * mass >= 0.
        rows = [
            np.column_stack([1 - torque, -rate]),
            np.column_stack([1 + torque, rate]),
            np.column_stack([loads.normals, loads.normal_rates]) / weight,
            np.column_stack([sinking, -loads.normal_rates[light]]) / weight,
            np.column_stack([np.ones(len(first.modes)), -first.modes]),
        ]
        level = -first.limit(self.limits) / self.scale
        return level, np.concatenate(rows) * (1.0, -self.scale)

    # ---------------------------------------------------------------------------- the search

    def run(self) -> None:
        """Searches, with the feet together first, and then with each free."""
        from scipy.stats import qmc  # slow to import

        space = self.space
        if not (space.high > space.low).any():
            return
        together = Subspace(space, space.start, space.directions())
        samples = qmc.Sobol(together.size, seed=0).random(_SAMPLES)
        tried = [self.evaluate(together.at(sample)) for sample in samples]
        order = np.argsort([self.merit(stance) for stance in tried], kind="stable")
        for start in (together.start, *samples[order[:_STARTS]]):
            self._descend(together, start, _DESCENT)
        # Where symmetry makes the best, nothing is to be gained apart: a look tells.
        before = np.inf
        while before - self.best.level > _WORTHWHILE * abs(self.best.level):
            before = self.best.level
            apart = Subspace(space, self.best.coordinates, np.eye(len(space.start)))
            self._descend(apart, apart.start, _LOOK)

    def merit(self, stance: _Stance | None) -> float:
        """Returns the level, worse by what is used up more than there is; infinite for none."""
        if stance is None:
            return np.inf
        room = stance.rows[stance.rows[:, 1] == 0, 0]  # rows that do not depend on the level
        return stance.level - _UNREACHED * float(np.minimum(room, 0).sum())

    def _descend(self, subspace: Subspace, start: Array, iterations: int) -> None:
        """Goes down to a local best in (shares, level), as SLSQP finds it."""
        from scipy import optimize  # slow to import

        first = self.evaluate(subspace.at(start))
        if first is None:
            return
        missing = first.rows - np.array([_UNREACHED, 0.0])

        def rows(share: Array) -> Array:
            stance = self.evaluate(subspace.at(share))
            return missing if stance is None else stance.rows

        def derivative(values: Array) -> Array:
            share, level = values[:-1], values[-1]
            here = rows(share)
            columns = []
            for index in range(len(share)):
                step = np.zeros(len(share))
                step[index] = _STEP if share[index] + _STEP <= 1 else -_STEP
                ahead = self.evaluate(subspace.at(share + step))
                if ahead is None:
                    step = -step
                    ahead = self.evaluate(subspace.at(share + step))
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


def _active(space: StanceSpace, best: _Stance) -> tuple[str, ...]:
    """Returns what the best stance lies on."""
    robot = space.robot

    def sides(name: str, low: float, value: float, high: float, near: float) -> list[str]:
        found = [f"{name} low"] if value - low <= near else []
        return [*found, f"{name} high"] if high - value <= near else found

    found = []
    for name, low, value, high in zip(
        space.names, space.low, best.coordinates, space.high, strict=True
    ):
        if high > low:
            found += sides(name, low, value, high, _AT_BOUND * (high - low))
    margin, joints = best.stand.task.joint_margin, best.stand.joint_positions(robot)
    lower, upper = robot.lower_limits + margin, robot.upper_limits - margin
    for name, low, value, high in zip(robot.joint_names, lower, joints, upper, strict=True):
        found += sides(name, low, value, high, _AT_LIMIT)
    return (*found, *(f"{foot} stretched" for foot in space.stretched(best.stand)))
