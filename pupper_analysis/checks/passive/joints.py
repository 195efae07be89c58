"""What acts at joints and bodies: springs, damping in powers of the speed, gravity compensation."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco

from pupper_analysis.checks.passive.extra import Extra
from pupper_analysis.checks.passive.scene import DISABLE, Scene, numbers_in_words


def springs(scene: Scene) -> Iterator[Extra]:
    """Yields the springs of the robot's joints."""
    model = scene.model
    for joint in scene.reference.joints() if not scene.off(DISABLE.mjDSBL_SPRING) else ():
        linear, higher = float(model.jnt_stiffness[joint]), model.jnt_stiffnesspoly[joint]
        if not (linear or higher.any()):
            continue
        force, length = scene.unit(joint)
        name = scene.joint_name(joint)
        value: dict[str, object] = {"stiffness": linear}
        text = f"stiffness {linear:.6g} {force}/{length}"
        if higher.any():
            value["polynomial"] = [float(each) for each in higher]
            text += f" and {numbers_in_words(higher)} in the next powers"
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE.value:
            text += " in all six directions"
        else:
            rest = float(model.qpos_spring[model.jnt_qposadr[joint]])
            value["rest"] = rest
            text += f", at rest at {rest:.6g} {length}"
        if model.jnt_springyield[joint]:
            value["yield"] = float(model.jnt_springyield[joint])
            text += f", yielding at {value['yield']:.6g}"
        yield Extra(
            "spring",
            name,
            value,
            f"{force}/{length}",
            f"joint {name}: no spring in the URDF, one of {text} in the MJCF",
            (("jnt_stiffness", joint), ("jnt_stiffnesspoly", joint)),
        )


def damping_polynomials(scene: Scene) -> Iterator[Extra]:
    """Yields damping in higher powers of a joint's speed."""
    model = scene.model
    for joint in scene.reference.joints() if not scene.off(DISABLE.mjDSBL_DAMPER) else ():
        first = int(model.jnt_dofadr[joint])
        free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE.value
        dofs = slice(first, first + (6 if free else 1))
        if model.dof_dampingpoly[dofs].any():
            values = [float(each) for each in model.dof_dampingpoly[first]]
            name = scene.joint_name(joint)
            text = (
                f"joint {name}: linear damping in the URDF, and {numbers_in_words(values)} in the "
                "next powers of the speed in the MJCF"
            )
            slots = (("dof_dampingpoly", dofs),)
            yield Extra("damping polynomial", name, values, "", text, slots)


def gravity_compensation(scene: Scene) -> Iterator[Extra]:
    """Yields the bodies whose weight is (partly) carried by nothing."""
    model = scene.model
    for body in sorted(scene.bodies):
        share = float(model.body_gravcomp[body])
        if share and model.body_mass[body] and model.body_weldid[body]:
            name = scene.name("body", body)
            text = (
                f"body {name}: no gravity compensation in the URDF, of {100 * share:.6g} % of "
                "its weight in the MJCF"
            )
            slots = (("body_gravcomp", body),)
            yield Extra("gravity compensation", name, share, "", text, slots)


def free_joint_friction(scene: Scene) -> Iterator[Extra]:
    """Yields dry friction of the robot's free joint, which a default class may give it."""
    model = scene.model
    for joint in scene.reference.joints() if not scene.off(DISABLE.mjDSBL_FRICTIONLOSS) else ():
        value = float(model.dof_frictionloss[model.jnt_dofadr[joint]])
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE.value and value:
            name = scene.joint_name(joint)
            text = (
                f"free joint of {name}: no dry friction in the URDF, of {value:.6g} N and N m in "
                "the MJCF (a default class reaches it; use <freejoint/>)"
            )
            yield Extra("dry friction", name, value, "", text)
