"""How near a robot's parts come to each other and to the ground, by the shapes in its URDF."""

from __future__ import annotations

import functools
import json
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import coal  # comes with pin
import numpy as np
import pinocchio as pin
import placo
from numpy.typing import NDArray

from pupper_analysis.files import readable
from pupper_analysis.models.xml import parse_text, to_text
from pupper_analysis.results import Result
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.kinematics import Kinematics
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.parts import Direction, part_of

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_AS_LARGE = 2.0
"""A shape around a foot's centre is the foot if no point of it is further from its own centre than
this many of the foot's radii: a calf that ends there is longer."""

_SAME = 1e-6  # m: what is nearer to each other is the same place, or the same size


@dataclass(frozen=True)
class Clearance(Result):
    """The least distance, and of what.

    Attributes:
        distance: m; negative: how deep one is in the other.
        links: The two links, or the one that is nearest to the ground.
    """

    distance: float
    links: tuple[str, ...]


def shapes_of(robot: Robot) -> Shapes:
    """Returns a robot's shapes, built once per robot and thread."""
    return _cached(robot, threading.get_ident())


@functools.lru_cache(maxsize=8)
def _cached(robot: Robot, _thread: int) -> Shapes:
    return Shapes(robot)


class Shapes:
    """A robot in PlaCo, with the shapes of its URDF: boxes, spheres, cylinders, capsules.

    Meshes are not looked at.

    Attributes:
        robot: The robot.
        wrapper: PlaCo's robot.
        kinematics: Where its com and feet are, by its own model.
        tasks: Whatever a solver made for this robot once, and uses again.
        limits: The joint limits that PlaCo's robot was given last.
        begun: How a solver began last: what it was asked, and what it found.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.kinematics = robot, Kinematics(robot.structure)
        self.tasks: dict[object, Any] = {}
        self.limits: tuple[Array, Array] | None = None
        self.begun: tuple[tuple[object, ...], Array, float, float] | None = None
        self.wrapper = placo.RobotWrapper("", placo.Flags.ignore_collisions, _primitives(robot))
        _leave_names_to_links(self.wrapper.model)
        self._convention = robot.pin_convention
        self._model, self._shapes = self.wrapper.model, self.wrapper.collision_model
        self._objects = list(self.wrapper.collision_model.geometryObjects)
        self._links = [self.wrapper.model.frames[o.parentFrame].name for o in self._objects]
        self._paired = False
        self._data = self.wrapper.model.createData()
        self._placed = pin.GeometryData(self.wrapper.collision_model)
        self._looked_at = [*self._not_feet()]
        self._parts = [
            part_of(self._links[index], shape, self._in_link(index))
            for index, shape, _ in self._looked_at
        ]

    def _in_link(self, index: int) -> pin.SE3:
        """Returns where a shape is in its link's frame."""
        shape = self._objects[index]
        link: pin.SE3 = self.wrapper.model.frames[shape.parentFrame].placement
        return link.actInv(shape.placement)

    def pair(self) -> None:
        """Makes PlaCo look at the distances between links, but not between neighbours.

        Neighbours are links on the same or on adjacent joints, and those that overlap in the home
        configuration.
        """
        if self._paired:
            return
        model, objects = self.wrapper.model, self._objects
        pairs = set()
        for index, one in enumerate(objects):
            for other, link in zip(objects[:index], self._links[:index], strict=True):
                joints = {one.parentJoint, other.parentJoint}
                parents = {int(model.parents[joint]) for joint in joints}
                if len(joints) == 2 and not joints & parents:
                    pairs.add((link, self._links[index]))
        self._load(pairs)
        self._move(self.robot.home)
        overlapping = {
            (self._links[near.objA], self._links[near.objB])
            for near in self.wrapper.distances()
            if near.min_distance <= 0
        }
        self._load({pair for pair in pairs if not {pair, pair[::-1]} & overlapping})
        self._paired = True

    def _load(self, pairs: set[tuple[str, str]]) -> None:
        with readable(json.dumps(sorted(pairs)).encode()) as file:
            self.wrapper.load_collision_pairs(str(file))

    def _move(self, qpos: Array) -> None:
        self.wrapper.state.q = self.robot.pin_convention.q(qpos)
        self.wrapper.update_kinematics()

    def between_links(self, qpos: Array) -> Clearance | None:
        """Returns the least distance between links that are not neighbours, if there are such."""
        self.pair()
        self._move(qpos)
        nearest = min(self.wrapper.distances(), key=lambda near: near.min_distance, default=None)
        if nearest is None:
            return None
        links = self._links[nearest.objA], self._links[nearest.objB]
        return Clearance(float(nearest.min_distance), links)

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
        return Clearance(height, (self._links[lowest],))

    def heights(
        self, qpos: Array, ground: Ground, places: Mapping[str, Array], depths: Mapping[str, float]
    ) -> Array:
        """Returns how high each shape (n,) is above slope and steps (m); infinite for the feet.

        All shapes on the link of a flat foot are the foot. A shape that reaches into its own foot's
        sphere, as a calf's does, may be as deep in the ground as the foot.

        Args:
            qpos: (nq,) the configuration.
            ground: The ground.
            places: {foot: (3,) of its centre (m)}, for the steps.
            depths: {foot: how deep it is in the ground (m)}.
        """
        heights = np.full(len(self._objects), np.inf)
        for index, height in self._heights(qpos, ground, places, depths):
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
        if None not in self._parts and not steps:
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
        for (index, _, sunk), part in zip(self._looked_at, self._parts, strict=True):
            assert part is not None
            height = part.height(link_of(part.link), normal)
            found.append((index, height if sunk is None else height + depths.get(sunk, 0.0)))
        return found

    def _place(self, qpos: Array) -> None:
        """Moves the shapes to a configuration, whose quaternion is normalised."""
        q = self._convention.unit_q(qpos)
        pin.updateGeometryPlacements(self._model, self._data, self._shapes, self._placed, q)

    def moved_by(self, joints: IntArray) -> BoolArray:
        """Tells of each shape (n,), feet included, whether one of some joints moves it.

        Args:
            joints: Their numbers, in actuator order.
        """
        model, names = self.wrapper.model, self.robot.joint_names
        moving = {model.getJointId(names[joint]) for joint in joints}
        return np.array([bool(moving & set(model.supports[o.parentJoint])) for o in self._objects])

    def height_rates(
        self, qpos: Array, ground: Ground, places: Mapping[str, Array], depths: Mapping[str, float]
    ) -> Array:
        """Returns how ``heights`` change (n, 2 + nu) with the base's x and y and the joints.

        Zero for the feet. What is nearest moves as the part of the shape that is there.
        """
        robot, model = self.robot, self.wrapper.model
        data = self._data
        pin.computeJointJacobians(model, data, robot.pin_convention.q(qpos))
        rates = np.zeros((len(self._objects), 2 + robot.nu))
        for index, near, _ in self._above(qpos, ground, places, depths):
            out, joint = -near.normal, int(self._objects[index].parentJoint)
            jacobian = pin.getJointJacobian(model, data, joint, pin.LOCAL_WORLD_ALIGNED)
            jacobian = jacobian[:, robot.pin_convention.v_index]
            x, y, z = (near.getNearestPoint1() - data.oMi[joint].translation).tolist()
            a, b, c = out.tolist()
            turning = np.array([y * c - z * b, z * a - x * c, x * b - y * a])  # (x, y, z) x out
            rates[index] = [*out[:2], *(out @ jacobian[:3] + turning @ jacobian[3:])]
        return rates

    def _above(
        self,
        qpos: Array,
        ground: Ground,
        places: Mapping[str, Array],
        depths: Mapping[str, float],
    ) -> Iterator[tuple[int, coal.DistanceResult, float]]:
        """Yields each shape's number, what of the ground is nearest, and how deep it may be."""
        self._place(qpos)
        obstacles: list[tuple[coal.CollisionGeometry, coal.Transform3s]] = [
            (coal.Halfspace(ground.normal(), 0.0), coal.Transform3s())
        ]
        for centre, half in ground.steps(places).values():
            box = coal.Box(2 * half)
            obstacles.append((box, coal.Transform3s(ground.rotation(), centre)))
        at = self._placed.oMg
        for index, shape, sunk in self._looked_at:
            place = at[index]
            where = coal.Transform3s(place.rotation, place.translation)
            near = [_nearest(shape, where, *obstacle) for obstacle in obstacles]
            depth = 0.0 if sunk is None else depths.get(sunk, 0.0)
            if len(near) == 1:
                yield index, near[0], depth
            else:
                yield index, min(near, key=lambda found: float(found.min_distance)), depth

    def _not_feet(self) -> Iterator[tuple[int, coal.CollisionGeometry, str | None]]:
        """Yields number and form of each shape that is no foot, and the foot it reaches into.

        A foot and the shapes on its link move as one body, so that it is told once for all.
        """
        robot, model, shapes = self.robot, self.wrapper.model, self.wrapper.collision_model
        data, placed = self._data, self._placed
        pin.updateGeometryPlacements(model, data, shapes, placed, pin.neutral(model))
        feet: dict[int, tuple[str, coal.Sphere, coal.Transform3s]] = {}  # by their joint
        flat: set[int] = set()
        for foot, frame in robot.foot_frames.items():
            number = model.getFrameId(frame, pin.FrameType.BODY)
            if foot not in robot.soles:
                flat.add(int(model.frames[number].parentJoint))
                continue
            where = pin.updateFramePlacement(model, data, number)
            there = coal.Transform3s(where.rotation, where.translation)
            ball = coal.Sphere(robot.foot_radius[foot])
            feet[int(model.frames[number].parentJoint)] = foot, ball, there
        for index, (shape, place) in enumerate(zip(self._objects, placed.oMg, strict=True)):
            joint, at = int(shape.parentJoint), coal.Transform3s(place.rotation, place.translation)
            if joint in flat:
                continue
            sunk = None
            if joint in feet:
                foot, ball, there = feet[joint]
                other = foot in robot.description.foot_geoms
                if _is_sole(shape.geometry, at, ball, there, other=other):
                    continue
                if _nearest(shape.geometry, at, ball, there).min_distance < 0:
                    sunk = foot
            yield index, shape.geometry, sunk


