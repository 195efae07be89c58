"""The best stance: how high, how wide and how far forward a robot stands best."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis import contact
from pupper_analysis.configuration import Configuration
from pupper_analysis.envelope import Interval, pose_envelope
from pupper_analysis.errors import (
    ConfigurationError,
    StanceUnreachableError,
    StaticsInfeasibleError,
)
from pupper_analysis.payload import payload_limit
from pupper_analysis.results import Result
from pupper_analysis.robot import Robot, on_ground
from pupper_analysis.stand import Stand, solve_stand, stand_statics
from pupper_analysis.statics import LoadSharing
from pupper_analysis.task import Ground, Point, StandTask

Array = NDArray[np.float64]

COORDINATES = ("height", "x", "length", "width", "pitch")
"""What is searched over: see ``BestStance.coordinates``."""

HEIGHT_RESERVE = 0.05
"""Share of the reachable heights that is left out at either end: legs stretched or folded up."""

SPREAD = 0.25
"""Most that a foot is moved fore-aft or sideways, in parts of the greatest reachable height."""

CLOSING = 0.5
"""Most that a foot is moved inwards, in parts of its distance from the middle of the feet."""

MOST_PITCH = 0.3
"""Most that the base pitches away from the task's pitch (rad)."""

LEAST_MOBILITY = 0.5
"""A leg's least mobility, in parts of the nominal one: the smallest singular value of its Jacobian.

A stretched leg has none. It holds the greatest loads without torque, and falls when it is pushed.
"""

_SAMPLES = 64  # a power of two, as Sobol's sequence likes it
_STARTS = 2  # of the samples, besides the nominal stand
_DESCENT = 120  # evaluations per descent
_POLISH = 160  # evaluations of the last search around the best
_REFUSED = 1e6  # a value worse than any of a stance that holds; how far off it is, is added
_AT_BOUND = 1e-2  # of the bounds' distance
_AT_LIMIT = 1e-2  # rad


class Objective(StrEnum):
    """What the best stance has the best of.

    UTILISATION: the least peak motor utilisation.
    MARGIN: the largest distance of the com's projection from the support polygon's edge.
    PAYLOAD: the largest payload at a point of the base.
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
        value: The objective's value there: peak torque / effort limit, margin (m) or payload (kg).
        nominal_value: That of the task as it was given (by default the nominal stand).
        nominal: The stand of the task as it was given.
        coordinates: {``height`` of the base (m); ``x`` of the base from the centre of the feet (m);
            ``length``: each foot's way outwards, fore-aft (m); ``width``: the same sideways (m);
            ``pitch`` (rad)} of the best stance, in world axes.
        bounds: Between which values of each coordinate it was sought.
        active: What it lies on, and what a better stance may be beyond: bounds, such as ``"height
            high"``; joint limits, such as ``"FL_KFE low"``; legs with no more than
            ``LEAST_MOBILITY``, such as ``"FL stretched"`` (or folded up).
        evaluations: Stances tried.
    """

    objective: Objective
    stand: Stand
    value: float
    nominal_value: float
    nominal: Stand
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
    sharing: LoadSharing = LoadSharing.EVEN,
) -> BestStance:
    """Searches for the best stance: the base's height, place and pitch, and how wide the feet are.

    The feet move symmetrically, outwards or inwards. All else is the task's: its roll, yaw, ground,
    lifted feet, margins and posture; ``feet`` that it places stay there. The com is where the base
    takes it, inside the support polygon with at least ``com_margin``.

    The bounds are: of the height, the reachable ones less ``HEIGHT_RESERVE`` at either end; of x
    and pitch, how far the base can go from the task with the feet planted (``pose_envelope``), the
    pitch by at most ``MOST_PITCH``; of the feet, ``SPREAD`` of the greatest height outwards and no
    more than ``CLOSING`` of their distance from the middle inwards. Legs keep ``LEAST_MOBILITY``:
    stretched ones would win, needing no torque. A stance is also refused if it has parts touching
    each other or the ground (not: its steps) that do not in the task's.

    Samples of Sobol's sequence, descents by Nelder and Mead's method from the best of them and from
    the nominal stand, and a last search by random steps of shrinking size: the same every time, and
    never worse than the nominal stand.

    Args:
        robot: A robot with a floating base.
        objective: What shall be best.
        task: Where the search begins, and all that is not searched over; the nominal stand by
            default.
        point: Where the payload is, in the base's frame (m).
        sharing: Which contact forces the motors' utilisation is that of: ``EVEN``, what a simulator
            holds for good, or those of least torque (least in the sum of squares: not always of
            least peak).

    Returns:
        The best stance found.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand, or no
            motor has an effort limit that it could use.
        StanceUnreachableError: If the task itself is out of reach.
        StaticsInfeasibleError: If the task itself cannot be held.
    """
    search = _Search(robot, _objective(objective), task or StandTask(), point, sharing)
    search.run()
    return BestStance(
        objective=search.objective,
        stand=search.stand,
        value=search.sign * search.cost,
        nominal_value=search.sign * search.nominal_cost,
        nominal=search.nominal,
        coordinates=dict(zip(COORDINATES, search.coordinates.tolist(), strict=True)),
        bounds={
            name: Interval(float(low), float(high))
            for name, low, high in zip(COORDINATES, search.low, search.high, strict=True)
        },
        active=search.active(),
        evaluations=search.evaluations,
    )


