"""Frees the base of a robot that its MJCF holds in the world."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arrays import (
    make_placement,
    rotation_from_quaternion,
)
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.mjcf import JointKind, compile_spec, free_joints, has_free_joint
from pupper_analysis.models.spec_tree import join_free_base
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare.contact_points import compute_lowest_height
from pupper_analysis.robot.contact import limb_ends
from pupper_analysis.robot.matching.match import limbs_on_the_world

Array = NDArray[np.float64]

_AT_THE_GROUND = 1e-6
"""By how much a limb's lowest point may be below a base's frame that is on the ground with it (m):
what a wheel's height and radius are rounded to."""

_TILTED = 0.7
"""Cosine of how far from level a base's frame has to be where a file has it, to be told: 45 deg."""


def free_base(
    urdf: UrdfFile, spec: mujoco.MjSpec, source: Path
) -> tuple[mujoco.MjSpec, list[Diagnostic]]:
    """Returns a spec in which the base of a robot with two limbs or more is free; what was done.

    Args:
        urdf: The URDF.
        spec: The MJCF's; it is changed.
        source: Its file.

    Raises:
        ModelError: If it has limbs and no base: MuJoCo fuses the root link of a URDF with the
            world, where its mass is lost.
    """
    stated = set(urdf.tree.joints)
    if has_free_joint(spec):
        return spec, []
    joined = join_free_base(spec, stated=stated)
    if joined is not None:
        return spec, [joined]
    if len(limbs_on_the_world(spec, urdf.root)) >= 2:
        raise ModelError(source, diagnose("limbs-on-the-world"))
    bodies = list(spec.worldbody.bodies)
    size = {body.name: len(body.find_all(mujoco.mjtObj.mjOBJ_JOINT)) for body in bodies}
    base = max(bodies, key=lambda body: size[body.name], default=None)
    if base is None or list(base.joints):
        return spec, []
    if len(list(_limbs(base))) < 2:
        return spec, []
    base.add_freejoint()
    return spec, [diagnose("free-joint-added", subject=("body", base.name))]


def _limbs(base: mujoco.MjsBody) -> Iterator[mujoco.MjsBody]:
    """Yields the bodies that joints attach to a base, or to what is fixed to it."""
    for body in base.bodies:
        if list(body.joints):
            yield body
        else:
            yield from _limbs(body)


def remove_free_joint_friction(spec: mujoco.MjSpec) -> list[Diagnostic]:
    """Takes dry friction off an MJCF's free joints, in place: it would hold what falls."""
    notes = []
    for joint in spec.joints:
        if joint.type == JointKind.FREE and joint.frictionloss:
            notes.append(diagnose("free-joint-friction-taken-off", friction=joint.frictionloss))
            joint.frictionloss = 0.0
    return notes


def place_base_frame(spec: mujoco.MjSpec, file: mujoco.MjModel, source: Path) -> list[Diagnostic]:
    """Raises the frame of a free base to the height of its com where no limb ends below it.

    Roll, pitch and height are of a base's frame with z up: that the file's first keyframe
    (``home``) has it more than 45 deg from level is told. The URDF's frame follows, as it does
    where files have it in other places.

    Args:
        spec: The MJCF's, in which all bodies have names; it is changed.
        file: What MuJoCo compiles its file to: the same, unless the base has been freed.
        source: The file.

    Returns:
        What was done.

    Raises:
        ModelError: If MuJoCo refuses the spec.
    """
    base = next((joint.parent for joint in spec.joints if joint.type == JointKind.FREE), None)
    if base is None or base.frame is not None:
        return []  # what is in a frame has its place in that
    body = mujoco.mj_name2id(file, mujoco.mjtObj.mjOBJ_BODY, base.name)
    if body >= 0 and body in file.jnt_bodyid[free_joints(file)]:
        model = file
    else:
        whole = spec.copy()
        whole.compiler.discardvisual = False  # a limb may end in what is only seen
        model = compile_spec(whole, source)
        body = model.body(base.name).id
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turn, place = data.xmat[body].reshape(3, 3), int(model.jnt_qposadr[model.body_jntadr[body]])
    keys = sorted(range(model.nkey), key=lambda key: model.key(key).name != "home")
    # Of a file without keyframes it is where the bodies are written.
    begun = (
        rotation_from_quaternion(model.key_qpos[keys[0], place + 3 : place + 7]) if keys else turn
    )
    if begun[2, 2] < _TILTED:
        tilt, subject = Quantity(float(np.arccos(begun[2, 2])), "rad"), ("body", base.name)
        return [diagnose("base-frame-tilted", subject=subject, tilt=tilt)]
    ends = [end for end in limb_ends(model) if end != body]
    below = np.isin(model.body_weldid[model.geom_bodyid], ends)
    touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    for some in (below & touching, below):  # of what is only seen each vertex is looked at
        bottom = compute_lowest_height(model, data, np.flatnonzero(some).tolist())
        if data.xpos[body][2] > bottom + _AT_THE_GROUND:
            return []
    fixed = model.body_weldid == model.body_weldid[body]  # a root may weigh nothing itself
    com = model.body_mass[fixed] @ data.xipos[fixed] / model.body_mass[fixed].sum()
    up = float(com[2] - data.xpos[body][2])
    reach = float(np.linalg.norm(data.xpos[ends] - com, axis=1).max(initial=0.0))
    hangs = bottom < com[2] - min(up, reach) / 2
    if not hangs or turn[2, 2] < 1 - 1e-9:
        return []
    _raise_frame(spec, base, place, up, model)
    return [diagnose("base-frame-lifted", subject=("body", base.name), height=Quantity(up, "m"))]


def _raise_frame(
    spec: mujoco.MjSpec, base: mujoco.MjsBody, place: int, up: float, model: mujoco.MjModel
) -> None:
    """Raises a free base's level frame, and nothing else.

    Args:
        spec: The base's, with its keyframes; it is changed.
        base: The base.
        place: Of its free joint in ``qpos``.
        up: By how much, along its z axis (m).
        model: What MuJoCo compiles of it.
    """
    there = np.array([0.0, 0.0, up])
    own = (*base.geoms, *base.sites, *base.cameras, *base.lights, *base.bodies, *base.frames)
    frame = base.add_frame(pos=-there)
    for element in own:
        if element.frame is None:
            element.set_frame(frame)
    if base.explicitinertial:
        base.ipos = base.ipos - there
    start = model.body(base.name)
    base.pos = make_placement(start.quat, start.pos).act(there)
    for key in spec.keys:
        qpos = np.array(key.qpos)
        if len(qpos) >= place + 7:
            quaternion = qpos[place + 3 : place + 7].copy()
            mujoco.mju_normalize4(quaternion)  # of zeros it makes none, as its compiler
            qpos[place : place + 3] = make_placement(quaternion, qpos[place : place + 3]).act(there)
            key.qpos = qpos