def _height(found: tuple[int, float]) -> float:
    return found[1]


def _nearest(
    one: coal.CollisionGeometry,
    at: coal.Transform3s,
    other: coal.CollisionGeometry,
    there: coal.Transform3s,
) -> coal.DistanceResult:
    """Returns the distance, where it is, and the direction from one shape to the other."""
    result = coal.DistanceResult()
    coal.distance(one, at, other, there, coal.DistanceRequest(), result)
    return result


def _is_sole(
    shape: coal.CollisionGeometry,
    at: coal.Transform3s,
    ball: coal.Sphere,
    there: coal.Transform3s,
    *,
    other: bool,
) -> bool:
    """Tells whether a shape is the foot.

    If the foot is the MJCF's (``other``), the URDF's is a sphere around its centre, of any size, or
    another shape there that is about as large: many files have a cylinder that lies.
    """
    away = float(np.linalg.norm(at.getTranslation() - there.getTranslation()))
    sphere = isinstance(shape, coal.Sphere)
    if other:
        shape.computeLocalAABB()
        about = sphere or float(shape.aabb_radius) < _AS_LARGE * ball.radius
        return bool(away < ball.radius and about)
    return bool(sphere and max(away, abs(shape.radius - ball.radius)) < _SAME)


def _primitives(robot: Robot) -> str:
    """Returns the URDF without visuals and meshes, so that no file is needed."""
    root = parse_text(robot.description.urdf)
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        for shape in link.findall("collision"):
            if shape.find("geometry/mesh") is not None:
                link.remove(shape)
    return to_text(root)


def _leave_names_to_links(model: pin.Model) -> None:
    """Renames frames of joints that are named like a link: PlaCo asks for names alone."""
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    taken = {frame.name for frame in model.frames}
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY and frame.name in links:
            while frame.name in taken:
                frame.name += " (joint)"
            taken.add(frame.name)
