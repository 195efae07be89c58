"""How stiff an equilibrium is: whether it lasts where the feet let it move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from pupper_analysis.stance.sag.contact_kinematics import Solution
from pupper_analysis.stance.sag.equilibrium import SagEquilibrium

Array = NDArray[np.float64]

SMALL_SLIP = 0.01
"""A sole that has slipped by less, in parts of the height at which the robot stands, rests where it
has come to: some 3 mm of a biped of 0.3 m. MuJoCo's pivoted by 0.1 to 0.4 mm."""


def find_sliding_feet(system: SagEquilibrium, solution: Solution) -> tuple[str, ...]:
    """Returns the pinned feet that slide: what presses of them slips, and it is no small way.

    A foot of one point slides where that point slips. A sole may pivot by a fraction of a
    millimetre, all its points at their friction, until its leg is no longer twisted: where
    there is an equilibrium so near, the sole rests in it.
    """
    loose, names = set(find_slipping_feet(system, solution)), tuple(system.anchors)
    if not loose:
        return ()
    small = SMALL_SLIP * system.robot.stand_height
    slips = np.linalg.norm(measure_slips(system, solution), axis=1)
    found = []
    for foot in system.robot.feet_with(system.stand.stance_feet):
        points = [point for point in system.robot.feet[foot] if point in names]
        pressed = [point for point in points if solution.forces[point][2] > 0]
        if not pressed or not loose.issuperset(pressed):
            continue
        way = max(float(slips[names.index(point)]) for point in pressed)
        if len(system.robot.feet[foot]) == 1 or way > small:
            found.append(foot)
    return tuple(found)


def turning_stiffness(system: SagEquilibrium, solution: Solution) -> list[tuple[int, Array]]:
    """Returns number and stiffness (2, 2) of feet that slip against a slip to the side (N/m).

    Friction is against the slip s: f_t = -mu f_n s / |s|. Moved across, s turns, and with it
    the force, by mu f_n / |s| to the side; along s nothing holds it.
    """
    slips: Array = measure_slips(system, solution)
    found = []
    forces, loose = system.stacked(solution), set(find_slipping_feet(system, solution))
    for row, point in enumerate(system.anchors):
        if point not in loose:
            continue
        mu, slip = system.sliding_friction[point], slips[row]
        way = float(np.linalg.norm(slip))
        if way > 0 and forces[row, 2] > 0:
            along = slip / way
            stiff = mu * forces[row, 2] / way * (np.eye(2) - np.outer(along, along))
            found.append((row, stiff))
    return found


def find_slipping_feet(system: SagEquilibrium, solution: Solution) -> tuple[str, ...]:
    """Returns the pinned feet that slip."""
    forces, names = system.stacked(solution), tuple(system.anchors)
    places = system.slips(solution.qpos, forces)
    return tuple(names[row] for row, *_ in system.slipping_rows(forces, places))


def measure_slips(system: SagEquilibrium, solution: Solution) -> Array:
    """Returns how far the pinned feet that touch have slipped (n, 2), soles as one body (m)."""
    begun = np.array([system.crept.get(foot, np.zeros(2)) for foot in system.anchors])
    places = system.touch(solution.qpos).places[:, :2]
    return system.as_one(places - begun.reshape(-1, 2))


def find_idle_points(system: SagEquilibrium, depths: Array) -> set[str]:
    """Returns the points of soles that touch, but are not pressed at depths (n,) (m)."""
    soles = {point for points in system.robot.feet.values() if len(points) > 1 for point in points}
    return {
        foot
        for foot, depth in zip(system.anchors, depths, strict=True)
        if foot in soles and depth <= -system.laws[foot].margin
    }


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
