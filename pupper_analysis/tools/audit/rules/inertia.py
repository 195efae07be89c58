"""Rules about moments of inertia."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.models.stated.geometry import known_points, link_points
from pupper_analysis.models.stated.model import (
    Array,
    Inertial,
    Link,
    RobotModel,
)
from pupper_analysis.tools.audit.registry import Found, rule

FACTOR = 100.0
"""How far an inertia may be from that of a solid box: units slip by 1000 or more."""

UNREAD = 8.0
"""Times m R^2 that an inertia may be where some mesh is not read, and R is that of the shapes that
are, and of the joints."""

TINY = 1e-10
"""What counts as no inertia, per mass (m^2): a radius of gyration of 0.01 mm."""

REACH = 0.05
"""How far a link without shapes is taken to reach, at least (m)."""


def _stated(robot: RobotModel) -> Iterator[tuple[Link, Inertial]]:
    for body in robot.links.values():
        if body.inertial is not None and body.inertial.stated and body.inertial.mass > 0:
            yield body, body.inertial


@rule
def inertia_not_positive_definite(robot: RobotModel) -> Iterator[Found]:
    """Finds negative moments; and moments of zero on moving bodies to which nothing is fixed."""
    for body, inertial in _stated(robot):
        least, _, greatest = inertial.moments
        scale = max(abs(least), greatest)
        zero = max(1e-9 * scale, TINY * inertial.mass)
        alone = body.moving and len(robot.fixed_group(body.name)) == 1
        if least < -max(zero, inertial.rounding) or (alone and least <= zero):
            told = diagnose(
                "inertia-not-positive-definite",
                least=Quantity(least, "kg m^2"),
                greatest=Quantity(greatest, "kg m^2"),
            )
            yield Found(robot.link_tag, body.name, told, robot.inertial_part("inertia"))


@rule
def triangle_inequality(robot: RobotModel) -> Iterator[Found]:
    """Compares the greatest moment with the sum of the others.

    The tolerance is that of values rounded in their last digit, 1e-5 of the greatest moment at
    least and 1 % at most. Source: R. Featherstone, "Rigid Link Dynamics Algorithms", 2008, ch. 2.
    """
    for body, inertial in _stated(robot):
        least, middle, greatest = inertial.moments
        tolerance = min(max(1e-5 * greatest, 3 * inertial.rounding), 0.01 * greatest)
        excess = greatest - least - middle
        # Of six equal values two moments are 0, but for rounding to either side.
        positive = least >= -max(1e-9 * greatest, TINY * inertial.mass)
        if positive and excess > max(tolerance, TINY * inertial.mass):
            told = diagnose(
                "triangle-inequality",
                least=Quantity(least, "kg m^2"),
                middle=Quantity(middle, "kg m^2"),
                greatest=Quantity(greatest, "kg m^2"),
                excess=Quantity(excess, "kg m^2"),
                share=Quantity(excess / greatest, "1"),
                equal=bool(np.allclose(inertial.inertia, inertial.inertia[0, 0], rtol=1e-6)),
            )
            yield Found(robot.link_tag, body.name, told, robot.inertial_part("inertia"))


@rule
def inertia_implausible(robot: RobotModel) -> Iterator[Found]:
    """Compares the greatest moment with what a body of this mass and size can have.

    An inertia is at most m R^2, with R the distance of the furthest point from the com; twice that
    is allowed, as shapes may be simplified, 8 times where meshes are not read. Without shapes, R is
    the way to the furthest joint or frame, and 100 times that is allowed. At the lower end,
    it is compared with that of a solid box of the body's mass around its own shapes,
    m (a^2 + b^2) / 12.
    """
    for body, inertial in _stated(robot):
        greatest = float(inertial.moments[-1])
        if greatest <= 0 or robot.is_negligible(body):
            continue
        points, whole = known_points(robot.fixed_group(body.name), body)
        shaped = points is not None
        allowed = (2.0 if whole else UNREAD) if shaped else FACTOR
        if points is None or not whole:
            ends = link_points(robot, body)
            points = ends if points is None else np.concatenate([points, ends])
        reach = float(np.linalg.norm(points - inertial.com, axis=1).max())
        if not shaped:
            reach = max(reach, REACH)
        own, _ = known_points([body], body)
        expected = 0.0 if own is None else _solid_box(own, inertial.mass)
        if greatest > allowed * inertial.mass * reach**2:
            told = diagnose(
                "inertia-too-large",
                moment=Quantity(greatest, "kg m^2"),
                mass=Quantity(inertial.mass, "kg"),
                gyration=Quantity(np.sqrt(greatest / inertial.mass), "m"),
                reach=Quantity(reach, "m"),
            )
        elif greatest < expected / FACTOR:
            told = diagnose(
                "inertia-too-small",
                moment=Quantity(greatest, "kg m^2"),
                mass=Quantity(inertial.mass, "kg"),
                solid=Quantity(expected, "kg m^2"),
                times=expected / greatest,
            )
        else:
            continue
        yield Found(robot.link_tag, body.name, told, robot.inertial_part("inertia"))


def _solid_box(points: Array, mass: float) -> float:
    """Returns the greatest moment (kg m^2) of a solid box around points (n, 3), in their axes."""
    _, middle, greatest = np.sort(np.ptp(points, axis=0))
    return mass * float(middle**2 + greatest**2) / 12
