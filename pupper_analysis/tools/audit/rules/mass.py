"""Rules about masses, centres of mass (CoM) and moments of inertia.

Input is the model that a file states, with shapes and joints at zero angles. The rules compare the
inertials of links with physical laws, with the size of the shapes, with the efforts of the motors,
and with each other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
from scipy.constants import g as standard_gravity

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    Quantity,
    Severity,
    Vector,
    diagnose,
)
from pupper_analysis.models.inertias import (
    MIN_REPEATED_LINKS,
    find_placeholder_inertias,
    is_power_of_ten,
)
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.mjcf import compile_spec, has_free_joint
from pupper_analysis.models.places import Place
from pupper_analysis.models.sides import LEG_JOINT_NAME
from pupper_analysis.models.stated.mjcf import find_element_place, joint_name
from pupper_analysis.models.stated.model import HINGE_JOINT, Inertial, Link, MjcfModel, RobotModel
from pupper_analysis.tools.audit.registry import (
    compute_hull_distance,
    compute_hull_volume,
    list_extent_points,
    list_known_points,
    list_link_points,
    rule,
)
from pupper_analysis.tools.audit.rules.files import find_first_place
from pupper_analysis.tools.audit.rules.shapes import MAX_DENSITY

MAX_COM_OFFSET = 0.002
"""Fixed part of the tolerance [m] for a CoM outside the convex hull of a link's shapes, joints and
frames. A fraction of the extent of the points is added. Chosen, not tuned.
"""

DRAWN_FRACTION, SIMPLIFIED_FRACTION = 0.05, 0.5
"""Fractions of a link's extent that are added to `MAX_COM_OFFSET`. `DRAWN_FRACTION` is for visual
shapes and meshes, `SIMPLIFIED_FRACTION` for simple collision shapes, which may be smaller than the
link. Chosen, not tuned.
"""

DEFAULT_DENSITY = 1000.0
"""MuJoCo's default density of a geom [kg/m^3]. A visual mesh with this density probably has mass by
accident, which `visual_adds_mass` reports."""


@rule
def mass_not_positive(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find links with a stated mass <= 0 [kg].

    A mass of zero with an inertia of zero is accepted: zeros mark a link without mass.
    """
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
        yield CheckFinding(robot.link_tag, body.name, message, robot.inertial_path("mass"))


@rule
def moving_body_without_mass(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find moving links without mass, or with less than 0.1 % of the mass that each link moves.

    Links fixed to the moving link are included. The free base of a URDF with legs is checked, too.
    """
    if robot.format == "urdf" and robot.has_free_base and len(_list_legs(robot)) > 1:
        group = robot.fixed_group(robot.base)
        if robot.total_mass > 0 and not any(part.mass for part in group):
            message = diagnose("legged-base-without-mass", legs=_list_legs(robot))
            yield CheckFinding(robot.link_tag, robot.base, message)
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
            part = robot.inertial_path("mass")
            yield CheckFinding(robot.link_tag, body.name, message, part, severity=Severity.WARNING)
        if not body.moving or any(part.mass != 0 for part in group):
            continue
        carries = carried > 0
        joint = body.joints[0].name
        message = diagnose("moving-body-without-mass", joint=joint, carries=carries)
        yield CheckFinding(
            robot.link_tag, body.name, message, severity=Severity.WARNING if carries else None
        )


def _list_legs(robot: RobotModel) -> list[str]:
    """Return the first moving links of the limbs at the base that contain a leg joint or link.

    A limb has two or more moving joints.
    """
    legs = []
    for part in robot.fixed_group(robot.base):
        for child in robot.children(part.name):
            limb = [child, *robot.descendants(child.name)] if child.moving else []
            joints = [joint.name for link in limb for joint in link.joints if joint.moves]
            names = joints + [link.name for link in limb]
            if len(joints) > 1 and any(map(LEG_JOINT_NAME.search, names)):
                legs.append(child.name)
    return legs


MIN_MASS_FRACTION = 1e-3
"""Smallest accepted ratio of the mass of a moving link, with fixed links, to the mass of all
descendant links that move relative to this link. A smaller mass is reported: the unit may be wrong,
or a mass may be missing. Chosen, not tuned.
"""


@rule
def com_outside_shapes(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find a CoM outside the convex hull of a link's shapes, joints and frames.

    The tolerance is `MAX_COM_OFFSET` plus a fraction of the extent. Without shapes of known size,
    joints and frames form the hull, and the tolerance is the length of the longest limb.
    """
    span = max((_compute_reach(robot, name) for name in robot.links), default=0.0)
    for body in robot.links.values():
        inertial = body.inertial
        if inertial is None or not inertial.stated or robot.is_negligible(body):
            continue
        group = robot.fixed_group(body.name)
        shapes = [shape for part in group for shape in part.shapes]
        points, drawn = (
            list_extent_points(group, body),
            any(shape.kind == "mesh" or not shape.collides for shape in shapes),
        )
        if points is None:
            solid = [
                replace(part, shapes=tuple(s for s in part.shapes if s.collides)) for part in group
            ]
            points = list_extent_points(solid, body)
            drawn = all(s.kind == "mesh" for part in solid for s in part.shapes)
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
                    robot.link_tag, body.name, message, robot.inertial_path("origin")
                )
        if points is None or not body.shapes:
            continue
        points = np.concatenate([points, list_link_points(robot, body)])
        size = float(np.ptp(points, axis=0).max())
        outside = compute_hull_distance(points, inertial.com)
        if outside > MAX_COM_OFFSET + (DRAWN_FRACTION if drawn else SIMPLIFIED_FRACTION) * size:
            message = diagnose(
                "com-outside-shapes",
                com=Vector(tuple(inertial.com), "m"),
                outside=Quantity(outside, "m"),
                size=Quantity(size, "m"),
            )
            yield CheckFinding(robot.link_tag, body.name, message, robot.inertial_path("origin"))


