"""Torque limits in verdicts: motors with a limit of zero, overloaded motors, and unknown limits.

Inputs are a robot and the static joint torques of a stance [N m, N]. Outputs are joint names and
messages. A message about a limit of zero proposes another limit, if available: that of the other
file (URDF or MJCF), or that of a similar limb. A motor counts as unloaded if the torque is at most
`MIN_TORQUE_PER_MASS` times the robot's mass.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.models.efforts import (
    EffortCode,
    EffortLimit,
    EffortStatement,
    read_tendon_forces,
)
from pupper_analysis.models.transmission import Drive, list_tendon_joints, measure_actuator_levers
from pupper_analysis.robot.alike import sibling_joints
from pupper_analysis.robot.joints import find_footless_joints, force_unit
from pupper_analysis.robot.robot import Robot, describe_unstated_efforts
from pupper_analysis.simulation.verdict import find_overloaded_motors
from pupper_analysis.simulation.verify import FORCE_TOLERANCE, torque_scale
from pupper_analysis.statics.equilibrium import (
    MIN_TORQUE_PER_MASS,
    GravityCompensation,
    compute_utilisation,
)


def list_driven_limits(robot: Robot) -> list[EffortLimit]:
    """Return the torque limits of the joints that need a motor.

    Dependent joints (of closed loops and couplings) and passive joints
    (`Description.passive_joints`) need no motor.
    """
    following = () if robot.closure is None else robot.closure.dependent_joints.tolist()
    passive = robot.description.passive_joints
    return [
        limit
        for index, limit in enumerate(robot.efforts)
        if index not in following and limit.joint not in passive
    ]


def report_unstated_efforts(robot: Robot) -> tuple[Diagnostic, ...]:
    """Report, in one diagnostic, the driven joints whose torque limit no file states."""
    limits = list_driven_limits(robot)
    joints = [limit.joint for limit in limits if limit.code is EffortCode.UNKNOWN]
    return (describe_unstated_efforts(joints),) if joints else ()


def describe_loaded_passive_joints(robot: Robot, statics: GravityCompensation) -> Diagnostic | None:
    """Create the message that joints without a motor must hold a torque in a stance.

    Passive joints have no actuator in the MJCF, and an effort limit of zero
    (`Description.passive_joints`).

    Returns:
        The message; None if no passive joint is loaded.
    """
    needed = dict(zip(statics.joint_names, np.abs(statics.joint_torques).tolist(), strict=True))
    least = MIN_TORQUE_PER_MASS * robot.total_mass
    loaded = [joint for joint in robot.description.passive_joints if needed[joint] > least]
    if not loaded:
        return None
    hardest = max(loaded, key=needed.__getitem__)
    unit = force_unit(robot, hardest)
    torque = Quantity(needed[hardest], unit)
    return diagnose("passive-joints-loaded", joints=loaded, hardest=hardest, torque=torque)


def list_overloaded_joints(
    robot: Robot, statics: GravityCompensation, positions: Array
) -> tuple[str, ...]:
    """Return the names of the joints whose limits do not permit the static torques of a stance.

    The limit of a passive joint is zero.

    If only tendons drive some joints, the forces F of the actuators at the tendons are the
    least-squares solution of tau = M F. tau are the static torques of these joints, and M are the
    levers at ``positions``. The motors of other joints exert tau - M F.

    Args:
        robot: Robot.
        statics: Static joint torques of the stance.
        positions: Joint positions of the stance, shape (nu,) [rad, m].
    """
    tendons = _find_tendon_drives(robot, positions)
    if tendons is None:
        return find_overloaded_motors(statics)
    model, rows, actuators, levers = tendons
    torques = statics.joint_torques
    forces = np.linalg.lstsq(levers[rows], torques[rows], rcond=None)[0]
    own = torques - levers @ forces
    overloaded = np.zeros(robot.nu, dtype=bool)
    overloaded[rows] = np.abs(own[rows]) > FORCE_TOLERANCE * torque_scale(robot, torques)
    own[rows] = 0.0
    overloaded |= compute_utilisation(robot, own) > 1
    for column, (actuator, force) in enumerate(zip(actuators, forces.tolist(), strict=True)):
        limits = read_tendon_forces(model, actuator)
        if any(not limit.lower <= force <= limit.upper for limit in limits):
            overloaded[[row for row in rows if levers[row, column]]] = True
    return tuple(np.array(robot.joint_names)[overloaded].tolist())


def _find_tendon_drives(
    robot: Robot, positions: Array
) -> tuple[mujoco.MjModel, list[int], list[int], Array] | None:
    """Find the joints that only tendons drive, and the levers of the tendons' actuators.

    The levers are measured at ``positions``, joint positions of shape (nu,) [rad, m].

    Returns:
        Model of the published file. Indices of the joints, in actuator order. Ids of the actuators
        at these tendons. Levers, shape (nu, number of actuators): torque at each joint per unit of
        actuator force. None if no tendon drives a joint alone, for example.
    """
    file = None if robot.published is None else robot.published.file
    driven = {
        servo.joint for servo in robot.description.made_servos if servo.instead_of is Drive.TENDON
    }
    if file is None or not driven or robot.closure is not None:
        return None
    model, by_actuator = file.model, list_tendon_joints(file.model)
    rows = [row for row, name in enumerate(robot.joint_names) if name in driven]
    # A joint without a name in the file has the id -1, and no lever.
    kind = mujoco.mjtObj.mjOBJ_JOINT
    joints = [mujoco.mj_name2id(model, kind, name) for name in robot.joint_names]
    at_rows = {joints[row] for row in rows}
    actuators = [actuator for actuator, own in by_actuator.items() if at_rows & set(own)]
    qpos = model.qpos0.copy()
    levers = np.zeros((robot.nu, len(actuators)))
    known = np.array(joints) >= 0
    in_file = np.array(joints)[known]
    qpos[model.jnt_qposadr[in_file]] = positions[known]
    _, at_dofs = measure_actuator_levers(model, qpos, actuators)
    levers[known] = at_dofs[:, model.jnt_dofadr[in_file]].T
    return model, rows, actuators, levers


def describe_zero_torque_limits(robot: Robot) -> Diagnostic | None:
    """Create the message about motors whose torque limit in a file is zero or negative.

    The message proposes another limit, if available: that of the other file (URDF or MJCF), or that
    of the corresponding joint of a similar limb.

    Returns:
        The message; None without such a limit, for example.
    """
    null = [limit for limit in list_driven_limits(robot) if limit.without_torque]
    if not null or null[0].origin is None:
        return None
    origin = null[0].origin
    low, high = origin.stated
    twins = [(limit.joint, limit.positive_statement) for limit in null]
    twin = next(((joint, statement) for joint, statement in twins if statement is not None), None)
    return diagnose(
        "motors-without-torque",
        joints=[limit.joint for limit in null],
        file=origin.file,
        attribute=origin.attribute,
        value=f"{high:g}" if origin.attribute in ("effort", "gear") else f"{low:g} {high:g}",
        negative=null[0].code is EffortCode.NEGATIVE,
        **_make_proposed_limit_fields(robot, twin or _sibling_limit(robot, null)),
    )


def _make_proposed_limit_fields(
    robot: Robot, found: tuple[str, EffortStatement] | None
) -> dict[str, Any]:
    """Return the fields that propose an effort limit, for the message about a limit of zero.

    ``found`` is a joint with the proposed limit. If it is None, all fields are None.
    """
    if found is None:
        return {"other": None, "other_file": None, "other_name": None, "other_attribute": None}
    joint, statement = found
    return {
        "other": Quantity(statement.symmetric_torque, force_unit(robot, joint)),
        "other_file": statement.file,
        "other_name": joint,
        "other_attribute": statement.attribute,
    }


def _sibling_limit(robot: Robot, null: list[EffortLimit]) -> tuple[str, EffortStatement] | None:
    """Find an effort limit to propose: that of the corresponding joint of a similar limb.

    ``null`` are the limits that are zero or negative. The result is the name of the corresponding
    joint, and its limit; None without such a joint.
    """
    limits, siblings = {limit.joint: limit for limit in robot.efforts}, sibling_joints(robot)
    for limit in null:
        for name in siblings.get(limit.joint, ()):
            origin = limits[name].origin
            if limits[name].code is EffortCode.STATED and origin is not None:
                return name, origin
    return None


def loads_motor_without_torque(robot: Robot, statics: GravityCompensation) -> bool:
    """Return True if a motor with a torque limit of zero or below must hold a torque in a stance.

    Torques [N m, N] of at most `MIN_TORQUE_PER_MASS` times the robot's mass [kg] count as zero.
    """
    return bool(_list_loaded_zero_motors(robot, statics))


def springs_replace_motors(robot: Robot, statics: GravityCompensation) -> bool:
    """Return True if each loaded joint with a motor without torque has a spring.

    A linear joint stiffness in the MJCF counts as a spring. A simulation must test if the springs
    are strong enough.
    """
    model = robot.mj_model
    joints = [model.joint(name).id for name in _list_loaded_zero_motors(robot, statics)]
    return bool((model.jnt_stiffness[joints] > 0).all())


def _list_loaded_zero_motors(robot: Robot, statics: GravityCompensation) -> list[str]:
    """Return the joints that must hold a torque, although their torque limit is zero or below."""
    needed = dict(zip(statics.joint_names, np.abs(statics.joint_torques), strict=True))
    least = MIN_TORQUE_PER_MASS * robot.total_mass
    return [
        limit.joint
        for limit in list_driven_limits(robot)
        if limit.without_torque and needed[limit.joint] > least
    ]


def describe_unknown_limits(robot: Robot, statics: GravityCompensation) -> Diagnostic | None:
    """Create the message about motors whose torque limit no file states, with the largest torque.

    Returns:
        The message; None if no motor without a stated limit must hold a torque. The message omits
        unloaded joints that move no foot.
    """
    needed = dict(zip(statics.joint_names, np.abs(statics.joint_torques), strict=True))
    least = MIN_TORQUE_PER_MASS * robot.total_mass
    unknown = [
        limit.joint for limit in list_driven_limits(robot) if limit.code is EffortCode.UNKNOWN
    ]
    if not any(needed[joint] > least for joint in unknown):
        return None
    aside = find_footless_joints(robot)  # joints without a foot below
    unknown = [joint for joint in unknown if joint not in aside or needed[joint] > least]
    hardest = max(unknown, key=needed.__getitem__)
    return diagnose(
        "torque-limits-unknown",
        joints=unknown,
        count=len(unknown),
        torque=Quantity(float(needed[hardest]), force_unit(robot, hardest)),
        hardest=hardest,
    )
