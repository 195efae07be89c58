"""Where a robot whose base is held is commanded to be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.robot.joints import (
    check_in_range,
    default_positions,
    joint_ranges,
    joint_unit,
    named_positions,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.task import StandTask

Array = NDArray[np.float64]

_SLACK = 1e-3
"""Largest displacement [rad, m] of a given joint of a loop that closes the loop (rounding)."""

LIMIT_TOLERANCE = 1e-6
"""What is nearer to a limit is at it (rad, m): rounding."""


class PostureSource(StrEnum):
    """Where a posture is from, but for the joints that were given."""

    KEYFRAME = "a keyframe of the MJCF"
    MIDDLE = "the middle of the joints' ranges"


@dataclass(frozen=True, eq=False)
class Posture(Result):
    """Where a robot whose base is held is commanded to be.

    Attributes:
        joint_names: In actuator order.
        qpos: (nu,) joint positions (rad, m of a joint that slides): all of a held robot's qpos.
        source: Where it is from, but for the joints that were given.
        keyframe: The keyframe's name; "" if it is from none, or that has no name.
        given: The joints that were given.
    """

    joint_names: tuple[str, ...]
    qpos: Array = field(metadata={"unit": "rad"})
    source: PostureSource
    keyframe: str
    given: tuple[str, ...]


def check_held(robot: Robot) -> None:
    """Checks that a robot's base is held in the world.

    Raises:
        ConfigurationError: If it is free.
    """
    if robot.floating:
        raise ConfigurationError("robot", diagnose("base-is-free", robot=robot.name))


def joint_units(robot: Robot) -> tuple[str, ...]:
    """Returns the unit of each joint's position: rad, or m of one that slides."""
    return tuple(joint_unit(robot, name) for name in robot.joint_names)


@check_arguments
def find_posture(
    robot: Robot, joints: Mapping[str, float] | None = None, *, keyframe: str | None = None
) -> Posture:
    """Finds the posture that is asked for.

    Joints that are not given are where a keyframe has them, or else in the middle of their ranges,
    at zero where they have none. Joints that follow others are where these take them.

    Args:
        robot: A robot whose base is held.
        joints: {joint, or a pattern such as ``*elbow*``: its position (rad, m)}; of patterns that
            match the same joint the last counts.
        keyframe: The MJCF's keyframe for the others; by default ``home``, or else the first, if
            it is within the joints' ranges.

    Raises:
        ConfigurationError: If the base is free, a position is out of its joint's range, or
            loops and couplings of joints cannot be closed there.
        UnknownNameError: If a joint or the keyframe is not there; the message lists what is.
    """
    check_held(robot)
    ranges = joint_ranges(robot)
    qpos, name = default_positions(robot, keyframe)
    source = PostureSource.MIDDLE if name is None else PostureSource.KEYFRAME
    given = named_positions(robot, joints or {})
    for joint, position in given.items():
        qpos[robot.joint_names.index(joint)] = position
    placed = np.array([robot.joint_names.index(joint) for joint in given], dtype=np.int64)
    start = qpos
    qpos = _closed(robot, start, placed)
    moved = np.abs(qpos - start) > _SLACK
    for joint, position, ends, by in zip(robot.joint_names, qpos, ranges, moved, strict=True):
        bonds = robot.closure.bonds if robot.closure is not None and by else ()
        stated = "keyframe" if source is PostureSource.KEYFRAME and joint not in given else "joints"
        check_in_range(robot, joint, float(position), tuple(ends.tolist()), stated, bonds)
    return Posture(robot.joint_names, qpos, source, name or "", tuple(given))


def _closed(robot: Robot, qpos: Array, placed: NDArray[np.int64]) -> Array:
    """Closes loops and couplings near a posture (nu,), some joints of which are given.

    Raises:
        ConfigurationError: If they cannot be closed there.
    """
    if robot.closure is None:
        return qpos
    moving = np.ones(robot.nu)
    moving[placed] = 0.0
    closed = robot.closure.closed(qpos, moving)
    if closed is None:  # which are rounded, if two of a loop are given
        closed = robot.closure.closed(qpos, robot.closure.readiness(placed))
        if closed is not None and (np.abs(closed - qpos)[placed] > _SLACK).any():
            closed = None
    if closed is None:
        problem = diagnose("posture-does-not-close", bonds=robot.closure.bonds)
        raise ConfigurationError("joints", problem)
    return closed


@check_arguments
def held_stand(robot: Robot, posture: Posture) -> Stand:
    """Return a posture as a stand without feet, for the functions that simulate and judge stands.

    Args:
        robot: A robot whose base is fixed to the world.
        posture: The commanded joint positions.

    Raises:
        ConfigurationError: If the base is free, or an argument has another type.
    """
    check_held(robot)
    return Stand(task=StandTask(), qpos=posture.qpos, robot=robot.fingerprint)
