"""A stand judged: Pinocchio's errors of a configuration, and how near its parts come."""

from __future__ import annotations

import math

from numpy.typing import ArrayLike

from pupper_analysis.arrays import angle_between
from pupper_analysis.stance.clearance import Shapes
from pupper_analysis.stance.problem import Goal
from pupper_analysis.stance.solver import Stand
from pupper_analysis.statics.support_polygon import margin_inside


def measure(shapes: Shapes, goal: Goal, qpos: ArrayLike, iterations: int) -> Stand:
    """Returns the stand at a configuration, with its errors and clearances.

    Args:
        shapes: The robot with its shapes.
        goal: What is asked of the stand.
        qpos: (nq,) the configuration.
        iterations: Quadratic programmes that it took.
    """
    robot, task = shapes.robot, goal.task
    own = robot.structure.state(qpos)
    com, feet = shapes.whereabouts.at(own)
    x, y, z, *turn = own[:7].tolist()
    at = (x, y) if goal.by_base else (com[0], com[1])
    # Who changes a stand changes that alone: goals share their arrays.
    targets = {foot: target.copy() for foot, target in goal.targets.items()}
    missed = [math.dist(feet[foot], target.tolist()) for foot, target in targets.items()]
    contacts = dict(zip(goal.stance_feet, goal.contacts.copy(), strict=True))
    return Stand(
        task=task,
        qpos=own,
        foot_targets=targets,
        depths=goal.depths,
        stance_feet=goal.stance_feet,
        normals=dict.fromkeys(goal.stance_feet, task.ground.normal()),
        contact_points=contacts,
        foot_error=max(missed),
        orientation_error=angle_between(goal.turn, turn),
        height_error=abs(z - goal.height),
        com_error=math.dist(at, goal.place.tolist()),
        com_margin=margin_inside((com[0], com[1]), goal.corners),
        ground_clearance=shapes.above_ground(own, task.ground, targets, goal.depths),
        self_clearance=None if task.self_clearance is None else shapes.between_links(own),
        iterations=iterations,
        robot=robot.fingerprint,
    )
