"""Soles on legs that cannot lay them quite flat: they lie as the legs lay them, to micrometres.

A leg of four joints has three for its sole's place in a plane and its pitch. Roll and yaw are the
leg's own, and a sole that is a microradian off level, by its mesh's digits or by what it sinks in,
cannot be laid as it should. A leg of five joints lacks one of roll, pitch and yaw.
"""

from __future__ import annotations

from dataclasses import replace

import pinocchio as pin

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.frozen import freeze_arrays
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.problem import Goal
from pupper_analysis.stance.solver import Point

_YIELD = 5e-5
"""Soles give way by less (m): a tenth of what feet sink in, and no more."""

_JOINTS = 6  # of a leg that lays its sole anywhere, in any orientation


def has_underactuated_feet(robot: Robot) -> bool:
    """Tells whether a robot has soles that its legs, of fewer than six joints, lay as they can."""
    return any(
        len(points) > 1 and _joints_to(robot, points[0]) < _JOINTS for points in robot.feet.values()
    )


def find_missing_joints(robot: Robot, goal: Goal) -> Diagnostic | None:
    """Tells which joints the legs lack for a sole that is lifted or moved; None if none.

    Or for loops and couplings that give way.
    """
    task = goal.task
    if goal.give is not None and goal.give.any():
        return diagnose("loops-give-way", most=float(abs(goal.give).max()))
    moved = [
        sole for sole in robot.feet if {sole, *robot.feet[sole]} & {*task.swing, *task.foot_offsets}
    ]
    short = {
        sole: _joints_to(robot, robot.feet[sole][0]) for sole in moved if len(robot.feet[sole]) > 1
    }
    if not short or min(short.values()) >= _JOINTS:
        return None
    sole = min(short, key=short.__getitem__)
    return diagnose("sole-needs-six-joints", subject=("foot", sole), joints=short[sole])


def _joints_to(robot: Robot, point: str) -> int:
    """Returns how many joints move a contact point against the base."""
    model = robot.pin_model
    frame = model.getFrameId(robot.contact_frames[point], pin.FrameType.BODY)
    above = model.supports[model.frames[frame].parentJoint]
    return sum(model.names[joint] in robot.joint_names for joint in above)


def relax_foot_orientation(robot: Robot, goal: Goal, point: Point) -> Goal:
    """Returns a goal whose feet are where a configuration has them, if they miss by micrometres.

    Args:
        robot: The robot.
        goal: The goal.
        point: Where a solver ended.
    """
    if point.exact or point.miss >= _YIELD or not has_underactuated_feet(robot):
        return goal
    places = Configuration(robot, point.qpos).foot_positions()
    return replace(goal, targets=freeze_arrays({foot: places[foot] for foot in goal.targets}))
