"""Search space of the best stance: coordinates, bounds and constraint slacks.

A stance is a vector of coordinates: base height, base x and y, roll, pitch, yaw, and the horizontal
displacement of each free foot. `StanceSpace` converts coordinates to stand tasks and stands, and
computes the slacks of a stand (`StanceSlack`). All slacks of an allowed stand are >= 0, up to
`JOINT_LIMIT_OVERSHOOT` at the joint limits.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import StrEnum

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.robot import contact
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot, borrow
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.stance.problem import compute_targets
from pupper_analysis.stance.search import search_from_configuration, search_stand
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.stand import Stand, solve_stand
from pupper_analysis.stance.task import Point, StandTask
from pupper_analysis.stance.workspace import ANGLE_COORDINATES, find_interval
from pupper_analysis.statics.support_polygon import differentiate_side_distances, polygon_sides

BASE_COORDINATES = ("height", "x", "y", "roll", "pitch", "yaw")
"""Coordinates of the base; see `BestStance.coordinates` for the definition."""


HEIGHT_RESERVE = 0.05
"""Fraction of the reachable interval of base heights that the search excludes at either end,
because the legs are stretched or folded there. Chosen, not tuned.
"""

MAX_OUTWARD_STEP = 0.25
"""Bound of the search: largest displacement of a foot along x or y, relative to the largest
reachable base height. This bound applies outwards and inwards; see `MAX_INWARD_STEP` for a second
inward bound. Chosen, not tuned."""

MAX_INWARD_STEP = 0.5
"""Bound of the search: largest displacement of a foot towards the centre of the feet along x or y.
It is relative to the smallest distance of a free foot from this centre along the same axis. The
bound of `MAX_OUTWARD_STEP` applies, too. Chosen, not tuned."""

MIN_OFFSET_RATIO = 0.01
"""Smallest offset of a foot from the centre of the feet along x or y, with which one direction
along this axis is outward. It is relative to the largest distance of a free foot from this centre.
With a smaller offset, as of a biped's feet along x, both directions are outward. Chosen, not
tuned."""

MAX_BASE_ROTATION = 0.3
"""Bound of the search: largest difference of the base's roll, pitch and yaw from the initial task
[rad]. Chosen, not tuned."""

MIN_SINGULAR_VALUE_RATIO = 0.5
"""Lower bound of the smallest singular value of a leg's Jacobian, relative to the initial stand.

The singular value of a stretched leg is zero: the leg carries a large load without torque, but a
small push may topple the robot. Chosen, not tuned.
"""

JOINT_RESERVE = 0.02
"""Distance from the joint limits [rad, m] that the search requires in addition to the task's joint
margin; less if the initial stand is closer to a limit. The reserve covers the deflection of servos,
and the extension of legs whose feet sink into soft ground. Chosen, not tuned."""

EDGE_RESERVE_RATIO = 0.05
"""Additional distance of the CoM from the edges of the support polygon that the search requires,
relative to the additional distance of the initial stand. Additional means beyond the task's CoM
margin. At an edge, the robot has no balance after its feet sink into soft ground, although a
payload may be balanced. Chosen, not tuned."""

JOINT_LIMIT_OVERSHOOT = 1e-4
"""Largest amount [rad, m] by which a joint of an allowed stance may enter the reserve at its limits
(`JOINT_RESERVE`): the optimiser slightly violates a constraint that is active. The reserve is at
least this amount, so the joint stays within its limits and the task's margin. Chosen, not tuned."""

MIN_MOTION_RCOND = 1e-6
"""Smallest accepted ratio of the smallest to the largest singular value of the Jacobian of the
contact points by the joints. With a smaller ratio the joint motions are undetermined, and
`StanceSpace.compute_motions` returns None. Chosen, not tuned.
"""

MAX_MOTION_RESIDUAL = 1e-9
"""Largest accepted error of the velocity of a contact point, per unit velocity of a coordinate [m/m
or m/rad]. If the error is larger, `StanceSpace.compute_motions` returns None. The equations of
soles are redundant, and are satisfied to rounding. Chosen, not tuned.
"""


