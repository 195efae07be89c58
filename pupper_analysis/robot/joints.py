"""The joints of a robot: what each does, how long legs are, where those are that carry no foot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fnmatch import fnmatchcase

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_finite
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.base.units import Position
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


OBLIQUE = ("oblique", "oblique slide")
"""What a joint does whose axis is along none of the base's: turns, or slides."""


def joint_motions(robot: Robot) -> dict[str, str]:
    """Returns {joint: what it does, as words of how its axis lies in the base at zero angles}."""
    rest = Configuration(robot, robot.neutral())
    return {
        name: _motion(rest.joint_axis(name), is_slide=is_slide(robot, name))
        for name in robot.joint_names
    }


def is_slide(robot: Robot, joint: str) -> bool:
    """Tells whether a joint slides."""
    kind = robot.mj_model.jnt_type[robot.mj_model.joint(joint).id]
    return bool(kind == JointKind.SLIDE)


def _motion(axis: Array, *, is_slide: bool) -> str:
    """Returns the word for what a joint does."""
    direction = int(np.argmax(np.abs(axis)))
    aligned = abs(axis[direction]) > np.cos(np.radians(1.0))
    if is_slide:
        return f"along {'xyz'[direction]}" if aligned else OBLIQUE[1]
    return ("roll", "pitch", "yaw")[direction] if aligned else OBLIQUE[0]


def leg_joints(robot: Robot, foot: str) -> tuple[str, ...]:
    """Returns the joints that move a foot against the base, from the base outwards.

    Raises:
        UnknownNameError: If the foot is unknown.
    """
    model = robot.pin_model
    frame = model.frames[
        model.getFrameId(robot.contact_frames[robot.check_foot(foot)], pin.FrameType.BODY)
    ]
    support = [model.names[joint] for joint in model.supports[frame.parentJoint]]
    return tuple(name for name in support if name in robot.joint_names)


_ROUNDED = 1e-6
"""A position that is further beyond a limit is out of range (rad, m): both are typed."""


def placed_joints(robot: Robot, posture: Mapping[str, float]) -> Mapping[str, float]:
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
) -> dict[str, Position]:
    """Returns {joint: its position, with its unit} of {joint, or a pattern: position}.

    Raises:
        UnknownNameError: If a pattern matches no joint.
        ConfigurationError: If a position is no finite number, or a length of what turns.
    """
    given: dict[str, Position] = {}
    for pattern, value in joints.items():
        chosen = [joint for joint in robot.joint_names if fnmatchcase(joint, pattern)]
        if not chosen:
            raise UnknownNameError(robot.name, "joint", pattern, robot.joint_names).at(argument)
        place = check_finite(f"{argument} {pattern!r}", value)
        for joint in chosen:
            given[joint] = Position(place, joint_unit(robot, joint))
            if getattr(value, "unit", "rad or m") not in ("rad or m", given[joint].unit):
                slides = is_slide(robot, joint)
                problem = diagnose("joint-slides-or-turns", joint=joint, slides=slides)
                raise ConfigurationError(argument, problem)
    return given


def with_units(robot: Robot, posture: Mapping[str, float]) -> dict[str, float]:
    """Returns a stand's posture with the unit of the joints that each position is of."""
    found = dict(posture)
    for pattern, value in posture.items():
        placed = named_positions(robot, {pattern: value}, "posture")
        units = {one.unit for one in placed.values()}
        found[pattern] = Position(value, *units) if len(units) == 1 else value
    return found


def check_in_range(
    robot: Robot,
    joint: str,
    position: float,
    ends: tuple[float, float],
    argument: str,
    bonds: tuple[str, ...] = (),
) -> None:
    """Checks that a joint's position is within its range.

    Raises:
        ConfigurationError: If it is not.
    """
    low, high = ends
    if not low - _ROUNDED <= position <= high + _ROUNDED:
        unit, degrees = joint_unit(robot, joint), math.radians(position)
        typed = unit == "rad" and argument != "keyframe"
        problem = diagnose(
            "joint-out-of-range",
            subject=("joint", joint),
            position=Quantity(round(position, 9), unit),
            bonds=bonds or None,
            degrees=position if typed and low <= degrees <= high else None,
            low=Quantity(low, unit),
            high=Quantity(high, unit),
        )
        raise ConfigurationError(argument, problem)


def joint_unit(robot: Robot, joint: str) -> str:
    """Returns the unit of a joint's position: rad, or m of one that slides."""
    return "m" if is_slide(robot, joint) else "rad"
