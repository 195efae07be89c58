"""Clearances of a robot: distances between links [m], and heights above the ground [m].

`ClearanceShapes` evaluates both at a configuration, with their Jacobians by qvel. The shapes are
MuJoCo's collision shapes, with convex hulls of meshes. Distances are computed with the library
coal. Pairs of neighbouring links, and feet on the ground, are left out.
"""

from __future__ import annotations

import bisect
import functools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import coal  # comes with pin
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.base.results import Result
from pupper_analysis.models.shapes import Direction
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.shapes import CarriedShape, excluded_pairs
from pupper_analysis.robot.structure import Kinematics

NUM_NEAREST_PAIRS = 12
"""Number of pairs of collision shapes whose distances are constrained in a search of a stand or
posture: the nearest pairs, on links that are not neighbours. Chosen, not tuned: Pupper v3 has 32
such pairs, of which fewer are close to each other at once."""

_LEVEL_NORMAL = (0.0, 0.0, 1.0)
"""Unit normal of level ground, in the world frame."""


@dataclass(frozen=True)
class Clearance(Result):
    """Smallest distance of two links, or of a link from the ground.

    Attributes:
        distance: Distance (m); negative for a penetration depth.
        links: The two links, or the link nearest to the ground.
        surface: Foot or hand whose step, plane or bar is nearest to the link; empty for the floor,
            and for two links.
    """

    distance: float = field(metadata={"unit": "m"})
    links: tuple[str, ...]
    surface: str = ""


class OffGround(NamedTuple):
    """Collision shape, no foot, that must be above the ground.

    Attributes:
        number: Index in ``ClearanceShapes.shapes``.
        shape: Collision shape with its link.
        sunk: Contact point on the same joint whose sphere intersects the shape; None without such a
            point.
    """

    number: int
    shape: CarriedShape
    sunk: str | None


class SurfaceDistance(NamedTuple):
    """Distance of a collision shape from the nearest surface of the ground.

    Attributes:
        surface: Name of the foot or hand whose step, plane or bar is the surface; empty for the
            floor.
        near: Result of coal: distance [m] and nearest points in the world.
    """

    surface: str
    near: coal.DistanceResult

    @property
    def distance(self) -> float:
        """Distance of the shape from the surface [m]; negative if the shape penetrates it."""
        return float(self.near.min_distance)


class SolidPair(NamedTuple):
    """Pair of collision shapes of a robot, with the distance between the shapes.

    Attributes:
        one: Index of the first shape.
        other: Index of the second shape.
        near: Result of coal: distance [m] and nearest points in the world.
    """

    one: int
    other: int
    near: coal.DistanceResult

    @property
    def distance(self) -> float:
        """Distance of the two shapes [m]; minus the penetration depth if the shapes overlap."""
        return float(self.near.min_distance)


def measure_distance(
    first: coal.CollisionGeometry,
    first_pose: coal.Transform3s,
    second: coal.CollisionGeometry,
    second_pose: coal.Transform3s,
) -> coal.DistanceResult:
    """Compute the distance [m] of two collision shapes, with nearest points, in the world frame.

    Args:
        first: First shape.
        first_pose: Pose of the first shape in the world.
        second: Second shape.
        second_pose: Pose of the second shape in the world.
    """
    result = coal.DistanceResult()
    coal.distance(first, first_pose, second, second_pose, coal.DistanceRequest(), result)
    return result


_ABSENT_FLOOR_DEPTH = 1e3
"""Depth [m] below the world origin of the half-space that replaces the floor if the MJCF has none:
far below each part of a robot. Chosen, not tuned."""


