"""The stances among which the best is sought: what is free, between which bounds, what is refused.

A stance is a vector: the base's height, place and turn, and how far each free foot is moved.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot import contact
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot, lend
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.stance.problem import make_goal
from pupper_analysis.stance.search import continue_stand, search_stand
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.stand import Stand, solve_stand
from pupper_analysis.stance.task import Point, StandTask
from pupper_analysis.stance.workspace import find_interval
from pupper_analysis.statics.support_polygon import polygon_sides

Array = NDArray[np.float64]

BASE_COORDINATES = ("height", "x", "y", "roll", "pitch", "yaw")

_TURNS = ("roll", "pitch", "yaw")
"""The base's coordinates: see ``BestStance.coordinates``."""

HEIGHT_RESERVE = 0.05
"""Share of the reachable heights that is left out at either end: legs stretched or folded up."""

MAX_OUTWARD_STEP = 0.25
"""Most that a foot is moved outwards, fore-aft or sideways, in parts of the greatest height."""

MAX_INWARD_STEP = 0.5
"""Most that a foot is moved inwards, in parts of its distance from the middle of the feet."""

MAX_BASE_ROTATION = 0.3
"""Most that the base rolls, pitches or yaws away from the task (rad)."""

MIN_SINGULAR_VALUE_RATIO = 0.5
"""The least singular value of a leg's Jacobian that is kept, in parts of the nominal one.

A stretched leg has none. It holds the greatest loads without torque, and falls when it is pushed.
"""

JOINT_RESERVE = 0.02
"""Least distance of the joints from their limits (rad), on top of the task's, where the task's own
stance leaves as much: what a servo gives way, and a foot that sinks into soft ground stretches its
leg. On a limit a nudge is enough: Go1 bore 61 kg with its knees on theirs, and failed with 1."""

JOINT_LIMIT_OVERSHOOT = 1e-4
"""The same where it leaves less: a search that follows a limit steps over it by a little, where
there is no stance to evaluate."""


@dataclass(frozen=True, eq=False)
class StanceSlack:
    """What a stance has left of what it may not use up; all >= 0 where it is allowed.

    Attributes:
        singular_values: (n,) of each leg, less its least, in parts of the nominal one.
        joints: (2 nu,) distances from both limits, less the margin and ``JOINT_RESERVE`` (rad).
        edges: (m,) distances of the com's projection from the edges of the support polygon, less
            the margin (m).
        touching: Minus how deep parts are in each other that the task's stand has apart (m).
    """

    singular_values: Array
    joints: Array
    edges: Array
    touching: float

    def less(self, inside: float) -> Array:
        """Returns all of it as one vector, in comparable units, less a little.

        Nothing is taken off where parts touch: it is zero wherever they do not.
        """
        room = [self.singular_values - inside, self.joints - inside, 10 * self.edges - inside]
        return np.concatenate([*room, [10 * self.touching]])


