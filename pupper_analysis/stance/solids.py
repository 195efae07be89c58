"""Shapes in coal, on a robot's joints, and how near two of them are."""

from __future__ import annotations

import bisect
from typing import NamedTuple

import coal  # comes with pin
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


class SolidPair(NamedTuple):
    """Two shapes, by their numbers, and how near they are."""

    one: int
    other: int
    near: coal.DistanceResult

    @property
    def distance(self) -> float:
        """m; negative: how deep one is in the other."""
        return float(self.near.min_distance)


class Solids:
    """Shapes in coal, on the joints of Pinocchio's model of a robot.

    Attributes:
        joints: The number of each shape's joint.
        data: Pinocchio's.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot, self._model = robot, robot.pin_model
        self.data = self._model.createData()
        self.joints = [
            int(self._model.getJointId(shape.joint)) if shape.joint else 1 for shape in robot.shapes
        ]
        self._geometry = pin.GeometryModel()
        for shape in self.objects(self._model):
            self._geometry.addGeometryObject(shape)
        self._placed = pin.GeometryData(self._geometry)
        for shape in robot.shapes:
            shape.solid.computeLocalAABB()  # the balls round them

    def objects(self, model: pin.Model) -> list[pin.GeometryObject]:
        """Returns the shapes on the joints and links of a model of the robot's structure."""
        found = []
        for shape, joint in zip(self._robot.shapes, self.joints, strict=True):
            frame = model.getFrameId(shape.link, pin.FrameType.BODY)
            place = model.frames[frame].placement * shape.place
            name = f"geom {shape.geom}"
            found.append(pin.GeometryObject(name, joint, frame, place, shape.solid))
        return found

    def placed(self, qpos: Array) -> pin.StdVec_SE3:
        """Moves the shapes to a configuration, whose quaternion is normalised; returns where."""
        q = self._robot.pin_convention.unit_q(qpos)
        pin.updateGeometryPlacements(self._model, self.data, self._geometry, self._placed, q)
        return self._placed.oMg

    def nearest_pairs(self, qpos: Array, pairs: IntArray, most: int) -> list[SolidPair]:
        """Returns the nearest of some pairs of shapes (n, 2), in order.

        Balls round the shapes tell that most pairs are too far apart to be looked at.
        """
        at, solids = self.placed(qpos), [shape.solid for shape in self._robot.shapes]
        centres = np.array(
            [place.act(one.aabb_center) for place, one in zip(at, solids, strict=True)]
        )
        radii = np.array([one.aabb_radius for one in solids])
        one, other = pairs.T
        apart = np.linalg.norm(centres[one] - centres[other], axis=1) - radii[one] - radii[other]
        found: list[SolidPair] = []
        for index in np.argsort(apart, kind="stable"):
            if len(found) >= most and apart[index] > found[most - 1].distance:
                break
            a, b = pairs[index].tolist()
            near = measure_distance(solids[a], to_transform(at[a]), solids[b], to_transform(at[b]))
            bisect.insort(found, SolidPair(a, b, near), key=lambda pair: pair.distance)
        return found[:most]


def to_transform(place: pin.SE3) -> coal.Transform3s:
    """Returns a place as coal has it."""
    return coal.Transform3s(place.rotation, place.translation)


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
