"""Mends the usual faults of an MJCF that MuJoCo refuses, so that the rest can be audited."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.robot_model.model import Array, Inertial

MUJOCO_ERRORS = (ValueError, RuntimeError, TypeError, OSError, MemoryError)
"""What MuJoCo's bindings raise when they refuse a model."""


def repair_spec(original: mujoco.MjSpec) -> tuple[mujoco.MjSpec, mujoco.MjModel | None]:
    """Returns a copy whose usual faults are mended, and what MuJoCo compiles it to, if it does."""
    spec = original.copy()
    spec.compiler.balanceinertia = True
    spec.compiler.boundmass = 1e-9
    spec.compiler.boundinertia = 1e-12
    for body in spec.bodies:
        body.mass = max(body.mass, 0.0)
        body.inertia = np.maximum(body.inertia, 0.0)
        if not math.isnan(body.fullinertia[0]):
            tensor = full_matrix(np.array(body.fullinertia))
            moments = Inertial(1.0, np.zeros(3), tensor, stated=True).moments
            if not (moments[0] > 0 and moments[0] + moments[1] >= moments[2]):
                body.fullinertia = np.full(6, np.nan)
                body.inertia = np.full(3, np.clip(np.nan_to_num(np.abs(moments).max()), 1e-9, 1e9))
    for joint in spec.joints:
        if joint.range[0] >= joint.range[1]:
            joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        if not np.linalg.norm(joint.axis) > 1e-9:
            joint.axis = (0.0, 0.0, 1.0)
    for actuator in spec.actuators:
        for what in ("ctrl", "force"):
            low, high = getattr(actuator, f"{what}range")
            if low >= high:
                setattr(actuator, f"{what}limited", mujoco.mjtLimited.mjLIMITED_FALSE)
    for without_keyframes in (False, True):
        try:
            if without_keyframes:
                for key in list(spec.keys):
                    spec.delete(key)
            return spec, spec.compile()
        except MUJOCO_ERRORS:
            continue
    return spec, None


def full_matrix(full: Array) -> Array:
    """Returns the (3, 3) matrix of MuJoCo's fullinertia (xx, yy, zz, xy, xz, yz)."""
    xx, yy, zz, xy, xz, yz = full
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def switched_off_ranges(
    original: mujoco.MjSpec, compiled: mujoco.MjSpec
) -> dict[int, tuple[float, float]]:
    """Returns the ranges of those joints whose limits the repair has switched off (rad, m)."""
    ranges = {}
    for joint, copied in zip(original.joints, compiled.joints, strict=True):
        if joint.limited == copied.limited:
            continue
        angular = joint.type in (JointKind.HINGE, JointKind.BALL)
        unit = math.pi / 180 if angular and original.compiler.degree else 1.0
        stated = any(joint.range) or joint.limited == mujoco.mjtLimited.mjLIMITED_TRUE
        if stated:
            ranges[copied.id] = (float(joint.range[0]) * unit, float(joint.range[1]) * unit)
    return ranges
