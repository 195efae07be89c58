"""Joints of a robot: motion types, legs, and postures.

A posture contains the positions of joints that move no foot or hand, for example of a head.
The user specifies a posture as {joint name or pattern: position}. This module resolves the names,
and checks units, loops and joint ranges. It also returns the default posture of a robot with a
fixed base.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pinocchio as pin

from pupper_analysis.base.arguments import (
    check_finite,
    find_name_patterns,
    match_names,
    suggest_degrees,
)
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.base.units import (
    JointUnits,
    Position,
    combine_joint_units,
    select_joint_units,
)
from pupper_analysis.models.attributes import known_limits
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

OBLIQUE_MOTIONS = ("oblique", "oblique slide")
"""Motion types of a hinge, and of a slide, whose axis is more than 1 deg off each world axis
(`joint_motions`)."""


def joint_motions(robot: Robot) -> dict[str, str]:
    """Classify the motion of each joint by the direction of its axis.

    The axis is expressed in the world frame, with all joint positions zero and a free base at the
    origin; a fixed base has the pose of the MJCF.

    Returns:
        {joint: motion}. The motion of a hinge about x, y or z is ``roll``, ``pitch`` or ``yaw``.
        The motion of a slide is ``along x``, ``along y`` or ``along z``. For axes more than 1 deg
        off these directions, the motion is ``oblique`` (hinge) or ``oblique slide``.
    """
    zero_configuration = Configuration(robot, robot.neutral())
    return {
        name: _classify_motion(zero_configuration.joint_axis(name), is_slide=is_slide(robot, name))
        for name in robot.joint_names
    }


def is_slide(robot: Robot, joint: str) -> bool:
    """Return True if a joint is a slide."""
    model = robot.before_servos.mj_model
    return bool(model.jnt_type[model.joint(joint).id] == JointKind.SLIDE)


def _classify_motion(axis: Array, *, is_slide: bool) -> str:
    """Name the motion about or along an axis (3,), such as ``pitch`` or ``along x``."""
    direction = int(np.argmax(np.abs(axis)))
    aligned = abs(axis[direction]) > np.cos(np.radians(1.0))
    if is_slide:
        return f"along {'xyz'[direction]}" if aligned else OBLIQUE_MOTIONS[1]
    return ("roll", "pitch", "yaw")[direction] if aligned else OBLIQUE_MOTIONS[0]


def leg_joints(robot: Robot, foot: str) -> tuple[str, ...]:
    """Return the joints between the base and a contact point, in order from the base.

    Args:
        robot: The robot.
        foot: Contact point.

    Raises:
        UnknownNameError: If there is no such contact point.
    """
    model = robot.pin_model
    frame = model.frames[
        model.getFrameId(robot.contact_frames[robot.check_foot(foot)], pin.FrameType.BODY)
    ]
    support = [model.names[joint] for joint in model.supports[frame.parentJoint]]
    return tuple(name for name in support if name in robot.joint_names)


_LIMIT_ATOL = 1e-6
"""Largest excess of a requested joint position over a joint limit [rad, m] that is accepted,
because users enter rounded positions. Chosen, not tuned."""


def resolve_posture(robot: Robot, posture: Mapping[str, float]) -> Mapping[str, float]:
    """Check a requested posture, and expand its patterns to {joint: position [rad, m]}.

    Args:
        robot: The robot.
        posture: {joint, or pattern such as ``*elbow*``: position [rad, m]}. If several patterns
            match a joint, the last counts.

    Raises:
        UnknownNameError: If a pattern matches no joint.
        ConfigurationError: If a position is not valid, for example, or a joint moves a foot or
            hand.
    """
    placed = named_positions(robot, posture, "posture") if posture else {}
    free = find_footless_joints(robot) if placed else ()
    if robot.closure is not None and any(joint not in free for joint in placed):
        free = (*free, *_list_loop_joints(robot, placed))
    for joint in placed:
        if joint not in free:
            raise ConfigurationError("posture", diagnose("joint-is-the-stands", joint=joint))
    return placed


_MAX_POSTURE_VIOLATION = 1e-6
"""Largest constraint violation [rad, m] with which a requested posture counts as closing its loops
and couplings. Chosen, not tuned."""


def _list_loop_joints(robot: Robot, placed: Mapping[str, float]) -> tuple[str, ...]:
    """Return the coupled joints that move no foot, if ``placed`` has all and closes the loops."""
    closure = robot.closure
    assert closure is not None
    indices = sorted({*closure.dependent_joints.tolist(), *closure.driving_joints.tolist()})
    names = [robot.joint_names[index] for index in indices]
    if not placed.keys() >= {*names}:
        return ()
    positions = robot.make_qpos(robot.home[-robot.nu :])
    for index in indices:
        positions[robot.nq - robot.nu + index] = placed[robot.joint_names[index]]
    if closure.largest_violation(positions) > _MAX_POSTURE_VIOLATION:
        return ()
    return tuple(name for name in names if name not in _foot_joints(robot))


def find_footless_joints(robot: Robot) -> tuple[str, ...]:
    """Return the joints that move no foot or hand, and belong to no loop or coupling.

    The joints are in actuator order.
    """
    model = robot.structure.model
    foot_or_coupled_joints = {
        model.names[joint]
        for foot in robot.structure.parents.values()
        for joint in list(model.supports[foot])
    }
    if robot.closure is not None:
        coupled = (*robot.closure.dependent_joints.tolist(), *robot.closure.driving_joints.tolist())
        foot_or_coupled_joints |= {robot.joint_names[joint] for joint in coupled}
    return tuple(joint for joint in robot.joint_names if joint not in foot_or_coupled_joints)


def _foot_joints(robot: Robot) -> set[str]:
    """Return the names, in Pinocchio's model, of all joints between world and feet or hands."""
    model = robot.structure.model
    return {
        model.names[joint]
        for foot in robot.structure.parents.values()
        for joint in list(model.supports[foot])
    }


