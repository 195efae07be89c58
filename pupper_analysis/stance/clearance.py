"""How near a robot's parts come to each other and to the ground, by MuJoCo's shapes of it."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import coal  # comes with pin
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.kinematics import Kinematics
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.shapes import ContactShape, excluded_pairs
from pupper_analysis.stance.parts import Direction, Part, to_part
from pupper_analysis.stance.solids import SolidPair, Solids, measure_distance, to_transform

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Clearance(Result):
    """The least distance, and of what.

    Attributes:
        distance: m; negative: how deep one is in the other.
        links: The two links, or the one that is nearest to the ground.
    """

    distance: float
    links: tuple[str, ...]


class ClearanceShapes:
    """The shapes with which MuJoCo has a robot touch: of meshes the convex hulls.

    Attributes:
        robot: The robot.
        shapes: Its shapes, those of the feet included.
        kinematics: Where its com and feet are.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.kinematics = robot, Kinematics(robot.structure)
        self.shapes: tuple[ContactShape, ...] = robot.shapes
        self._parts = [*self._not_feet()]

    def at(self, qpos: ArrayLike) -> Kinematics:
        """Takes ``kinematics`` to a configuration (nq,), and returns it.

        Raises:
            ConfigurationError: If it has a wrong length, a value is not finite, or the quaternion
                is zero.
        """
        self.kinematics.move(self.robot.structure.state(qpos))
        return self.kinematics

    @property
    def off_ground(self) -> IntArray:
        """Numbers of the shapes that are no feet."""
        return np.array([index for index, _, _ in self._parts], dtype=np.int64)

    @functools.cached_property
    def _solids(self) -> Solids:
        return Solids(self.robot)

    @functools.cached_property
    def _pairs(self) -> IntArray:
        """Pairs (n, 2) of shapes whose distances count: not those of neighbours.

        Neighbours are links on the same or on adjacent joints, those that the MJCF excludes from
        touching each other, and those that overlap in the home configuration.
        """
        model, shapes = self.robot.pin_model, self.shapes
        joints = [model.getJointId(shape.joint) if shape.joint else 1 for shape in shapes]
        excepted, able, never = excluded_pairs(self.robot), set(), set()
        every = [(before, index) for index in range(len(shapes)) for before in range(index)]
        links = {both: frozenset(shapes[number].link for number in both) for both in every}
        for one, other in every:
            both = {joints[one], joints[other]}
            if len(both) == 2 and not both & {int(model.parents[joint]) for joint in both}:
                able.add(links[one, other])
            if frozenset((shapes[one].body, shapes[other].body)) in excepted:
                never.add(links[one, other])
        looked = [both for both in every if links[both] in able - never]
        near = self._solids.nearest_pairs(self.robot.home, _numbers(looked), len(looked))
        never |= {links[pair.one, pair.other] for pair in near if pair.distance <= 0}
        return _numbers(both for both in looked if links[both] not in never)

    def between_links(self, qpos: Array) -> Clearance | None:
        """Returns the least distance between links that are not neighbours, if there are such."""
        nearest = self._nearest_pairs(qpos, 1)
        if not nearest:
            return None
        one, other, near = nearest[0]
        return Clearance(float(near.min_distance), (self.shapes[one].link, self.shapes[other].link))

    def above_ground(
        self,
        qpos: Array,
        ground: Ground,
        places: Mapping[str, Array],
        depths: Mapping[str, float],
        *,
        moved: bool = False,
    ) -> Clearance | None:
        """Returns how high the lowest part other than the feet is above slope and steps.

        See ``heights``; ``moved`` says that ``kinematics`` has been taken there.
        """
        found = self._heights(qpos, ground, places, depths, moved=moved)
        if not found:
            return None
        lowest, height = min(found, key=_height)
        return Clearance(height, (self.shapes[lowest].link,))

    def heights(
        self,
        qpos: Array,
        ground: Ground,
        places: Mapping[str, Array],
        depths: Mapping[str, float],
        *,
        moved: bool = False,
    ) -> Array:
        """Returns how high each shape (n,) is above slope and steps (m); infinite for the feet.

        All shapes on the link of a flat foot are the foot. A shape that reaches into its own foot's
        sphere, as a calf's does, may be as deep in the ground as the foot.

        Args:
            qpos: (nq,) the configuration.
            ground: The ground.
            places: {foot: (3,) of its centre (m)}, for the steps.
            depths: {foot: how deep it is in the ground (m)}.
            moved: Says that ``kinematics`` has been taken there.
        """
        heights = np.full(len(self.shapes), np.inf)
        for index, height in self._heights(qpos, ground, places, depths, moved=moved):
            heights[index] = height
        return heights

    def _heights(
        self,
        qpos: Array,
        ground: Ground,
        places: Mapping[str, Array],
        depths: Mapping[str, float],
        *,
        moved: bool = False,
    ) -> list[tuple[int, float]]:
        """Returns number and height of each shape that is no foot; see ``heights``."""
        steps = ground.heights and any(height > 0 for height in ground.heights.values())
        if not steps:
            if not moved:
                self.kinematics.move(self.robot.structure.state(qpos))
            return self._above_plane(ground, depths)
        return [
            (index, float(near.min_distance) + depth)
            for index, near, depth in self._above(qpos, ground, places, depths)
        ]

    def _above_plane(self, ground: Ground, depths: Mapping[str, float]) -> list[tuple[int, float]]:
        """Returns number and height of what is no foot above a plane, where ``kinematics`` is."""
        normal: Direction = tuple(ground.normal().tolist())
        found, link_of = [], self.kinematics.link
        for index, part, sunk in self._parts:
            height = part.height(link_of(part.link), normal)
            found.append((index, height if sunk is None else height + depths.get(sunk, 0.0)))
        return found

    def moved_by(self, joints: IntArray) -> BoolArray:
        """Tells of each shape (n,), feet included, whether one of some joints moves it.

        Args:
            joints: Their numbers, in actuator order.
        """
        model, names = self.robot.pin_model, self.robot.joint_names
        moving = {model.getJointId(names[joint]) for joint in joints}
        own = [model.getJointId(shape.joint) if shape.joint else 0 for shape in self.shapes]
        return np.array([bool(moving & set(model.supports[joint])) for joint in own])

    def height_rates(
        self, qpos: Array, ground: Ground, places: Mapping[str, Array], depths: Mapping[str, float]
    ) -> Array:
        """Returns how ``heights`` change (n, nv) with the robot's motion.

        Zero for the feet. What is nearest moves as the part of the shape that is there.
        """
        robot = self.robot
        at = Configuration(robot, qpos)
        rates = np.zeros((len(self.shapes), robot.nv))
        if any(ground.heights.values()):
            found = [
                (index, near.getNearestPoint1(), -near.normal)
                for index, near, _ in self._above(qpos, ground, places, depths)
            ]
        else:
            normal = ground.normal()
            self.kinematics.move(at.qpos)
            link = self.kinematics.link
            found = [
                (n, part.lowest(link(part.link), normal), normal) for n, part, _ in self._parts
            ]
        for index, point, out in found:
            rates[index] = out @ at.point_jacobian(self.shapes[index].link, point)
        return rates

    def distances(self, qpos: Array, most: int) -> Array:
        """Returns the least distances between links that are not neighbours, in order (m).

        Args:
            qpos: (nq,) the configuration.
            most: How many at most.
        """
        return np.array([pair.distance for pair in self._nearest_pairs(qpos, most)])

    def distance_rates(self, at: Configuration, most: int) -> Array:
        """Returns how ``distances`` change (n, nv) with the robot's motion."""
        found = self._nearest_pairs(at.qpos, most)
        rates = np.zeros((len(found), self.robot.nv))
        for row, (one, other, near) in zip(rates, found, strict=True):
            ends = (one, near.getNearestPoint1(), -1), (other, near.getNearestPoint2(), 1)
            for shape, point, sign in ends:
                moved = at.point_jacobian(self.shapes[shape].link, point)
                row += sign * (near.normal @ moved)
        return rates

    def _nearest_pairs(self, qpos: Array, most: int) -> list[SolidPair]:
        return self._solids.nearest_pairs(qpos, self._pairs, most)

    def _above(
        self,
        qpos: Array,
        ground: Ground,
        places: Mapping[str, Array],
        depths: Mapping[str, float],
    ) -> Iterator[tuple[int, coal.DistanceResult, float]]:
        """Yields each shape's number, what of the ground is nearest, and how deep it may be."""
        at = self._solids.placed(qpos)
        obstacles: list[tuple[coal.CollisionGeometry, coal.Transform3s]] = [
            (coal.Halfspace(ground.normal(), 0.0), coal.Transform3s())
        ]
        for centre, half in ground.steps(places).values():
            box = coal.Box(2 * half)
            obstacles.append((box, coal.Transform3s(ground.rotation(), centre)))
        for index, _, sunk in self._parts:
            solid, where = self.shapes[index].solid, to_transform(at[index])
            near = [measure_distance(solid, where, *obstacle) for obstacle in obstacles]
            depth = 0.0 if sunk is None else depths.get(sunk, 0.0)
            if len(near) == 1:
                yield index, near[0], depth
            else:
                yield index, min(near, key=lambda found: float(found.min_distance)), depth

    def _not_feet(self) -> Iterator[tuple[int, Part, str | None]]:
        """Yields number and form of each shape that is no foot, and the foot it reaches into.

        A flat foot and the shapes on its link move as one body, so that it is told once for all.
        """
        robot, model = self.robot, self.robot.pin_model
        feet: dict[str, str] = {}  # by their joint
        flat: set[str] = set()
        for foot, frame in robot.foot_frames.items():
            number = model.getFrameId(frame, pin.FrameType.BODY)
            name = model.names[model.frames[number].parentJoint]
            joint = name if name in robot.joint_names else ""
            if foot in robot.soles:
                feet[joint] = foot
            else:
                flat.add(joint)
        for index, shape in enumerate(self.shapes):
            if not shape.on_ground or shape.geom in robot.foot_geoms or shape.joint in flat:
                continue
            sunk = feet.get(shape.joint)
            if sunk is not None and not self._reaches_into(shape, sunk):
                sunk = None
            yield index, to_part(shape), sunk

    def _reaches_into(self, shape: ContactShape, foot: str) -> bool:
        """Whether a shape on the link of a foot reaches into the foot's sphere."""
        self.kinematics.move(self.robot.structure.state(self.robot.neutral()))
        turn, place = self.kinematics.link(shape.link)
        centre = turn.T @ (np.array(self.kinematics.feet()[foot]) - place)
        ball, there = coal.Sphere(self.robot.foot_radius[foot]), coal.Transform3s(np.eye(3), centre)
        near = measure_distance(shape.solid, to_transform(shape.place), ball, there)
        return bool(near.min_distance < 0)


def _numbers(pairs: Iterable[tuple[int, int]]) -> IntArray:
    return np.array([*pairs], dtype=np.int64).reshape(-1, 2)


def _height(found: tuple[int, float]) -> float:
    return found[1]
