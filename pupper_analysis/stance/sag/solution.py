"""Where a robot rests on soft ground, and a step from there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Anchor:
    """Where a foot touched the ground first: if it is pinned, it has rolled from there.

    Attributes:
        place: (3,) of the sphere's centre (m).
        turned: (3, 3) of the foot's frame.
    """

    place: Array
    turned: Array


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution of the equations.

    Attributes:
        qpos: (nq,).
        forces: {foot that touches: (3,)} in the ground's frame, whose z is its normal (N).
        residuals: The largest element left after each Newton step (N, N m, m).
    """

    qpos: Array
    forces: dict[str, Array]
    residuals: tuple[float, ...] = ()

    def force(self, foot: str) -> Array:
        """Returns the force (3,) on a foot, zero if it does not touch (N)."""
        return self.forces.get(foot, np.zeros(3))


def integrate_step(qpos: Array, step: Array) -> Array:
    """Returns the qpos (nq,) after a step (nv,) in the directions of qvel."""
    moved = qpos.copy()
    moved[:3] += step[:3]
    moved[7:] += step[6:]
    turned = pin.Quaternion(*qpos[3:7].tolist()) * pin.Quaternion(pin.exp3(step[3:6]))
    moved[3:7] = turned.coeffs()[[3, 0, 1, 2]]
    return moved