def find_joints(robot: Robot, pattern: str) -> list[str]:
    """Return the joints that a name or a pattern selects (`match_names`), in actuator order.

    Raises:
        UnknownNameError: If the pattern matches no joint.
    """
    chosen = match_names(pattern, robot.joint_names)
    if not chosen:
        raise UnknownNameError(robot.name, "joint", pattern, robot.joint_names)
    return chosen


def find_motor_joints(robot: Robot, pattern: str) -> list[str]:
    """Return the joints whose motors a name or a pattern selects, in actuator order.

    Passive joints (`Description.passive_joints`) have no motor: a pattern that also matches other
    joints does not select them. A passive joint alone is selected, for example by its name.

    Raises:
        UnknownNameError: If the pattern matches no joint.
    """
    chosen, passive = find_joints(robot, pattern), robot.description.passive_joints
    return [joint for joint in chosen if joint not in passive] or chosen


def named_positions(
    robot: Robot, joints: Mapping[str, float], argument: str = "joints"
) -> dict[str, Position]:
    """Expand patterns of joint names in requested positions, and add the unit to each position.

    Args:
        robot: The robot.
        joints: {joint, or pattern such as ``*elbow*``: position [rad, m]}. If several patterns
            match a joint, the last counts.
        argument: Name of the caller's argument, for error messages.

    Returns:
        {joint: position with its unit}.

    Raises:
        UnknownNameError: If a pattern matches no joint.
        ConfigurationError: If a position is not a finite number, or has a unit of length for a
            hinge or a unit of angle for a slide.
    """
    positions: dict[str, Position] = {}
    for pattern, value in joints.items():
        try:
            chosen = find_joints(robot, pattern)
        except UnknownNameError as error:
            raise error.with_location(argument) from None
        position = check_finite(f"{argument} {pattern!r}", value)
        for joint in chosen:
            positions[joint] = Position(position, joint_unit(robot, joint))
            if getattr(value, "unit", "rad or m") not in ("rad or m", positions[joint].unit):
                slides = is_slide(robot, joint)
                problem = diagnose("joint-slides-or-turns", joint=joint, slides=slides)
                raise ConfigurationError(argument, problem)
    return positions


def with_units(robot: Robot, posture: Mapping[str, float]) -> dict[str, float]:
    """Add the unit to each position of a posture: rad for hinges, m for slides.

    Args:
        robot: Robot.
        posture: {name or pattern of joints: position [rad, m]}.

    Returns:
        {name or pattern: `Position`}. A position whose pattern matches both hinges and slides stays
        a number without unit.

    Raises:
        UnknownNameError: If a pattern matches no joint.
        ConfigurationError: If a position is not a finite number, or has a unit of length for a
            hinge or a unit of angle for a slide.
    """
    result = dict(posture)
    for pattern, value in posture.items():
        placed = named_positions(robot, {pattern: value}, "posture")
        units = {position.unit for position in placed.values()}
        result[pattern] = Position(value, *units) if len(units) == 1 else value
    return result


_KEYFRAME_ROUNDING = 1e-3
"""Excess of a keyframe's joint position over the joint limit [rad, m] below which the excess is
attributed to rounded numbers in files. Chosen, not tuned."""


def joint_ranges(robot: Robot) -> Array:
    """Return the joint ranges that URDF and MJCF both permit, shape (nu, 2) [rad, m].

    Columns: lower limit, upper limit; infinite without a limit. If the ranges of the files do not
    overlap, the result is a range of zero width.
    """
    model = robot.mj_model
    joints = [model.joint(name).id for name in robot.joint_names]
    stated = np.where(
        model.jnt_limited[joints].astype(bool)[:, None],
        known_limits(model.jnt_range[joints]),
        (-np.inf, np.inf),
    )
    low = np.maximum(stated[:, 0], robot.lower_limits)
    return np.column_stack([low, np.maximum(low, np.minimum(stated[:, 1], robot.upper_limits))])


