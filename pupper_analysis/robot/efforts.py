"""What each motor of a robot can give, by both of its files, and what is said about it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import mujoco
import pinocchio as pin

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.models.efforts import (
    EffortLimit,
    effort_of,
)
from pupper_analysis.models.transmission import drives_by_joint
from pupper_analysis.robot.coordinates import PinocchioConvention

_EFFORT_TOLERANCE = 1e-6
"""Relative: limits that differ by less are one, rounded otherwise."""


def efforts_of(
    mj_model: mujoco.MjModel,
    pin_model: pin.Model,
    convention: PinocchioConvention,
    joint_names: Sequence[str],
    before: Mapping[str, EffortLimit],
) -> tuple[EffortLimit, ...]:
    """Returns what each joint's motor can give, in the order of the names.

    Args:
        mj_model: MuJoCo's model of the MJCF.
        pin_model: Pinocchio's of the URDF.
        convention: Where the joints are in it.
        joint_names: Their names, in both.
        before: {joint: the same}, of motors that a preparation replaced by servos. Where the servo
            has that limit, it is told with the statements of the file itself.
    """
    urdf, limits = pin_model.effortLimit.take(convention.v_index).tolist(), []
    drives = drives_by_joint(mj_model)
    for name, effort in zip(joint_names, urdf, strict=True):
        joint, first = int(mj_model.joint(name).id), before.get(name)
        limit = effort_of(mj_model, joint, effort, drives=drives.get(joint, ()))
        same = first is not None and _alike(first.lower, limit.lower)
        same = same and first is not None and _alike(first.upper, limit.upper)
        limits.append(first if same and first is not None else limit)
    return tuple(limits)


def effort_notes(limits: Sequence[EffortLimit]) -> list[Diagnostic]:
    """Tells of efforts: which file's count where they differ, and what was made of them."""
    notes: list[Diagnostic] = []
    unstated, geared, uneven = [], [], []
    differing: dict[tuple[str, str, str], list[Diagnostic]] = {}
    for limit in limits:
        urdf = [one for one in limit.stated if one.file == "URDF"]
        others = [one for one in limit.stated if one.file != "URDF"]
        if not urdf:
            unstated.append(limit.joint)
        if limit.gear != 1.0:
            effort = Quantity(urdf[0].stated[1], "N m")
            joint = "joint", limit.joint
            geared.append(diagnose("effort-geared", subject=joint, effort=effort, gear=limit.gear))
        if not _alike(-limit.lower, limit.upper):
            uneven.append(limit.joint)
        if urdf and others and limit.origin is not None:
            other = min(others, key=lambda one: one.least)
            if not _alike(urdf[0].least, other.least):
                pair = sorted((urdf[0], other), key=lambda one: one.least)
                key = pair[0].file, pair[0].attribute, pair[1].attribute
                least, unused = (Quantity(one.least, "N m") for one in pair)
                joint = "joint", limit.joint
                told = diagnose("lesser-effort", subject=joint, least=least, unused=unused)
                differing.setdefault(key, []).append(told)
    if unstated:
        notes.append(diagnose("effort-unstated", joints=unstated))
    if geared:
        notes.append(diagnose("efforts-multiplied-by-gear", joints=geared))
    for (file, attribute, other_attribute), joints in differing.items():
        notes.append(
            diagnose(
                "effort-limits-differ",
                file=file,
                attribute=attribute,
                instead_of=other_attribute,
                joints=joints,
            )
        )
    if uneven:
        notes.append(diagnose("motors-uneven", joints=uneven))
    return notes


def _alike(one: float, other: float) -> bool:
    return one == other or math.isclose(one, other, rel_tol=_EFFORT_TOLERANCE)
