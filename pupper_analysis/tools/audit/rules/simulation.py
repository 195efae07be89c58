"""Rules about how MuJoCo simulates a model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import (
    Quantity,
    Severity,
    Vector,
    diagnose,
)
from pupper_analysis.models.readers import Found
from pupper_analysis.models.stated.geometry import solid_of
from pupper_analysis.models.stated.model import MjcfModel, Shape, UrdfModel
from pupper_analysis.robot.contact import combine_geoms, ground_geom
from pupper_analysis.robot.stability import servo_stability
from pupper_analysis.tools.audit.registry import rule
from pupper_analysis.tools.audit.rules.actuators import drives
from pupper_analysis.tools.audit.rules.files import first_place

STANDARD_GRAVITY = 9.80665
"""m/s^2; what is used differs by the third digit."""


@rule
def gravity_unusual(robot: MjcfModel) -> Iterator[Found]:
    """Finds a gravity off by more than 0.02 m/s^2 in any direction; NOTE unless it points up."""
    gravity = np.array(robot.file.spec.option.gravity)
    if np.linalg.norm(gravity - (0.0, 0.0, -STANDARD_GRAVITY)) > 0.02:
        place = first_place(robot.file, "option", "gravity")
        told = diagnose("gravity-unusual", gravity=Vector(tuple(gravity), "m/s^2"))
        severity = None if gravity[2] > 0 else Severity.NOTE
        yield Found("option", "", told, place=place, severity=severity)


@rule
def armature_zero(robot: MjcfModel) -> Iterator[Found]:
    """Finds models in which the armature of every driven joint, and of its motor, is 0."""
    if robot.mj_model is None:
        return
    model = robot.mj_model
    driven = list(drives(model))
    armature = [
        model.dof_armature[model.jnt_dofadr[drive.joint]] + model.actuator_armature[drive.id]
        for drive in driven
    ]
    if driven and not any(armature):
        told = diagnose("armature-zero", joints=len(driven))
        yield Found("joint", driven[0].joint_name, told)


@rule
def servo_unstable(robot: MjcfModel) -> Iterator[Found]:
    """Tests the stability of all servos together at qpos0; see ``servo_stability``."""
    model = robot.mj_model
    if model is None or model.opt.integrator != mujoco.mjtIntegrator.mjINT_EULER.value:
        return
    used = [drive for drive in drives(model) if drive.damping > 0 or drive.stiffness > 0]
    if not used:
        return
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    stiffness, damping = np.zeros(model.nv), np.zeros(model.nv)
    implicit = np.array(model.dof_damping)
    for drive in used:
        dof = model.jnt_dofadr[drive.joint]
        stiffness[dof] += drive.gear**2 * max(drive.stiffness, 0.0)
        damping[dof] += drive.gear**2 * max(drive.damping, 0.0)
        implicit[dof] += drive.gear**2 * model.actuator_damping[drive.id]
    found = servo_stability(model, data, stiffness, damping, implicit)
    if found is not None and found.ratio > 1:
        drive = max(used, key=lambda drive: float(found.shares[model.jnt_dofadr[drive.joint]]))
        told = diagnose(
            "servo-unstable",
            kp=Quantity(drive.gain, "N m/rad"),
            kd=Quantity(drive.damping, "N m s/rad"),
            step=Quantity(model.opt.timestep, "s"),
            times=found.ratio,
        )
        yield Found("actuator", drive.name, told)


@rule
def foot_frictionless(robot: MjcfModel) -> Iterator[Found]:
    """Finds feet whose contact with the ground, as MuJoCo combines it, has no sliding friction.

    A file without ground is to be put into a scene: there, condim 1 of the foot gives way to the
    ground's 3, so that the friction alone counts.
    """
    model = robot.mj_model
    if model is None:
        return
    ground = ground_geom(model)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        name = model.geom(geom).name
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        at_site = any(
            "foot" in model.site(site).name.lower()
            and np.linalg.norm(model.site_pos[site] - model.geom_pos[geom]) < 1e-3
            for site in range(model.nsite)
            if model.site_bodyid[site] == body
        )
        called = "foot" in name.lower() or "foot" in robot.body_names[body].lower()
        if not collides or not body or not (called or at_site):
            continue
        contact = combine_geoms(model, geom, geom if ground is None else ground)
        friction = contact.friction[0] if ground is None else contact.sliding_friction
        if friction < 1e-3:
            told = diagnose(
                "foot-frictionless", condim=contact.condim, friction=contact.friction[0]
            )
            if name:
                yield Found("geom", name, told)
            else:
                yield Found("body", robot.body_names[body], told, "geom")


# Rules about what each engine makes of what a file does not say.

WATER = 1000.0
"""The density that PhysX gives a shape of which none is known (kg/m^3)."""


@rule
def link_without_inertial(robot: UrdfModel) -> Iterator[Found]:
    """Finds links without <inertial>, but for ``world``, which PyBullet leaves without mass."""
    links = [
        body for body in robot.links.values() if body.inertial is None and body.name != "world"
    ]
    if not links:
        return
    told = diagnose(
        "link-without-inertial",
        others=[link.name for link in links[1:]],
        weighs=Quantity(robot.total_mass + len(links), "kg"),
        mass=Quantity(robot.total_mass, "kg"),
    )
    yield Found("link", links[0].name, told)


@rule
def massless_link_collides(robot: UrdfModel) -> Iterator[Found]:
    """Finds links without mass, stated or not, that have shapes for contacts."""
    links = {
        body: [shape for shape in body.shapes if shape.collides]
        for body in robot.links.values()
        if body.mass == 0
    }
    links = {body: shapes for body, shapes in links.items() if shapes}
    if not links:
        return
    masses = [_water(shapes) for shapes in links.values()]
    known = [mass for mass in masses if mass is not None]
    first, *others = (link.name for link in links)
    told = diagnose(
        "massless-link-collides",
        others=others,
        water=Quantity(sum(known), "kg") if len(known) == len(masses) else None,
        mass=Quantity(robot.total_mass, "kg"),
    )
    yield Found("link", first, told, "collision")


def _water(shapes: Sequence[Shape]) -> float | None:
    """Returns the mass of shapes full of water (kg); None if one is a mesh."""
    solids = [solid_of(shape.kind, shape.size) for shape in shapes]
    known = [solid.volume for solid in solids if solid is not None]
    return WATER * sum(known) if len(known) == len(solids) else None