class ClearanceShapes:
    """Collision shapes of a robot, for distances between links and heights above the ground.

    Args:
        robot: Robot.

    Attributes:
        robot: Robot.
        shapes: Collision shapes of the robot (``robot.shapes``), including foot shapes.
        kinematics: Kinematics of links, CoM and feet.
        parts: Shapes that must be above the ground, without feet and, for example, shapes on a
            fixed or welded base.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.kinematics = robot, Kinematics(robot.structure)
        self.shapes: tuple[CarriedShape, ...] = robot.shapes
        self._has_floor = robot.has_floor
        self.parts = [*self._list_parts()]
        joints = {number: name for name, number in robot.structure.joints.items()}
        # Shapes of a hand surround its contact sphere.
        self._hands = {hand: joints.get(robot.structure.parents[hand], "") for hand in robot.hands}
        self._heights = [(part.shape.form.height, part.shape.link) for part in self.parts]
        self._nearest: tuple[tuple[bytes, int], list[SolidPair]] | None = None

    def move_to(self, qpos: ArrayLike) -> Kinematics:
        """Compute the poses of links, CoM and feet at a configuration ``qpos``, shape (nq,).

        Returns:
            ``kinematics``, which the next call overwrites.
        """
        self.kinematics.update(qpos)
        return self.kinematics

    @functools.cached_property
    def _pairs(self) -> IntArray:
        """Index pairs (n, 2) of the collision shapes on links that are not neighbours.

        Links on one joint, or on a joint and its parent, are neighbours. Links that the MJCF
        excludes from contact, or that touch in the home pose, count as neighbours.
        """
        model, shapes = self.robot.pin_model, self.shapes
        base = 1 if self.robot.floating else 0  # 0 is Pinocchio's universe
        joints = [model.getJointId(shape.joint) if shape.joint else base for shape in shapes]
        excepted, able, never = excluded_pairs(self.robot.mj_model), set(), set()
        pairs = [(first, second) for second in range(len(shapes)) for first in range(second)]
        links = {pair: frozenset(shapes[number].link for number in pair) for pair in pairs}
        for first, second in pairs:
            both = {joints[first], joints[second]}
            if len(both) == 2 and not both & {int(model.parents[joint]) for joint in both if joint}:
                able.add(links[first, second])
            if frozenset((shapes[first].body, shapes[second].body)) in excepted:
                never.add(links[first, second])
        checked = [pair for pair in pairs if links[pair] in able - never]
        for shape in shapes:
            shape.form.collision.computeLocalAABB()  # centre and radius of the bounding sphere
        near = self._find_nearest(self.robot.home, _to_index_pairs(checked), len(checked))
        never |= {links[pair.one, pair.other] for pair in near if pair.distance <= 0}
        return _to_index_pairs(pair for pair in checked if links[pair] not in never)

    def find_closest_links(self, qpos: Array) -> Clearance | None:
        """Return the smallest distance [m] between links that are not neighbours.

        Args:
            qpos: Configuration, shape (nq,).

        Returns:
            Distance [m] and both links; None without such links with collision shapes.
        """
        for pair in self.find_nearest_pairs(qpos, 1):
            links = self.shapes[pair.one].link, self.shapes[pair.other].link
            return Clearance(pair.distance, links)
        return None

    def find_nearest_pairs(self, qpos: Array, most: int) -> list[SolidPair]:
        """Return the nearest pairs of collision shapes on links that are not neighbours.

        Args:
            qpos: Configuration, shape (nq,).
            most: Maximum number of pairs.

        Returns:
            Pairs with distance [m], the nearest first.
        """
        key = np.asarray(qpos, dtype=float).tobytes(), most
        if self._nearest is None or self._nearest[0] != key:
            self._nearest = key, self._find_nearest(qpos, self._pairs, most)
        self.move_to(qpos)
        return list(self._nearest[1])

    def _find_nearest(self, qpos: Array, pairs: IntArray, most: int) -> list[SolidPair]:
        """Return the ``most`` nearest of given index pairs (n, 2) of shapes, nearest first."""
        solids, at = (
            [shape.form.collision for shape in self.shapes],
            self._list_shape_poses(self.move_to(qpos)),
        )
        centres = np.array(
            [pose.transform(solid.aabb_center) for pose, solid in zip(at, solids, strict=True)]
        ).reshape(-1, 3)
        radii = np.array([solid.aabb_radius for solid in solids])
        first, second = pairs.T
        apart = np.linalg.norm(centres[first] - centres[second], axis=1)
        apart -= radii[first] + radii[second]
        nearest: list[SolidPair] = []
        for index in np.argsort(apart, kind="stable"):
            if len(nearest) >= most and apart[index] > nearest[most - 1].distance:
                break
            a, b = pairs[index].tolist()
            near = measure_distance(solids[a], at[a], solids[b], at[b])
            bisect.insort(nearest, SolidPair(a, b, near), key=lambda pair: pair.distance)
        return nearest[:most]

    def _list_shape_poses(self, at: Kinematics) -> list[coal.Transform3s]:
        """Return the pose of each collision shape in the world frame, for the link poses ``at``."""
        links = [(at.links[shape.link], shape.form.pose) for shape in self.shapes]
        return [
            coal.Transform3s(turn @ pose.rotation, turn @ pose.position + place)
            for (turn, place), pose in links
        ]

    def distance_jacobian(self, at: Configuration, most: int) -> Array:
        """Return the Jacobian by qvel of the distances between the nearest collision shapes.

        Args:
            at: Configuration.
            most: Maximum number of pairs.

        Returns:
            Shape (n, nv) [m per m or rad], for the n pairs of `find_nearest_pairs` in their order.
        """
        found = self.find_nearest_pairs(at.qpos, most)
        rates = np.zeros((len(found), self.robot.nv))
        for row, (first, second, near) in zip(rates, found, strict=True):
            ends = (first, near.getNearestPoint1(), -1), (second, near.getNearestPoint2(), 1)
            for shape, point, sign in ends:
                moved = at.point_jacobian(self.shapes[shape].link, point)
                row += sign * (near.normal @ moved)
        return rates

    def find_lowest_part(
        self,
        at: Kinematics,
        ground: Ground,
        foot_targets: Mapping[str, Array],
        depths: Mapping[str, float],
    ) -> Clearance | None:
        """Find the collision shape in ``parts`` with the smallest height above the ground.

        Args:
            at: Kinematics of the configuration.
            ground: Ground: slope, steps and planes of feet.
            foot_targets: {contact point: target of the sphere centre, shape (3,) [m], in the
                world}. A step is below the target of its foot.
            depths: {contact point: penetration of the ground [m]}.

        Returns:
            Smallest height [m], with the link and the name of the nearest surface. The name is
            empty on a single plane. None if `measure_part_heights` is empty.
        """
        heights = self.measure_part_heights(at, ground, foot_targets, depths)
        if not heights:
            return None
        lowest = min(heights)
        index = heights.index(lowest)
        surfaces = (
            () if _is_plane(ground) else [*self._measure_above_steps(at, ground, foot_targets)]
        )
        surface = surfaces[index].surface if surfaces else ""
        return Clearance(lowest, (self.parts[index].shape.link,), surface)

    def measure_part_heights(
        self,
        at: Kinematics,
        ground: Ground,
        foot_targets: Mapping[str, Array],
        depths: Mapping[str, float],
    ) -> list[float]:
        """Compute the heights [m] of the shapes in ``parts`` above slope, steps and planes.

        If a part, such as a calf, intersects the sphere of a foot, the part may be as deep in the
        ground as the foot. The penetration of this foot is therefore added to the height of the
        part.

        Args:
            at: Kinematics of the configuration.
            ground: Ground: slope, steps and planes of feet.
            foot_targets: {contact point: target of the sphere centre, shape (3,) [m], in the
                world}. A step is below the target of its foot.
            depths: {contact point: penetration of the ground [m]}.

        Returns:
            Heights in the order of ``parts``; empty without parts or ground.
        """
        if self._is_floorless(ground):
            return []
        if _is_plane(ground):
            normal: Direction = tuple(ground.normal().tolist()) if ground.slope else _LEVEL_NORMAL
            heights = [height(at.links[link], normal) for height, link in self._heights]
        else:
            heights = [
                step.distance for step in self._measure_above_steps(at, ground, foot_targets)
            ]
        return [
            height if part.sunk is None else height + depths.get(part.sunk, 0.0)
            for height, part in zip(heights, self.parts, strict=True)
        ]

    def height_jacobian(
        self, at: Configuration, ground: Ground, foot_targets: Mapping[str, Array]
    ) -> Array:
        """Compute the Jacobian (n, nv) by qvel of the heights of collision shapes above the ground.

        The n shapes are the shapes of `measure_part_heights`. The point of a shape that is nearest
        to the ground is treated as fixed to the link.

        Args:
            at: Configuration.
            ground: Ground: slope, steps and planes of feet.
            foot_targets: {contact point: target of the sphere centre, shape (3,) [m], in the
                world}. A step is below the target of its foot.
        """
        there = self.move_to(at.qpos)
        if self._is_floorless(ground):
            return np.zeros((0, self.robot.nv))
        if _is_plane(ground):
            normal = ground.normal()
            shapes = [part.shape for part in self.parts]
            ends = [(s.form.find_lowest_point(there.links[s.link], normal), normal) for s in shapes]
        else:
            steps = self._measure_above_steps(there, ground, foot_targets)
            ends = [(step.near.getNearestPoint1(), -step.near.normal) for step in steps]
        rates = [
            out @ at.point_jacobian(part.shape.link, point)
            for part, (point, out) in zip(self.parts, ends, strict=True)
        ]
        return np.array(rates).reshape(-1, self.robot.nv)

    def _is_floorless(self, ground: Ground) -> bool:
        """Return True if the robot has no ground: no floor, raised steps or planes of feet."""
        return not self._has_floor and _is_plane(ground)

    def _measure_above_steps(
        self, at: Kinematics, ground: Ground, foot_targets: Mapping[str, Array]
    ) -> Iterator[SurfaceDistance]:
        """Yield the smallest distance [m] of each shape in ``parts`` from slope, steps and planes.

        For shapes on the joint of a hand, the surface that this hand touches is ignored.
        """
        where = self._list_shape_poses(at)
        floor = coal.Halfspace(ground.normal(), 0.0 if self._has_floor else -_ABSENT_FLOOR_DEPTH)
        obstacles: list[tuple[str, coal.CollisionGeometry, coal.Transform3s]] = [
            ("", floor, coal.Transform3s())
        ]
        for foot, step in ground.steps(foot_targets).items():
            wide, _, high = (2 * step.half).tolist()
            box = coal.Cylinder(wide / 2, high) if step.round else coal.Box(2 * step.half)
            obstacles.append((foot, box, coal.Transform3s(step.rotation, step.centre)))
        for part in self.parts:
            own = part.shape.form.collision, where[part.number]
            distances = [
                SurfaceDistance(foot, measure_distance(*own, *obstacle))
                for foot, *obstacle in obstacles
                if self._hands.get(foot) != part.shape.joint
            ]
            yield min(distances, key=lambda result: result.distance)

    def _list_parts(self) -> Iterator[OffGround]:
        """Yield each shape of the robot that is no foot and must stay above the ground.

        Shapes are left out if file or task determine their pose, as on a fixed base or a sole.
        """
        robot, model = self.robot, self.robot.pin_model
        feet: dict[str, str] = {}  # {joint: foot}
        is_base_placed = not robot.floating or None in robot.fixed_parts.values()
        flat = {""} if is_base_placed else set[str]()
        for foot, frame in robot.contact_frames.items():
            number = model.getFrameId(frame, pin.FrameType.BODY)
            name = model.names[model.frames[number].parentJoint]
            joint = name if name in robot.joint_names else ""
            if foot in robot.feet and foot in robot.bearing_points:
                feet[joint] = foot
            else:
                flat.add(joint)
        for index, shape in enumerate(self.shapes):
            may_touch = shape.on_ground or not self._has_floor  # without a floor: planes of hands
            if not may_touch or shape.geom in robot.foot_geoms or shape.joint in flat:
                continue
            sunk = feet.get(shape.joint)
            if sunk is not None and not self._intersects_foot(shape, sunk):
                sunk = None
            yield OffGround(index, shape, sunk)

    def _intersects_foot(self, shape: CarriedShape, foot: str) -> bool:
        """Return True if a collision shape intersects the contact sphere of a foot.

        The shape and the foot belong to the same joint. The robot is in the neutral configuration.
        """
        self.kinematics.update(self.robot.neutral())
        turn, place = self.kinematics.links[shape.link]
        centre = turn.T @ (np.array(self.kinematics.feet[foot]) - place)
        ball = coal.Sphere(self.robot.contact_radius[foot])
        there = coal.Transform3s(np.eye(3), centre)
        own = coal.Transform3s(shape.form.pose.rotation, shape.form.pose.position)
        return bool(measure_distance(shape.form.collision, own, ball, there).min_distance < 0)


def _to_index_pairs(pairs: Iterable[tuple[int, int]]) -> IntArray:
    """Convert pairs of indices to an array, shape (n, 2)."""
    return np.array([*pairs], dtype=np.int64).reshape(-1, 2)


def _is_plane(ground: Ground) -> bool:
    """Return True if no step is above the slope and no foot has a separate plane."""
    return not ground.planes and all(height <= 0 for height in ground.heights.values())
