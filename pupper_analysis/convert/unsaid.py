"""What an MJCF has and no URDF can say, in words."""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.models.transmission import is_at_one_joint

_NAMED = 3
"""Names in a row that are listed."""

_GRAVITY = (0.0, 0.0, -9.81)
"""That of Pinocchio, and whoever else loads a URDF (m/s^2)."""

_FREE = mujoco.mjtJoint.mjJNT_FREE.value


def others(model: mujoco.MjModel) -> list[str]:
    """Says what else a URDF cannot say."""
    moving = model.jnt_type != _FREE
    dofs = model.jnt_dofadr[moving]
    some = []
    if model.dof_armature[dofs].any():
        low, high = (float(f(model.dof_armature[dofs])) for f in (np.min, np.max))
        some.append(f"armature ({low:g} to {high:g} kg m^2): crosscheck takes it from the MJCF")
    fixed = np.setdiff1d(np.arange(model.nv), dofs)
    for values, what, unit in (
        (model.dof_damping, "damping", "N s/m"),
        (model.dof_frictionloss, "friction", "N"),
        (model.dof_armature, "armature", "kg"),
    ):
        if values[fixed].any():
            some.append(f"{what} of the free joint ({float(values[fixed].max()):g} {unit})")
    if model.jnt_stiffness[moving].any():
        some.append(f"springs of {int((model.jnt_stiffness[moving] != 0).sum())} joints")
    if model.body_gravcomp.any():
        some.append(f"gravity compensation of {int((model.body_gravcomp != 0).sum())} bodies")
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
            some.append(f"{what}: {count}")
    affine = mujoco.mjtBias.mjBIAS_AFFINE.value
    servos = int((model.actuator_biastype == affine).sum())
    if servos:
        some.append(f"the gains of {servos} servos; their joints have transmissions")
    return some


def surroundings(model: mujoco.MjModel, robot: set[int]) -> list[str]:
    """Says what is around the robot, and on it, that no URDF has.

    Args:
        model: The model.
        robot: The bodies that are links.
    """
    others = [body for body in range(1, model.nbody) if body not in robot]
    away = [*others] if 0 in robot else [0, *others]
    some = []
    if others:
        names = [model.body(body).name or f"{body}" for body in others]
        shown = ", ".join(map(repr, names[:_NAMED])) + (", ..." if len(names) > _NAMED else "")
        some.append(f"{len(others)} bodies that the robot does not carry: {shown}")
    for count, what in (
        (int(np.isin(model.geom_bodyid, away).sum()), "geoms of the world and of such bodies"),
        (int(np.isin(model.site_bodyid, away).sum()), "sites there"),
        (model.ncam, "cameras"),
        (model.nlight, "lights"),
    ):
        if count:
            some.append(f"{what}: {count}")
    gravity = model.opt.gravity
    if not np.allclose(gravity, _GRAVITY):
        some.append(f"gravity ({', '.join(f'{value:g}' for value in gravity)}) m/s^2")
    if model.opt.density or model.opt.viscosity:
        some.append("the fluid around the robot")
    return some
