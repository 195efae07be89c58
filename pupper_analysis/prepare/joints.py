"""The joints of two files: limits that both keep, one motor at each, couplings."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.description import Description
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.transmission import group_actuators_by_joint
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.matching.match import Match
from pupper_analysis.robot.robot import Robot

_NARROWER = 1e-3
"""A limit that is further in by more is another one (rad, m): keyframes and files are rounded."""

_TURNS = 2 * math.pi
"""What a joint without limits may turn, either way, where loops bind it (rad): round."""


def limit_continuous_joints(robot: Robot) -> Description | None:
    """Returns the description with limits for joints that turn round and round; None without loops.

    Where loops bind joints, PlaCo's constraints on joints know no others. No note tells, as the
    limits are further away than such a joint has to turn.
    """
    if robot.closure is None or not robot.pin_convention.unbounded.any():
        return None
    tree = UrdfTree.of(robot.description.urdf)
    for name, joint in tree.joints.items():
        if joint.kind != "continuous" or name not in robot.joint_names:
            continue
        number = robot.mj_model.joint(name).id
        limited = bool(robot.mj_model.jnt_limited[number])
        ends = robot.mj_model.jnt_range[number].tolist() if limited else (-_TURNS, _TURNS)
        joint.set_range(*ends)
    return replace(robot.description, urdf=to_text(tree.root))


def narrow_limits(robot: Robot) -> tuple[Description | None, list[Diagnostic]]:
    """Returns the description with the URDF's limits narrowed to the MJCF's; None if they are.

    A stand at an angle that MuJoCo's limit excludes is thrown out of it by the first step.
    """
    model, narrower = robot.mj_model, {}
    for name, low, high in zip(
        robot.joint_names, robot.lower_limits, robot.upper_limits, strict=True
    ):
        joint = model.joint(name).id
        if not model.jnt_limited[joint]:
            continue
        first, last = (float(value) for value in model.jnt_range[joint])
        inside = max(first, float(low)), min(last, float(high))
        if inside[0] < inside[1] and (first > low + _NARROWER or last < high - _NARROWER):
            narrower[name] = inside
    if not narrower:
        return None, []
    tree = UrdfTree.of(robot.description.urdf)
    for name, ends in narrower.items():
        tree.joints[name].set_range(*ends)
    messages = [
        diagnose("joint-range", subject=("joint", name), lower=low, upper=high)
        for name, (low, high) in narrower.items()
    ]
    noted = [diagnose("narrower-limits-kept", joints=messages)]
    return replace(robot.description, urdf=to_text(tree.root)), noted


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


def check_motors(model: mujoco.MjModel, source: Path) -> None:
    """Refuses joints of several motors: a stand has one command for each joint.

    Raises:
        ModelError: If a hinge or slide has several.
    """
    several = [
        joint for joint, motors in group_actuators_by_joint(model).items() if len(motors) > 1
    ]
    if several:
        names = [str(model.joint(joint).name) for joint in several]
        raise ModelError(source, diagnose("joints-of-several-motors", joints=names))
