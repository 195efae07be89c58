"""Rules about the simulation of a model in MuJoCo, and about defaults of other engines."""

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
from pupper_analysis.models.stated.model import MjcfModel, UrdfModel
from pupper_analysis.robot.contact import combine_geoms, ground_geom
from pupper_analysis.robot.shapes import may_touch
from pupper_analysis.tools.audit.registry import rule
from pupper_analysis.tools.audit.rules.actuators import list_drives
from pupper_analysis.tools.audit.rules.files import find_first_place


@rule
def gravity_unusual(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find a gravity more than 0.02 m/s^2 away from standard gravity.

    Common values differ in the third digit. NOTE if gravity points more down than sideways, since a
    tilted gravity simulates a slope.
    """
    gravity = np.array(robot.file.spec.option.gravity)
    if np.linalg.norm(gravity - (0.0, 0.0, -standard_gravity)) > 0.02:
        place = find_first_place(robot.file, "option", "gravity")
        message = diagnose("gravity-unusual", gravity=Vector(tuple(gravity), "m/s^2"))
        wrong = gravity[2] > 0 or np.hypot(*gravity[:2]) > -gravity[2]
        severity = None if wrong else Severity.NOTE
        yield CheckFinding("option", "", message, place=place, severity=severity)


@rule
def armature_zero(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find models with zero armature at all driven joints and motors."""
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
    """Find feet without sliding friction in the ground contact.

    Contact parameters are combined as in MuJoCo. Without ground in the file, MuJoCo's default
    ground is assumed: condim 1 of the foot is replaced by 3, unless the foot has a higher priority.
    A friction coefficient of 0 is reported nevertheless, as the ground of a scene may have none
    either.
    """
    model = robot.mj_model
    if model is None:
        return
    ground = ground_geom(model)
    for geom in _list_colliding_geoms(model):
        body = int(model.geom_bodyid[geom])
        name = model.geom(geom).name
        at_site = any(
            "foot" in model.site(site).name.lower()
            and np.linalg.norm(model.site_pos[site] - model.geom_pos[geom]) < 1e-3
            for site in range(model.nsite)
            if model.site_bodyid[site] == body
        )
        called = "foot" in name.lower() or "foot" in robot.body_names[body].lower()
        if not (called or at_site):
            continue
        contact = combine_geoms(model, geom, ground)
        friction = contact.friction[0]
        if ground is None:
            friction = min(friction, float(model.geom_friction[geom, 0]))
        if friction < 1e-3 or contact.condim == 1:
            message = diagnose("foot-frictionless", condim=contact.condim, friction=friction)
            if name:
                yield CheckFinding("geom", name, message)
            else:
                yield CheckFinding("body", robot.body_names[body], message, "geom")


@rule
def ground_not_met(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find floating robots without a shape that can touch the ground, or a default ground."""
    model = robot.mj_model
    if (
        model is None
        or not (model.jnt_type == FREE_JOINT).any()
        or model.npair
        or robot.file.lacking
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


FREE_JOINT = mujoco.mjtJoint.mjJNT_FREE.value
"""MuJoCo's joint type of a free joint."""


def _has_free_root(model: mujoco.MjModel, geom: int) -> bool:
    """Return True if the tree of a geom begins with a free joint."""
    joint = model.body_jntadr[model.body_rootid[model.geom_bodyid[geom]]]
    return bool(joint >= 0 and model.jnt_type[joint] == FREE_JOINT)


def _list_colliding_geoms(model: mujoco.MjModel) -> Iterator[int]:
    """Yield the geoms of moving bodies with contype or conaffinity."""
    for geom in range(model.ngeom):
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if collides and model.body_weldid[model.geom_bodyid[geom]]:
            yield geom


# Rules about defaults that engines assume for missing values.


@rule
def link_without_inertial(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find links without <inertial>, except ``world``: PyBullet assigns 1 kg to each."""
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
    """Find links with zero or missing mass that have collision shapes."""
    first, *others = [
        link.name
        for link in robot.links.values()
        if link.mass == 0 and any(shape.collides for shape in link.shapes)
    ] or [""]
    if first:
        yield CheckFinding(
            "link", first, diagnose("massless-link-collides", others=others), "collision"
        )