def _objective(value: str) -> Objective:
    try:
        return Objective(value)
    except ValueError as error:
        known = ", ".join(Objective)
        raise ConfigurationError("objective", f"{value!r} is none of {known}") from error


class _Search:
    """The search; ``coordinates``, ``stand`` and ``cost`` are those of the best stance so far."""

    def __init__(
        self,
        robot: Robot,
        objective: Objective,
        task: StandTask,
        point: tuple[float, float, float],
        sharing: LoadSharing,
    ) -> None:
        self.robot, self.objective = robot, objective
        self.point, self.sharing = point, sharing
        self.sign = 1.0 if objective is Objective.UTILISATION else -1.0
        self.nominal = self.stand = solve_stand(robot, task)
        if objective is Objective.UTILISATION and not np.isfinite(robot.effort_limits).any():
            raise ConfigurationError("objective", f"no motor of {robot.name} has an effort limit")
        # The floor turned, but without steps, which would have to follow the feet.
        ground = task.ground
        self._grounded = on_ground(robot, Ground(ground.slope, ground.uphill), {})
        self._touching = self._touches(self.nominal)
        self._mobile = LEAST_MOBILITY * self._mobility(self.nominal)
        self.nominal_cost = self.cost = self._cost(self.nominal)
        centre = np.mean(list(self.nominal.contact_points.values()), axis=0)[:2]
        self._y = float(self.nominal.qpos[1] - centre[1])
        self._outwards = {
            foot: np.sign(target[:2] - centre)
            for foot, target in self.nominal.foot_targets.items()
            if foot not in task.feet
        }
        height, pitch = self.nominal.task.height, task.pitch
        assert height is not None
        self.coordinates = np.array([height, self.nominal.qpos[0] - centre[0], 0.0, 0.0, pitch])
        self.low, self.high = self._bounds(centre)
        self.evaluations = 1

    def _bounds(self, centre: Array) -> tuple[Array, Array]:
        """Returns the coordinates' least and greatest values (5,); the nominal's are between."""
        within = pose_envelope(self.robot, self.nominal.task).intervals
        height, pitch = within["height"], self.coordinates[4]
        reserve = HEIGHT_RESERVE * (height.high - height.low)
        moved = [self.nominal.foot_targets[foot][:2] - centre for foot in self._outwards]
        apart = np.min(np.abs(moved), axis=0) if moved else np.zeros(2)
        spread = SPREAD * height.high if moved else 0.0
        inwards = np.minimum(spread, CLOSING * apart)
        low = (
            height.low + reserve,
            within["x"].low,
            *-inwards,
            max(within["pitch"].low, pitch - MOST_PITCH),
        )
        high = (
            height.high - reserve,
            within["x"].high,
            spread,
            spread,
            min(within["pitch"].high, pitch + MOST_PITCH),
        )
        return np.minimum(low, self.coordinates), np.maximum(high, self.coordinates)

    def task(self, coordinates: Array) -> StandTask:
        """Returns the task with the coordinates (5,)."""
        height, x, length, width, pitch = map(float, coordinates)
        task = self.nominal.task
        offsets: dict[str, Point] = dict(task.foot_offsets)
        for foot, (along, across) in self._outwards.items():
            had = task.foot_offsets.get(foot, (0.0, 0.0))
            offsets[foot] = (
                float(had[0] + along * length),
                float(had[1] + across * width),
            )
        return replace(
            task,
            height=height,
            pitch=pitch,
            offset=(x, self._y),
            foot_offsets=offsets,
            com="centre",
        )

    def evaluate(self, share: Array) -> float:
        """Returns the cost at a place between the bounds (5,), each from 0 to 1."""
        coordinates = self.low + np.clip(share, 0, 1) * (self.high - self.low)
        self.evaluations += 1
        try:
            stand = solve_stand(self.robot, self.task(coordinates), explain=False)
            new = self._touches(stand)
            added = sum(depth for pair, depth in new.items() if pair not in self._touching)
            if added > 0:
                return _REFUSED * (1 + added)
            stiff = self._mobile - self._mobility(stand)
            if (stiff > 0).any():
                return _REFUSED * (1 + float(stiff.max()))
            cost = self._cost(stand)
        except StanceUnreachableError as error:
            return _REFUSED * (1 + sum(error.shortfall.values()))
        except StaticsInfeasibleError as error:
            return _REFUSED * (1 + max(0.0, -error.margin))
        except ConfigurationError:
            return 2 * _REFUSED
        if cost < self.cost:
            self.cost, self.stand, self.coordinates = cost, stand, coordinates
        return cost

    def _cost(self, stand: Stand) -> float:
        statics = stand_statics(self.robot, stand, sharing=self.sharing)
        margin = statics.com_margin
        assert margin is not None
        if stand is not self.nominal and margin < stand.task.com_margin:
            return _REFUSED * (1 + stand.task.com_margin - margin)
        if self.objective is Objective.UTILISATION:
            return float(statics.motor_utilisation.max())
        if self.objective is Objective.MARGIN:
            return -margin
        return -payload_limit(self.robot, stand, self.point).mass

    def _mobility(self, stand: Stand) -> Array:
        """Returns the least foot speed per joint speed of each leg (n,) (m)."""
        jacobians = Configuration(self.robot, stand.qpos).foot_jacobians().values()
        values = [np.linalg.svd(jacobian[:, 6:], compute_uv=False)[-1] for jacobian in jacobians]
        return np.array(values)

    def active(self) -> tuple[str, ...]:
        """Returns what the best stance lies on."""
        robot, joints = self.robot, self.stand.joint_positions(self.robot)
        mobility = self._mobility(self.stand)

        def sides(name: str, low: float, value: float, high: float, near: float) -> list[str]:
            found = [f"{name} low"] if value - low <= near else []
            return [*found, f"{name} high"] if high - value <= near else found

        found = []
        for name, low, value, high in zip(
            COORDINATES, self.low, self.coordinates, self.high, strict=True
        ):
            if high > low:
                found += sides(name, low, value, high, _AT_BOUND * (high - low))
        margin = self.stand.task.joint_margin
        lower, upper = robot.lower_limits + margin, robot.upper_limits - margin
        for name, low, value, high in zip(robot.joint_names, lower, joints, upper, strict=True):
            found += sides(name, low, value, high, _AT_LIMIT)
        stretched = (mobility < 1.02 * self._mobile) & (self._mobile > 0)
        found += [f"{robot.feet[index]} stretched" for index in np.flatnonzero(stretched)]
        return tuple(found)

    def _touches(self, stand: Stand) -> dict[tuple[int, int], float]:
        """Returns how deep parts are in each other or in the ground (m), but for soles in it."""
        robot = self._grounded
        data = mujoco.MjData(robot.mj_model)
        robot.mj_convention.set_state(data, stand.qpos)
        mujoco.mj_kinematics(robot.mj_model, data)
        mujoco.mj_comPos(robot.mj_model, data)
        mujoco.mj_collision(robot.mj_model, data)
        ground = contact.ground_geom(robot.mj_model)
        touches: dict[tuple[int, int], float] = {}
        for touch in data.contact:
            one, two = sorted(int(geom) for geom in touch.geom)
            if touch.dist < 0 and not {one, two} <= {ground, *robot.soles}:
                touches[one, two] = max(touches.get((one, two), 0.0), -float(touch.dist))
        return touches

    def run(self) -> None:
        """Searches."""
        from scipy import optimize  # slow to import
        from scipy.stats import qmc

        width = np.where(self.high > self.low, self.high - self.low, 1.0)
        start = (self.coordinates - self.low) / width
        samples = qmc.Sobol(len(COORDINATES), seed=0).random(_SAMPLES)
        costs = [self.evaluate(sample) for sample in samples]
        order = np.argsort(costs, kind="stable")[:_STARTS]
        for begin in (start, *samples[order]):
            # Into the box: a simplex is flat where all its corners are clipped to one bound.
            corners = [
                begin,
                *(begin + 0.15 * np.where(begin < 0.5, row, -row) for row in np.eye(5)),
            ]
            optimize.minimize(
                self.evaluate,
                begin,
                method="Nelder-Mead",
                bounds=[(0.0, 1.0)] * len(COORDINATES),
                options={
                    "initial_simplex": np.array(corners),
                    "maxfev": _DESCENT,
                    "xatol": 1e-4,
                    "fatol": 1e-9,
                },
            )
        random, step = np.random.default_rng(0), 0.1
        for _ in range(_POLISH):
            before = self.cost
            best = (self.coordinates - self.low) / width
            direction = random.standard_normal(len(COORDINATES))
            direction *= random.random(len(COORDINATES)) < 0.6
            self.evaluate(best + step * direction)
            step = min(0.2, 1.6 * step) if self.cost < before else max(1e-4, 0.9 * step)
