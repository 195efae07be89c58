"""Whether a robot's joints can move its com to every place over its feet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_POSES = 3
"""How many random poses are looked at: the first may be singular."""

_LEAST_COM_RATE = 1e-6
"""A com that moves by less against the base, per unit of joint rates, does not move (m/rad)."""

_SIDEWAYS = 1e-3
"""Nor does one that moves by less of how it moves the other way: soles that are a microradian off
level let it."""


def can_move_com(robot: Robot) -> bool:
    """Tells whether a robot can move its com in x and in y with its feet where they are.

    The base keeps its height and orientation. Legs of three joints or more can do it; legs of two,
    that swing in a plane, cannot move it sideways, unless arms or a waist do.
    """
    return robot.once(_moves_com)


def _moves_com(robot: Robot) -> bool:
    if not robot.contact_points:
        return True
    if len(robot.feet) < len(robot.contact_points):
        # Soles and wheels lie on the ground: in other poses other motions are free.
        return any(_ways(robot, pose) == 2 for pose in (robot.nominal, robot.home[-robot.nu :]))
    random = np.random.default_rng(0)
    low, high = np.maximum(robot.lower_limits, -np.pi), np.minimum(robot.upper_limits, np.pi)
    return any(_ways(robot, random.uniform(low, np.maximum(low, high))) == 2 for _ in range(_POSES))


def _ways(robot: Robot, joints: Array) -> int:
    """Returns in how many directions the com can move, seen from above, at positions (nu,)."""
    config = Configuration(robot, robot.posed(joints))
    held = np.eye(4, robot.nv, k=2)  # the base's height and its three turns
    feet = np.vstack(list(config.foot_jacobians().values()))
    free = linalg.null_space(np.vstack([held, feet]), rcond=1e-9)
    moved = config.com_jacobian()[:2] @ free
    sizes = np.linalg.svd(moved, compute_uv=False)
    return int((sizes > max(_LEAST_COM_RATE, _SIDEWAYS * float(sizes.max(initial=0.0)))).sum())
