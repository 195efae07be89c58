"""Efforts that nobody meant, and a robot whose motors give what is asked about in their place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.models.attributes import BY_KIND
from pupper_analysis.models.efforts import EffortLimit, EffortStatement, Motor, placeholder_efforts
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.robot import Robot


@check_arguments
def with_efforts(robot: Robot, efforts: Mapping[str, float]) -> Robot:
    """Returns the robot with other limits of its motors, said in its notes.

    For files with placeholders. They bound what is computed and what is simulated of the robot; its
    file as it was published is simulated with its own.

    Args:
        robot: The robot.
        efforts: {joint: what its motor can give either way, at the joint (N m; N of a slide)}.

    Returns:
        The robot; itself, if nothing is asked.

    Raises:
        UnknownNameError: If it has no such joint.
        ConfigurationError: If one is not positive and finite.
    """
    for name, effort in efforts.items():
        if name not in robot.joint_names:
            raise UnknownNameError(robot.name, "joint", name, robot.joint_names)
        if isinstance(effort, bool) or not 0 < effort < math.inf:
            problem = diagnose("effort-not-valid", joint=name, effort=effort)
            raise ConfigurationError("effort", problem)
    if not efforts:
        return robot
    urdf, mjcf = robot.description.trees()
    stated, told = dict(robot.description.efforts), []
    before = {limit.joint: limit for limit in robot.efforts}
    for name, effort in efforts.items():
        urdf.joints[name].state(BY_KIND["effort"], effort)
        mjcf.limit_effort(name, effort)
        range_ = (-effort, effort)
        origin = EffortStatement.of("", "joint", name, "effort", range_)
        stated[name] = EffortLimit(name, *range_, origin, (origin,))
        own = before[name].least
        told.append(
            diagnose(
                "effort-in-place-of",
                subject=("joint", name),
                effort=Quantity(effort, "N m"),
                own=Quantity(own, "N m") if own < math.inf else None,
            )
        )
    built = rebuild_robot(robot, urdf=to_text(urdf.root), mjcf=mjcf.spec, efforts=stated)
    return replace(built, notes=(*robot.notes, diagnose("efforts-as-asked", joints=told)))


def efforts_nobody_meant(robot: Robot) -> tuple[Diagnostic, ...]:
    """Tells whether a verdict rests on efforts that look like placeholders; not on asked ones."""
    stated = {
        limit.joint: max(-limit.lower, limit.upper)
        for limit in robot.efforts
        if limit.origin is None or limit.origin.file
    }
    joints = list(placeholders_among(robot, stated))
    if not joints:
        return ()
    return (diagnose("rests-on-placeholder-efforts", joints=joints, count=len(joints)),)


def placeholders_among(robot: Robot, efforts: Mapping[str, float]) -> dict[str, Diagnostic]:
    """Returns which efforts look like placeholders, and why; see ``placeholder_efforts``.

    Args:
        robot: The robot, whose masses and armatures they are held against.
        efforts: {joint: effort (N m)}; those of slides are left out.
    """
    model = robot.mj_model
    weights, motors = np.bincount(model.body_weldid, model.body_mass, model.nbody), []
    for name, effort in efforts.items():
        joint = model.joint(name).id
        if model.jnt_type[joint] != JointKind.HINGE:
            continue
        link = int(model.body_weldid[model.jnt_bodyid[joint]])
        carrier = int(model.body_weldid[model.body_parentid[link]])
        mass = float(weights[link] + weights[carrier])
        motors.append(Motor(name, effort, mass, float(model.dof_armature[model.jnt_dofadr[joint]])))
    found = placeholder_efforts(motors, robot.total_mass)
    return {joint: why for joints, why in found for joint in joints}
