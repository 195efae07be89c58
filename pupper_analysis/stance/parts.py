"""Shapes as sums of simple sets: how far each reaches below its centre is told in closed form."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.kinematics import Place
from pupper_analysis.robot.shapes import ContactShape

Array = NDArray[np.float64]
Direction = tuple[float, float, float]

_G = mujoco.mjtGeom


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A shape in its link's frame, as the sum of a point, bars, an ellipse, a ball and a hull (m).

    Attributes:
        link: Its link.
        centre: Its centre.
        bars: Half of each: a box is the sum of three, a capsule that of one and a ball.
        radii: Those of an ellipse, two at right angles, or of an ellipsoid, three; () without one.
        ball: The ball's radius.
        hull: (n, 3) corners of a convex hull, from the centre; None without one.
    """

    link: str
    centre: Direction
    bars: tuple[Direction, ...]
    radii: tuple[Direction, ...]
    ball: float
    hull: Array | None

    def height(self, link: Place, normal: Direction) -> float:
        """Returns how high its lowest point is above a plane through the origin (m).

        A shape reaches below its centre by its support function, which of a sum of convex sets is
        the sum of theirs, and of a hull that of its corners.

        Args:
            link: Where its link is.
            normal: Of the plane, a unit vector.
        """
        turn, place = link
        a, b, c = normal
        # The normal in the link's axes, and the height of the link's origin.
        if a == 0.0 and b == 0.0:
            (u, v, w), height = turn[2].tolist(), place.item(2)
        else:
            (xx, xy, xz), (yx, yy, yz), (u, v, w) = turn.tolist()
            at_x, at_y, height = place.tolist()
            u, v, w = a * xx + b * yx + c * u, a * xy + b * yy + c * v, a * xz + b * yz + c * w
            height = a * at_x + b * at_y + c * height
        x, y, z = self.centre
        height += u * x + v * y + w * z - self.ball
        for x, y, z in self.bars:
            height -= abs(u * x + v * y + w * z)
        if self.radii:
            height -= math.hypot(*[u * x + v * y + w * z for x, y, z in self.radii])
        if self.hull is not None:
            height += self.hull.dot((u, v, w)).min()
        return float(height)

    def lowest(self, link: Place, normal: Array) -> Array:
        """Returns the point (3,) in the world that is lowest above a plane; see ``height`` (m)."""
        turn, place = link
        own = turn.T @ normal
        point = np.array(self.centre) - self.ball * own
        for bar in self.bars:
            point -= math.copysign(1.0, own @ bar) * np.array(bar)
        if self.radii:
            radii = np.array(self.radii)
            reach = radii @ own
            point -= radii.T @ reach / max(float(np.linalg.norm(reach)), 1e-300)
        if self.hull is not None:
            point += self.hull[(self.hull @ own).argmin()]
        lowest: Array = turn @ point + place
        return lowest


def to_part(shape: ContactShape) -> Part:
    """Returns a shape as a sum."""
    bars: tuple[int, ...] = ()
    radii: tuple[int, ...] = ()
    ball, size = 0.0, shape.size.tolist()
    if shape.kind == _G.mjGEOM_BOX:
        bars = (0, 1, 2)
    elif shape.kind == _G.mjGEOM_SPHERE:
        ball = size[0]
    elif shape.kind == _G.mjGEOM_ELLIPSOID:
        radii = (0, 1, 2)
    elif shape.kind == _G.mjGEOM_CYLINDER:  # MuJoCo's sizes: the radius, and half of the length
        bars, radii, size = (2,), (0, 1), [size[0], size[0], size[1]]
    elif shape.kind == _G.mjGEOM_CAPSULE:
        bars, ball, size = (2,), size[0], [0.0, 0.0, size[1]]
    turn, mesh = shape.place.rotation, shape.kind == _G.mjGEOM_MESH

    def along(axis: int) -> Direction:
        x, y, z = (size[axis] * turn[:, axis]).tolist()
        return x, y, z

    x, y, z = shape.place.translation.tolist()
    return Part(
        link=shape.link,
        centre=(x, y, z),
        bars=tuple(along(axis) for axis in bars),
        radii=tuple(along(axis) for axis in radii),
        ball=ball,
        hull=np.ascontiguousarray(shape.hull @ turn.T) if mesh else None,
    )
