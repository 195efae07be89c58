"""The bodies of a robot, as each engine has them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

import pupper_analysis as pa
from tests.support.engines import mujoco_at


class Body(NamedTuple):
    """A moving body: mass [kg], com [m] and inertia about it [kg m^2], and the frame's pose.

    All are in the axes of the base at zero angles, positions from the base.
    """

    mass: float
    com: np.ndarray
    inertia: np.ndarray
    position: np.ndarray
    rotation: np.ndarray


def pinocchio_bodies(robot: pa.Robot) -> dict[str, Body]:
    """What moves with each joint (and with the base, "base"), by Pinocchio from the URDF."""
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
    """The same by MuJoCo from the MJCF."""
    model = robot.mj_model
    data = mujoco_at(robot, robot.neutral())
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


def assert_same_bodies(one: dict[str, Body], two: dict[str, Body], tolerance: float) -> None:
    """Compare all there is, relative to the size of each quantity."""
    assert one.keys() == two.keys()
    for name, body in one.items():
        for field, value in body._asdict().items():
            other = getattr(two[name], field)
            size = max(float(np.abs(value).max()), 1e-2 if field in ("com", "position") else 0.0)
            np.testing.assert_allclose(
                other, value, rtol=0, atol=tolerance * size, err_msg=f"{name}: {field}"
            )
