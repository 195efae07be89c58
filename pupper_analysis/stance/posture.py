"""Posture of a robot with a fixed base: commanded joint positions, from options or a keyframe.

`find_posture` takes positions of some joints [rad, m]. It completes them from a keyframe or the
middle of the joint ranges, closes loops and couplings, and checks the limits. `held_stand` converts
a posture to a stand without feet, so that the functions for stands can simulate and judge it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.robot.joints import (
    check_in_range,
    default_positions,
    joint_ranges,
    named_positions,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.judge import Stand, attach_robot
from pupper_analysis.stance.task import StandTask

_MAX_CLOSING_DISPLACEMENT = 1e-3
"""Largest displacement [rad, m] of a joint with a given position, to close a loop. The displacement
corrects the rounding of typed positions. The error about another joint out of range names the loops
if closing them moved the joint by more. Chosen, not tuned."""

LIMIT_TOLERANCE = 1e-6
"""Largest excess of a joint position over a joint limit [rad, m] that `steady_state` accepts as
rounding. Chosen, not tuned."""


class PostureSource(StrEnum):
    """Source of the joint positions that the caller of `find_posture` did not give."""

    KEYFRAME = "a keyframe of the MJCF"
    MIDDLE = "the middle of the joints' ranges"


@dataclass(frozen=True, eq=False)
class Posture(Result):
    """Commanded posture of a robot with a fixed base.

    Attributes:
        joint_names: Names of the joints, in actuator order.
        qpos: Joint positions, shape (nu,) (rad, or m of a slide); the complete qpos of such a
            robot.
        source: Source of the joint positions that were not given.
        keyframe: Name of the keyframe; "" without a keyframe, or if the keyframe has no name.
        requested_joints: Names of the joints whose positions were requested.
    """

    joint_names: tuple[str, ...]
    qpos: Array = field(metadata={"unit": "rad"})
    source: PostureSource
    keyframe: str
    requested_joints: tuple[str, ...]


def check_fixed_base(robot: Robot) -> None:
    """Check that the base of a robot is fixed to the world; raise an error otherwise.

    Raises:
        ConfigurationError: If the base is free, or falls along a joint without motor.
    """
    if robot.floating:
        raise ConfigurationError("robot", diagnose("base-is-free", robot=robot.name))
    robot.check_base_is_held()


@check_arguments
def find_posture(
    robot: Robot, joints: Mapping[str, float] | None = None, *, keyframe: str | None = None
) -> Posture:
    """Complete given joint positions to a posture of all joints, for a robot with a fixed base.

    Joints that are not given have the positions of a keyframe, or without a keyframe the middle of
    their ranges (zero, if possible, for an unlimited joint). Joints of loops and couplings then
    move to close loops; given joints move by at most 1e-3 rad or m. Driven joints stay at the
    positions of a keyframe if dependent joints alone can close the loops.

    Args:
        robot: Robot with a fixed base.
        joints: {joint, or a pattern such as ``*elbow*``: position [rad, m]}. If several patterns
            match a joint, the last counts.
        keyframe: Keyframe of the MJCF for joints that are not given. Default: ``home``, or the
            first keyframe if there is no ``home``. If the positions of this default keyframe are
            outside of the joint ranges by more than rounding, no keyframe is used.

    Raises:
        ConfigurationError: If the base is free, a position is out of range, or closed loops and
            couplings cannot be closed.
        UnknownNameError: If a joint or the keyframe is unknown.
    """
    check_fixed_base(robot)
    ranges = joint_ranges(robot)
    qpos, name = default_positions(robot, keyframe)
    source = PostureSource.MIDDLE if name is None else PostureSource.KEYFRAME
    given = named_positions(robot, joints or {})
    for joint, position in given.items():
        qpos[robot.joint_names.index(joint)] = position
    placed = np.array([robot.joint_names.index(joint) for joint in given], dtype=np.int64)
    start = qpos
    qpos = close_posture(robot, start, placed, keeps_driven=source is PostureSource.KEYFRAME)
    moved = np.abs(qpos - start) > _MAX_CLOSING_DISPLACEMENT
    for joint, position, ends, by in zip(robot.joint_names, qpos, ranges, moved, strict=True):
        bonds = robot.closure.constraint_names if robot.closure is not None and by else ()
        stated = "keyframe" if source is PostureSource.KEYFRAME and joint not in given else "joints"
        check_in_range(robot, joint, float(position), tuple(ends.tolist()), stated, bonds)
    return Posture(robot.joint_names, qpos, source, name or "", tuple(given))


def close_posture(
    robot: Robot, qpos: Array, placed: NDArray[np.int64], *, keeps_driven: bool
) -> Array:
    """Close loops and couplings near a posture of a robot with a fixed base.

    Args:
        robot: Robot with a fixed base.
        qpos: Joint positions, shape (nu,) [rad, m], whose loops may be open.
        placed: Indices of the joints that move by at most 1e-3 rad or m.
        keeps_driven: Whether driven joints stay in place, if dependent joints alone can close the
            loops within the joint ranges.

    Returns:
        Joint positions, shape (nu,) [rad, m], perhaps outside of the joint ranges.

    Raises:
        ConfigurationError: If loops and couplings cannot be closed.
    """
    if robot.closure is None:
        return qpos
    ranges, following = joint_ranges(robot), np.zeros(robot.nu)
    following[np.setdiff1d(robot.closure.dependent_joints, placed)] = 1.0
    closed = robot.closure.close_loops(qpos, following) if keeps_driven else None
    if closed is not None and _is_within(closed, ranges):
        return closed
    closed = _close_loops(robot, qpos, placed)
    if _is_within(closed, ranges):
        return closed
    # Ranges of unequal width, for example of a finger and the follower with another limit.
    followed = robot.closure.close_loops(qpos, following)
    return followed if followed is not None and _is_within(followed, ranges) else closed


def _is_within(qpos: Array, ranges: Array) -> bool:
    """Return True if all joint positions, shape (nu,), are within the ranges, shape (nu, 2)."""
    return bool(((ranges[:, 0] <= qpos) & (qpos <= ranges[:, 1])).all())


def _close_loops(robot: Robot, qpos: Array, placed: NDArray[np.int64]) -> Array:
    """Return positions (nu,) near ``qpos`` that close all loops; ``placed`` joints hardly move."""
    if robot.closure is None:
        return qpos
    moving = np.ones(robot.nu)
    moving[placed] = 0.0
    closed = robot.closure.close_loops(qpos, moving)
    if closed is None:  # two given joints of one loop are rounded
        closed = robot.closure.close_loops(qpos, robot.closure.step_weights(placed))
        if closed is not None and (np.abs(closed - qpos)[placed] > _MAX_CLOSING_DISPLACEMENT).any():
            closed = None
    if closed is None:
        problem = diagnose("posture-does-not-close", bonds=robot.closure.constraint_names)
        raise ConfigurationError("joints", problem)
    return closed


@check_arguments
def held_stand(robot: Robot, posture: Posture) -> Stand:
    """Convert a posture to a stand without feet, for the functions that simulate and judge stands.

    Args:
        robot: Robot with a fixed base.
        posture: Commanded joint positions, from `find_posture`.

    Raises:
        ConfigurationError: If the base is free, for example.
    """
    check_fixed_base(robot)
    stand = Stand(task=StandTask(), qpos=posture.qpos, robot=robot.fingerprint)
    return attach_robot(stand, robot)
