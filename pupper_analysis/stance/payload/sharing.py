"""What motors bear if their legs share the load as these can: a linear programme."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.results import Result
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Place, find_place
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.contacts import make_contacts

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sharing(Result):
    """The greatest payload with which some vertical contact forces keep all motors within limits.

    Attributes:
        mass: kg; infinite if the motors set no limit.
        joint_torques: (nu,) the feed-forward with which legs share it so (N m); the servos are
            commanded ctrl = q* + tau / kp with q* of the feet as deep as their forces push them.
        normal_forces: {foot that carries: N}.
    """

    mass: float
    joint_torques: Array
    normal_forces: dict[str, float]


def share_load(robot: Robot, stand: Stand, point: Place) -> Sharing | None:
    """Finds the greatest payload that motors bear with any sharing of the load among the feet.

    Without tangential forces, which creep away, the feet's normal forces n and the mass m obey
    three equations of balance, g + m |g| J_p^T e_z = J^T n in the base's rows that lift and tilt.
    Three feet have one answer; more share the load as the motors' limits allow. The greatest m is a
    linear programme.

    Args:
        robot: The robot.
        stand: How it stands, without payload.
        point: Where the mass is, as in ``with_payload``.

    Returns:
        The sharing; None on a slope, where tangential forces carry, too, or if no sharing bears it.
    """
    from scipy import optimize  # slow to import

    if not all(np.array_equal(normal, UP) for normal in stand.normals.values()):
        return None
    config, feet = Configuration(robot, stand.qpos), stand.stance_feet
    carrying = make_contacts(robot, feet, None, stand.normals, stand.depths)
    lifting = config.by_motors(carrying.jacobian(config))[:, 2::3]
    loading = config.by_motors(find_place(robot, point).load_per_mass(config))
    held, limits = config.by_motors(config.load()), robot.effort_limits
    weight = robot.total_mass * float(np.linalg.norm(robot.gravity))
    # In weights, and masses of the robot: all unknowns are of the order of 1.
    table = np.column_stack([lifting, -robot.total_mass * loading / weight])
    balance, joints, motors = slice(2, 5), slice(6, None), np.isfinite(limits)
    rows = table[joints][motors]
    room = np.concatenate([(limits - held[joints])[motors], (limits + held[joints])[motors]])
    found = optimize.linprog(
        -np.eye(len(feet) + 1)[-1],
        A_ub=np.concatenate([-rows, rows]),
        b_ub=room / weight,
        A_eq=table[balance],
        b_eq=held[balance] / weight,
    )
    if found.status == _UNBOUNDED:
        return Sharing(math.inf, np.full(robot.nu, np.nan), dict.fromkeys(feet, math.nan))
    if not found.success:
        return None
    torques = held[joints] - weight * table[joints] @ found.x
    normal = dict(zip(feet, (weight * found.x[:-1]).tolist(), strict=True))
    return Sharing(float(found.x[-1]) * robot.total_mass, torques, normal)


_UNBOUNDED = 3  # of scipy's linprog
