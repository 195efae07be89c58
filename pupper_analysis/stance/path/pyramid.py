"""Feet in a pyramidal friction cone along a path: how they sink and creep, edge by edge."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.contact import ContactParameters
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_SLIDING = 0.98
"""Share of its normal force that a foot's edges along its push bear at most: one that is asked for
more slides, and its speed is no matter of friction alone."""

_NEWTON_STEPS = 8  # of Newton's iteration; the function has at most ten kinks, of which few are met


def is_pyramid(robot: Robot, foot: str) -> bool:
    """Returns whether a foot's friction cone is a pyramid."""
    pyramidal = robot.mj_model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL.value
    return bool(pyramidal and robot.contacts[foot].condim > 1)


def contact_frame(normal: Array) -> Array:
    """Returns the axes (3, 3) of a contact with the ground: normal, and the edges' directions.

    Source: MuJoCo, mju_makeFrame: the second is that of y, if the normal is not near to it.
    """
    start = np.array([0.0, 1.0, 0.0] if abs(normal[1]) < 0.5 else [0.0, 0.0, 1.0])
    first = start - float(start @ normal) * normal
    first /= np.linalg.norm(first)
    return np.array([normal, first, np.cross(normal, first)])


@dataclass(frozen=True)
class _Pyramid:
    """A contact's edges at one moment.

    A pyramid has a pair of edges per direction of friction j, n + mu_j e_j and n - mu_j e_j, all as
    soft as each other. With h = k d r + b dr/dt and P = h + d2r/dt2, which all have in common, and
    q_j = mu_j (b v_j + dv_j/dt), the edges give

        f = g max(0, P - q_j) and g max(0, P + q_j),  g = d / ((1 - d) A_edge)

    A push along e_j asks a pair for the difference D_j = F_j / mu_j of its forces, so that its sum
    is max(2 g P, |D_j|): from |D_j| = 2 g P on only one of them presses. A pair of rolling or
    spinning has its q_j from the leg's motion, and the sum g max(2 P, P + |q_j|). Normal force and
    pushes then give P, and the accelerations.

    Attributes:
        conductance: g (kg).
        pushes: |D_j| of the pairs along the ground (N).
        turns: |q_j| of the other pairs (m/s^2).
    """

    conductance: float
    pushes: Sequence[float]
    turns: Sequence[float]

    def pressure(self, load: float, mass: float, still: float) -> float:
        """Returns P (m/s^2) under a normal force; zero if no edge presses.

        Args:
            load: The force if nothing sank with the foot (N).
            mass: What sinks with it (kg).
            still: h (m/s^2).
        """
        g = self.conductance
        count = len(self.pushes) + len(self.turns)
        # All edges pressing give the least sum: from there Newton's steps come from one side.
        found = (load + mass * still) / (2 * g * count + mass)
        for _ in range(_NEWTON_STEPS):
            missing, slope = mass * (found - still) - load, mass
            for push in self.pushes:
                both = 2 * g * found > push
                missing += 2 * g * found if both else push
                slope += 2 * g if both else 0.0
            for turn in self.turns:
                both = found > turn
                missing += g * max(0.0, 2 * found if both else found + turn)
                slope += 2 * g if both else g if found > -turn else 0.0
            if not slope > 0:
                return 0.0
            step = missing / slope
            found -= step
            if abs(step) <= 1e-12 * (abs(found) + 1e-9):
                break
        return found


def sink_in_pyramid(
    law: GroundLaw, contact: ContactParameters, time: Array, given: Array, masses: Array
) -> tuple[Array, Array, Array]:
    """Returns how a foot sinks and creeps in a pyramidal cone, from rest.

    Args:
        law: The ground under it.
        contact: Its contact's parameters.
        time: (n,) s.
        given: (n, 6) in the contact's frame: the force on the foot along the normal if nothing sank
            with it, and along the edges (N), and the foot's angular velocity (rad/s).
        masses: (n,) what sinks with it (kg).

    Returns:
        (n,) depths (m), (n,) their second derivatives (m/s^2), and (n, 2) how far it has crept
        along the edges (m).
    """
    from scipy.interpolate import CubicSpline  # slow to import

    pairs, mu = contact.condim - 1, np.maximum(contact.friction, mujoco.mjMINMU).tolist()
    spline = CubicSpline(time, given)
    # Of condim 4 there is spinning, about the normal, of 6 rolling about both other axes as well.
    turning = list(zip(mu[2:pairs], (3, 4, 5), strict=False))

    def change(state: Array, moment: Array, rate: Array, mass: float) -> Array:
        depth, sinking, creep = float(state[0]), float(state[1]), state[2:4]
        d = law.impedance(depth)
        g = d / ((1 - d) * law.normal * 2 * pairs)
        still = law.stiffness * d * (depth + law.margin) + law.damping * sinking
        load = max(float(moment[0]), 0.0)
        wanted = [float(moment[1]) / mu[0], float(moment[2]) / mu[1]]
        most = _SLIDING * load
        total = abs(wanted[0]) + abs(wanted[1])
        if total > most:
            wanted = [one * most / total for one in wanted]
        turns = [
            abs(friction * (law.damping * float(moment[axis]) + float(rate[axis])))
            for friction, axis in turning
        ]
        pyramid = _Pyramid(g, [abs(one) for one in wanted], turns)
        pressure = pyramid.pressure(load, mass, still) if load > 0 else 0.0
        faster = []
        for push, friction, speed in zip(wanted, mu, creep, strict=False):
            share = abs(push) / g
            alone = share > 2 * pressure
            q = share - max(pressure, 0.0) if alone else share / 2
            faster.append(-math.copysign(q, push) / friction - law.damping * float(speed))
        return np.array([sinking, pressure - still, *faster, *creep])

    own = 1 / max(law.damping, math.sqrt(law.stiffness), 1e-3)
    counts = np.maximum(1, np.ceil(np.diff(time) / (own / 8))).astype(int)
    state = np.zeros(6)
    state[0] = law.depth(max(0.0, float(given[0, 0])))
    depths, accelerations, crept = [state[0]], [0.0], [np.zeros(2)]
    for start, end, count, mass in zip(time[:-1], time[1:], counts, masses, strict=False):
        step = float(end - start) / count
        moments = np.linspace(start, end, 2 * count + 1)
        values, rates = spline(moments), spline(moments, 1)
        for index in range(0, 2 * count, 2):
            one = change(state, values[index], rates[index], mass)
            two = change(state + step / 2 * one, values[index + 1], rates[index + 1], mass)
            three = change(state + step / 2 * two, values[index + 1], rates[index + 1], mass)
            four = change(state + step * three, values[index + 2], rates[index + 2], mass)
            state = state + step / 6 * (one + 2 * two + 2 * three + four)
        depths.append(state[0])
        accelerations.append(change(state, values[-1], rates[-1], mass)[1])
        crept.append(state[4:6].copy())
    return np.array(depths), np.array(accelerations), np.array(crept)
