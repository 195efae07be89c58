"""A base that is free in the world by slides and hinges, or slides and a ball: one free joint."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.attributes import PASSIVE
from pupper_analysis.models.mjcf import JointKind, compile_spec

Array = NDArray[np.float64]


_LEAST_VOLUME: Final = 0.1
"""Least volume that three axes span: those of coordinates span 1, and 0 are none."""

_LOSSES: Final = tuple(one.mjcf[0] for one in PASSIVE if one.mujoco)


def join_free_base(
    spec: mujoco.MjSpec, source: Path, *, stated: Collection[str] = ()
) -> Diagnostic | None:
    """Gives a base that is free in parts a free joint instead, in place.

    Models after OpenSim, and some exporters, free a base by three slides and three hinges (or a
    ball). All programs here know one free base; which joints make it is a convention. Keyframes
    have the same pose afterwards.

    Args:
        spec: The MJCF.
        source: Where it came from, for messages.
        stated: Joints that the URDF has, too: if these are among them, they stay.

    Returns:
        What was done; None if there is no such base.
    """
    base = _free_in_parts(spec, stated)
    if base is None:
        return None
    joints = list(base.joints)
    ball = joints[-1].type == JointKind.BALL
    lossy = [word for word in _LOSSES if any(np.any(getattr(j, word)) for j in joints)]
    poses = _poses(compile_spec(spec.copy(), source), base.name, len(joints))
    for joint in joints:
        delete_joint(spec, joint)
    base.add_freejoint()
    for key, qpos in zip(spec.keys, poses, strict=True):
        key.qpos, key.qvel = qpos, []
    return diagnose("base-joints-joined", subject=("body", base.name), ball=ball, losses=lossy)


def delete_joint(spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> None:
    """Deletes a joint with all that refers to it."""
    name = joint.name
    for actuator in list(spec.actuators):
        if actuator.target == name:
            _delete_sensors(spec, actuator.name)
            spec.delete(actuator)
    for equality in list(spec.equalities):
        # A connect or weld names bodies, which may be called like joints.
        joints = equality.type == mujoco.mjtEq.mjEQ_JOINT
        if joints and name in (equality.name1, equality.name2):
            spec.delete(equality)
    _delete_sensors(spec, name)
    spec.delete(joint)


def _delete_sensors(spec: mujoco.MjSpec, name: str) -> None:
    for sensor in list(spec.sensors):
        if name and name in (sensor.objname, sensor.refname):
            spec.delete(sensor)


def _free_in_parts(spec: mujoco.MjSpec, stated: Collection[str]) -> mujoco.MjsBody | None:
    """Returns the base of the largest robot if its joints leave it free, and nothing drives it."""
    joint_count = mujoco.mjtObj.mjOBJ_JOINT
    bodies = list(spec.worldbody.bodies)
    base = max(bodies, key=lambda body: len(body.find_all(joint_count)), default=None)
    if base is None:
        return None
    joints = list(base.joints)
    kinds = [joint.type for joint in joints]
    slides = [JointKind.SLIDE] * 3
    if kinds not in ([*slides, JointKind.BALL], [*slides, *[JointKind.HINGE] * 3]):
        return None
    names = {joint.name for joint in joints}
    driven = {actuator.target for actuator in spec.actuators}
    if names & (driven | set(stated)) - {""} or any(np.any(j.stiffness) for j in joints):
        return None
    if len(base.find_all(joint_count)) == len(joints):  # a thing, and no robot
        return None
    if any(abs(np.linalg.det(axes)) < _LEAST_VOLUME for axes in _axes(joints)):
        return None
    return base


def _axes(joints: Sequence[mujoco.MjsJoint]) -> list[Array]:
    """Returns the axes of the slides, and of the hinges, as rows of unit vectors."""
    found = []
    for kind in (JointKind.SLIDE, JointKind.HINGE):
        axes = np.array([joint.axis for joint in joints if joint.type == kind])
        if len(axes):
            found.append(axes / np.linalg.norm(axes, axis=1, keepdims=True))
    return found


def _poses(model: mujoco.MjModel, base: str, count: int) -> list[list[float]]:
    """Returns the keyframes' positions with the base's pose in the place of its joints'."""
    data = mujoco.MjData(model)
    body = model.body(base)
    first = int(body.jntadr[0])
    start = int(model.jnt_qposadr[first])
    last = first + count - 1
    end = int(model.jnt_qposadr[last]) + (4 if model.jnt_type[last] == JointKind.BALL else 1)
    found = []
    for number in range(model.nkey):
        mujoco.mj_resetDataKeyframe(model, data, number)
        mujoco.mj_kinematics(model, data)
        pose = [*data.xpos[body.id].tolist(), *data.xquat[body.id].tolist()]
        qpos = data.qpos.tolist()
        found.append([*qpos[:start], *pose, *qpos[end:]])
    return found
