"""Sums of rigid bodies: mass, first moment and inertia about an origin, which add up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TRIANGLE = 1e-6
"""By how much of itself a principal moment may exceed the sum of the others, for rounding."""


@dataclass(frozen=True, eq=False)
class Mass:
    """What a body weighs, and how that is spread.

    Attributes:
        mass: kg.
        com: (3,) m.
        inertia: (3, 3) about the com (kg m^2).
    """

    mass: float
    com: Array
    inertia: Array

    def moved(self, pose: pin.SE3) -> Mass:
        """Describes it in another frame: x' = pose x."""
        turn = np.array(pose.rotation)
        com = turn @ self.com + np.array(pose.translation)
        return Mass(self.mass, com, turn @ self.inertia @ turn.T)

    def minus(self, others: list[Mass]) -> Mass | None:
        """Takes others away; None if no mass is left."""
        if not others:
            return self
        mass = self.mass - sum(other.mass for other in others)
        if mass <= 0:
            return None
        moment = self.mass * self.com - sum(other.mass * other.com for other in others)
        com = moment / mass
        # About the com of what is left, so that no great numbers cancel.
        inertia = self._about(com) - sum(other._about(com) for other in others)
        return Mass(mass, com, inertia)

    def _about(self, point: Array) -> Array:
        arm = self.com - point
        return self.inertia + self.mass * (float(arm @ arm) * np.eye(3) - np.outer(arm, arm))

    @property
    def is_physical(self) -> bool:
        """Says whether a rigid body can be so."""
        if not self.mass > 0:
            return False
        least, middle, greatest = np.linalg.eigvalsh(self.inertia)
        return bool(least > 0 and least + middle >= (1 - _TRIANGLE) * greatest)


def total_mass(bodies: list[Mass]) -> Mass:
    """Adds bodies up, in one frame."""
    heavy = [body for body in bodies if body.mass > 0]
    if not heavy:
        return Mass(0.0, np.zeros(3), np.zeros((3, 3)))
    mass = sum(body.mass for body in heavy)
    com = np.array(sum(body.mass * body.com for body in heavy)) / mass
    inertia = np.array(sum(body._about(com) for body in heavy))
    return Mass(mass, com, inertia)


def is_same_mass(one: Mass, two: Mass, tolerance: float = 1e-11) -> bool:
    """Says whether two bodies are the same but for rounding."""
    size = max(float(np.abs(one.inertia).max()), float(np.abs(two.inertia).max()), 1e-300)
    return bool(
        abs(one.mass - two.mass) <= tolerance * max(one.mass, two.mass)
        and float(np.abs(one.com - two.com).max()) <= tolerance
        and float(np.abs(one.inertia - two.inertia).max()) <= tolerance * size
    )


def turned_like(wanted: Array, own: Array, near: Array) -> Array | None:
    """Returns the rotation that makes one tensor of another: wanted = R own R^T.

    Args:
        wanted: The tensor.
        own: The same in other axes.
        near: Of the rotations that do, the nearest to this one is returned, or none at all.

    Returns:
        It; None if the principal moments differ.
    """
    moments, axes = np.linalg.eigh(wanted)
    others, own_axes = np.linalg.eigh(own)
    if float(np.abs(moments - others).max()) > 1e-10 * float(np.abs(moments).max()):
        return None
    candidates = [np.eye(3), near]
    for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        turn = axes @ np.diag(signs).astype(float) @ own_axes.T
        candidates.append(turn if np.linalg.det(turn) > 0 else -turn)
    size = float(np.abs(wanted).max())
    right = [
        turn
        for turn in candidates
        if float(np.abs(turn @ own @ turn.T - wanted).max()) <= 1e-11 * size
    ]
    straight = [turn for turn in right if np.allclose(turn, np.eye(3), atol=1e-12)]
    if straight:
        return straight[0]
    return max(right, key=lambda turn: float(np.trace(near.T @ turn)), default=None)