class StanceSpace:
    """All stances around a task's, as vectors.

    Attributes:
        robot: The robot.
        nominal: The task's own stand.
        names: Of the coordinates.
        start: Coordinates of the task's own stand.
        low: The coordinates' least values.
        high: Their greatest.
    """

    def __init__(self, robot: Robot, task: StandTask) -> None:
        self.robot = robot
        self.nominal = nominal = solve_stand(robot, task)
        # The floor turned, but without steps, which would have to follow the feet.
        ground = Ground(task.ground.slope, task.ground.uphill)
        left = self._from_limits(self.nominal) - task.joint_margin
        self._reserve = np.clip(left, JOINT_LIMIT_OVERSHOOT, JOINT_RESERVE)
        self._grounded = build_on_ground(robot, ground, {})
        self._data = mujoco.MjData(self._grounded.mj_model)
        self._touching = self._touches(nominal)
        self._nominal_values = _singular_values(Configuration(robot, nominal.qpos))
        self.centre = nominal.centre(robot)[:2]
        self.free = tuple(foot for foot in robot.feet if foot not in task.feet)
        self.names = (*BASE_COORDINATES, *(f"{foot} {axis}" for foot in self.free for axis in "xy"))
        height, place = nominal.task.height, nominal.qpos[:2] - self.centre
        assert height is not None
        base = [height, *place, task.roll, task.pitch, task.yaw]
        self.start = np.array([*base, *np.zeros(2 * len(self.free))])
        self.low, self.high = self._bounds()

    def _bounds(self) -> tuple[Array, Array]:
        """Returns the coordinates' least and greatest values; the task's are between."""
        # Turns go no further than that, so that their ends need not be found.
        most = dict.fromkeys(BASE_COORDINATES, math.inf) | dict.fromkeys(_TURNS, MAX_BASE_ROTATION)
        within = {
            name: find_interval(self.robot, self.nominal, name, most[name], usual_starts_only=True)
            for name in BASE_COORDINATES
        }
        height = within["height"]
        reserve = HEIGHT_RESERVE * (height.high - height.low)
        low, high = [height.low + reserve], [height.high - reserve]
        for name, value in zip(BASE_COORDINATES[1:], self.start[1:], strict=False):
            low.append(max(within[name].low, value - most[name]))
            high.append(min(within[name].high, value + most[name]))
        outwards = self.outwards()
        apart = [abs(self._from_centre(foot)) for foot in self.free]
        inwards = (
            np.minimum(MAX_OUTWARD_STEP * height.high, MAX_INWARD_STEP * np.min(apart, axis=0))
            if apart
            else 0
        )
        for foot in self.free:
            way = np.where(outwards[foot] > 0, 1.0, -1.0)
            ends = np.sort([-way * inwards, way * MAX_OUTWARD_STEP * height.high], axis=0)
            low += ends[0].tolist()
            high += ends[1].tolist()
        return np.minimum(low, self.start), np.maximum(high, self.start)

    def _from_centre(self, foot: str) -> Array:
        points = self.robot.feet[foot]
        place = np.mean([self.nominal.foot_targets[point][:2] for point in points], axis=0)
        away: Array = place - self.centre
        return away

    def outwards(self) -> dict[str, Array]:
        """Returns {free foot: (2,) signs of the way outwards along x and y}."""
        return {foot: np.sign(self._from_centre(foot)) for foot in self.free}

    @property
    def symmetric(self) -> bool:
        """Whether nothing in the task tells left from right."""
        task, ground = self.nominal.task, self.nominal.task.ground
        sideways = abs(math.sin(ground.uphill)) * ground.slope
        turned = max(abs(task.roll), abs(task.yaw), sideways, abs(self.start[2]))
        uneven = task.swing or task.feet or task.foot_offsets or any(ground.heights.values())
        return turned < 1e-9 and not uneven

    def directions(self) -> Array:
        """Returns (size, k): along which the feet move together, fore-aft or sideways.

        Columns: the base's coordinates (of these only height, x and pitch if the task is
        symmetric), the length of the stance, its width in front, and its width behind.
        """
        keep = (0, 1, 4) if self.symmetric else range(len(BASE_COORDINATES))
        columns = [np.eye(len(self.start))[index] for index in keep]
        outwards = self.outwards()
        for axis, side in ((0, 0.0), (1, 1.0), (1, -1.0)):
            column = np.zeros(len(self.start))
            for index, foot in enumerate(self.free):
                if side in (0.0, outwards[foot][0]):
                    column[len(BASE_COORDINATES) + 2 * index + axis] = outwards[foot][axis]
            if column.any():
                columns.append(column)
        return np.array(columns).T

    def task(self, coordinates: Array) -> StandTask:
        """Returns the task of a vector of coordinates."""
        height, x, y, roll, pitch, yaw = map(float, coordinates[: len(BASE_COORDINATES)])
        task = self.nominal.task
        offsets: dict[str, Point] = dict(task.foot_offsets)
        for foot, move in zip(
            self.free, coordinates[len(BASE_COORDINATES) :].reshape(-1, 2), strict=True
        ):
            had = task.foot_offsets.get(foot, (0.0, 0.0))
            offsets[foot] = (float(had[0] + move[0]), float(had[1] + move[1]))
        # An offset is from the centre of the feet as they are then: the feet may move it.
        return replace(
            task,
            height=height,
            roll=roll,
            pitch=pitch,
            yaw=yaw,
            offset=(x, y),
            foot_offsets=offsets,
            com="centre",
        )

    def stand(self, coordinates: Array, near: Stand | None = None) -> Stand | None:
        """Returns the stand of a vector of coordinates, if one is found; its com may lack margin.

        How much it has of that is in its ``room``: a search goes by it. Stands are looked for from
        the usual starts alone: one that is found only with legs bent another way is not missed
        among thousands.

        Args:
            coordinates: The coordinates.
            near: A stand whose coordinates are almost these, from which alone it is looked for.

        Raises:
            ConfigurationError: If it cannot be asked for.
        """
        task = self.task(coordinates)
        goal = make_goal(self.robot, replace(task, com_margin=0.0), {})
        with lend(self.robot, SearchContext) as context:
            if near is None:
                stand: Stand | None = search_stand(context, goal, usual_starts_only=True)
            else:
                stand = continue_stand(context, goal, near.qpos)
        return stand.for_task(task) if stand is not None and stand.solved else None

    def room(self, stand: Stand) -> StanceSlack:
        """Returns what a stand leaves of what it may not use up."""
        config, task = Configuration(self.robot, stand.qpos), self.nominal.task
        least = MIN_SINGULAR_VALUE_RATIO * self._nominal_values
        scale = np.where(self._nominal_values > 0, self._nominal_values, 1.0)
        limits = self._from_limits(stand) - self._reserve - task.joint_margin
        sides = polygon_sides(stand.corners(self.robot))
        edges = sides[:, :2] @ config.center_of_mass()[:2] + sides[:, 2]
        new = self._touches(stand)
        added = sum(depth for pair, depth in new.items() if pair not in self._touching)
        return StanceSlack(
            singular_values=(_singular_values(config) - least) / scale,
            joints=np.minimum(limits, 1.0),
            edges=edges - task.com_margin,
            touching=-added,
        )

    def _from_limits(self, stand: Stand) -> Array:
        """Returns how far joints are from their lower, and from their upper limits (2 nu,)."""
        joints = stand.joint_positions(self.robot)
        return np.concatenate([joints - self.robot.lower_limits, self.robot.upper_limits - joints])

    def _touches(self, stand: Stand) -> dict[tuple[int, int], float]:
        """Returns how deep parts are in each other or the ground (m), but for feet in it."""
        robot, data = self._grounded, self._data
        robot.mj_convention.set_state(data, stand.qpos)
        mujoco.mj_kinematics(robot.mj_model, data)
        mujoco.mj_comPos(robot.mj_model, data)
        mujoco.mj_collision(robot.mj_model, data)
        ground = contact.ground_geom(robot.mj_model)
        touches: dict[tuple[int, int], float] = {}
        for geoms, distance in zip(data.contact.geom, data.contact.dist, strict=True):
            one, two = sorted(map(int, geoms))
            if distance < 0 and not {one, two} <= {ground, *robot.foot_geoms}:
                touches[one, two] = max(touches.get((one, two), 0.0), -float(distance))
        return touches


def _singular_values(config: Configuration) -> Array:
    """Returns the least foot speed per joint speed of each leg (n,) (m)."""
    columns = np.array([jacobian[:, 6:] for jacobian in config.foot_jacobians().values()])
    values: Array = np.linalg.svd(columns, compute_uv=False)[:, -1]
    return values