ACTIVE_BOUND_RTOL = 1e-3
"""Distance of a coordinate from a bound of the search, relative to the interval between the bounds,
below which the bound is active. Also the slack of a leg's smallest singular value, relative to the
initial value, and of a joint [rad, m], below which the constraint is active. Chosen, not tuned."""


class BoundKind(StrEnum):
    """Kind of a bound that a best stance reaches."""

    JOINT = "joint"
    """Limit of a joint, with the reserve `JOINT_RESERVE`."""
    LEG = "leg"
    """Smallest singular value of a leg's Jacobian (`MIN_SINGULAR_VALUE_RATIO`)."""
    STEP = "step"
    """Largest displacement of a foot along x or y."""
    BASE = "base"
    """Bound of a coordinate of the base."""


@dataclass(frozen=True)
class ActiveBound:
    """Bound that a best stance reaches.

    Attributes:
        kind: Kind of the bound.
        name: Joint, contact point, or coordinate.
        value: Bound of the coordinate, or distance of a joint from its limit [m or rad]; smallest
            singular value of a leg relative to that of the initial stand [1].
    """

    kind: BoundKind
    name: str
    value: float = field(metadata={"unit": "varies"})


@dataclass(frozen=True, eq=False)
class StanceSlack:
    """Constraint slacks of a stance: distances from the bounds, negative if violated.

    In an allowed stance all slacks are >= 0, those of the joints >= -`JOINT_LIMIT_OVERSHOOT`.

    Attributes:
        singular_values: Shape (n,); smallest singular value of the Jacobian of each contact point
            less the lower bound, relative to the initial value.
        joints: Shape (2 nu,) [rad, m]; distances from the lower, then the upper joint limits, less
            the joint margin and the reserve. Values are at most 1.
        edges: Shape (m,) [m]; signed distances of the projected CoM from the edges of the support
            polygon, less the CoM margin and ``StanceSpace.edge_reserve``. The order is continuous
            in the positions of the feet.
        penetration: Negative total penetration [m] of pairs of geoms that do not penetrate each
            other in the initial stand; zero if there is none. Contacts of feet with the ground or
            with feet are left out.
    """

    singular_values: Array
    joints: Array
    edges: Array
    penetration: float

    def to_vector(self, reduction: float) -> Array:
        """Return the constraint slacks of a stance as a vector for the nonlinear program, (n,).

        The order is ``singular_values``, ``joints``, ``edges``, ``penetration``. ``edges`` and
        ``penetration`` [m] are multiplied by 10, to have the magnitude of the others. ``reduction``
        is subtracted from all entries except ``penetration``, so that the program ends at stances
        without violations.
        """
        slacks = [
            self.singular_values - reduction,
            self.joints - reduction,
            10 * self.edges - reduction,
        ]
        return np.concatenate([*slacks, [10 * self.penetration]])


