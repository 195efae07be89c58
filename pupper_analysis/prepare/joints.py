"""Make the joints of URDF and MJCF consistent: limits, couplings, a single actuator per joint.

Input is a robot with matched joints; output is the robot's description with changes, and notes. The
joint limits of the URDF [rad, m] are narrowed to the limits of the MJCF. Continuous joints of a
robot with closed loops or couplings get limits. ``<mimic>`` couplings of the URDF are added to the
MJCF. Joints with several actuators are rejected.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.units import select_joint_units
from pupper_analysis.models.attributes import known_limits
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.transmission import group_actuators_by_joint
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.matching.match import Match
from pupper_analysis.robot.robot import Robot

_LIMIT_ATOL = 1e-3
"""Tolerance [rad, m] for comparing the joint limits of URDF and MJCF in `narrow_limits`. Smaller
differences are rounding. Chosen, not tuned.
"""

_CONTINUOUS_LIMIT = 2 * math.pi
"""Limit of a continuous joint in both directions [rad]: a revolution. It is used for robots with
closed loops or couplings, if the MJCF does not limit the joint. Chosen, not tuned.
"""


def limit_continuous_joints(robot: Robot) -> Description | None:
    """Add joint limits to the continuous joints of a robot with closed loops or couplings.

    Reason: PlaCo's joint constraints in closed loops require limits. The limits are those of the
    MJCF, or one revolution in both directions.

    Returns:
        Copy of the robot's description, with the limits [rad] in the URDF; None if no joint needs
        limits.
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

    Reason: MuJoCo pushes back a joint that is beyond the limits in the MJCF. A stand must not
    contain such a joint.

    Returns:
        Copy of the robot's description with the new limits, and a note that lists the limits. None
        and an empty list if no limit changes.

    Raises:
        ModelError: If the limits of a joint in both files have no position in common. The error
            contains the joint and the limits in both files.
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
        known_low, known_high = known_limits(model.jnt_range[joint])
        ordered = low <= high and mjcf_low <= mjcf_high  # crossed limits have their own error
        if ordered and bounds[0] > bounds[1] + _LIMIT_ATOL:
            unit = select_joint_units(slides=model.jnt_type[joint] == JointKind.SLIDE).position
            raise ModelError(
                robot.description.urdf_source,
                diagnose(
                    "joint-limits-disjoint",
                    subject=("joint", name),
                    urdf_lower=Quantity(float(low), unit),
                    urdf_upper=Quantity(float(high), unit),
                    mjcf_lower=Quantity(mjcf_low, unit),
                    mjcf_upper=Quantity(mjcf_high, unit),
                ),
            )
        if bounds[0] <= bounds[1] and (
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
    """Add the ``<mimic>`` couplings of the URDF to the MJCF, as joint equalities.

    A mimic joint follows another joint, the leader. No coupling is added, but a note, if the mimic
    joint has an actuator in the MJCF, for example.

    Args:
        matched: Matched joints of both files, with the couplings of the URDF.
        description: Description to which the couplings are added; not modified.

    Returns:
        Description with the couplings (the same object if none was added), and the notes.
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
    for name, (leader, multiplier, offset) in matched.robot.description.mimics.items():
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
    """Raise an error if a hinge or slide has several actuators.

    Reason: a stand is held by a single servo command per joint.

    Raises:
        ModelError: If a hinge or slide has several actuators.
    """
    several = [
        joint for joint, actuators in group_actuators_by_joint(model).items() if len(actuators) > 1
    ]
    if several:
        names = [str(model.joint(joint).name) for joint in several]
        raise ModelError(source, diagnose("joints-of-several-motors", joints=names))
