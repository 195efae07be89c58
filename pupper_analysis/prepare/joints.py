"""Make the joints of both files consistent: joint limits, couplings, one actuator per joint.

Input is a robot with matched joints; output is its description with changes, and notes. The joint
limits of the URDF [rad, m] are narrowed to those of the MJCF, and continuous joints of closed loops
get limits. ``<mimic>`` couplings of the URDF are added to the MJCF. Joints with several actuators
are rejected.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.attributes import known_positions
from pupper_analysis.models.description import Description
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.transmission import group_actuators_by_joint
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.matching.match import Match
from pupper_analysis.robot.robot import Robot

_LIMIT_ATOL = 1e-3
"""Tolerance [rad, m] of the comparison of joint limits. A limit of the MJCF replaces that of the
URDF if it is narrower by more than the tolerance. Smaller differences are rounding. Chosen, not
tuned.
"""

_CONTINUOUS_LIMIT = 2 * math.pi
"""Limit of a continuous joint of a robot with closed loops, in both directions [rad], if the MJCF
has none. Chosen as one revolution: larger angles are not needed."""


def limit_continuous_joints(robot: Robot) -> Description | None:
    """Add limits to the continuous joints of a robot with loops or couplings; None without any.

    PlaCo's joint constraints in closed loops require limits. The limit is that of the MJCF, or one
    revolution in both directions [rad].
    """
    if robot.closure is None or not robot.pin_convention.unbounded.any():
        return None
    tree = UrdfTree.of(robot.description.urdf)
    for name, joint in tree.joints.items():
        if joint.kind != "continuous" or name not in robot.joint_names:
            continue
        joint_id = robot.mj_model.joint(name).id
        limited = bool(robot.mj_model.jnt_limited[joint_id])
        bounds = (
            robot.mj_model.jnt_range[joint_id].tolist()
            if limited
            else (-_CONTINUOUS_LIMIT, _CONTINUOUS_LIMIT)
        )
        joint.set_range(*bounds)
    return replace(robot.description, urdf=to_text(tree.root))


def narrow_limits(robot: Robot) -> tuple[Description | None, list[Diagnostic]]:
    """Narrow the joint limits of the URDF [rad, m] to the overlap with the limits of the MJCF.

    Reason: if a joint of a stand were beyond the limits of the MJCF, MuJoCo would push it back.
    Limits are kept if both ranges do not overlap, or if no limit of the MJCF is narrower by more
    than ``_LIMIT_ATOL``.

    Returns:
        Robot description with the new limits, None if no limit changes; and notes on the change.
    """
    model, narrower = robot.mj_model, {}
    for name, low, high in zip(
        robot.joint_names, robot.lower_limits, robot.upper_limits, strict=True
    ):
        joint = model.joint(name).id
        if not model.jnt_limited[joint]:
            continue
        mjcf_low, mjcf_high = (float(value) for value in model.jnt_range[joint])
        bounds = max(mjcf_low, float(low)), min(mjcf_high, float(high))
        known_low, known_high = known_positions(model.jnt_range[joint])
        if bounds[0] < bounds[1] and (
            known_low > low + _LIMIT_ATOL or known_high < high - _LIMIT_ATOL
        ):
            narrower[name] = bounds
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
    """Add the ``<mimic>`` couplings of the URDF to the MJCF; return the description, and notes.

    A joint remains uncoupled in three cases: it has an actuator in the MJCF; a joint equality of
    the MJCF, active or not, refers to it; or the MJCF lacks the joint or its leader. If a joint
    already depends on other joints, it is skipped without a note.

    Args:
        matched: Matched joints of both files.
        description: Description.

    Returns:
        Description with the couplings, unchanged without couplings; notes.
    """
    spec = description.mjcf.copy()
    driven = {actuator.target for actuator in spec.actuators}
    closure, names = matched.robot.closure, matched.robot.joint_names
    dependent = (
        {names[joint] for joint in closure.dependent_joints} if closure is not None else set()
    )
    stated = {
        name
        for equality in spec.equalities
        if equality.type == mujoco.mjtEq.mjEQ_JOINT
        for name in (equality.name1, equality.name2)
    }
    joints = {joint.name for joint in spec.joints}
    added, uncoupled = [], []
    for name, (leader, multiplier, offset) in matched.mimics.items():
        if name in dependent:
            continue
        if name in stated or name in driven or leader not in joints or name not in joints:
            uncoupled.append(name)
            continue
        SpecTree(spec).add_coupling(name, leader, multiplier, offset)
        added.append(name)
    notes = [diagnose("mimics-coupled", joints=added)] if added else []
    notes += [diagnose("mimics-taken-as-free", joints=uncoupled)] if uncoupled else []
    return (replace(description, mjcf=spec) if added else description), notes


def check_motors(model: mujoco.MjModel, source: Path) -> None:
    """Raise an error if a joint has several actuators: a stand has a single command per joint.

    Raises:
        ModelError: If a hinge or slide has several actuators.
    """
    several = [
        joint for joint, actuators in group_actuators_by_joint(model).items() if len(actuators) > 1
    ]
    if several:
        names = [str(model.joint(joint).name) for joint in several]
        raise ModelError(source, diagnose("joints-of-several-motors", joints=names))
