"""How stiff an equilibrium is: whether it lasts where the feet let it move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from pupper_analysis.stance.sag.equilibrium import Equilibrium
from pupper_analysis.stance.sag.solution import Solution

Array = NDArray[np.float64]


def stiffness_at(system: Equilibrium, solution: Solution, derivative: Array) -> float:
    """Returns the least eigenvalue of the Hessian where the feet allow it to move.

    Args:
        system: The equations.
        solution: The solution.
        derivative: Of the equations there; see ``Equilibrium.derivative``.
    """
    n = system.robot.nv
    touch = system.touch(solution.qpos)
    config, places, jacobian = touch.config, touch.places, touch.jacobians.reshape(-1, n)
    normal = jacobian[2::3]
    rates = np.array(
        [system.laws[f].rate(d) for f, d in zip(system.anchors, places[:, 2], strict=True)]
    )
    idle = system.idle(places[:, 2])
    rates[[row for row, foot in enumerate(system.anchors) if foot in idle]] = 0.0
    pushed = normal.copy()  # where a foot's normal force acts, with the friction it brings
    slipping = system.slipping(solution)
    for row, foot in enumerate(system.anchors):
        if foot in slipping and foot not in idle:
            force = solution.forces[foot]
            pushed[row] += force[:2] / force[2] @ jacobian[3 * row : 3 * row + 2]
    hessian = derivative[:n, :n] + pushed.T @ (rates[:, None] * normal)
    loose = {*slipping, *idle}
    sticks = [row for row, foot in enumerate(system.anchors) if foot not in loose]
    held = jacobian.reshape(-1, 3, n)[sticks, :2].reshape(-1, n)
    if system.feet == "sliding":  # as a whole it may be anywhere, turned anyhow about z
        held = np.eye(3, n)
        held[2] = np.concatenate([np.zeros(3), config.base_rotation()[2], np.zeros(n - 6)])
    _, lengths, rows = np.linalg.svd(held)
    least = max(held.shape) * np.finfo(float).eps * lengths.max(initial=0.0)
    free = rows[np.count_nonzero(lengths > least) :].T  # what nothing of it is held of
    reduced = free.T @ hessian @ free, free.T @ config.mass_matrix() @ free
    real, _, scale, *_ = lapack.dggev(*reduced, compute_vl=0, compute_vr=0)
    return float(np.divide(real, scale, out=np.full(len(real), np.inf), where=scale != 0).min())
