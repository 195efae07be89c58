"""Rules about the simulation of a model in MuJoCo, and about defaults of other engines.

Input is the model of a file, compiled by MuJoCo for an MJCF. The rules check gravity, armature,
the contacts between feet and ground with parameters that are combined as in MuJoCo, and links of a
URDF without inertial. No rule of this module simulates.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
from scipy.constants import g as standard_gravity

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Severity,
    Vector,
    diagnose,
)
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.shapes import read_shape
from pupper_analysis.models.sides import LEG_JOINT_NAME
from pupper_analysis.models.stated.model import MjcfModel, UrdfModel
from pupper_analysis.robot.contact import MIN_FOOT_FRICTION, combine_geoms, ground_geom
from pupper_analysis.robot.shapes import may_touch
from pupper_analysis.tools.audit.registry import rule
from pupper_analysis.tools.audit.rules.actuators import list_drives
from pupper_analysis.tools.audit.rules.files import find_first_place


@rule
def gravity_unusual(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find an MJCF whose gravity differs by more than 0.02 m/s^2 from (0, 0, -9.80665) m/s^2.

    The severity is NOTE if gravity points mainly down, since a tilted gravity may simulate a slope.
    """
    gravity = np.array(robot.file.spec.option.gravity)
    if np.linalg.norm(gravity - (0.0, 0.0, -standard_gravity)) > 0.02:
        place = find_first_place(robot.file, "option", "gravity")
        message = diagnose("gravity-unusual", gravity=Vector(tuple(gravity), "m/s^2"))
        wrong = gravity[2] > 0 or np.hypot(*gravity[:2]) >= -gravity[2]
        severity = None if wrong else Severity.NOTE
        yield CheckFinding("option", "", message, place=place, severity=severity)


