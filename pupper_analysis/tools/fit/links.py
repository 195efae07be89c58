"""The links that bodies are named by: of all that a joint moves, the one whose frame is its own."""

from __future__ import annotations

import pinocchio as pin

from pupper_analysis.robot.robot import Robot

AXES = ("x", "y", "z")
"""Components of a com, in the link's frame."""


def link_of(model: pin.Model, number: int) -> str:
    """Returns the URDF's link that a joint of Pinocchio's moves.

    Args:
        model: The model.
        number: The joint's.
    """
    frames = [
        frame
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and frame.parentJoint == number
    ]
    own = next((frame for frame in frames if frame.placement.isIdentity(1e-12)), frames[0])
    return str(own.name)


def bodies_of(robot: Robot) -> tuple[tuple[str, int], ...]:
    """Returns the moving bodies of a robot: the link each is named by, and its joint's number.

    The links that are fixed to it are part of it. What has no mass is left out.
    """
    model = robot.structure.model
    return tuple(
        (link_of(model, number), number)
        for number in range(1, model.njoints)
        if model.inertias[number].mass > 0
    )
