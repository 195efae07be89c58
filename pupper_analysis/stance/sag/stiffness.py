"""How stiff an equilibrium is: whether it lasts where the feet let it move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from pupper_analysis.stance.sag.equilibrium import SagEquilibrium
from pupper_analysis.stance.sag.slip import find_idle_points, find_slipping_feet, turning_stiffness
from pupper_analysis.stance.sag.solution import Solution

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Compliance:
    """What holds an equilibrium against small motions that the feet allow.

    Attributes:
        hessian: (nv, nv) of the energy (N m/rad, N/m ...); not symmetric where feet slip.
        mass: (nv, nv) the mass matrix.
        free: (nv, k) a basis of the motions.
    """

    hessian: Array
    mass: Array
    free: Array

    def reduced(self, without: Array | None = None) -> tuple[Array, Array]:
        """Returns Hessian and mass matrix (k, k) of the motions.

        Args:
            without: (nv,) stiffness that is taken off the diagonal.
        """
        hessian = self.hessian if without is None else self.hessian - np.diag(without)
        return self.free.T @ hessian @ self.free, self.free.T @ self.mass @ self.free

    def stiffness(self, without: Array | None = None) -> float:
        """Returns the least eigenvalue of the Hessian relative to the mass matrix (1/s^2)."""
        real, _, scale, *_ = lapack.dggev(*self.reduced(without), compute_vl=0, compute_vr=0)
        values = np.divide(real, scale, out=np.full(len(real), np.inf), where=scale != 0)
        return float(values.min())


def stiffness_at(system: SagEquilibrium, solution: Solution, derivative: Array) -> float:
    """Returns the least eigenvalue of the Hessian where the feet allow it to move.

    Args: as ``compliance_at``.
    """
    return compliance_at(system, solution, derivative).stiffness()


def compliance_at(system: SagEquilibrium, solution: Solution, derivative: Array) -> Compliance:
    """Returns what holds an equilibrium where the feet allow it to move.

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
    unpressed = find_idle_points(system, places[:, 2])
    rates[[row for row, foot in enumerate(system.anchors) if foot in unpressed]] = 0.0
    pushed = normal.copy()  # where a foot's normal force acts, with the friction it brings
    moving = find_slipping_feet(system, solution)
    for row, foot in enumerate(system.anchors):
        if foot in moving and foot not in unpressed:
            force = solution.forces[foot]
            pushed[row] += force[:2] / force[2] @ jacobian[3 * row : 3 * row + 2]
    hessian = derivative[:n, :n] + pushed.T @ (rates[:, None] * normal)
    across = system.as_one(jacobian.reshape(-1, 3, n)[:, :2])
    for row, stiff in turning_stiffness(system, solution):
        hessian += across[row].T @ stiff @ across[row]
    loose = {*moving, *unpressed}
    sticks = [row for row, foot in enumerate(system.anchors) if foot not in loose]
    held = across[sticks].reshape(-1, n)
    if system.feet == "sliding":  # as a whole it may be anywhere, turned anyhow about z
        held = np.eye(3, n)
        held[2] = np.concatenate([np.zeros(3), config.base_rotation()[2], np.zeros(n - 6)])
    _, lengths, rows = np.linalg.svd(held)
    least = max(held.shape) * np.finfo(float).eps * lengths.max(initial=0.0)
    free = rows[np.count_nonzero(lengths > least) :].T  # what nothing of it is held of
    return Compliance(hessian, config.mass_matrix(), free)
