"""Joints whose axis alone is elsewhere, while what they move is in place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from pupper_analysis.checks.patterns.case import Found, PatternCase, PatternFinding
from pupper_analysis.diagnostics import Quantity, diagnose
from pupper_analysis.models.multibody import MultibodyTree, TreeJoint

_PARALLEL = 1e-9  # sine of an angle

_MANY = 20
"""Joints elsewhere of which no single one is looked at: it is another robot, and each look takes as
long as a comparison."""


def other_lines(case: PatternCase) -> Found:
    """Finds joints whose axis alone is elsewhere.

    A body is drawn from its joint on: if that is moved, com, children and frames all are at other
    places as seen from it, though none of them has moved in the robot.
    """
    names = [element for kind, element in case.keys if kind == "position"]
    for name in names if len(names) <= _MANY else ():
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
    before = pin.SE3(mine.rotation, mine.position)
    put = pin.SE3(new.rotation, new.position).actInv(before)
    joint = replace(mine, position=new.position, rotation=new.rotation, axis=new.axis)
    joints = {**values.joints, name: joint}
    for child in values.children(name):
        place = put * pin.SE3(values.joints[child].rotation, values.joints[child].position)
        joints[child] = replace(
            values.joints[child],
            position=np.array(place.translation),
            rotation=np.array(place.rotation),
        )
    body = values.bodies[name]
    turned = replace(
        body,
        com=np.array(put.act(body.com)),
        inertia=put.rotation @ body.inertia @ put.rotation.T,
    )
    frames = {
        frame: (owner, np.array(put.act(place)) if owner == name else place)
        for frame, (owner, place) in values.frames.items()
    }
    return replace(values, joints=joints, bodies={**values.bodies, name: turned}, frames=frames)


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
