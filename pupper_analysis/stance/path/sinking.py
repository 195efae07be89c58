"""Paths on soft ground: the feet sink by what they carry, and creep where they are pushed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.path.creeping import crept
from pupper_analysis.stance.path.stance_path import StancePath

Array = NDArray[np.float64]

_STEPS = 3  # of Newton's iteration, for legs that get longer by millimetres


def sunk_path(robot: Robot, path: StancePath) -> Array:
    """Returns a path's qpos (n, nq) with the feet where soft ground has them: sunk, and crept.

    The base stays, and legs get longer. (The com moves with them, by a hundredth of the depths.)
    The depths are those under the path's forces in motion, which the ground follows with a delay
    (``depths_of``).
    MuJoCo has the contact half way down, so that a foot that rolls, rolls on a radius that is
    shorter by half its depth: by a tenth for v3. And a foot that is pushed as it rolls creeps
    (``crept``).

    Args:
        robot: The robot.
        path: Its path, which is for rigid ground.
    """
    normal = path.stances[0].task.ground.normal()
    depths = np.column_stack(
        [
            depths_of(GroundLaw.of(robot, foot), path.time, path.forces[:, column] @ normal)
            for column, foot in enumerate(path.feet)
        ]
    )
    centres = np.array(
        [list(Configuration(robot, qpos).foot_positions().values()) for qpos in path.qpos]
    )
    radius = np.array([robot.foot_radius[foot] for foot in path.feet])
    both, reach = depths[1:] + depths[:-1], 4 * radius
    shorter = np.divide(both, reach, out=np.zeros_like(both), where=reach > 0)  # corners roll not
    rolled = np.diff(centres, axis=0) * (path.stance_feet[1:] & path.stance_feet[:-1])[..., None]
    back = np.cumsum(shorter[..., None] * rolled, axis=0)
    goals = centres - depths[..., None] * normal
    goals[1:] -= back
    goals += crept(robot, path)
    rows = []
    for qpos, places in zip(path.qpos, goals, strict=True):
        targets = dict(zip(path.feet, places, strict=True))
        sunk = qpos.copy()
        for _ in range(_STEPS):
            config = Configuration(robot, sunk)
            positions, jacobians = config.foot_positions(), config.foot_jacobians()
            missing = np.concatenate([targets[foot] - positions[foot] for foot in path.feet])
            jacobian = np.concatenate([jacobians[foot][:, 6:] for foot in path.feet])
            sunk[7:] += np.linalg.lstsq(jacobian, missing, rcond=1e-6)[0]
        rows.append(sunk)
    return np.array(rows)


def depths_of(law: GroundLaw, time: Array, forces: Array) -> Array:
    """Returns how deep a foot sinks (n,) under a normal force that changes with time (m).

    MuJoCo's contact gives R f = k d(r) r + b dr/dt + d2r/dt2, with R = (1 - d)/d A: critically
    damped as a rule, so that the depth lags behind the force, with a time constant of
    solref[0] (20 ms). It begins at rest. A foot that would have to pull is out of the ground.

    Args:
        law: The ground under it.
        time: (n,) s.
        forces: (n,) N.
    """
    from scipy.interpolate import CubicSpline  # slow to import

    # An eighth of the faster of the law's own times: the classical Runge-Kutta method's error is
    # then below 1e-5 of the depth.
    own = 1 / max(law.damping, math.sqrt(law.stiffness), 1e-3)
    counts = np.maximum(1, np.ceil(np.diff(time) / (own / 8))).astype(int)
    pressed = CubicSpline(time, np.maximum(forces, 0.0))

    def change(depth: float, rate: float, force: float) -> tuple[float, float]:
        d = law.impedance(depth)
        softness = (1 - d) / d * law.normal
        return rate, softness * force - law.damping * rate - law.stiffness * d * depth

    depth, rate = law.depth(max(0.0, float(forces[0]))), 0.0
    found = [depth]
    for start, end, count in zip(time[:-1], time[1:], counts, strict=True):
        step = float(end - start) / count
        half_steps = np.maximum(pressed(np.linspace(start, end, 2 * count + 1)), 0.0).tolist()
        for index in range(count):
            one, two, three = half_steps[2 * index : 2 * index + 3]
            v1, a1 = change(depth, rate, one)
            v2, a2 = change(depth + step / 2 * v1, rate + step / 2 * a1, two)
            v3, a3 = change(depth + step / 2 * v2, rate + step / 2 * a2, two)
            v4, a4 = change(depth + step * v3, rate + step * a3, three)
            depth = depth + step / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
            rate = rate + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        found.append(depth)
    return np.array(found)