def default_positions(robot: Robot, keyframe: str | None = None) -> tuple[Array, str | None]:
    """Return the default posture of a robot with a fixed base, and the name of its keyframe.

    The posture is the keyframe ``keyframe``; else the keyframe ``home`` or the first keyframe, if
    it is within the joint ranges; else the middle of each joint range. If a limit is infinite, the
    position nearest to zero replaces the middle. Loops are not closed.

    Args:
        robot: Robot with a fixed base.
        keyframe: Name of a keyframe of the MJCF. Its positions may exceed the joint ranges.

    Returns:
        Joint positions in actuator order, shape (nu,) [rad, m]; name of the keyframe, None if no
        keyframe is used.

    Raises:
        UnknownNameError: If there is no such keyframe.
    """
    ranges = joint_ranges(robot)
    keys = {str(key.name): np.array(key.qpos) for key in robot.description.mjcf.keys}
    if keyframe is not None and keyframe not in keys:
        raise UnknownNameError(robot.description.mjcf_source, "keyframe", keyframe, tuple(keys))
    name = keyframe if keyframe is not None else next((k for k in ("home", *keys) if k in keys), "")
    qpos = keys.get(name, np.zeros(0))
    if keyframe is not None and not len(qpos):
        qpos = robot.mj_model.qpos0
    if len(qpos) >= robot.mj_model.nq:
        # The keyframe may belong to the model with a free base, and then has more elements.
        positions = qpos[len(qpos) - robot.mj_model.nq + robot.mj_convention.qpos_index]
        clipped = np.clip(positions, *ranges.T)
        is_rounded = np.abs(positions - clipped) < _KEYFRAME_ROUNDING
        if keyframe is not None or is_rounded.all():
            return np.where(is_rounded, clipped, positions), name
    bounded = np.isfinite(ranges)
    limits = np.where(bounded, ranges, 0.0)
    middle = np.where(bounded.all(axis=1), limits.mean(axis=1), np.clip(0.0, *ranges.T))
    return middle, None


def check_in_range(
    robot: Robot,
    joint: str,
    position: float,
    ends: tuple[float, float],
    argument: str,
    bonds: tuple[str, ...] = (),
) -> None:
    """Raise an error if the position of a joint is outside of its range.

    Args:
        robot: The robot.
        joint: Joint.
        position: Position [rad, m].
        ends: Lower and upper limit [rad, m].
        argument: Name of the argument, for the message.
        bonds: Names of loop constraints that restrict the range, for the message.

    Raises:
        ConfigurationError: If the position is beyond a limit by more than 1e-6 rad or m
            (``_LIMIT_ATOL``).
    """
    low, high = ends
    if not low - _LIMIT_ATOL <= position <= high + _LIMIT_ATOL:
        unit = joint_unit(robot, joint)
        may_be_degrees = unit == "rad" and argument != "keyframe"
        problem = diagnose(
            "joint-out-of-range",
            subject=("joint", joint),
            position=Quantity(round(position, 9), unit),
            bonds=bonds or None,
            written=suggest_degrees(position, low, high) if may_be_degrees else None,
            low=Quantity(low, unit),
            high=Quantity(high, unit),
        )
        raise ConfigurationError(argument, problem)


def get_joint_units(robot: Robot, joint: str) -> JointUnits:
    """Return the units of a joint's position, velocity and effort, by its type (hinge or slide)."""
    return select_joint_units(slides=is_slide(robot, joint))


def check_motor_joints(robot: Robot, joints: Iterable[str], argument: str) -> None:
    """Raise a ConfigurationError if a rotary motor is assigned to a slide.

    Reason: the transmission from a rotary motor to a slide is unknown.

    Args:
        robot: Robot.
        joints: Joints to which motors are assigned.
        argument: Name of the argument or option, for the message.
    """
    chosen = list(joints)
    slides = [joint for joint in chosen if is_slide(robot, joint)]
    if slides:
        hinges = [joint for joint in chosen if joint not in slides]
        patterns = find_name_patterns(hinges, robot.joint_names)
        problem = diagnose("motor-at-slide", joints=slides, patterns=patterns)
        raise ConfigurationError(argument, problem)


def get_common_units(robot: Robot, joints: Iterable[str]) -> JointUnits:
    """Return the common units of position, velocity, effort etc. of several joints.

    If hinges and slides are mixed, each unit names both units, such as "rad or m".
    """
    return combine_joint_units(get_joint_units(robot, joint) for joint in joints)


def joint_unit(robot: Robot, joint: str) -> str:
    """Return the unit of the position of a joint: m for slides, rad for hinges."""
    return get_joint_units(robot, joint).position


def force_unit(robot: Robot, joint: str) -> str:
    """Return the unit of the motor force of a joint: N for slides, N m for hinges."""
    return get_joint_units(robot, joint).effort


def list_position_units(robot: Robot) -> tuple[str, ...]:
    """Return the unit of each joint position, ``"rad"`` or ``"m"``, in actuator order."""
    return tuple(joint_unit(robot, name) for name in robot.joint_names)


def list_force_units(robot: Robot) -> tuple[str, ...]:
    """Return the unit of each motor torque or force, ``"N m"`` or ``"N"``, in actuator order."""
    return tuple(force_unit(robot, name) for name in robot.joint_names)
