"""Feet that creep along a path: MuJoCo's friction lets go of a foot that is pushed as it rolls."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.friction import DryFriction
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.path.pyramid import is_pyramid
from pupper_analysis.stance.path.stance_path import StancePath

Array = NDArray[np.float64]

_SLIDING = 0.98
"""A foot that needs more of its friction slides, and its speed is no matter of friction alone."""


def integrate_creep(robot: Robot, path: StancePath, motion: Array, forces: Array) -> Array:
    """Returns how far each foot has crept along a path (n, feet, 3) (m).

    A contact at rest gives f_t = -c v (``GroundLaw``), and a foot creeps as long as it is pushed.
    One that rolls is at the edge of its cone, |f_t|^2/mu^2 + |m|^2/mu_r^2 = f_n^2, where friction
    takes as much power as it can: v and omega are in the cone's directions,

        v / (f_t/mu^2) = omega / (m/mu_r^2) = -|mu_r omega| / sqrt(f_n^2 - |f_t|^2/mu^2)

    so that the same push moves it as fast as it rolls: by 1 mm in a sway of v3. Feet in pyramidal
    cones are left where they are: see ``sink_in_pyramid``.

    Args:
        robot: The robot on the path's ground.
        path: Its path.
        motion: (n, nv) qvel along it, as the ground has it.
        forces: (n, feet, 3) of the ground on each foot, in world axes (N).
    """
    from scipy.integrate import cumulative_trapezoid  # slow to import

    friction, normal = DryFriction.of(robot), path.stances[0].task.ground.normal()
    laws = {foot: GroundLaw.of(robot, foot) for foot in path.feet}
    speeds, rolling_off = np.zeros_like(forces), np.zeros_like(forces)
    carrying = path.stance_feet & ~path.infeasible[:, None]
    carrying &= [not is_pyramid(robot, foot) for foot in path.feet]
    for row, (qpos, qvel) in enumerate(zip(path.qpos, motion, strict=True)):
        config = Configuration(robot, qpos)
        for column in np.flatnonzero(carrying[row]):
            foot, force = path.feet[column], forces[row, column]
            pressing = float(force @ normal)
            pushed = force - pressing * normal
            mu, limits = friction.sliding[foot], friction.turning[foot]
            if np.linalg.norm(pushed) >= _SLIDING * mu * pressing:
                continue
            turning = config.frame_jacobian(robot.contact_frames[foot])[3:] @ qvel
            about = float(turning @ normal)
            rolling = limits[0] * float(np.linalg.norm(turning - about * normal))
            scaled = math.hypot(rolling, limits[2] * about)
            room = math.sqrt(pressing**2 - float(pushed @ pushed) / mu**2)
            viscosity = laws[foot].viscosity(laws[foot].depth(pressing))
            rate = scaled / (mu**2 * room)
            if rate > 1 / viscosity:
                rolling_off[row, column] = -rate * pushed
                continue
            speeds[row, column] = -pushed / viscosity
    speeds = _followed(path.time, speeds, np.array([law.damping for law in laws.values()]))
    speeds += rolling_off
    found: Array = cumulative_trapezoid(speeds, path.time, axis=0, initial=0.0)
    return found


def _followed(time: Array, speeds: Array, damping: Array) -> Array:
    """Returns speeds (n, feet, 3) that follow these by dv/dt = b (w - v), as contacts have it."""
    found = np.zeros_like(speeds)  # it begins at rest
    left = np.exp(-np.diff(time)[:, None] * damping)[..., None]
    for index, share in enumerate(left):
        wanted = (speeds[index] + speeds[index + 1]) / 2
        found[index + 1] = wanted + share * (found[index] - wanted)
    return found
