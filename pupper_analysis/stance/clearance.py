"""How near a robot's parts come to each other and to the ground, by MuJoCo's shapes of it."""

from __future__ import annotations

import bisect
import functools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import coal  # comes with pin
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.results import Result
from pupper_analysis.models.shapes import Direction
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.shapes import CarriedShape, excluded_pairs
from pupper_analysis.robot.structure import Kinematics

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_UP = (0.0, 0.0, 1.0)  # most grounds' normal


@dataclass(frozen=True)
class Clearance(Result):
    """The least distance, and of what.

    Attributes:
        distance: m; negative: how deep one is in the other.
        links: The two links, or the one that is nearest to the ground.
    """

    distance: float = field(metadata={"unit": "m"})
    links: tuple[str, ...]


class OffGround(NamedTuple):
    """A shape that is no foot, and shall be above the ground.

    Attributes:
        number: Which of the robot's shapes.
        shape: The shape.
        sunk: The foot into whose sphere it reaches, if it does.
    """

    number: int
    shape: CarriedShape
    sunk: str | None


class SolidPair(NamedTuple):
    """Two shapes, by their numbers, and how near they are."""

    one: int
    other: int
    near: coal.DistanceResult

    @property
    def distance(self) -> float:
        """m; negative: how deep one is in the other."""
        return float(self.near.min_distance)


def measure_distance(
    one: coal.CollisionGeometry,
    at: coal.Transform3s,
    other: coal.CollisionGeometry,
    there: coal.Transform3s,
) -> coal.DistanceResult:
    """Returns the distance, where it is, and the direction from one shape to the other."""
    result = coal.DistanceResult()
    coal.distance(one, at, other, there, coal.DistanceRequest(), result)
    return result


_NO_FLOOR = 1e3
"""Depth [m] of the half-space that replaces a floor if the file has none: out of reach."""


