"""What an MJCF has and no URDF can say."""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.models.transmission import is_at_one_joint
from pupper_analysis.prepare.notes import describe_span

_GRAVITY = (0.0, 0.0, -9.81)
"""That of Pinocchio, and whoever else loads a URDF (m/s^2)."""


def tell_other_elements(model: mujoco.MjModel) -> list[Diagnostic]:
    """Tells what else a URDF cannot say."""
    moving = model.jnt_type != JointKind.FREE
    dofs = model.jnt_dofadr[moving]
    some: list[Diagnostic] = []
    if model.dof_armature[dofs].any():
        values = describe_span(model.dof_armature[dofs], "kg m^2")
        some.append(diagnose("armature-not-in-urdf", armature=values))
    fixed = np.setdiff1d(np.arange(model.nv), dofs)
    for values, what, unit in (
        (model.dof_damping, "damping", "N s/m"),
        (model.dof_frictionloss, "friction", "N"),
        (model.dof_armature, "armature", "kg"),
    ):
        if values[fixed].any():
            most = Quantity(values[fixed].max(), unit)
            some.append(diagnose("property-of-free-joint", what=Term(what), value=most))
    if model.jnt_stiffness[moving].any():
        count = int((model.jnt_stiffness[moving] != 0).sum())
        some.append(diagnose("springs-not-in-urdf", count=count))
    if model.body_gravcomp.any():
        count = int((model.body_gravcomp != 0).sum())
        some.append(diagnose("gravity-compensation-not-in-urdf", count=count))
    elsewhere = sum(not is_at_one_joint(model, number) for number in range(model.nactuator))
    for count, what in (
        (model.ntendon, "tendons"),
        (model.nkey, "keyframes"),
        (model.nsensor, "sensors"),
        (model.nexclude, "excluded contacts"),
        (model.npair, "pairs of geoms that touch"),
        (elsewhere, "actuators that are not at a joint"),
    ):
        if count:
            some.append(diagnose("not-in-urdf", what=Term(what), count=count))
    affine = mujoco.mjtBias.mjBIAS_AFFINE.value
    servos = int((model.actuator_biastype == affine).sum())
    if servos:
        some.append(diagnose("gains-not-in-urdf", count=servos))
    return some


def tell_surroundings(model: mujoco.MjModel, robot: set[int]) -> list[Diagnostic]:
    """Tells what is around the robot, and on it, that no URDF has.

    Args:
        model: The model.
        robot: The bodies that are links.
    """
    others = [body for body in range(1, model.nbody) if body not in robot]
    away = [*others] if 0 in robot else [0, *others]
    some = []
    if others:
        names = [model.body(body).name or f"{body}" for body in others]
        some.append(diagnose("bodies-not-carried", bodies=names))
    for count, what in (
        (int(np.isin(model.geom_bodyid, away).sum()), "geoms of the world and of such bodies"),
        (int(np.isin(model.site_bodyid, away).sum()), "sites there"),
        (model.ncam, "cameras"),
        (model.nlight, "lights"),
    ):
        if count:
            some.append(diagnose("not-in-urdf", what=Term(what), count=count))
    gravity = model.opt.gravity
    if not np.allclose(gravity, _GRAVITY):
        some.append(diagnose("gravity-not-in-urdf", gravity=gravity))
    if model.opt.density or model.opt.viscosity:
        some.append(diagnose("fluid-not-in-urdf"))
    return some
