"""Rules about what USD's physics makes of what a file says, and does not say."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from pupper_analysis.base.diagnostics import Quantity, Severity, Term, diagnose
from pupper_analysis.models.attributes import BY_KIND
from pupper_analysis.models.loading import Check, Found
from pupper_analysis.models.places import Place
from pupper_analysis.models.stated.model import HINGE, SLIDE
from pupper_analysis.tools.usd.model import BALL_RADIUS, WATER, Origin, UsdModel

CONTRADICTION = 1e-3
"""Relative: one schema has single precision, 1e-7, and some writers five digits."""

GAP, TURN = 1e-3, math.radians(1.0)
"""How far the frames of a joint may be apart (m, rad): prims may stand at rounded numbers."""

OFF = 1e-4
"""m: a com that is not stated may be so far from the origin, where it may have been meant."""

SATURATED = math.radians(2.0)
"""A drive that is at its limit when its joint is off by less is stiff, or of another unit (rad).

Pupper's servo is there at 34 degrees, and at 0.6 if its gain per radian is written per degree."""

USUAL = 0.1, 6.0
"""rad: where such a drive is at its limit if its gain was meant per radian."""

SMALL = 0.05
"""m: the extent of the joints of a robot that was drawn in m and is read in cm, at most: 5 m."""


def mass_of_water(robot: UsdModel) -> Iterator[Found]:
    """Finds bodies whose mass, or some of it, is of shapes without any stated density."""
    for name, weighed in robot.weights.items():
        if weighed.origin is Origin.WATER and weighed.inertial is not None:
            message = diagnose(
                "mass-of-water",
                mass=Quantity(weighed.water, "kg"),
                density=Quantity(WATER, "kg/m^3"),
                total=Quantity(robot.total_mass, "kg"),
            )
            yield Found(robot.link_tag, name, message)


def mass_unstated(robot: UsdModel) -> Iterator[Found]:
    """Finds bodies of whose mass nothing is known; NOTE of those that are fixed to another."""
    for name, weighed in robot.weights.items():
        if weighed.inertial is None:
            shapes = any(shape.collides for shape in robot.links[name].shapes)
            message = diagnose("mass-unstated", shapes=shapes)
            alone = robot.links[name].moving or robot.links[name].parent is None
            yield Found(robot.link_tag, name, message, severity=None if alone else Severity.NOTE)


def inertia_unstated(robot: UsdModel) -> Iterator[Found]:
    """Finds stated masses without a stated inertia; WARNING where there is no shape either."""
    for name, weighed in robot.weights.items():
        inertial, stated = weighed.inertial, weighed.origin is Origin.STATED
        if stated and weighed.inertia_made and inertial is not None and inertial.mass > 0:
            shapes = any(shape.collides for shape in robot.links[name].shapes)
            message = diagnose(
                "inertia-unstated",
                mass=Quantity(inertial.mass, "kg"),
                shapes=shapes,
                radius=Quantity(BALL_RADIUS, "m"),
            )
            severity = None if shapes else Severity.WARNING
            yield Found(robot.link_tag, name, message, severity=severity)
        elif stated and weighed.com_made and inertial is not None:
            away = float(np.linalg.norm(inertial.com))
            if away > OFF:
                message = diagnose("com-unstated", away=Quantity(away, "m"))
                yield Found(robot.link_tag, name, message, severity=Severity.WARNING)
        elif weighed.axes_made and inertial is not None and np.ptp(inertial.moments) > 0:
            yield Found(robot.link_tag, name, diagnose("principal-axes-unstated"))


def inertias_contradict(robot: UsdModel) -> Iterator[Found]:
    """Compares newton:inertia with the tensor of physics:diagonalInertia and principalAxes."""
    for name, weighed in robot.weights.items():
        stated = weighed.inertial
        if weighed.newton is None or stated is None or weighed.inertia_made:
            continue
        size = float(np.abs(weighed.newton).max())
        off = float(np.abs(weighed.newton - stated.inertia).max())
        if off <= CONTRADICTION * size:
            continue
        moments = np.linalg.eigvalsh(weighed.newton)
        turned = bool(np.allclose(moments, stated.moments, atol=CONTRADICTION * size))
        message = diagnose("inertias-contradict", off=Quantity(off / size, "1"), turned=turned)
        yield Found(robot.link_tag, name, message)


