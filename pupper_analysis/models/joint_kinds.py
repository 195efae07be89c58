"""Kinds of MuJoCo's joints, of a compiled model and of a spec."""

from __future__ import annotations

from enum import IntEnum

import mujoco
import numpy as np
from numpy.typing import NDArray


class JointKind(IntEnum):
    """What a joint lets move; equal to MuJoCo's numbers."""

    FREE = mujoco.mjtJoint.mjJNT_FREE.value
    BALL = mujoco.mjtJoint.mjJNT_BALL.value
    SLIDE = mujoco.mjtJoint.mjJNT_SLIDE.value
    HINGE = mujoco.mjtJoint.mjJNT_HINGE.value

    @property
    def dofs(self) -> int:
        """Its degrees of freedom."""
        return {JointKind.FREE: 6, JointKind.BALL: 3}.get(self, 1)


FREE, BALL, SLIDE, HINGE = JointKind


def spec_kind(joint: mujoco.MjsJoint) -> JointKind:
    """Returns the kind of a joint of a spec."""
    return JointKind(int(joint.type))


def free_joints(model: mujoco.MjModel) -> list[int]:
    """Returns the ids of the free joints."""
    return [int(joint) for joint in np.flatnonzero(model.jnt_type == FREE)]


def scalar_joints(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Returns the ids of the hinges and slides, which have one coordinate each."""
    return np.flatnonzero(model.jnt_type >= min(SLIDE, HINGE))


def has_free_joint(model: mujoco.MjModel | mujoco.MjSpec) -> bool:
    """Tells whether anything floats freely."""
    if isinstance(model, mujoco.MjSpec):
        return any(spec_kind(joint) is FREE for joint in model.joints)
    return bool((model.jnt_type == FREE).any())
