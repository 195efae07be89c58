"""Bodies that can be: what stands and falls has mass."""

from __future__ import annotations

import numpy as np

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.robot.robot import Robot

_ROUNDING = 1e-6
"""Of a body's largest moment of inertia: so much less than nothing is rounding, also a file's."""


def check_bodies(robot: Robot) -> None:
    """Checks that what moves with each joint has no negative mass or moment of inertia.

    A robot that has passed is not looked at again: it does not change.

    Raises:
        ModelError: If one has; it names the joint.
    """
    robot.once(_check_bodies)


def _check_bodies(robot: Robot) -> None:
    model = robot.pin_model
    for name, inertia in zip(list(model.names)[1:], list(model.inertias)[1:], strict=True):
        moments = np.linalg.eigvalsh(inertia.inertia)
        if inertia.mass < 0 or moments[0] < -_ROUNDING * np.abs(moments).max():
            problem = diagnose(
                "inertial-of-no-body",
                subject=None if name == "root_joint" else ("joint", name),
                joint=None if name == "root_joint" else name,
                mass=Quantity(inertia.mass, "kg"),
                moment=Quantity(moments[0], "kg m^2"),
            )
            raise ModelError(robot.description.urdf_source, problem)
