"""Joints that follow others in the URDF alone: the MJCF gets couplings that it does not state."""

from __future__ import annotations

from dataclasses import replace

import mujoco

from pupper_analysis.diagnostics import Diagnostic, diagnose
from pupper_analysis.matching.match import Match
from pupper_analysis.models.description import Description
from pupper_analysis.models.spec_tree import SpecTree


def couple_mimics(matched: Match, description: Description) -> tuple[Description, list[Diagnostic]]:
    """Returns the description with the URDF's ``<mimic>`` in its MJCF, where that says nothing.

    A joint that has a motor of its own in the MJCF, or is bound there, stays as it is; so does one
    whose coupling is there and switched off.

    Args:
        matched: The two files.
        description: What is to be built of them.

    Returns:
        The description, and what was done.
    """
    spec = description.mjcf.copy()
    driven = {actuator.target for actuator in spec.actuators}
    closure, names = matched.robot.closure, matched.robot.joint_names
    bound = {names[joint] for joint in closure.following} if closure is not None else set()
    stated = {
        name
        for equality in spec.equalities
        if equality.type == mujoco.mjtEq.mjEQ_JOINT
        for name in (equality.name1, equality.name2)
    }
    joints = {joint.name for joint in spec.joints}
    added, free = [], []
    for name, (leader, multiplier, offset) in matched.mimics.items():
        if name in bound:
            continue
        if name in stated or name in driven or leader not in joints or name not in joints:
            free.append(name)
            continue
        SpecTree(spec).add_coupling(name, leader, multiplier, offset)
        added.append(name)
    notes = [diagnose("mimics-coupled", joints=added)] if added else []
    notes += [diagnose("mimics-taken-as-free", joints=free)] if free else []
    return (replace(description, mjcf=spec) if added else description), notes
