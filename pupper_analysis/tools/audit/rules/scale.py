"""Rules about density and size: whether the numbers are in kg and m at all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.models.readers import Found
from pupper_analysis.models.stated.geometry import extent_points, known_points, link_points
from pupper_analysis.models.stated.model import Array, Link, RobotModel
from pupper_analysis.tools.audit.registry import rule

DENSEST = 20_000.0
"""Mass per volume of the convex hull (kg/m^3) above which no link is: tungsten has 19300.

The hull is the largest volume that a body of these shapes can have. Of 1500 links of robots in use
the densest has 15600, a wrist whose mesh leaves out what is screwed to it.
"""

UNREAD = 5.0
"""Times that, where some mesh is not read: the shapes that are may be smaller than the link."""

LIGHTEST = 2.0
"""Likewise below which none is (kg/m^3): air has 1.2, the lightest foam 10; the links, 8.8."""

SHARE = 0.01
"""Of the robot's mass: what weighs less may have a token of a shape."""

TOKEN = 0.5
"""A shape less than this share of the way to the next joint does not show how large a link is."""

SMALL = 0.01
"""Nor does one below this extent (m)."""

LARGE, TINY = 20.0, 0.002
"""Extents between which the joints of a robot are expected (m)."""

OUT_OF_SCALE = 20.0
"""Times the extent of all joints that no link is drawn; of 1500 links the largest has 2.3."""


@rule
def density_implausible(robot: RobotModel) -> Iterator[Found]:
    """Compares a moving body's mass, with all that is fixed to it, with its shapes' convex hull."""
    for body in _moving(robot):
        group = robot.fixed_group(body.name)
        mass = sum(part.mass for part in group)
        if mass < SHARE * robot.total_mass or mass <= 0:
            continue
        points, whole = known_points(group, body)
        if points is None or not (whole or body.moving):
            continue  # of a base, what is not read may be nearly all
        most = DENSEST if whole else UNREAD * DENSEST
        links = link_points(robot, body)
        own, way = _extent(points), _extent(links)
        if own < max(SMALL, TOKEN * way):
            continue
        volume = _volume(np.concatenate([points, links]))
        density = mass / volume if volume > 0 else np.inf
        if volume > 0 and not (LIGHTEST if whole else 0.0) <= density <= most:
            told = diagnose(
                "denser-than-metal" if density > most else "lighter-than-foam",
                mass=Quantity(mass, "kg"),
                volume=Quantity(volume, "m^3"),
                density=Quantity(density, "kg/m^3"),
            )
            yield Found(robot.link_tag, body.name, told, robot.inertial_part("mass"))


@rule
def scale_unusual(robot: RobotModel) -> Iterator[Found]:
    """Compares the extent of all joints with that of robots, and that of each link with it."""
    places = np.array([joint.position for joint in robot.joints.values() if joint.moves])
    if len(places) < 2 or robot.base not in robot.links:
        return
    size = _extent(places)
    if size > LARGE or 0 < size < TINY:
        told = diagnose(
            "joints-out-of-scale",
            size=Quantity(size, "m"),
            least=Quantity(TINY, "m"),
            most=Quantity(LARGE, "m"),
        )
        yield Found(robot.link_tag, robot.base, told)
    if size < SMALL:
        return
    for body in robot.links.values():
        points = extent_points([body], body)
        if points is not None and _extent(points) > OUT_OF_SCALE * size:
            told = diagnose(
                "shapes-out-of-scale",
                length=Quantity(_extent(points), "m"),
                times=_extent(points) / size,
                size=Quantity(size, "m"),
            )
            yield Found(robot.link_tag, body.name, told)


def _moving(robot: RobotModel) -> Iterator[Link]:
    for body in robot.links.values():
        if body.parent is None or body.moving:
            yield body


def _extent(points: Array) -> float:
    return float(np.ptp(points, axis=0).max())


def _volume(points: Array) -> float:
    """Returns the volume of the convex hull (m^3); 0 of what lies in a plane."""
    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0
