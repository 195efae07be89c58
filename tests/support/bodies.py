"""Bodies of a robot in each engine."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

import pupper_analysis as pa
from tests.support.engines import evaluate_mujoco


class Body(NamedTuple):
    """Moving body, expressed in the axes of the base at zero angles, with positions from the base.

    Attributes:
        mass: Mass [kg].
        com: Centre of mass (3,) [m].
        inertia: Inertia (3, 3) about the CoM [kg m^2].
        position: Origin of the body's frame (3,) [m].
        rotation: Rotation (3, 3) of the body's frame.
    """

    mass: float
    com: np.ndarray
    inertia: np.ndarray
    position: np.ndarray
    rotation: np.ndarray


def pinocchio_bodies(robot: pa.Robot) -> dict[str, Body]:
    """Return {joint, or "base": moved body} by Pinocchio from the URDF."""
    model = robot.pin_model
    config = pa.Configuration(robot, robot.neutral())
    bodies = {}
    for index in range(1, model.njoints):
        name = "base" if index == 1 else str(model.names[index])
        frame = robot.base
        if index > 1:
            links = (f for f in model.frames if f.type == pin.FrameType.BODY)
            frame = next(link.name for link in links if link.parentJoint == index)
        inertia, rotation = model.inertias[index], config.frame_rotation(frame)
        origin = config.frame_position(frame)
        bodies[name] = Body(
            float(inertia.mass),
            origin + rotation @ inertia.lever,
            rotation @ inertia.inertia @ rotation.T,
            origin,
            rotation,
        )
    return bodies


def mujoco_bodies(robot: pa.Robot) -> dict[str, Body]:
    """Return {joint, or "base": moved body} by MuJoCo from the MJCF."""
    model = robot.mj_model
    data = evaluate_mujoco(robot, robot.neutral())
    bodies = {}
    for index in range(1, model.nbody):
        joint = model.joint(int(model.body_jntadr[index]))
        name = "base" if index == 1 else str(joint.name)
        axes = data.ximat[index].reshape(3, 3)
        bodies[name] = Body(
            float(model.body_mass[index]),
            data.xipos[index].copy(),
            axes @ np.diag(model.body_inertia[index]) @ axes.T,
            data.xpos[index].copy(),
            data.xmat[index].reshape(3, 3).copy(),
        )
    return bodies


BODIES = {"urdf": pinocchio_bodies, "mjcf": mujoco_bodies}
"""{format: function that returns the bodies}."""


def assert_same_bodies(one: dict[str, Body], two: dict[str, Body], tolerance: float) -> None:
    """Check that two robots have equal bodies, relative to the size of each quantity."""
    assert one.keys() == two.keys()
    for name, body in one.items():
        for field, value in body._asdict().items():
            other = getattr(two[name], field)
            size = max(float(np.abs(value).max()), 1e-2 if field in ("com", "position") else 0.0)
            np.testing.assert_allclose(
                other, value, rtol=0, atol=tolerance * size, err_msg=f"{name}: {field}"
            )