@rule
def gravity_compensated(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find moving bodies with nonzero ``gravcomp``, which compensates weight; one finding.

    The severity is NOTE if ``actuatorgravcomp`` of a joint adds the compensation to the torque of
    the motor. MuJoCo ignores all values if no value is positive, or if there is no gravity.
    """
    model = robot.mj_model
    if model is None or not (model.body_gravcomp > 0).any() or not model.opt.gravity.any():
        return
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY.value:
        return
    borne = model.body_gravcomp * model.body_mass * (model.body_weldid > 0)
    bodies = np.flatnonzero(borne)
    if not bodies.size:
        return
    by_motors = bool(model.jnt_actgravcomp.any())
    weight = float(borne.sum() * np.linalg.norm(model.opt.gravity))
    message = diagnose(
        "gravity-compensated",
        value=float(model.body_gravcomp[bodies[0]]),
        more=[model.body(body).name for body in bodies[1:].tolist()],
        weight=Quantity(weight, "N"),
        share=float(borne.sum() / model.body_mass[model.body_weldid > 0].sum()),
        motors=by_motors,
    )
    severity = Severity.NOTE if by_motors else None
    name = model.body(int(bodies[0])).name
    yield CheckFinding("body", name, message, "gravcomp", severity=severity)


@rule
def armature_zero(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find models in which the armature of all driven joints and of their actuators is zero."""
    if robot.mj_model is None:
        return
    model = robot.mj_model
    driven = list(list_drives(model))
    armature = [
        model.dof_armature[model.jnt_dofadr[drive.joint]] + model.actuator_armature[drive.id]
        for drive in driven
    ]
    if driven and not any(armature):
        message = diagnose("armature-zero", joints=len(driven))
        yield CheckFinding("joint", driven[0].joint_name, message)


@rule
def foot_frictionless(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find feet with no, or almost no, sliding friction in the ground contact.

    Contact parameters are combined as in MuJoCo. If the file has no ground, MuJoCo's default ground
    is assumed; a foot without friction is then reported nevertheless, since the ground of another
    scene may have no friction.
    """
    model = robot.mj_model
    if model is None:
        return
    ground = ground_geom(model)
    for geom in list_foot_geoms(robot):
        contact = combine_geoms(model, geom, ground)
        friction = contact.friction[0]
        if ground is None:
            friction = min(friction, float(model.geom_friction[geom, 0]))
        if friction < MIN_FOOT_FRICTION or contact.condim == 1:
            message = diagnose("foot-frictionless", condim=contact.condim, friction=friction)
            yield _make_geom_finding(robot, geom, message)


def _make_geom_finding(robot: MjcfModel, geom: int, message: Diagnostic) -> CheckFinding:
    """Make a finding about a geom; about the body of a geom without a name."""
    assert robot.mj_model is not None
    name = robot.mj_model.geom(geom).name
    if name:
        return CheckFinding("geom", name, message)
    body = robot.body_names[int(robot.mj_model.geom_bodyid[geom])]
    return CheckFinding("body", body, message, "geom")


def list_foot_geoms(robot: MjcfModel) -> list[int]:
    """Return the indices of the collision geoms of feet in MuJoCo's model.

    A foot is a geom of a moving body with "foot" in the name of geom or body, or at a site with
    "foot" in the name. Empty without a compiled model.
    """
    model = robot.mj_model
    if model is None:
        return []
    feet = []
    for geom in _list_colliding_geoms(model):
        body = int(model.geom_bodyid[geom])
        at_site = any(
            "foot" in model.site(site).name.lower()
            and np.linalg.norm(model.site_pos[site] - model.geom_pos[geom]) < 1e-3
            for site in range(model.nsite)
            if model.site_bodyid[site] == body
        )
        named = "foot" in model.geom(geom).name.lower() + robot.body_names[body].lower()
        if named or at_site:
            feet.append(geom)
    return feet


@rule
def foot_softer_than_its_size(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find spherical feet whose ground contact reaches full impedance deeper than half the radius.

    The impedance of the contact is combined as in MuJoCo. The width of ``solimp`` [m] must not
    exceed `MAX_WIDTH_RATIO` times the radius, if the impedance rises (``solimp[0] < solimp[1]``).
    """
    model = robot.mj_model
    if model is None:
        return
    ground = ground_geom(model)
    feet: dict[tuple[float, float], list[int]] = {}
    for geom in _list_foot_spheres(robot, model):
        radius = float(model.geom_size[geom, 0])
        rises, width = _read_impedance(combine_geoms(model, geom, ground).solimp)
        if rises and width > MAX_WIDTH_RATIO * radius and may_touch(model, geom, ground):
            feet.setdefault((radius, width), []).append(geom)
    for (radius, width), geoms in feet.items():
        message = diagnose(
            "foot-softer-than-its-size",
            width=Quantity(width, "m"),
            radius=Quantity(radius, "m"),
            others=len(geoms) - 1,
        )
        yield _make_geom_finding(robot, geoms[0], message)


MAX_WIDTH_RATIO = 0.5
"""Largest width of ``solimp`` relative to the radius of a foot that is not reported. Chosen, not
tuned."""


def _list_foot_spheres(robot: MjcfModel, model: mujoco.MjModel) -> list[int]:
    """Return the ids of spherical geoms of feet; without named feet, of spheres that end limbs."""
    named, spheres = list_foot_geoms(robot), mujoco.mjtGeom.mjGEOM_SPHERE
    if named:
        return [geom for geom in named if model.geom_type[geom] == spheres]
    found: dict[int, list[int]] = {}
    for geom in _list_colliding_geoms(model):
        found.setdefault(int(model.geom_bodyid[geom]), []).append(geom)
    carriers = set(model.body_weldid[model.body_parentid[model.body_jntnum > 0]].tolist())
    return [
        geoms[0]
        for body, geoms in found.items()
        if len(geoms) == 1
        and model.geom_type[geoms[0]] == spheres
        and int(model.body_weldid[body]) not in carriers
    ]


def _read_impedance(solimp: Sequence[float]) -> tuple[bool, float]:
    """Return True if the contact impedance grows with depth, and the transition depth [m]."""
    return bool(solimp[0] < solimp[1]), float(solimp[2])


@rule
def hull_below_foot(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find meshes of a shank whose convex hull, which MuJoCo collides, reaches below the foot.

    The lowest points of the mesh and of the foot's sphere are compared, with the shank inclined up
    to `MAX_SHANK_ANGLE` about the axis of the knee.
    """
    model = robot.mj_model
    if model is None:
        return
    data, ground = mujoco.MjData(model), ground_geom(model)
    mujoco.mj_kinematics(model, data)
    is_mesh = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    weld = model.body_weldid[model.geom_bodyid]
    for foot in _list_foot_spheres(robot, model):
        body = int(weld[foot])
        joint = int(model.body_jntadr[body])
        if model.body_jntnum[body] != 1:
            continue
        if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE or not may_touch(
            model, foot, ground
        ):
            continue
        directions = _list_downward_directions(data, joint, foot)
        sphere = read_shape(model, foot, data).support(directions)
        meshes = np.flatnonzero(is_mesh & (weld == body)).tolist()
        for mesh in meshes:
            hull = read_shape(model, mesh, data).support(directions)
            if hull is None or sphere is None or not may_touch(model, mesh, ground):
                continue
            depths = hull - sphere
            if depths.max() > MIN_HULL_DEPTH:
                message = diagnose(
                    "hull-below-foot",
                    mesh=model.mesh(int(model.geom_dataid[mesh])).name,
                    depth=_round_depth(float(depths.max())),
                    angle=Quantity(abs(_SHANK_ANGLES[int(depths.argmax())]), "rad"),
                )
                yield _make_geom_finding(robot, foot, message)
                break


MAX_SHANK_ANGLE = np.deg2rad(60.0)
"""Largest angle [rad] between the shank and the vertical at which the lowest points of the shank's
convex hull and of the foot are compared. Chosen, not tuned."""

MIN_HULL_DEPTH = 1e-3
"""Depth [m] of the convex hull of a mesh below the lowest point of the foot's sphere, above which
the hull is reported. Chosen, not tuned."""

_SHANK_ANGLES = np.linspace(-MAX_SHANK_ANGLE, MAX_SHANK_ANGLE, 25)
"""Inclinations of a shank, shape (25,) [rad], at which the mesh of the shank and the foot are
compared.
"""


def _list_downward_directions(data: mujoco.MjData, knee: int, foot: int) -> Array:
    """Return the unit vectors that point down if a shank is inclined by `_SHANK_ANGLES`, (n, 3).

    The vectors are expressed in the world frame for the configuration of ``data``. Without
    inclination, down is the direction from the knee to the foot, normal to the knee axis. ``knee``
    is the id of a joint, ``foot`` of a geom.
    """
    axis = data.xaxis[knee]
    down = data.geom_xpos[foot] - data.xanchor[knee]
    down = down - (down @ axis) * axis
    down /= max(float(np.linalg.norm(down)), 1e-12)
    cosines, sines = np.cos(_SHANK_ANGLES)[:, None], np.sin(_SHANK_ANGLES)[:, None]
    directions: Array = cosines * down + sines * np.cross(axis, down)
    return directions


def _round_depth(depth: float) -> Quantity:
    """Round a depth [m] to three significant digits."""
    return Quantity(float(f"{depth:.3g}"), "m")


@rule
def feet_without_contact(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find floating robots whose feet cannot touch the ground, while other shapes can.

    A foot is a body with "foot" or "feet" in the name of the body, a geom or a site. Without such a
    name, a foot is the end of a leg. At least two feet are required.
    """
    model = robot.mj_model
    if model is None or robot.refusal is not None or robot.file.missing_collision_meshes:
        return
    ground = ground_geom(model)
    touching = [
        geom
        for geom in range(model.ngeom)
        if _has_free_root(model, geom) and may_touch(model, geom, ground)
    ]
    feet = _list_foot_bodies(robot, model)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ends = [_is_end_touching(model, data, body, touching) for body in feet]
    if len(feet) >= MIN_UNTOUCHED_FEET and touching and not any(ends):
        message = diagnose(
            "feet-without-contact",
            feet=[robot.body_names[body] for body in feet],
            touching=robot.body_names[int(model.geom_bodyid[touching[0]])],
        )
        yield CheckFinding("body", robot.body_names[feet[0]], message, "geom")


MAX_FOOT_GAP = 0.005
"""Largest distance between the end of a foot and the end of the shapes of its body that can touch
the ground [m]. With a larger distance, the foot itself has no contact. Chosen, not tuned.
"""


def _is_end_touching(
    model: mujoco.MjModel, data: mujoco.MjData, body: int, touching: Sequence[int]
) -> bool:
    """Return True if a geom of ``touching`` is at the end of a foot.

    The end is evaluated in the direction from the joint to a geom with a foot in its name, if
    possible.
    """
    weld = model.body_weldid[model.geom_bodyid]
    own = np.flatnonzero(weld == body).tolist()
    named = [geom for geom in own if _FOOT_NAME.search(model.geom(geom).name)]
    able = [geom for geom in own if geom in touching]
    if not named or not able or not model.body_jntnum[body]:
        return bool(able)
    down = data.geom_xpos[named[0]] - data.xanchor[int(model.body_jntadr[body])]
    down /= max(float(np.linalg.norm(down)), 1e-12)
    ends = []
    for geoms in (named, able):
        points = [read_shape(model, geom, data).support(down[None]) for geom in geoms]
        ends.append(max((float(point[0]) for point in points if point is not None), default=0.0))
    return ends[1] >= ends[0] - MAX_FOOT_GAP


MIN_UNTOUCHED_FEET = 2
"""Smallest number of feet that must be unable to touch the ground for `feet_without_contact`. A
single foot without contact is a difference between left and right. Chosen, not tuned."""


def _list_foot_bodies(robot: MjcfModel, model: mujoco.MjModel) -> list[int]:
    """Return the ids of the moving bodies that carry feet, see `feet_without_contact`."""
    weld = model.body_weldid
    names: dict[int, str] = {}
    for body in range(1, model.nbody):
        names[int(weld[body])] = f"{names.get(int(weld[body]), '')} {robot.body_names[body]}"
    for geom in range(model.ngeom):
        body = int(weld[model.geom_bodyid[geom]])
        names[body] = f"{names.get(body, '')} {model.geom(geom).name}"
    for site in range(model.nsite):
        body = int(weld[model.site_bodyid[site]])
        names[body] = f"{names.get(body, '')} {model.site(site).name}"
    drawn = {int(weld[model.geom_bodyid[geom]]) for geom in range(model.ngeom)}
    named = [body for body, text in names.items() if body in drawn and _FOOT_NAME.search(text)]
    named = [body for body in named if body]
    if named:
        return named
    parents = {int(weld[model.body_parentid[b]]) for b in range(1, model.nbody) if weld[b] == b}
    ends = [body for body in range(1, model.nbody) if weld[body] == body and body not in parents]
    return [body for body in ends if body in drawn and _has_leg_joint(model, body)]


_FOOT_NAME = re.compile(r"foot|feet", re.IGNORECASE)
"""Regular expression that finds a foot in the name of a body, a geom or a site."""


def _has_leg_joint(model: mujoco.MjModel, body: int) -> bool:
    """Return True if a joint between the world and a body has the name of a leg joint."""
    while body:
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            if LEG_JOINT_NAME.search(model.joint(joint).name):
                return True
        body = int(model.body_parentid[body])
    return False


@rule
def ground_not_met(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find floating robots of which no shape can touch the ground, or whose contacts are disabled.

    In a file without ground, a plane with MuJoCo's default contact bits is assumed. Models with
    contact pairs, for example, are skipped.
    """
    model = robot.mj_model
    if (
        model is None
        or not (model.jnt_type == FREE_JOINT_TYPE).any()
        or model.npair
        or robot.file.missing_collision_meshes
    ):
        return
    ground = ground_geom(model)
    free = [geom for geom in range(model.ngeom) if _has_free_root(model, geom)]
    off = bool(model.opt.disableflags & _CONTACTS_OFF_FLAGS)
    if off or not any(may_touch(model, geom, ground) for geom in free):
        name = None if off or ground is None else model.geom(ground).name or "ground"
        scene = ground is None and not off
        message = diagnose("ground-not-met", ground=name, off=off, scene=scene)
        yield CheckFinding("body", robot.base, message)


_CONTACTS_OFF_FLAGS = (
    mujoco.mjtDisableBit.mjDSBL_CONTACT.value | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
)
"""Bits of ``disableflags`` that disable contacts."""


FREE_JOINT_TYPE = mujoco.mjtJoint.mjJNT_FREE.value
"""MuJoCo's joint type of a free joint, compared with ``MjModel.jnt_type``."""


def _has_free_root(model: mujoco.MjModel, geom: int) -> bool:
    """Return True if the tree of a geom begins with a free joint."""
    joint = model.body_jntadr[model.body_rootid[model.geom_bodyid[geom]]]
    return bool(joint >= 0 and model.jnt_type[joint] == FREE_JOINT_TYPE)


def _list_colliding_geoms(model: mujoco.MjModel) -> Iterator[int]:
    """Yield the geoms of moving bodies with contype or conaffinity."""
    for geom in range(model.ngeom):
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if collides and model.body_weldid[model.geom_bodyid[geom]]:
            yield geom


# Rules about defaults that engines assume for missing values.


@rule
def link_without_inertial(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find links without <inertial>, except ``world``: PyBullet assigns 1 kg to each.

    A single finding lists the links.
    """
    first, *others = [
        link.name for link in robot.links.values() if link.inertial is None and link.name != "world"
    ] or [""]
    if first:
        message = diagnose(
            "link-without-inertial",
            others=others,
            weighs=Quantity(robot.total_mass + 1 + len(others), "kg"),
            mass=Quantity(robot.total_mass, "kg"),
        )
        yield CheckFinding("link", first, message)


@rule
def massless_link_collides(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find links with zero or missing mass that have collision shapes, as a single finding."""
    first, *others = [
        link.name
        for link in robot.links.values()
        if link.mass == 0 and any(shape.collides for shape in link.shapes)
    ] or [""]
    if first:
        yield CheckFinding(
            "link", first, diagnose("massless-link-collides", others=others), "collision"
        )
