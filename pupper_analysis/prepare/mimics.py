"""Joints that follow others in the URDF alone: the MJCF gets couplings that it does not state."""

from __future__ import annotations

from dataclasses import replace

import mujoco

from pupper_analysis.diagnostics import Diagnostic, diagnose
from pupper_analysis.matching.match import Match
from pupper_analysis.models.description import Description

_TIME = 5e-3
"""Time constant of the couplings (s): MuJoCo's own, 20 ms, lets fingers of grammes open far."""


def coupled(matched: Match, description: Description) -> tuple[Description, list[Diagnostic]]:
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
    joints = {joint.name: joint for joint in spec.joints}
    added, free = [], []
    for name, (leader, multiplier, offset) in matched.mimics.items():
        if name in bound:
            continue
        if name in stated or name in driven or leader not in joints or name not in joints:
            free.append(name)
            continue
        # MuJoCo's polynomial is of the coordinates less those of its zero pose.
        rest = offset - joints[name].ref + multiplier * joints[leader].ref
        equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=name, name2=leader)
        equality.data[:5] = (rest, multiplier, 0.0, 0.0, 0.0)
        equality.objtype = mujoco.mjtObj.mjOBJ_JOINT
        step = float(spec.option.timestep)
        equality.solref = (max(_TIME, 2 * step), 1.0)
        added.append(name)
    notes = [diagnose("mimics-coupled", joints=added)] if added else []
    notes += [diagnose("mimics-taken-as-free", joints=free)] if free else []
    return (replace(description, mjcf=spec) if added else description), notes
