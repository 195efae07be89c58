"""Where the joints of a standing robot are that carry no foot: its arms, its head."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase

from pupper_analysis.base.arguments import check_finite
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.robot.robot import Robot

_ROUNDED = 1e-6
"""A position that is further beyond a limit is out of range (rad, m): both are typed."""


def placed_joints(robot: Robot, posture: Mapping[str, float]) -> dict[str, float]:
    """Returns {joint: its position} of a stand's posture.

    Args:
        robot: The robot.
        posture: {joint, or a pattern such as ``*elbow*``: its position (rad, m)}; of patterns that
            match the same joint the last counts.

    Raises:
        UnknownNameError: If there is no such joint; the message lists those that are.
        ConfigurationError: If a joint carries a foot or is part of a loop.
    """
    placed = named_positions(robot, posture, "posture") if posture else {}
    free = free_joints(robot) if placed else ()
    for joint in placed:
        if joint not in free:
            raise ConfigurationError("posture", diagnose("joint-is-the-stands", joint=joint))
    return placed


def free_joints(robot: Robot) -> tuple[str, ...]:
    """Returns the joints that carry no foot and are in no loop or coupling, in actuator order."""
    model = robot.structure.model
    bound = {
        model.names[one]
        for foot in robot.structure.parents.values()
        for one in list(model.supports[foot])
    }
    if robot.closure is not None:
        both = (*robot.closure.following.tolist(), *robot.closure.leading.tolist())
        bound |= {robot.joint_names[joint] for joint in both}
    return tuple(joint for joint in robot.joint_names if joint not in bound)


def named_positions(
    robot: Robot, joints: Mapping[str, float], argument: str = "joints"
) -> dict[str, float]:
    """Returns {joint: its position} of {joint, or a pattern: position}.

    Raises:
        UnknownNameError: If a pattern matches no joint.
        ConfigurationError: If a position is no finite number.
    """
    given: dict[str, float] = {}
    for pattern, value in joints.items():
        chosen = [joint for joint in robot.joint_names if fnmatchcase(joint, pattern)]
        if not chosen:
            raise UnknownNameError(robot.name, "joint", pattern, robot.joint_names).at(argument)
        given |= dict.fromkeys(chosen, check_finite(f"{argument} {pattern!r}", value))
    return given


def check_in_range(
    robot: Robot, joint: str, position: float, ends: tuple[float, float], argument: str
) -> None:
    """Checks that a joint's position is within its range.

    Raises:
        ConfigurationError: If it is not.
    """
    low, high = ends
    if not low - _ROUNDED <= position <= high + _ROUNDED:
        unit = joint_unit(robot, joint)
        problem = diagnose(
            "joint-out-of-range",
            subject=("joint", joint),
            position=Quantity(position, unit),
            low=Quantity(low, unit),
            high=Quantity(high, unit),
        )
        raise ConfigurationError(argument, problem)


def joint_unit(robot: Robot, joint: str) -> str:
    """Returns the unit of a joint's position: rad, or m of one that slides."""
    model = robot.mj_model
    return "m" if model.jnt_type[model.joint(joint).id] == JointKind.SLIDE else "rad"