class ClearanceShapes:
    """The shapes with which MuJoCo has a robot touch: of meshes the convex hulls.

    Attributes:
        robot: The robot.
        shapes: Its shapes, those of the feet included.
        kinematics: Where its com and feet are.
        parts: The shapes that are no feet.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.kinematics = robot, Kinematics(robot.structure)
        self.shapes: tuple[CarriedShape, ...] = robot.shapes
        self._has_floor = robot.has_floor
        self.parts = [*self._not_feet()]
        joints = {number: name for name, number in robot.structure.joints.items()}
        # A hand's own shapes are around its ball.
        self._hands = {hand: joints.get(robot.structure.parents[hand], "") for hand in robot.hands}
        self._heights = [(part.shape.form.height, part.shape.link) for part in self.parts]

    def move_to(self, qpos: ArrayLike) -> Kinematics:
        """Takes ``kinematics`` to a configuration (nq,), and returns it."""
        self.kinematics.move(qpos)
        return self.kinematics

    @functools.cached_property
    def _pairs(self) -> IntArray:
        """Pairs (n, 2) of shapes whose distances count: not those of neighbours.

        Neighbours are links on the same or on adjacent joints, those that the MJCF excludes from
        touching each other, and those that overlap in the home configuration.
        """
        model, shapes = self.robot.pin_model, self.shapes
        joints = [model.getJointId(shape.joint) if shape.joint else 1 for shape in shapes]
        excepted, able, never = excluded_pairs(self.robot.mj_model), set(), set()
        every = [(before, index) for index in range(len(shapes)) for before in range(index)]
        links = {both: frozenset(shapes[number].link for number in both) for both in every}
        for one, other in every:
            both = {joints[one], joints[other]}
            if len(both) == 2 and not both & {int(model.parents[joint]) for joint in both}:
                able.add(links[one, other])
            if frozenset((shapes[one].body, shapes[other].body)) in excepted:
                never.add(links[one, other])
        looked = [both for both in every if links[both] in able - never]
        for shape in shapes:
            shape.form.collision.computeLocalAABB()  # the balls round them
        near = self._nearest(self.robot.home, _numbers(looked), len(looked))
        never |= {links[pair.one, pair.other] for pair in near if pair.distance <= 0}
        return _numbers(both for both in looked if links[both] not in never)

    def closest_links(self, qpos: Array) -> Clearance | None:
        """Returns the least distance between links that are not neighbours, if there are such."""
        for pair in self.nearest_pairs(qpos, 1):
            links = self.shapes[pair.one].link, self.shapes[pair.other].link
            return Clearance(pair.distance, links)
        return None

    def nearest_pairs(self, qpos: Array, most: int) -> list[SolidPair]:
        """Returns the nearest pairs of shapes on links that are not neighbours, in order."""
        return self._nearest(qpos, self._pairs, most)

    def _nearest(self, qpos: Array, pairs: IntArray, most: int) -> list[SolidPair]:
        """Returns the nearest of some pairs of shapes (n, 2), in order.

        Balls round the shapes tell that most pairs are too far apart to be looked at.
        """
        solids, at = [one.form.collision for one in self.shapes], self._places(self.move_to(qpos))
        centres = np.array(
            [place.transform(one.aabb_center) for place, one in zip(at, solids, strict=True)]
        )
        radii = np.array([one.aabb_radius for one in solids])
        one, other = pairs.T
        apart = np.linalg.norm(centres[one] - centres[other], axis=1) - radii[one] - radii[other]
        found: list[SolidPair] = []
        for index in np.argsort(apart, kind="stable"):
            if len(found) >= most and apart[index] > found[most - 1].distance:
                break
            a, b = pairs[index].tolist()
            near = measure_distance(solids[a], at[a], solids[b], at[b])
            bisect.insort(found, SolidPair(a, b, near), key=lambda pair: pair.distance)
        return found[:most]

    def _places(self, at: Kinematics) -> list[coal.Transform3s]:
        links = [(at.links[shape.link], shape.form.pose) for shape in self.shapes]
        return [
            coal.Transform3s(turn @ pose.rotation, turn @ pose.position + place)
            for (turn, place), pose in links
        ]

    def distance_jacobian(self, at: Configuration, most: int) -> Array:
        """Returns how the distances of ``nearest_pairs`` change (n, nv) with the robot's motion."""
        found = self.nearest_pairs(at.qpos, most)
        rates = np.zeros((len(found), self.robot.nv))
        for row, (one, other, near) in zip(rates, found, strict=True):
            ends = (one, near.getNearestPoint1(), -1), (other, near.getNearestPoint2(), 1)
            for shape, point, sign in ends:
                moved = at.point_jacobian(self.shapes[shape].link, point)
                row += sign * (near.normal @ moved)
        return rates

    def lowest_part(
        self,
        at: Kinematics,
        ground: Ground,
        places: Mapping[str, Array],
        depths: Mapping[str, float],
    ) -> Clearance | None:
        """Returns how high the lowest part but the feet is; see ``part_heights``."""
        heights = self.part_heights(at, ground, places, depths)
        if not heights:
            return None
        lowest = min(heights)
        return Clearance(lowest, (self.parts[heights.index(lowest)].shape.link,))

    def part_heights(
        self,
        at: Kinematics,
        ground: Ground,
        places: Mapping[str, Array],
        depths: Mapping[str, float],
    ) -> list[float]:
        """Returns how high each of ``parts`` is above slope and steps (m); empty without ground.

        A part that reaches into its own foot's sphere, as a calf's does, may sink as the foot does.

        Args:
            at: Where the robot is.
            ground: The ground.
            places: {foot: (3,) of its centre (m)}, for the steps.
            depths: {foot: how deep it is in the ground (m)}.
        """
        if self._is_floorless(ground):
            return []
        if _is_plane(ground):
            normal: Direction = tuple(ground.normal().tolist()) if ground.slope else _UP
            heights = [height(at.links[link], normal) for height, link in self._heights]
        else:
            heights = [float(near.min_distance) for near in self._above_steps(at, ground, places)]
        return [
            height if part.sunk is None else height + depths.get(part.sunk, 0.0)
            for height, part in zip(heights, self.parts, strict=True)
        ]

    def height_jacobian(
        self, at: Configuration, ground: Ground, places: Mapping[str, Array]
    ) -> Array:
        """Returns how ``part_heights`` change (n, nv) with the robot's motion.

        What is nearest moves as the point of the part that is there.
        """
        there = self.move_to(at.qpos)
        if self._is_floorless(ground):
            return np.zeros((0, self.robot.nv))
        if _is_plane(ground):
            normal = ground.normal()
            shapes = [part.shape for part in self.parts]
            ends = [(one.form.lowest(there.links[one.link], normal), normal) for one in shapes]
        else:
            steps = self._above_steps(there, ground, places)
            ends = [(near.getNearestPoint1(), -near.normal) for near in steps]
        rates = [
            out @ at.point_jacobian(part.shape.link, point)
            for part, (point, out) in zip(self.parts, ends, strict=True)
        ]
        return np.array(rates).reshape(-1, self.robot.nv)

    def _is_floorless(self, ground: Ground) -> bool:
        """Return True if no ground can touch the robot: no floor, and no plane of its own."""
        return not self._has_floor and _is_plane(ground)

    def _above_steps(
        self, at: Kinematics, ground: Ground, places: Mapping[str, Array]
    ) -> Iterator[coal.DistanceResult]:
        """Yields what of slope and steps is nearest to each of ``parts``."""
        where = self._places(at)
        floor = coal.Halfspace(ground.normal(), 0.0 if self._has_floor else -_NO_FLOOR)
        obstacles: list[tuple[str, coal.CollisionGeometry, coal.Transform3s]] = [
            ("", floor, coal.Transform3s())
        ]
        for foot, step in ground.steps(places).items():
            wide, _, high = (2 * step.half).tolist()
            box = coal.Cylinder(wide / 2, high) if step.round else coal.Box(2 * step.half)
            obstacles.append((foot, box, coal.Transform3s(step.rotation, step.centre)))
        for part in self.parts:
            own = part.shape.form.collision, where[part.number]
            met = [one for foot, *one in obstacles if self._hands.get(foot) != part.shape.joint]
            near = [measure_distance(*own, *one) for one in met]
            yield min(near, key=lambda found: float(found.min_distance))

    def _not_feet(self) -> Iterator[OffGround]:
        """Yields each shape that is no foot.

        A flat foot and the shapes on its link move as one body, so that it is stated once for all;
        and what is welded is where it is.
        """
        robot, model = self.robot, self.robot.pin_model
        feet: dict[str, str] = {}  # by their joint
        flat = {"" for point in robot.welds.values() if point is None}  # bolted to what it touches
        for foot, frame in robot.contact_frames.items():
            number = model.getFrameId(frame, pin.FrameType.BODY)
            name = model.names[model.frames[number].parentJoint]
            joint = name if name in robot.joint_names else ""
            if foot in robot.feet and foot in robot.bearing:
                feet[joint] = foot
            else:
                flat.add(joint)
        for index, shape in enumerate(self.shapes):
            may_touch = shape.on_ground or not self._has_floor  # without a floor: planes of hands
            if not may_touch or shape.geom in robot.foot_geoms or shape.joint in flat:
                continue
            sunk = feet.get(shape.joint)
            if sunk is not None and not self._reaches_into(shape, sunk):
                sunk = None
            yield OffGround(index, shape, sunk)

    def _reaches_into(self, shape: CarriedShape, foot: str) -> bool:
        """Whether a shape on the link of a foot reaches into the foot's sphere."""
        self.kinematics.move(self.robot.neutral())
        turn, place = self.kinematics.links[shape.link]
        centre = turn.T @ (np.array(self.kinematics.feet[foot]) - place)
        ball = coal.Sphere(self.robot.contact_radius[foot])
        there = coal.Transform3s(np.eye(3), centre)
        own = coal.Transform3s(shape.form.pose.rotation, shape.form.pose.position)
        return bool(measure_distance(shape.form.collision, own, ball, there).min_distance < 0)


def _numbers(pairs: Iterable[tuple[int, int]]) -> IntArray:
    return np.array([*pairs], dtype=np.int64).reshape(-1, 2)


def _is_plane(ground: Ground) -> bool:
    """Tells whether no step rises above the slope."""
    return not ground.planes and all(height <= 0 for height in ground.heights.values())
