"""Feet that creep along a path: MuJoCo's friction lets go of a foot that is pushed as it rolls."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.friction import DryFriction
from pupper_analysis.robot.robot import Robot
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

    so that the same push moves it as fast as it rolls: by 1 mm in a sway of v3. In a pyramidal cone
    a foot that is pushed by more than half of its friction creeps faster (``_past_an_edge``).

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
    edges = _edges(normal)
    shares_in = pressed_in(robot, path, forces)
    for row, (qpos, qvel) in enumerate(zip(path.qpos, motion, strict=True)):
        config = Configuration(robot, qpos)
        for column in np.flatnonzero(carrying[row]):
            foot, force = path.feet[column], forces[row, column]
            pressing = float(force @ normal)
            pushed = force - pressing * normal
            mu, limits = friction.sliding[foot], friction.turning[foot]
            if np.linalg.norm(pushed) >= _SLIDING * mu * pressing:
                continue
            turning = config.frame_jacobian(robot.foot_frames[foot])[3:] @ qvel
            about = float(turning @ normal)
            rolling = limits[0] * float(np.linalg.norm(turning - about * normal))
            scaled = math.hypot(rolling, limits[2] * about)
            room = math.sqrt(pressing**2 - float(pushed @ pushed) / mu**2)
            depth = laws[foot].depth(pressing * float(shares_in[row, column]))
            viscosity = laws[foot].viscosity(depth)
            rate = scaled / (mu**2 * room)
            if rate > 1 / viscosity:
                rolling_off[row, column] = -rate * pushed
                continue
            faster = np.eye(3)
            if _is_pyramid(robot, foot):
                shares = np.abs(edges @ pushed) / (mu * pressing)
                faster = edges.T @ np.diag([_past_an_edge(share) for share in shares]) @ edges
            speeds[row, column] = -faster @ pushed / viscosity
    speeds = _followed(path.time, speeds, np.array([law.damping for law in laws.values()]))
    speeds += rolling_off
    found: Array = cumulative_trapezoid(speeds, path.time, axis=0, initial=0.0)
    return found


def _followed(time: Array, speeds: Array, damping: Array) -> Array:
    """Returns speeds (n, feet, 3) that follow these by dv/dt = b (w - v), as contacts have it."""
    found = speeds.copy()
    left = np.exp(-np.diff(time)[:, None] * damping)[..., None]
    for index, share in enumerate(left):
        wanted = (speeds[index] + speeds[index + 1]) / 2
        found[index + 1] = wanted + share * (found[index] - wanted)
    return found


def pressed_in(robot: Robot, path: StancePath, forces: Array) -> Array:
    """Returns the share of feet's normal forces (n, feet) that presses them into the ground.

    All of it in an elliptic cone. In a pyramidal one that is pushed past an edge
    (``_past_an_edge``), the four edges would bear 2 (1 - u) of it if they pressed evenly.

    Args:
        robot: The robot on the path's ground.
        path: Its path.
        forces: (n, feet, 3) of the ground on each foot, in world axes (N).
    """
    found = np.ones(forces.shape[:2])
    friction, normal = DryFriction.of(robot), path.stances[0].task.ground.normal()
    for column, foot in enumerate(path.feet):
        if not _is_pyramid(robot, foot):
            continue
        limit = friction.sliding[foot] * np.maximum(forces[:, column] @ normal, 0.0)
        pushed = np.abs(forces[:, column] @ _edges(normal).T).max(axis=1)
        share = np.divide(pushed, limit, out=np.zeros_like(limit), where=limit > 0)
        found[:, column] = np.minimum(1.0, 2 * (1 - np.minimum(share, _SLIDING)))
    return found


def _is_pyramid(robot: Robot, foot: str) -> bool:
    """Returns whether a foot's friction is a pyramid of four edges.

    (Of condim 4 and 6 it has more, and those of rolling take their part of the load.)
    """
    pyramidal = robot.mj_model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL.value
    return bool(pyramidal and robot.contacts[foot].condim == 3)


def _edges(normal: Array) -> Array:
    """Returns the directions (2, 3) of a friction pyramid's edges on the ground.

    Source: MuJoCo, mju_makeFrame: the first is that of y, if the normal is not near to it.
    """
    start = np.array([0.0, 1.0, 0.0] if abs(normal[1]) < 0.5 else [0.0, 0.0, 1.0])
    first = start - float(start @ normal) * normal
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(normal, first)])


def _past_an_edge(share: float) -> float:
    """Returns how much faster than by its viscosity a foot creeps along an edge of a pyramid.

    The pyramid is four forces along its edges, of N/4 each at rest: a creep adds w to one and takes
    it from the one opposite, and w = u N/2 for a push of u times the friction. From u = 1/2 on the
    one opposite is gone. The others share N, and u N = (N - w)/3 + w.

    Args:
        share: Tangential force / (friction coefficient x normal force), along the edge.
    """
    return 1.0 if share <= 0.5 else (3 * share - 1) / share
