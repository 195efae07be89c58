"""What acts at joints and bodies: springs, damping in powers of the speed, gravity compensation."""

from __future__ import annotations

from collections.abc import Iterator

from pupper_analysis.base.diagnostics import Quantity, Vector, diagnose
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.robot.compare.mjcf_only.effect import DISABLE, MjcfOnlyEffect, NamedModel


def find_springs(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields the springs of the robot's joints."""
    model = scene.model
    for joint in scene.reference.joints() if not scene.off(DISABLE.mjDSBL_SPRING) else ():
        linear, higher = float(model.jnt_stiffness[joint]), model.jnt_stiffnesspoly[joint]
        if not (linear or higher.any()):
            continue
        force, length = scene.unit(joint)
        name = scene.joint_name(joint)
        value: dict[str, object] = {"stiffness": linear}
        free = model.jnt_type[joint] == JointKind.FREE
        if higher.any():
            value["polynomial"] = [float(each) for each in higher]
        if not free:
            value["rest"] = float(model.qpos_spring[model.jnt_qposadr[joint]])
        if model.jnt_springyield[joint]:
            value["yield"] = float(model.jnt_springyield[joint])
        told = diagnose(
            "spring-of-the-mjcf-alone",
            subject=("joint", name),
            stiffness=Quantity(linear, f"{force}/{length}"),
            higher=Vector(tuple(higher.tolist()), "1") if higher.any() else None,
            rest=None if free else Quantity(value["rest"], length),  # type: ignore[arg-type]
            free=free,
            yielding=value.get("yield"),
        )
        yield MjcfOnlyEffect(
            "spring",
            name,
            value,
            f"{force}/{length}",
            told,
            (("jnt_stiffness", joint), ("jnt_stiffnesspoly", joint)),
        )


def find_damping_polynomials(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields damping in higher powers of a joint's speed."""
    model = scene.model
    for joint in scene.reference.joints() if not scene.off(DISABLE.mjDSBL_DAMPER) else ():
        first = int(model.jnt_dofadr[joint])
        free = model.jnt_type[joint] == JointKind.FREE
        dofs = slice(first, first + (6 if free else 1))
        if model.dof_dampingpoly[dofs].any():
            values = [float(each) for each in model.dof_dampingpoly[first]]
            name = scene.joint_name(joint)
            powers = Vector(tuple(values), "1")
            told = diagnose("damping-in-higher-powers", subject=("joint", name), powers=powers)
            slots = (("dof_dampingpoly", dofs),)
            yield MjcfOnlyEffect("damping polynomial", name, values, "", told, slots)


def find_gravity_compensation(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields the bodies whose weight is (partly) carried by nothing."""
    model = scene.model
    for body in sorted(scene.bodies):
        share = float(model.body_gravcomp[body])
        if share and model.body_mass[body] and model.body_weldid[body]:
            name = scene.name("body", body)
            told = diagnose(
                "gravity-compensation-of-the-mjcf-alone",
                subject=("body", name),
                share=Quantity(share, "1"),
            )
            slots = (("body_gravcomp", body),)
            yield MjcfOnlyEffect("gravity compensation", name, share, "", told, slots)


def free_joint_friction(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields dry friction of the robot's free joint, which a default class may give it."""
    model = scene.model
    for joint in scene.reference.joints() if not scene.off(DISABLE.mjDSBL_FRICTIONLOSS) else ():
        value = float(model.dof_frictionloss[model.jnt_dofadr[joint]])
        if model.jnt_type[joint] == JointKind.FREE and value:
            name = scene.joint_name(joint)
            friction = Quantity(value, "N and N m")
            told = diagnose("free-joint-friction", subject=("body", name), friction=friction)
            yield MjcfOnlyEffect("dry friction", name, value, "", told)
