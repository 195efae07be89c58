"""Contacts of a stand that a whole-body posture keeps, and the stand of such a posture.

`keep_contacts` lists the tasks that keep the contact points, welds and grips of a stand in place.
`make_posture_stand` converts a solved posture to a stand on the same contacts. Functions for stands
can then compute statics and simulations of the posture.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import freeze_arrays
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.joints import find_footless_joints
from pupper_analysis.robot.robot import Robot, borrow
from pupper_analysis.stance.judge import Stand, evaluate_stand
from pupper_analysis.stance.posture_tasks import OrientationTask, PositionTask, PostureTask
from pupper_analysis.stance.problem import compute_foot_targets, compute_targets
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.task import StandTask


class KeptContact(NamedTuple):
    """Contact point, weld or grip that a posture keeps in place.

    Attributes:
        name: Name of the contact point, or of the welded or gripping part.
        description: Text for results and messages, for example "contact FR" or "weld base".
        task: Task that keeps the position or the orientation of the link.
    """

    name: str
    description: str
    task: PostureTask


def keep_points(robot: Robot, positions: dict[str, Array]) -> tuple[KeptContact, ...]:
    """Create the IK tasks that keep contact points at given positions.

    Args:
        robot: Robot.
        positions: {contact point: position of its centre in the world, shape (3,) [m]}.

    Raises:
        UnknownNameError: If the robot has no such contact point.
    """
    return tuple(
        KeptContact(
            point,
            f"contact {point}",
            PositionTask(robot.contact_frames[robot.check_foot(point)], position),
        )
        for point, position in positions.items()
    )


def keep_contacts(robot: Robot, stand: Stand) -> tuple[KeptContact, ...]:
    """Create the IK tasks with which a posture keeps the contacts of a stand in place.

    Contact points and grips keep their positions [m] in the world frame; welded parts also keep
    their orientations.

    Args:
        robot: Robot with the contacts of the stand.
        stand: Stand.

    Returns:
        A task per contact point of a stance foot and per grip, two tasks per weld.

    Raises:
        UnknownNameError: If the robot lacks a contact point of the stand.
    """
    kept = [*keep_points(robot, {foot: stand.foot_targets[foot] for foot in stand.stance_feet})]
    at = Configuration(robot, stand.qpos) if robot.fixed_parts else None
    for name, point in robot.fixed_parts.items():
        assert at is not None
        frame = robot.base if point is None else robot.contact_frames[point]
        kind = "grip" if name in robot.grips else "weld"
        kept.append(
            KeptContact(name, f"{kind} {name}", PositionTask(frame, at.frame_position(frame)))
        )
        if kind == "weld":
            turned = OrientationTask(frame, at.frame_rotation(frame))
            kept.append(KeptContact(name, f"orientation of weld {name}", turned))
    return tuple(kept)


def make_posture_stand(robot: Robot, stand: Stand, qpos: Array, iterations: int) -> Stand:
    """Create a `Stand` from a posture that keeps the contacts of a given stand.

    The task of the result requires values of the posture, for example its base pose and CoM.
    Contacts, margins and clearances are taken from the given stand.

    Args:
        robot: Robot with the contacts of the stand.
        stand: Stand whose contacts the posture keeps.
        qpos: Configuration of the posture, shape (nq,).
        iterations: Number of solved or attempted quadratic programs, for the result.

    Raises:
        ConfigurationError: If a lifted foot is not above the ground, for example.
    """
    at = Configuration(robot, qpos)
    task = _place_lifted_feet(robot, stand, _require_base(robot, stand, at), at)
    targets = compute_targets(robot, task, stand.depths, checked=False)
    foot_targets = dict(stand.foot_targets)
    for point in _list_lifted_points(robot, stand):
        foot_targets[point] = at.foot_positions()[point]
    targets = replace(
        targets,
        foot_targets=freeze_arrays(foot_targets),
        contact_by_foot=freeze_arrays(dict(stand.contact_points)),
        normals=freeze_arrays(dict(stand.normals)),
    )
    with borrow(robot, SearchContext) as context:
        return evaluate_stand(context.shapes, targets, at.qpos, iterations)


def _require_base(robot: Robot, stand: Stand, at: Configuration) -> StandTask:
    """Return a stand's task that requires base pose, CoM and footless joints of a configuration.

    `find_footless_joints` defines footless joints. An arm (hands only) has a base position instead
    of the CoM.
    """
    roll, pitch, yaw = map(float, pin.rpy.matrixToRpy(at.base_rotation()))
    centre, first = stand.centre(robot), robot.nq - robot.nu
    joints = dict(zip(robot.joint_names, at.qpos[first:].tolist(), strict=True))
    values: dict[str, Any] = {
        "height": float(at.qpos[2] - centre[2]),
        "roll": roll,
        "pitch": pitch,
        "yaw": yaw,
        "posture": {joint: joints[joint] for joint in find_footless_joints(robot)},
        "ik_seed": tuple(joints.values()),
    }
    if len(robot.hands) == len(robot.feet):
        x, y = (at.qpos[:2] - centre[:2]).tolist()
        return replace(stand.task, **values, offset=(x, y), com=None)
    x, y, _ = at.center_of_mass().tolist()
    return replace(stand.task, **values, offset=None, com=(x, y))


def _list_lifted_points(robot: Robot, stand: Stand) -> tuple[str, ...]:
    """Return the contact points of a stand that carry no load, are not welded and do not grip."""
    fixed = {point for name in robot.fixed_parts for point in robot.feet.get(name, ())}
    return tuple(
        point
        for point in robot.contact_points
        if point not in fixed and point not in stand.stance_feet
    )


def _place_lifted_feet(robot: Robot, stand: Stand, task: StandTask, at: Configuration) -> StandTask:
    """Return a task that requires the positions and heights of lifted feet in a configuration.

    The horizontal positions of hands, and of contacts with a ``place``, are unchanged.
    """
    feet = robot.feet_with(_list_lifted_points(robot, stand))
    positions = at.foot_positions()
    places = {
        foot: tuple(np.mean([positions[point][:2] for point in robot.feet[foot]], axis=0).tolist())
        for foot in feet
        if foot not in robot.hands
        and (foot not in task.contacts or task.contacts[foot].place is None)
    }
    offsets = {foot: by for foot, by in task.foot_offsets.items() if foot not in places}
    placed = replace(task, feet={**task.feet, **places}, foot_offsets=offsets)
    if not feet:
        return placed
    targets = compute_targets(robot, placed, stand.depths, checked=False)
    foot_targets = compute_foot_targets(robot, targets.task)
    heights = dict(placed.swing)
    for foot in feet:
        out = targets.task.ground.normal(foot) if foot in targets.task.ground.planes else UP
        apart = [positions[point] - foot_targets[point] for point in robot.feet[foot]]
        heights[foot] = heights.get(foot, 0.0) + float(np.mean(apart, axis=0) @ out)
        if heights[foot] <= 0.0:
            depth = Quantity(-heights[foot], "m")
            problem = diagnose("lifted-foot-in-ground", foot=foot, depth=depth)
            raise ConfigurationError("tasks", problem)
    return replace(placed, swing=heights)
