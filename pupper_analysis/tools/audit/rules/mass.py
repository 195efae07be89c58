"""Rules about masses, centres of mass and moments of inertia."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from scipy.constants import g as standard_gravity

from pupper_analysis.base.diagnostics import (
    Quantity,
    Severity,
    Vector,
    diagnose,
)
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.mjcf import has_free_joint
from pupper_analysis.models.places import Place
from pupper_analysis.models.sides import LEG_JOINT_NAME
from pupper_analysis.models.stated.mjcf import find_element_place, joint_name
from pupper_analysis.models.stated.model import (
    HINGE,
    Array,
    Inertial,
    Link,
    MjcfModel,
    RobotModel,
)
from pupper_analysis.tools.audit.registry import (
    compute_hull_distance,
    list_extent_points,
    list_known_points,
    list_link_points,
    rule,
)

MAX_COM_OFFSET = 0.002
"""How far a com may be outside its shapes (m), plus a share of their greatest extent."""

DRAWN_FRACTION, SIMPLIFIED_FRACTION = 0.05, 0.5
"""That share where a link is drawn, and where it has but simple shapes for contacts."""

DEFAULT_DENSITY = 1000.0
"""MuJoCo's density of a geom for which none is stated (kg/m^3)."""


@rule
def mass_not_positive(robot: RobotModel) -> Iterator[CheckFinding]:
    """Finds masses <= 0; not where nothing is claimed, with an inertia of zero too."""
    for body in robot.links.values():
        inertial = body.inertial
        if inertial is None or not inertial.stated or inertial.mass > 0:
            continue
        if inertial.mass == 0 and not inertial.inertia.any():
            continue
        largest = float(np.abs(inertial.inertia).max())
        message = diagnose(
            "mass-not-positive",
            mass=Quantity(inertial.mass, "kg"),
            largest=Quantity(largest, "kg m^2"),
        )
        yield CheckFinding(robot.link_tag, body.name, message, robot.inertial_part("mass"))


@rule
def moving_body_without_mass(robot: RobotModel) -> Iterator[CheckFinding]:
    """Finds moving bodies without mass, fixed ones counted in; WARNING if others hang on them.

    So are those that weigh less than a thousandth of what hangs on them: of 1500 links in use none
    that has mass is lighter than five thousandths of what it carries.
    """
    for body in robot.links.values():
        group = robot.fixed_group(body.name)
        mass = sum(part.mass for part in group)
        carried = (
            sum(descendant.mass for descendant in robot.descendants(body.name)) + body.mass - mass
        )
        if body.moving and 0 < mass < MIN_MASS_FRACTION * carried:
            message = diagnose(
                "hardly-any-mass", mass=Quantity(mass, "kg"), carried=Quantity(carried, "kg")
            )
            part = robot.inertial_part("mass")
            yield CheckFinding(robot.link_tag, body.name, message, part, severity=Severity.WARNING)
        if not body.moving or any(part.mass != 0 for part in group):
            continue
        carries = carried > 0
        joint = body.joints[0].name
        message = diagnose("moving-body-without-mass", joint=joint, carries=carries)
        yield CheckFinding(
            robot.link_tag, body.name, message, severity=Severity.WARNING if carries else None
        )


MIN_MASS_FRACTION = 1e-3
"""Of the mass that hangs on a link: what weighs less is a slip of units, or was forgotten."""