class StanceSpace:
    """Stances in the neighbourhood of an initial task, as vectors of coordinates.

    Args:
        robot: Robot.
        task: Initial task.

    Attributes:
        robot: Robot.
        nominal: Initial stand: the stand of the initial task.
        centre: Centre of the feet of the initial stand, shape (2,) [m], in the world frame.
        free: Feet that the task does not place; the search displaces these feet.
        names: Names of the coordinates: `BASE_COORDINATES`, then ``FR x``, ``FR y`` ...
        start: Coordinates of the initial stand, shape (n,) [m or rad].
        low: Lower bounds of the coordinates, shape (n,) [m or rad].
        high: Upper bounds of the coordinates, shape (n,) [m or rad].
        edge_reserve: Distance [m] of the CoM from the edges that is required in addition to the CoM
            margin of the task (`EDGE_RESERVE_RATIO`).
    """

    def __init__(self, robot: Robot, task: StandTask) -> None:
        self.robot = robot
        self.nominal = nominal = solve_stand(robot, task)
        # The floor has the task's slope, but no steps, because steps would have to follow the feet.
        ground = Ground(task.ground.slope, task.ground.uphill)
        available = self._compute_limit_distances(self.nominal) - task.joint_margin
        self._reserve = np.clip(available, JOINT_LIMIT_OVERSHOOT, JOINT_RESERVE)
        nearest = float(self._compute_edge_distances(nominal).min()) - task.com_margin
        self.edge_reserve = EDGE_RESERVE_RATIO * max(nearest, 0.0)
        self._robot_on_ground = build_on_ground(robot, ground, {})
        self._collision_data = mujoco.MjData(self._robot_on_ground.mj_model)
        self._initial_penetrations = self._compute_penetrations(nominal)
        self._initial_singular_values = _compute_min_singular_values(
            Configuration(robot, nominal.qpos)
        )
        self.centre = nominal.centre(robot)[:2]
        self.free = tuple(foot for foot in robot.feet if foot not in task.feet)
        self.names = (*BASE_COORDINATES, *(f"{foot} {axis}" for foot in self.free for axis in "xy"))
        height, place = nominal.task.height, nominal.qpos[:2] - self.centre
        assert height is not None
        base = [height, *place, task.roll, task.pitch, task.yaw]
        self.start = np.array([*base, *np.zeros(2 * len(self.free))])
        self.low, self.high = self._compute_bounds()

    def _compute_bounds(self) -> tuple[Array, Array]:
        """Return the lower and upper bounds of a stance's coordinates, (n,) each [m or rad]."""
        # A bounded rotation saves the search for the end of its interval.
        max_changes = dict.fromkeys(BASE_COORDINATES, math.inf)
        max_changes |= dict.fromkeys(ANGLE_COORDINATES, MAX_BASE_ROTATION)
        workspace = {
            name: find_interval(
                self.robot, self.nominal, name, max_changes[name], default_guesses_only=True
            )
            for name in BASE_COORDINATES
        }
        height = workspace["height"]
        reserve = HEIGHT_RESERVE * (height.high - height.low)
        low, high = [height.low + reserve], [height.high - reserve]
        for name, value in zip(BASE_COORDINATES[1:], self.start[1:], strict=False):
            low.append(max(workspace[name].low, value - max_changes[name]))
            high.append(min(workspace[name].high, value + max_changes[name]))
        outwards = self.outward_signs()
        distances = [abs(self._compute_foot_offset(foot)) for foot in self.free]
        inwards = (
            np.minimum(MAX_OUTWARD_STEP * height.high, MAX_INWARD_STEP * np.min(distances, axis=0))
            if distances
            else 0
        )
        for foot in self.free:
            signs = outwards[foot]
            low += np.where(signs > 0, -inwards, -MAX_OUTWARD_STEP * height.high).tolist()
            high += np.where(signs < 0, inwards, MAX_OUTWARD_STEP * height.high).tolist()
        return np.minimum(low, self.start), np.maximum(high, self.start)

    def _compute_foot_offset(self, foot: str) -> Array:
        """Return the initial position of a foot relative to the centre of the feet, (2,) [m]."""
        points = self.robot.feet[foot]
        position = np.mean([self.nominal.foot_targets[point][:2] for point in points], axis=0)
        offset: Array = position - self.centre
        return offset

    def outward_signs(self) -> dict[str, Array]:
        """Return, for each free foot, the signs of world x and y that lead away from the centre.

        Returns:
            {foot: -1, 0 or 1 along x and along y, shape (2,) [1]}; the centre is that of the feet.
            0 if both directions lead away (`MIN_OFFSET_RATIO`).
        """
        offsets = {foot: self._compute_foot_offset(foot) for foot in self.free}
        farthest = max((float(np.linalg.norm(offset)) for offset in offsets.values()), default=0.0)
        smallest = MIN_OFFSET_RATIO * farthest
        return {
            foot: np.where(np.abs(offset) > smallest, np.sign(offset), 0.0)
            for foot, offset in offsets.items()
        }

    @property
    def is_symmetric(self) -> bool:
        """True if base pose, ground and feet of the initial stand task are left-right symmetric.

        Tasks with moved feet or steps do not count as symmetric. Contacts, for example, are not
        checked.
        """
        task, ground = self.nominal.task, self.nominal.task.ground
        side_slope = abs(math.sin(ground.uphill)) * ground.slope
        asymmetry = max(abs(task.roll), abs(task.yaw), side_slope, abs(self.start[2]))
        uneven = task.swing or task.feet or task.foot_offsets or any(ground.heights.values())
        return asymmetry < 1e-9 and not uneven

    def coupled_directions(self) -> Array:
        """Return the directions of the search space in which the feet move together.

        Returns:
            A direction per column, shape (n, k) [m or rad]: base coordinates (only height, x and
            pitch if the stand is symmetric), then length of the stance, and width of the front, the
            rear and the middle feet, as far as these move a foot. If all feet are in the middle, as
            of a biped, the last direction moves left feet forward and right feet back.
        """
        keep = (0, 1, 4) if self.is_symmetric else range(len(BASE_COORDINATES))
        columns = [np.eye(len(self.start))[index] for index in keep]
        outwards = self.outward_signs()
        signs = np.array([outwards[foot] for foot in self.free]).reshape(-1, 2)
        moves = [np.column_stack([signs[:, 0], np.zeros(len(signs))])]
        for side in (1.0, -1.0, 0.0):
            moves.append(
                np.column_stack([np.zeros(len(signs)), signs[:, 1] * (signs[:, 0] == side)])
            )
        if not signs[:, 0].any():
            moves.append(np.column_stack([signs[:, 1], np.zeros(len(signs))]))
        base = np.zeros(len(BASE_COORDINATES))
        columns += [np.append(base, move.ravel()) for move in moves if move.any()]
        return np.array(columns).T

    def make_task(self, coordinates: Array) -> StandTask:
        """Create the stand task of a stance from the coordinates of the search, shape (n,).

        Coordinates are base height, x, y [m], roll, pitch, yaw [rad], then x and y [m] of the
        displacement of each free foot.
        """
        height, x, y, roll, pitch, yaw = map(float, coordinates[: len(BASE_COORDINATES)])
        task = self.nominal.task
        offsets: dict[str, Point] = dict(task.foot_offsets)
        for foot, shift in zip(
            self.free, coordinates[len(BASE_COORDINATES) :].reshape(-1, 2), strict=True
        ):
            initial = task.foot_offsets.get(foot, (0.0, 0.0))
            offsets[foot] = (float(initial[0] + shift[0]), float(initial[1] + shift[1]))
        # The offset refers to the centre of the displaced feet.
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

    def find_stand(self, coordinates: Array, near: Stand | None = None) -> Stand | None:
        """Solve the stand for a vector of coordinates, or return None if no stand is found.

        The CoM may be closer to the edge of the support region than the task requires.

        Args:
            coordinates: Coordinates, shape (n,) [m or rad].
            near: Stand with almost the same coordinates, as the only initial guess.

        Raises:
            ConfigurationError: If the coordinates give a task that is not valid.
        """
        task = self.make_task(coordinates)
        targets = compute_targets(self.robot, replace(task, com_margin=0.0), {})
        with borrow(self.robot, SearchContext) as context:
            if near is None:
                stand: Stand | None = search_stand(context, targets, default_guesses_only=True)
            else:
                stand = search_from_configuration(context, targets, near.qpos)
        return stand.for_task(task) if stand is not None and stand.solved else None

    def compute_slack(self, stand: Stand) -> StanceSlack:
        """Compute the slacks of the constraints on a stand."""
        config, task = Configuration(self.robot, stand.qpos), self.nominal.task
        min_values = MIN_SINGULAR_VALUE_RATIO * self._initial_singular_values
        scale = np.where(self._initial_singular_values > 0, self._initial_singular_values, 1.0)
        joint_slacks = self._compute_limit_distances(stand) - self._reserve - task.joint_margin
        edges = self._compute_edge_distances(stand)
        penetrations = self._compute_penetrations(stand)
        added = sum(
            depth for pair, depth in penetrations.items() if pair not in self._initial_penetrations
        )
        return StanceSlack(
            singular_values=(_compute_min_singular_values(config) - min_values) / scale,
            joints=np.minimum(joint_slacks, 1.0),
            edges=edges - task.com_margin - self.edge_reserve,
            penetration=-added,
        )

    def list_active_bounds(self, coordinates: Array, stand: Stand) -> Iterator[ActiveBound]:
        """Yield the bounds of the search that a stance reaches: joints, legs, feet, then the base.

        The CoM margin, and contacts of parts, are no such bounds. ``coordinates`` has the shape
        (n,) [m or rad].
        """
        slack = self.compute_slack(stand)
        joints = 2 * self.robot.joint_names
        distances = self._compute_limit_distances(stand)
        for index in np.flatnonzero(slack.joints < ACTIVE_BOUND_RTOL):
            yield ActiveBound(BoundKind.JOINT, joints[index], float(distances[index]))
        for index in np.flatnonzero(slack.singular_values < ACTIVE_BOUND_RTOL):
            ratio = MIN_SINGULAR_VALUE_RATIO + float(slack.singular_values[index])
            yield ActiveBound(BoundKind.LEG, self.robot.contact_points[index], ratio)
        tolerance = ACTIVE_BOUND_RTOL * (self.high - self.low)
        at_bound = np.minimum(coordinates - self.low, self.high - coordinates) < tolerance
        steps = np.flatnonzero(at_bound & (self.high > self.low))
        count = len(BASE_COORDINATES)
        for index in sorted(steps.tolist(), key=lambda place: place < count):
            kind = BoundKind.BASE if index < count else BoundKind.STEP
            yield ActiveBound(kind, self.names[index], float(coordinates[index]))

    def _compute_edge_distances(self, stand: Stand) -> Array:
        """Compute the signed distances of the CoM from the edges of the support polygon, (m,)."""
        sides = polygon_sides(stand.corners(self.robot), from_first=True)
        com = Configuration(self.robot, stand.qpos).center_of_mass()
        distances: Array = sides[:, :2] @ com[:2] + sides[:, 2]
        return distances

    def compute_motions(self, stand: Stand, config: Configuration) -> Array | None:
        """Compute the derivatives of a stand's configuration by the coordinates.

        The positions of the joints follow from J dq = dp - J_base dx with the Jacobians of all
        contact points.

        Returns:
            A velocity per coordinate, in the order of ``qvel``, shape (nv, n). None if the contact
            points do not determine the joints, for example (redundant or singular legs).
        """
        robot, task = self.robot, stand.task
        if robot.closure is not None or robot.hands or robot.fixed_parts or task.contacts:
            return None
        points, count = robot.contact_points, len(BASE_COORDINATES)
        shifts = np.zeros((len(points), 3, len(self.names)))
        normal = task.ground.normal()
        along = np.vstack([np.eye(2), -normal[:2] / normal[2]])  # horizontal steps along the slope
        for index, foot in enumerate(self.free):
            column = count + 2 * index
            rows = [points.index(point) for point in robot.feet[foot]]
            shifts[rows, :, column : column + 2] = along
        motions = np.zeros((robot.nv, len(self.names)))
        bearing = [points.index(point) for point in stand.stance_feet]
        motions[:3] = shifts[bearing].mean(axis=0)
        motions[[2, 0, 1], [0, 1, 2]] += 1.0  # height, x, y
        motions[3:6, 3:6] = _differentiate_orientation(task.roll, task.pitch)
        jacobians = np.concatenate([*config.foot_jacobians().values()])
        rates = shifts.reshape(3 * len(points), -1) - jacobians[:, :6] @ motions[:6]
        moving = 6 + np.flatnonzero(np.abs(jacobians[:, 6:]).max(axis=0) > 0)
        columns = jacobians[:, moving]
        motions[moving], _, rank, _ = np.linalg.lstsq(columns, rates, rcond=MIN_MOTION_RCOND)
        unmet = np.abs(columns @ motions[moving] - rates).max()
        if rank < len(moving) or unmet > MAX_MOTION_RESIDUAL:
            return None
        return motions

    def differentiate_slack(
        self, stand: Stand, config: Configuration, motions: Array
    ) -> Array | None:
        """Compute the derivatives of `StanceSlack.to_vector` by the coordinates of a stand.

        The stand must have no penetrations that the initial stand does not have. ``motions`` is the
        result of `compute_motions`, shape (nv, n).

        Returns:
            Shape (k, n). None if the corners of the support region are not the contact points.
        """
        contacts = np.array([*stand.contact_points.values()])
        if not np.array_equal(stand.corners(self.robot), contacts[:, :2]):
            return None
        jacobians = config.foot_twist_jacobians(self.robot.contact_points)
        left, _, right = np.linalg.svd(jacobians[:, :3, 6:], full_matrices=False)
        wrenches = np.zeros((len(jacobians), 6))
        wrenches[:, :3] = left[:, :, -1]
        # The derivative of the singular value u^T J v is u^T dJ v.
        value_rates = [
            right[index, -1] @ config.wrenches_derivative(jacobian[None], wrench[None])[6:]
            for index, (jacobian, wrench) in enumerate(zip(jacobians, wrenches, strict=True))
        ]
        scale = np.where(self._initial_singular_values > 0, self._initial_singular_values, 1.0)
        margin = self.nominal.task.joint_margin
        distances = self._compute_limit_distances(stand) - self._reserve - margin
        joint_rates = np.concatenate([motions[6:], -motions[6:]])
        joint_rates[distances > 1.0] = 0.0
        bearing = [self.robot.contact_points.index(point) for point in stand.contact_points]
        edge_rates = differentiate_side_distances(
            contacts,
            jacobians[bearing, :2] @ motions,
            config.center_of_mass()[:2],
            config.com_jacobian()[:2] @ motions,
        )
        rows = [
            np.array(value_rates) @ motions / scale[:, None],
            joint_rates,
            10 * edge_rates,
            np.zeros((1, motions.shape[1])),
        ]
        result: Array = np.concatenate(rows)
        return result

    def _compute_limit_distances(self, stand: Stand) -> Array:
        """Return each joint's distance [rad, m] from its lower, then upper limit, shape (2 nu,).

        A distance beyond a limit is negative.
        """
        joints = stand.joint_positions(self.robot)
        return np.concatenate([joints - self.robot.lower_limits, self.robot.upper_limits - joints])

    def _compute_penetrations(self, stand: Stand) -> dict[tuple[int, int], float]:
        """Return {pair of penetrating geoms: penetration [m]} of a stand, from MuJoCo's contacts.

        Contacts of feet with the ground or with other feet are left out.
        """
        robot, data = self._robot_on_ground, self._collision_data
        robot.mj_convention.set_state(data, stand.qpos)
        mujoco.mj_kinematics(robot.mj_model, data)
        mujoco.mj_comPos(robot.mj_model, data)
        mujoco.mj_collision(robot.mj_model, data)
        ground = contact.ground_geom(robot.mj_model)
        penetrations: dict[tuple[int, int], float] = {}
        for geoms, distance in zip(data.contact.geom, data.contact.dist, strict=True):
            first, second = sorted(map(int, geoms))
            if distance < 0 and not {first, second} <= {ground, *robot.foot_geoms}:
                depth = penetrations.get((first, second), 0.0)
                penetrations[first, second] = max(depth, -float(distance))
        return penetrations


def _differentiate_orientation(roll: float, pitch: float) -> Array:
    """Return the angular velocity of the base, in base axes, per rate of roll, pitch and yaw.

    The orientation is R = R_z(yaw) R_y(pitch) R_x(roll). A column per angle [rad], shape (3, 3).
    """
    sin_roll, cos_roll = math.sin(roll), math.cos(roll)
    sin_pitch, cos_pitch = math.sin(pitch), math.cos(pitch)
    return np.array(
        [
            [1.0, 0.0, -sin_pitch],
            [0.0, cos_roll, sin_roll * cos_pitch],
            [0.0, -sin_roll, cos_roll * cos_pitch],
        ]
    )


def _compute_min_singular_values(config: Configuration) -> Array:
    """Compute the smallest singular value of each contact point's Jacobian by the joints, (n,).

    Units: m/rad, or m/m for slides.
    """
    columns = np.array([jacobian[:, 6:] for jacobian in config.foot_jacobians().values()])
    values: Array = np.linalg.svd(columns, compute_uv=False)[:, -1]
    return values
