"""An MJCF's keyframes: read before its joints are matched, and put back where they are needed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np

from pupper_analysis.base.errors import UnknownNameError
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import JointKind, free_joints, silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile

_LEVEL = 1e-6
"""1 - cosine of the tilt up to which a base is level: 1.4 mrad."""

_CARRIED = 0.01
"""Of the weight: by less than that the ground's force is off where a robot rests; where one was put
by hand it is off by as much as it is."""


def list_keyframes(spec: mujoco.MjSpec) -> dict[str, dict[str, float]]:
    """Returns an MJCF's keyframes, {name: {joint: position}}; those without a name are numbered.

    Args:
        spec: A copy of its spec, in which every joint has a name.
    """
    if not len(spec.keys):
        return {}
    with silence_mujoco():
        model = spec.copy().compile()
    found = {}
    for number in range(model.nkey):
        name = model.key(number).name or f"keyframe {number + 1}"
        found[name] = {
            str(model.joint(joint).name): float(model.key_qpos[number, model.jnt_qposadr[joint]])
            for joint in range(model.njnt)
            if model.jnt_type[joint] != JointKind.FREE
        }
    return found


def resting_depths(model: mujoco.MjModel) -> dict[str, float]:
    """Returns how deep the ground has a robot's feet in keyframes in which it carries the robot.

    With the legs as they are there the feet are below the ground, as they sink in, and the base is
    as high as it is to be. A keyframe in which a robot falls, or is thrown up, was put there by
    hand: its height says nothing.

    Args:
        model: The MJCF's, as it is.

    Returns:
        {keyframe: m}.
    """
    found, free = {}, free_joints(model)
    for key in range(model.nkey) if len(free) == 1 else ():
        if not model.key_ctrl[key].any():
            continue
        data, force = mujoco.MjData(model), np.zeros(6)
        mujoco.mj_resetDataKeyframe(model, data, key)
        mujoco.mj_forward(model, data)
        base = int(model.jnt_bodyid[free[0]])
        carried, depth = 0.0, 0.0
        for number, touch in enumerate(data.contact):
            if 0 in model.geom_bodyid[touch.geom]:
                mujoco.mj_contactForce(model, data, number, force)
                carried += float(force[0])
                depth = max(depth, -float(touch.dist))
        weight = float(model.body_subtreemass[base] * np.linalg.norm(model.opt.gravity))
        level = float(np.abs(data.xmat[base][6:]).max()) > 1 - _LEVEL  # see ``place_base_frame``
        if level and abs(carried - weight) < _CARRIED * weight:
            found[model.key(key).name or f"keyframe {key + 1}"] = depth
    return found


def choose_keyframes(
    mjcf: MjcfFile, known: Mapping[str, Mapping[str, float]], wanted: str | None
) -> dict[str, Mapping[str, float]]:
    """Returns the keyframes to begin with: the one that is wanted, or ``home`` and then the others.

    Raises:
        UnknownNameError: If the MJCF has no such keyframe.
    """
    if wanted is not None:
        if wanted not in known:
            raise UnknownNameError(mjcf.path, "keyframe", wanted, tuple(known))
        return {wanted: known[wanted]}
    return dict(sorted(known.items(), key=lambda item: item[0] != "home"))


def with_keyframes(
    description: Description, known: Mapping[str, Mapping[str, float]]
) -> Description:
    """Returns a robot's files with keyframes, which were lost where the two were matched.

    Args:
        description: Both files, made alike.
        known: {keyframe: {joint: position}}; where they have none, a joint is at its reference.
    """
    if not known:
        return description
    spec = description.mjcf.copy()
    with silence_mujoco():
        model = spec.copy().compile()
    for name, pose in known.items():
        qpos = model.qpos0.copy()
        for joint in range(model.njnt):
            place = model.jnt_qposadr[joint]
            qpos[place] = pose.get(model.joint(joint).name, qpos[place])
        spec.add_key(name=name, qpos=qpos)
    return replace(description, mjcf=spec)
