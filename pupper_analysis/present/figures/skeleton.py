"""A robot as lines, and the polygons under it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.robot.contact import foot_site, limb_ends
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]
BOX_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A robot as lines, by MuJoCo's kinematics of the MJCF. In the world (m).

    Attributes:
        legs: {foot: (n, 3)} the joints from base to foot, and last the centre of the foot's sphere.
        arms: (n, 3) each: the joints of the limbs that have no foot.
        boxes: (n, 8, 3) corners of the boxes of the base: of its box geoms or, if it has none, of
            those around its geoms. Corner 4 i + 2 j + k has the signs i, j, k along the edges.
    """

    legs: dict[str, Array]
    arms: tuple[Array, ...]
    boxes: Array

    def points(self) -> Array:
        """Returns all points (n, 3) (m)."""
        return np.concatenate([self.boxes.reshape(-1, 3), *self.legs.values(), *self.arms])


def draw_skeleton(robot: Robot, qpos: ArrayLike) -> Skeleton:
    """Returns a robot as lines.

    Args:
        robot: The robot.
        qpos: (nq,) where it is.
    """
    model = robot.mj_model
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, np.asarray(qpos, dtype=float))
    mujoco.mj_kinematics(model, data)
    base = model.body(robot.mj_base).id
    legs: dict[str, Array] = {}
    for foot, (_, frame) in robot.description.contact_points.items():
        body, position = foot_site(model, frame, robot.name)
        tip = data.xpos[body] + data.xmat[body].reshape(3, 3) @ position
        legs[foot] = np.array([*_joints_to(model, data, base, body), tip])
    walked = {int(model.body_weldid[body]) for body, _ in robot.contact_places.values()}
    arms = [_joints_to(model, data, base, body) for body in limb_ends(model) if body not in walked]
    geoms = np.flatnonzero(model.geom_bodyid == base)
    drawn = geoms[model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_BOX.value]
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    boxes = []
    for geom in drawn if len(drawn) else geoms:
        centre, half_size = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        rotation = data.geom_xmat[geom].reshape(3, 3)
        boxes.append(data.geom_xpos[geom] + (centre + signs * half_size) @ rotation.T)
    long = tuple(np.array(arm) for arm in arms if len(arm) > 1)
    return Skeleton(legs, long, np.array(boxes).reshape(-1, 8, 3))


def _joints_to(model: mujoco.MjModel, data: mujoco.MjData, base: int, body: int) -> list[Array]:
    """Returns where the joints (3,) are that move a body against the base, from the base on (m)."""
    points: list[Array] = []
    while body not in (base, 0):
        first = int(model.body_jntadr[body])
        joints = range(first, first + int(model.body_jntnum[body]))
        points += [data.xanchor[joint].copy() for joint in reversed(joints)]
        body = int(model.body_parentid[body])
    return points[::-1]


def hull_corners(points: Iterable[Array]) -> Array:
    """Returns the corners (n, 2) of the convex hull of points (3,), seen from above (m)."""
    hull = shapely.MultiPoint([point[:2] for point in points]).convex_hull
    line = hull.exterior if hull.geom_type == "Polygon" else hull
    return np.array(line.coords)


def nearest_edge_point(polygon: Array, place: Array) -> Array:
    """Returns the point (2,) on a polygon's edge (n, 2) that is nearest to a place (2,) (m)."""
    edge = shapely.LineString(polygon) if len(polygon) > 1 else shapely.Point(polygon[0])
    nearest = shapely.shortest_line(shapely.Point(place), edge)
    return np.array(nearest.coords[-1])