def mass_not_counted(robot: UsdModel) -> Iterator[Found]:
    """Finds masses on what is neither a body nor touches things."""
    for path, mass in robot.idle.items():
        message = diagnose("mass-not-counted", mass=Quantity(mass, "kg"))
        name = path.rpartition("/")[2]
        yield Found("prim", name, message, place=Place(robot.file.path, None, path))


def joint_frames_apart(robot: UsdModel) -> Iterator[Found]:
    """Compares a joint's frames in its two bodies, as these stand, but for its own motion."""
    for name, (gap, turn) in robot.apart.items():
        if gap > GAP or turn > TURN:
            message = diagnose(
                "joint-frames-apart", gap=Quantity(gap, "m"), turn=Quantity(turn, "rad")
            )
            yield Found("joint", name, message)


def joint_numbers_contradict(robot: UsdModel) -> Iterator[Found]:
    """Compares the numbers of a joint that several schemas state."""
    for name, edge in robot.edges.items():
        for kind, stated in edge.stated.items():
            values = np.array(list(stated.values()))
            if kind == "effort":
                continue  # each is a limit: of a motor, of the joint
            if np.ptp(values) <= CONTRADICTION * np.abs(values).max():
                continue
            first, last = min(stated, key=stated.__getitem__), max(stated, key=stated.__getitem__)
            unit = BY_KIND[kind].unit(edge.kind == SLIDE)
            message = diagnose(
                "joint-numbers-contradict",
                one=first,
                first=Quantity(stated[first], unit),
                two=last,
                last=Quantity(stated[last], unit),
            )
            yield Found("joint", name, message)


def drive_gain_in_wrong_unit(robot: UsdModel) -> Iterator[Found]:
    """Finds hinges' drives that are at their limit within 2 degrees, and would not be per radian.

    NOTE, as arms of great stiffness are so, too.
    """
    for name, edge in robot.edges.items():
        drive, effort = edge.drive, edge.numbers.get("effort", math.inf)
        if drive is None or edge.kind != HINGE or drive.accelerates or drive.stiffness <= 0:
            continue
        meant = effort / (drive.stiffness * math.radians(1.0))
        if effort / drive.stiffness < SATURATED and USUAL[0] <= meant <= USUAL[1]:
            message = diagnose(
                "drive-gain-in-wrong-unit",
                written=drive.written,
                stiffness=Quantity(drive.stiffness, "N m/rad"),
                effort=Quantity(effort, "N m"),
                angle=Quantity(effort / drive.stiffness, "rad"),
            )
            yield Found("joint", name, message, severity=Severity.NOTE)


def units_unstated(robot: UsdModel) -> Iterator[Found]:
    """Finds stages without metersPerUnit; NOTE unless the robot is as small as if drawn in m."""
    if robot.file.stage.HasAuthoredMetadata("metersPerUnit"):
        return
    places = np.array([joint.position for joint in robot.joints.values()])
    size = float(np.ptp(places, axis=0).max()) if len(places) > 1 else 0.0
    message = diagnose(
        "units-unstated",
        unit=Quantity(robot.units.length, "m"),
        size=Quantity(size, "m"),
        drawn=Quantity(size / robot.units.length, "m"),
    )
    yield Found("file", "", message, severity=None if 0 < size < SMALL else Severity.NOTE)


def value_impossible(robot: UsdModel) -> Iterator[Found]:
    """Finds negative gains of drives, and shapes of size 0 and less."""
    for name, edge in robot.edges.items():
        if edge.drive is None:
            continue
        for attribute in ("stiffness", "damping"):
            value = getattr(edge.drive, attribute)
            if value < 0:
                message = diagnose("value-impossible", attribute=attribute, value=value)
                yield Found("joint", name, message)
    for link in robot.links.values():
        for shape in link.shapes:
            if shape.size and not min(shape.size) > 0:
                message = diagnose("shape-without-size", shape=shape.name, kind=Term(shape.kind))
                yield Found(robot.link_tag, link.name, message)


CHECKS: Final[Mapping[str, Check]] = {
    check.__name__.replace("_", "-"): check
    for check in (
        mass_of_water,
        mass_unstated,
        inertia_unstated,
        inertias_contradict,
        mass_not_counted,
        joint_frames_apart,
        joint_numbers_contradict,
        drive_gain_in_wrong_unit,
        units_unstated,
        value_impossible,
    )
}
"""{rule: what looks for it}."""
