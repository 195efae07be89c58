"""Shapes as sums of simple sets: how far each reaches below its centre is told in closed form."""

from __future__ import annotations

import math
from dataclasses import dataclass

import coal
import pinocchio as pin

from pupper_analysis.robot.kinematics import Place

Direction = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Part:
    """A shape in its link's frame, as the sum of a point, bars, a disc and a ball (m).

    Attributes:
        link: Its link.
        centre: Its centre.
        bars: Half of each: a box is the sum of three, a capsule that of one and a ball.
        disc: Two radii of it at right angles; () without one.
        ball: The ball's radius.
    """

    link: str
    centre: Direction
    bars: tuple[Direction, ...]
    disc: tuple[Direction, ...]
    ball: float

    def height(self, link: Place, normal: Direction) -> float:
        """Returns how high its lowest point is above a plane through the origin (m).

        A shape reaches below its centre by its support function, which of a sum of convex sets is
        the sum of theirs.

        Args:
            link: Where its link is.
            normal: Of the plane, a unit vector.
        """
        turn, place = link
        a, b, c = normal
        # The normal in the link's axes, and the height of the link's origin.
        (xx, xy, xz), (yx, yy, yz), (u, v, w) = turn.tolist()
        at_x, at_y, height = place.tolist()
        if a != 0.0 or b != 0.0:
            u, v, w = a * xx + b * yx + c * u, a * xy + b * yy + c * v, a * xz + b * yz + c * w
            height = a * at_x + b * at_y + c * height
        x, y, z = self.centre
        height += u * x + v * y + w * z - self.ball
        for x, y, z in self.bars:
            height -= abs(u * x + v * y + w * z)
        if self.disc:
            (x, y, z), (p, q, r) = self.disc
            height -= math.hypot(u * x + v * y + w * z, u * p + v * q + w * r)
        return float(height)


def part_of(link: str, shape: coal.CollisionGeometry, place: pin.SE3) -> Part | None:
    """Returns a shape at a place in its link's frame; None for a shape of another form."""
    bars, disc, ball = [], 0.0, 0.0
    if isinstance(shape, coal.Box):
        bars = list(enumerate(shape.halfSide.tolist()))
    elif isinstance(shape, coal.Sphere):
        ball = shape.radius
    elif isinstance(shape, coal.Cylinder):
        bars, disc = [(2, shape.halfLength)], shape.radius
    elif isinstance(shape, coal.Capsule):
        bars, ball = [(2, shape.halfLength)], shape.radius
    else:
        return None
    axes = place.rotation.T
    return Part(
        link,
        tuple(place.translation.tolist()),
        tuple(tuple((half * axes[axis]).tolist()) for axis, half in bars),
        tuple(tuple((disc * axes[axis]).tolist()) for axis in (0, 1)) if disc else (),
        ball,
    )
