"""Which feet slide, and what holds those against a slip to the side that slip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.stance.sag.equilibrium import SagEquilibrium
from pupper_analysis.stance.sag.solution import Solution

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
        mu, slip = system.friction.sliding[point], slips[row]
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
