"""Joints whose axis alone is elsewhere, while what they move is in place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.models.multibody import MultibodyTree, TreeJoint
from pupper_analysis.robot.compare.patterns.case import Found, PatternCase, PatternFinding
from pupper_analysis.robot.matching.alignment import in_body_frame

_PARALLEL = 1e-9  # sine of an angle

_MOST_MOVED_JOINTS = 20
"""Joints elsewhere of which no single one is looked at: it is another robot, and each look takes as
long as a comparison."""


def other_lines(case: PatternCase) -> Found:
    """Finds joints whose axis alone is elsewhere.

    A body is drawn from its joint on: if that is moved, com, children and frames all are at other
    places as seen from it, though none of them has moved in the robot.
    """
    names = [element for kind, element in case.keys if kind == "position"]
    for name in names if len(names) <= _MOST_MOVED_JOINTS else ():
        moved = with_line_of(case.second, case.first, name)
        gone = case.gone(moved)
        if ("position", name) not in gone:
            continue
        away, angle = _apart(case.first.joints[name], case.second.joints[name])
        yield PatternFinding(
            "line",
            diagnose(
                "axis-elsewhere",
                subject=("joint", name),
                distance=Quantity(away, "m") if away > case.tolerances.position else None,
                angle=Quantity(angle, "rad") if angle > case.tolerances.axis else None,
            ),
            gone,
        )


def with_line_of(values: MultibodyTree, other: MultibodyTree, name: str) -> MultibodyTree:
    """Returns a robot in which a joint turns about another's axis; its body stays at zero.

    Args:
        values: The robot.
        other: A robot with that joint, in the same frame of the parent's.
        name: The joint.
    """
    mine, new = values.joints[name], other.joints[name]
    put = new.placement.actInv(mine.placement)
    joint = replace(mine, position=new.position, rotation=new.rotation, axis=new.axis)
    turned = in_body_frame(values, name, np.array(put.rotation), np.array(put.translation))
    return replace(turned, joints={**turned.joints, name: joint})


def _apart(one: TreeJoint, two: TreeJoint) -> tuple[float, float]:
    """Returns the distance (m) of two joints' axes, and the angle (rad) between them.

    In the frame of the parent, at zero; an axis of the opposite sign is the same line.
    """
    first, second = one.rotation @ one.axis, two.rotation @ two.axis
    between, across = two.position - one.position, np.cross(first, second)
    sine = float(np.linalg.norm(across))
    if sine > _PARALLEL:
        away = abs(float(between @ across)) / sine
    else:
        away = float(np.linalg.norm(np.cross(between, first)))
    return away, float(np.arctan2(sine, abs(float(first @ second))))