@rule
def com_outside_shapes(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares coms with the convex hull of a body's shapes, joints, and what is fixed to it.

    That of a body without shapes is compared with the robot: no com is farther from the body's
    joints than its longest limb is long.
    """
    span = max((_reach(robot, name) for name in robot.links), default=0.0)
    for body in robot.links.values():
        inertial = body.inertial
        if inertial is None or not inertial.stated or robot.is_negligible(body):
            continue
        group = robot.fixed_group(body.name)
        points = list_extent_points(group, body)
        if points is None:
            outside = compute_hull_distance(list_link_points(robot, body), inertial.com)
            if 0 < span < outside:
                message = diagnose(
                    "com-far-from-joints",
                    com=Vector(tuple(inertial.com), "m"),
                    outside=Quantity(outside, "m"),
                    size=Quantity(span, "m"),
                )
                yield CheckFinding(
                    robot.link_tag, body.name, message, robot.inertial_part("origin")
                )
        if points is None or not body.shapes:
            continue
        points = np.concatenate([points, list_link_points(robot, body)])
        size = float(np.ptp(points, axis=0).max())
        outside = compute_hull_distance(points, inertial.com)
        shapes = [shape for part in group for shape in part.shapes]
        drawn = any(shape.kind == "mesh" or not shape.collides for shape in shapes)
        if outside > MAX_COM_OFFSET + (DRAWN_FRACTION if drawn else SIMPLIFIED_FRACTION) * size:
            message = diagnose(
                "com-outside-shapes",
                com=Vector(tuple(inertial.com), "m"),
                outside=Quantity(outside, "m"),
                size=Quantity(size, "m"),
            )
            yield CheckFinding(robot.link_tag, body.name, message, robot.inertial_part("origin"))


def _reach(robot: RobotModel, name: str) -> float:
    """Returns how far a link is from its root along the joints (m)."""
    chain = [robot.links[link_name].pose.position for link_name in (name, *robot.ancestors(name))]
    return float(sum(np.linalg.norm(np.diff(chain, axis=0), axis=1)))


@rule
def mass_beyond_motors(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares the weight, at the longest way between two joints, with all efforts together.

    No robot on legs could lift itself so. Joints whose effort nobody states, or is 0, say nothing.
    """
    hinges = [joint for joint in robot.joints.values() if joint.kind == HINGE and joint.parent]
    efforts = [joint.effort for joint in hinges]
    known = sum(1 for effort in efforts if 0 < effort < np.inf)
    if known < len(efforts) or known < 2:
        return
    distances = [
        float(np.linalg.norm(joint.position - before.position))
        for joint in hinges
        for before in hinges
        if robot.carrier(joint.parent) == robot.carrier(before.child)
    ]
    lever = max(distances, default=0.0)
    torque = robot.total_mass * standard_gravity * lever
    if torque > sum(efforts):
        message = diagnose(
            "mass-beyond-motors",
            mass=Quantity(robot.total_mass, "kg"),
            lever=Quantity(lever, "m"),
            torque=Quantity(torque, "N m"),
            joints=known,
            effort=Quantity(sum(efforts), "N m"),
        )
        yield CheckFinding(robot.link_tag, robot.base, message)


@rule
def visual_adds_mass(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Finds drawn geoms with a mass that nobody stated, in bodies whose mass is their geoms'."""
    compiler = robot.file.spec.compiler
    low, high = compiler.inertiagrouprange
    for body in robot.file.spec.bodies:
        if body.name == "world" or (body.explicitinertial and compiler.inertiafromgeom != 1):
            continue
        if not body.name or body.name not in robot.links:
            continue
        weighing = [
            geom
            for geom in body.geoms
            if low <= geom.group <= high and geom.density > 0 and geom.mass != 0
        ]
        drawn = [g for g in weighing if not (g.contype or g.conaffinity) and np.isnan(g.mass)]
        by_accident = [geom for geom in drawn if geom.density == DEFAULT_DENSITY]
        solid = len(drawn) < len(weighing)
        for geom in drawn if solid else by_accident:
            if not solid and geom.type != mujoco.mjtGeom.mjGEOM_MESH:
                continue
            message = diagnose(
                "visual-adds-mass",
                density=Quantity(geom.density, "kg/m^3"),
                mass=Quantity(robot.links[body.name].mass, "kg"),
                body=body.name,
            )
            place: Place | None = (
                None if geom.name else find_element_place(robot.file, geom, body.name)
            )
            yield CheckFinding("geom", geom.name, message, place=place)


@rule
def base_fused(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Finds two legs or more that begin at the world: no body of the robot carries them."""
    model = robot.mj_model
    if model is None or has_free_joint(model):
        return
    firsts: dict[str, list[str]] = {}
    for joint in range(model.njnt):
        top = int(model.body_rootid[model.jnt_bodyid[joint]])
        firsts.setdefault(robot.body_names[top], []).append(joint_name(model, joint))
    legs = [
        name
        for name, joints in firsts.items()
        if len(joints) > 1 and any(map(LEG_JOINT_NAME.search, joints))
    ]
    if len(legs) > 1:
        yield CheckFinding(robot.link_tag, legs[0], diagnose("base-fused", legs=legs))


# Rules about moments of inertia.

MAX_INERTIA_FACTOR = 100.0
"""How far an inertia may be from that of a solid box: units slip by 1000 or more."""

UNREAD_MESH_FACTOR = 8.0
"""Times m R^2 that an inertia may be where some mesh is not read, and R is that of the shapes that
are, and of the joints."""

MIN_GYRATION_SQUARED = 1e-10
"""What counts as no inertia, per mass (m^2): a radius of gyration of 0.01 mm."""

MIN_REACH = 0.05
"""How far a link without shapes is taken to reach, at least (m)."""


def _stated(robot: RobotModel) -> Iterator[tuple[Link, Inertial]]:
    for body in robot.links.values():
        if body.inertial is not None and body.inertial.stated and body.inertial.mass > 0:
            yield body, body.inertial


@rule
def inertia_not_positive_definite(robot: RobotModel) -> Iterator[CheckFinding]:
    """Finds negative moments; and moments of zero on moving bodies to which nothing is fixed."""
    for body, inertial in _stated(robot):
        least, _, greatest = inertial.moments
        scale = max(abs(least), greatest)
        zero = max(1e-9 * scale, MIN_GYRATION_SQUARED * inertial.mass)
        alone = body.moving and len(robot.fixed_group(body.name)) == 1
        if least < -max(zero, inertial.rounding) or (alone and least <= zero):
            message = diagnose(
                "inertia-not-positive-definite",
                least=Quantity(least, "kg m^2"),
                greatest=Quantity(greatest, "kg m^2"),
            )
            yield CheckFinding(robot.link_tag, body.name, message, robot.inertial_part("inertia"))


@rule
def triangle_inequality(robot: RobotModel) -> Iterator[CheckFinding]:
    """Compares the greatest moment with the sum of the others.

    The tolerance is that of values rounded in their last digit, 1e-5 of the greatest moment at
    least and 1 % at most. Source: R. Featherstone, "Rigid Link Dynamics Algorithms", 2008, ch. 2.
    """
    for body, inertial in _stated(robot):
        least, middle, greatest = inertial.moments
        tolerance = min(max(1e-5 * greatest, 3 * inertial.rounding), 0.01 * greatest)
        excess = greatest - least - middle
        # Of six equal values two moments are 0, but for rounding to either side.
        positive = least >= -max(1e-9 * greatest, MIN_GYRATION_SQUARED * inertial.mass)
        if positive and excess > max(tolerance, MIN_GYRATION_SQUARED * inertial.mass):
            message = diagnose(
                "triangle-inequality",
                least=Quantity(least, "kg m^2"),
                middle=Quantity(middle, "kg m^2"),
                greatest=Quantity(greatest, "kg m^2"),
                excess=Quantity(excess, "kg m^2"),
                share=Quantity(excess / greatest, "1"),
                equal=bool(np.allclose(inertial.inertia, inertial.inertia[0, 0], rtol=1e-6)),
            )
            yield CheckFinding(robot.link_tag, body.name, message, robot.inertial_part("inertia"))


@rule
def inertia_implausible(robot: RobotModel) -> Iterator[CheckFinding]:
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
        points, whole = list_known_points(robot.fixed_group(body.name), body)
        shaped = points is not None
        allowed = (2.0 if whole else UNREAD_MESH_FACTOR) if shaped else MAX_INERTIA_FACTOR
        if points is None or not whole:
            ends = list_link_points(robot, body)
            points = ends if points is None else np.concatenate([points, ends])
        reach = float(np.linalg.norm(points - inertial.com, axis=1).max())
        if not shaped:
            reach = max(reach, MIN_REACH)
        own, _ = list_known_points([body], body)
        expected = 0.0 if own is None else _solid_box(own, inertial.mass)
        if greatest > allowed * inertial.mass * reach**2:
            message = diagnose(
                "inertia-too-large",
                moment=Quantity(greatest, "kg m^2"),
                mass=Quantity(inertial.mass, "kg"),
                gyration=Quantity(np.sqrt(greatest / inertial.mass), "m"),
                reach=Quantity(reach, "m"),
            )
        elif greatest < expected / MAX_INERTIA_FACTOR:
            message = diagnose(
                "inertia-too-small",
                moment=Quantity(greatest, "kg m^2"),
                mass=Quantity(inertial.mass, "kg"),
                solid=Quantity(expected, "kg m^2"),
                times=expected / greatest,
            )
        else:
            continue
        yield CheckFinding(robot.link_tag, body.name, message, robot.inertial_part("inertia"))


@rule
def inertial_placeholder(robot: RobotModel) -> Iterator[CheckFinding]:
    """Finds tensors of a ball with a round moment, and one round mass of all moving links.

    Round is 1, 0.1, 0.01 ...: no body has such a tensor but by a choice, and exporters choose it.
    """
    moving = [
        (body, body.inertial)
        for body in robot.links.values()
        if body.moving and body.inertial is not None and body.inertial.stated
    ]
    balls: dict[float, list[str]] = {}
    for body, inertial in moving:
        moment = float(inertial.inertia[0, 0])
        ball = np.allclose(inertial.inertia, moment * np.eye(3), rtol=1e-9, atol=1e-9 * moment)
        if ball and _is_round(moment) and not robot.is_negligible(body):
            balls.setdefault(moment, []).append(body.name)
    for moment, names in balls.items():
        if len(names) >= _SEVERAL:
            message = diagnose(
                "inertia-of-a-ball", moment=Quantity(moment, "kg m^2"), others=tuple(names[1:])
            )
            yield CheckFinding(robot.link_tag, names[0], message, robot.inertial_part("inertia"))
    masses = {inertial.mass for _, inertial in moving}
    one = len(moving) > _SEVERAL and len(masses) == 1 and not robot.is_negligible(moving[0][0])
    if one and _is_round(mass := masses.pop()):
        message = diagnose("one-mass-of-all", mass=Quantity(mass, "kg"), count=len(moving))
        yield CheckFinding(robot.link_tag, moving[0][0].name, message, robot.inertial_part("mass"))


_SEVERAL = 2
"""One link may have any number by chance."""


def _is_round(value: float) -> bool:
    """Whether a number is a power of ten."""
    return value > 0 and bool(abs(np.log10(value) - round(np.log10(value))) < ROUND_LOG_ATOL)


ROUND_LOG_ATOL = 1e-9
"""Of a logarithm: a power of ten, but for the rounding of binary numbers."""


def _solid_box(points: Array, mass: float) -> float:
    """Returns the greatest moment (kg m^2) of a solid box around points (n, 3), in their axes."""
    _, middle, greatest = np.sort(np.ptp(points, axis=0))
    return mass * float(middle**2 + greatest**2) / 12