def _compute_reach(robot: RobotModel, name: str) -> float:
    """Compute the length of the chain from the root to a link: sum of frame distances [m]."""
    chain = [robot.links[link_name].pose.position for link_name in (name, *robot.ancestors(name))]
    return float(sum(np.linalg.norm(np.diff(chain, axis=0), axis=1)))


@rule
def mass_beyond_motors(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find a robot that is too heavy for the motors.

    The torque of the weight is the weight [N] times the longest distance between successive hinges
    [m]. This torque must not exceed the sum of the efforts of all hinges [N m]. Robots with an
    unknown effort are skipped.
    """
    hinges = [
        joint for joint in robot.joints.values() if joint.kind == HINGE_JOINT and joint.parent
    ]
    efforts = [joint.effort for joint in hinges]
    known = sum(1 for effort in efforts if 0 < effort < np.inf)
    if known < len(efforts) or known < 2:
        return
    distances = [
        float(np.linalg.norm(joint.position - before.position))
        for joint in hinges
        for before in hinges
        if robot.find_moving_body(joint.parent) == robot.find_moving_body(before.child)
    ]
    lever = max(distances, default=0.0)
    torque = robot.total_mass * standard_gravity * lever
    if torque > sum(efforts):
        heaviest = next(
            (
                name
                for name, link in robot.links.items()
                if link.moving and link.mass > MAX_MASS_FRACTION * robot.total_mass
            ),
            None,
        )
        message = diagnose(
            "mass-beyond-motors",
            mass=Quantity(robot.total_mass, "kg"),
            lever=Quantity(lever, "m"),
            torque=Quantity(torque, "N m"),
            joints=known,
            effort=Quantity(sum(efforts), "N m"),
            heaviest=heaviest,
        )
        impossible = torque > IMPOSSIBLE_TORQUE_RATIO * sum(efforts)
        severity = Severity.ERROR if impossible else None
        yield CheckFinding(robot.link_tag, heaviest or robot.base, message, severity=severity)


IMPOSSIBLE_TORQUE_RATIO = 10.0
"""Torque of the weight, relative to the sum of all efforts, above which `mass_beyond_motors` has
the severity ERROR instead of WARNING. A smaller ratio may have another cause than a wrong unit, for
example weak motors and straight legs. Chosen, not tuned.
"""


MAX_MASS_FRACTION = 0.9
"""Mass of a moving link, relative to the mass of the robot, above which `mass_beyond_motors`
reports this link instead of the base as too heavy for the motors. Chosen, not tuned."""


@rule
def total_mass_replaced(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find a ``settotalmass`` that differs from the sum of the masses in the file.

    The severity is NOTE if the ratio is at most `MAX_TOTAL_MASS_RATIO`, as of a weighed robot. It
    is also NOTE if the file states no mass: then MuJoCo computes all masses from densities.
    """
    spec, model = robot.file.spec, robot.mj_model
    if model is None or not spec.compiler.settotalmass > 0:
        return
    spec = spec.copy()
    spec.compiler.settotalmass = -1.0
    written = float(compile_spec(spec, robot.file.path).body_mass[1:].sum())
    total = float(model.body_mass[1:].sum())
    if not written > 0 or np.isclose(total, written, rtol=MASS_SUM_RTOL, atol=0.0):
        return
    factor = total / written
    from_geoms = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    is_stated = any(np.isfinite(geom.mass) for geom in spec.geoms) or (
        not from_geoms and any(body.explicitinertial for body in spec.bodies)
    )
    is_near = max(factor, 1 / factor) <= MAX_TOTAL_MASS_RATIO
    message = diagnose(
        "total-mass-replaced",
        written=Quantity(written, "kg"),
        total=Quantity(total, "kg"),
        factor=Quantity(factor, "1"),
    )
    place = find_first_place(robot.file, "compiler", "settotalmass")
    severity = Severity.NOTE if is_near or not is_stated else None
    yield CheckFinding("compiler", "", message, place=place, severity=severity)


MAX_TOTAL_MASS_RATIO = 2.0
"""Largest ratio between ``settotalmass`` and the sum of the masses in the file (or its inverse)
with which `total_mass_replaced` has the severity NOTE. Chosen, not tuned."""

MASS_SUM_RTOL = 1e-3
"""Relative difference up to which ``settotalmass`` equals the sum of the masses in the file, for
example if it is the rounded sum. Chosen, not tuned."""


@rule
def visual_adds_mass(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find visual geoms without stated mass that add to a mass which MuJoCo computes from geoms.

    If the mass of a body is only from such geoms, it may be intended: then only meshes of MuJoCo's
    default density are reported.
    """
    compiler = robot.file.spec.compiler
    if compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE:
        return
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
    """Find models without free joint in which two or more legs begin at the world.

    A leg has two joints or more, and a joint with the name of a leg joint.
    """
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
"""Upper bound of two ratios [1] in `inertia_implausible`. First ratio: largest moment of a link
without shapes of known size / (m R^2). Second ratio: moment of a solid box around the shapes /
largest moment of the link. Chosen, not tuned: wrong units change moments by a factor of 1000 or
more.
"""

UNREAD_MESH_FACTOR = 8.0
"""Largest ratio of a moment of inertia to m R^2 that is not reported if the sizes of some shapes
are unknown. R is the largest distance from the CoM to the known points, and may then be smaller
than the link. Chosen, not tuned.
"""

MIN_GYRATION_SQUARED = 1e-10
"""Moment of inertia per mass [m^2] up to which a moment, or the excess in `triangle_inequality`,
counts as zero: a radius of gyration of 0.01 mm. Chosen, not tuned."""

MIN_REACH = 0.05
"""Lower bound of the radius R [m] for a link without shapes of known size, whose largest moment of
inertia must be at most `MAX_INERTIA_FACTOR` m R^2. Without the bound, R could be zero. Chosen, not
tuned.
"""


def _list_stated_inertials(robot: RobotModel) -> Iterator[tuple[Link, Inertial]]:
    """Yield the links with an inertial in the file and a positive mass."""
    for body in robot.links.values():
        if body.inertial is not None and body.inertial.stated and body.inertial.mass > 0:
            yield body, body.inertial


@rule
def inertia_not_positive_definite(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find stated inertias, of a positive mass, with a negative or zero principal moment.

    The tolerance of a negative moment depends on the greatest moment and on the rounding of the
    stated numbers. Zero moments are findings for moving links without fixed links, and for the link
    with most of the mass of a moving group of fixed links.
    """
    for body, inertial in _list_stated_inertials(robot):
        least, _, greatest = inertial.moments
        scale = max(abs(least), greatest)
        zero = max(1e-9 * scale, MIN_GYRATION_SQUARED * inertial.mass)
        carrier = robot.find_moving_body(body.name)
        group = robot.fixed_group(carrier)
        alone = body.moving and len(group) == 1
        heaviest = (
            robot.links[carrier].moving
            and not robot.is_negligible(body)
            and 2 * inertial.mass > sum(part.mass for part in group)
        )
        is_negative = least < -max(1e-9 * scale, inertial.rounding)
        if is_negative or ((alone or heaviest) and least <= zero):
            message = diagnose(
                "inertia-not-positive-definite",
                least=Quantity(least, "kg m^2"),
                greatest=Quantity(greatest, "kg m^2"),
            )
            severity = None if is_negative or alone else Severity.WARNING
            part = robot.inertial_path("inertia")
            yield CheckFinding(robot.link_tag, body.name, message, part, severity=severity)


@rule
def triangle_inequality(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find inertias whose largest principal moment exceeds the sum of the other two.

    The tolerance depends on the rounding of the written digits; an excess up to
    `MIN_GYRATION_SQUARED` times the mass is accepted. Source: R. Featherstone, "Rigid Body Dynamics
    Algorithms", 2008, ch. 2.
    """
    for body, inertial in _list_stated_inertials(robot):
        least, middle, greatest = inertial.moments
        tolerance = min(max(1e-5 * greatest, 3 * inertial.rounding), 0.01 * greatest)
        excess = greatest - least - middle
        # An inertia with six equal entries has two moments of 0, up to rounding.
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
            yield CheckFinding(robot.link_tag, body.name, message, robot.inertial_path("inertia"))


@rule
def inertia_implausible(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find moments of inertia too large or too small for the mass and the size of the link.

    The upper limit is k m R^2. R is the largest distance of the shapes from the CoM, and k is 2,
    since shapes may be simplified; k is larger if sizes are unknown. The moments about the
    principal axes of the shapes are limited as well. The lower limit is 1 % of the largest moment
    of a solid box around the link's shapes, m (a^2 + b^2) / 12.
    """
    for body, inertial in _list_stated_inertials(robot):
        greatest = float(inertial.moments[-1])
        if greatest <= 0 or robot.is_negligible(body):
            continue
        points, is_complete = list_known_points(robot.fixed_group(body.name), body)
        shaped = points is not None
        allowed = (2.0 if is_complete else UNREAD_MESH_FACTOR) if shaped else MAX_INERTIA_FACTOR
        if points is None or not is_complete:
            ends = list_link_points(robot, body)
            points = ends if points is None else np.concatenate([points, ends])
        reach = float(np.linalg.norm(points - inertial.com, axis=1).max())
        if not shaped:
            reach = max(reach, MIN_REACH)
        own_points, _ = list_known_points([body], body)
        expected = 0.0 if own_points is None else _compute_box_moment(own_points, inertial.mass)
        if greatest > allowed * inertial.mass * reach**2:
            message = diagnose(
                "inertia-too-large",
                moment=Quantity(greatest, "kg m^2"),
                mass=Quantity(inertial.mass, "kg"),
                gyration=Quantity(np.sqrt(greatest / inertial.mass), "m"),
                reach=Quantity(reach, "m"),
            )
        elif shaped and is_complete and (excess := _find_excess_axis(inertial, points)) is not None:
            message = diagnose(
                "inertia-about-wrong-axis",
                axis=Vector(tuple(excess[0]), "1"),
                moment=Quantity(excess[1], "kg m^2"),
                most=Quantity(excess[2], "kg m^2"),
                distance=Quantity(np.sqrt(excess[2] / inertial.mass), "m"),
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
        yield CheckFinding(robot.link_tag, body.name, message, robot.inertial_path("inertia"))


MIN_AXIS_EXCESS = 3.0
"""Ratio of a moment about a principal axis of the shapes to m d^2 above which the moment is
reported; d is the largest distance of the shapes from this axis through the CoM. A body inside its
shapes has at most 1. Chosen: shapes may be simplified."""


def _find_excess_axis(inertial: Inertial, points: Array) -> tuple[Array, float, float] | None:
    """Find the axis about which the mass would have to be outside of the shapes.

    The moment about an axis through the CoM is at most m d^2, with the largest distance d between
    the shapes and the axis. ``points`` span the shapes, shape (n, 3) [m], in the frame of the link.

    Returns:
        Axis (3,), moment [kg m^2] and largest possible moment [kg m^2]. None if the ratio of both
        is small, or the shapes do not cover the link: for example a calf with the sphere of its
        foot only.
    """
    is_covered = (points.min(axis=0) <= inertial.com) & (inertial.com <= points.max(axis=0))
    if not is_covered.all() or inertial.mass > MAX_DENSITY * compute_hull_volume(points):
        return None
    arms = points - inertial.com
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    if len(axes) < 3:
        return None
    found = []
    for axis in axes:
        across = np.linalg.norm(arms - np.outer(arms @ axis, axis), axis=1).max()
        moment = float(axis @ inertial.inertia @ axis)
        most = inertial.mass * float(across) ** 2
        if moment > MIN_AXIS_EXCESS * most > 0:
            found.append((moment / most, axis, moment, most))
    if not found:
        return None
    return max(found, key=lambda excess: excess[0])[1:]


@rule
def inertial_placeholder(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find masses and inertias that are probably defaults of an exporter.

    An inertia is a finding if at least two moving links have this inertia, and the three moments
    are the same power of ten (1, 0.1, 0.01 ... kg m^2). A mass is a finding if the mass is a power
    of ten (1, 0.1, 0.01 ... kg), and common to all moving links with a stated mass, at least three.
    """
    inertias = (
        (body.name, inertial.inertia)
        for body, inertial in _list_moving_inertials(robot)
        if not robot.is_negligible(body)
    )
    for moment, names in find_placeholder_inertias(inertias).items():
        message = diagnose(
            "inertia-of-a-ball", moment=Quantity(moment, "kg m^2"), others=tuple(names[1:])
        )
        yield CheckFinding(robot.link_tag, names[0], message, robot.inertial_path("inertia"))
    placeholders = list_placeholder_masses(robot)
    if placeholders:
        mass = Quantity(placeholders[0].mass, "kg")
        message = diagnose("one-mass-of-all", mass=mass, count=len(placeholders))
        yield CheckFinding(
            robot.link_tag, placeholders[0].name, message, robot.inertial_path("mass")
        )


def _list_moving_inertials(robot: RobotModel) -> list[tuple[Link, Inertial]]:
    """Return the moving links with stated inertials, and the inertials."""
    return [
        (body, body.inertial)
        for body in robot.links.values()
        if body.moving and body.inertial is not None and body.inertial.stated
    ]


def list_placeholder_masses(robot: RobotModel) -> list[Link]:
    """Return all moving links with stated mass if the masses are probably defaults of an exporter.

    The masses are then equal, and a power of ten (1, 0.1, 0.01 ... kg). Empty for other masses, and
    for fewer than three links.
    """
    links = [body for body, _ in _list_moving_inertials(robot)]
    masses = {body.mass for body in links}
    if (
        len(links) > MIN_REPEATED_LINKS
        and len(masses) == 1
        and not robot.is_negligible(links[0])
        and is_power_of_ten(masses.pop())
    ):
        return links
    return []


@rule
def one_density(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find robots whose stated masses are the volumes of the shapes times a common density.

    At least `MIN_EQUAL_FRACTION` of the compared links must have the same density within
    `DENSITY_RTOL`. Copies, such as the four thighs of a quadruped, count once.
    """
    densities: dict[str, float] = {}
    masses: list[tuple[float, float]] = []
    for body, inertial in _list_stated_inertials(robot):
        volume = _compute_link_volume(body)
        if not volume or robot.is_negligible(body):
            continue
        if any(
            np.allclose((inertial.mass, volume), pair, rtol=COPY_RTOL, atol=0) for pair in masses
        ):
            continue
        masses.append((inertial.mass, volume))
        densities[body.name] = inertial.mass / volume
    if len(densities) < MIN_COMPARED_LINKS:
        return
    values = np.array(list(densities.values()))
    is_close = np.abs(values[:, None] / values - 1) <= DENSITY_RTOL
    shared = is_close[np.argmax(is_close.sum(axis=1))]
    if shared.mean() >= MIN_EQUAL_FRACTION:
        message = diagnose(
            "one-density",
            count=int(shared.sum()),
            compared=len(values),
            density=Quantity(float(np.median(values[shared])), "kg/m^3"),
            mass=Quantity(robot.total_mass, "kg"),
        )
        first = next(name for name, equal in zip(densities, shared, strict=True) if equal)
        yield CheckFinding(robot.link_tag, first, message, robot.inertial_path("mass"))


MIN_EQUAL_FRACTION = 0.75
"""Lower bound of the fraction of a robot's compared links that have the same density, from which
`one_density` reports the robot. Measured on 30 published robots with measured masses: the largest
fraction is 0.44.
"""

MIN_COMPARED_LINKS = 4
"""Smallest number of links with which `one_density` compares the densities of a robot. Chosen, not
tuned.
"""

COPY_RTOL = 1e-3
"""Relative difference of mass and volume up to which a link is a copy of another, for example with
a mirrored mesh. Chosen, not tuned."""

DENSITY_RTOL = 0.01
"""Relative difference up to which two links have the same density in the rule `one_density`.
Chosen, not tuned: CAD programs write masses with three digits or more.
"""


def _compute_link_volume(body: Link) -> float | None:
    """Compute the volume of the visual shapes of a link [m^3], or else of the collision shapes.

    None if unknown. The volumes of overlapping shapes are added.
    """
    for collides in (False, True):
        volumes = [shape.compute_volume() for shape in body.shapes if shape.collides == collides]
        known = [volume for volume in volumes if volume is not None]
        if volumes and len(known) == len(volumes):
            return sum(known)
    return None


def _compute_box_moment(points: Array, mass: float) -> float:
    """Compute the largest principal moment [kg m^2] of a solid box of a given mass [kg].

    The box is the axis-aligned bounding box of ``points``, shape (n, 3) [m].
    """
    _, middle, greatest = np.sort(np.ptp(points, axis=0))
    return mass * float(middle**2 + greatest**2) / 12
