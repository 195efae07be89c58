"""A robot with a payload welded to it, in both of its models."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.description import ModelTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Place, find_place

Array = NDArray[np.float64]

_NAME = "payload"


@check_arguments
def with_payload(
    robot: Robot,
    mass: float,
    point: Place = (0.0, 0.0, 0.0),
) -> Robot:
    """Welds a point mass to a robot, in the URDF's model and in the MJCF's.

    All else stays: joints, limits, gains, feet, and the height of the nominal stand. MuJoCo derives
    the softness of a contact from the mass behind it (``body_invweight0``): that is the loaded
    robot's, so that every prediction and simulation of the robot returned is of the loaded one.

    Args:
        robot: The robot.
        mass: Of the payload (kg), finite and >= 0.
        point: (3,) where it is, in the base's frame (m); or in that of a link, site or body, as
            ``("right_hand", 0.0, 0.0, 0.05)``, or a ``Tool``.

    Returns:
        The loaded robot; the robot itself for no mass.

    Raises:
        ConfigurationError: If the mass or the point is none, or it is for a base that is fixed.
        UnknownNameError: If the robot has no such link.
        ModelError: If the MJCF's base is not where the URDF's is.
    """
    tool = find_place(robot, point)
    try:
        weighed = float(mass)
    except (TypeError, ValueError):
        weighed = math.nan
    if isinstance(mass, bool) or not 0 <= weighed < math.inf:
        raise ConfigurationError("mass", diagnose("payload-not-valid", mass=repr(mass)))
    mass = weighed
    if mass == 0.0:
        return robot
    if tool.link == robot.base:
        robot.check_floating()
    link, place = tool.link, tool.offset
    body, there = tool.in_mjcf(robot)
    (urdf, mjcf), name = robot.description.trees(), _NAME
    sides: tuple[tuple[ModelTree, str, Array], ...] = ((urdf, link, place), (mjcf, body, there))
    while any(name in tree.names for tree, _, _ in sides):
        name += "_"
    weight = pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
    for tree, carrier, at in sides:
        tree.add_link(name, carrier, f"{name}_weld", at, weight)
    built = rebuild_robot(robot, urdf=to_text(urdf.root), mjcf=mjcf.spec)
    # What was changed in Pinocchio's model since it was read, such as a limit, stays.
    model = robot.pin_model.copy()
    on = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    welded = on.placement.act(pin.Inertia(mass, place, np.zeros((3, 3))))
    model.inertias[on.parentJoint] = model.inertias[on.parentJoint] + welded
    # The unloaded robot's stands are its own.
    return replace(built, pin_model=model, fingerprint=robot.fingerprint)
