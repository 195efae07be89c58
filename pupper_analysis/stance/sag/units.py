"""A robot's own units: what is small for one of 20 g, and for one of 3 t."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]

_TRUST = 0.5, 4.0  # rad, heights: a longer Newton step has left the branch
_WEAK = 4e-6  # weights per height: holds a sliding robot in its place as creep does
_RHO = 4.0  # weights per height: weighs slip against force in telling which way a foot slips


@dataclass(frozen=True)
class Units:
    """A robot's weight, and the height at which it carries that.

    Attributes:
        weight: N.
        length: Of its com above the lowest foot that carries, in its stand (m).
    """

    weight: float
    length: float

    @staticmethod
    def of(robot: Robot, stand: Stand) -> Units:
        """Returns those of a robot in a stand."""
        lowest = min(float(stand.foot_targets[foot][2]) for foot in stand.stance_feet)
        com = Configuration(robot, stand.qpos).center_of_mass()
        weight = robot.total_mass * float(np.linalg.norm(robot.gravity))
        return Units(weight, float(com[2]) - lowest)

    @property
    def stiffness(self) -> float:
        """Of a servo that gives the weight at a lever of the height for a turn of 1 (N m/rad)."""
        return self.weight * self.length

    @property
    def weak(self) -> float:
        """N/m: holds a sliding robot in its place."""
        return _WEAK * self.weight / self.length

    @property
    def rho(self) -> float:
        """N/m: weighs slip against force; any would do."""
        return _RHO * self.weight / self.length

    def left(self, residual: Array, nv: int, forces: slice | list[int]) -> float:
        """Returns the largest element of a residual of the equations, in these units.

        Args:
            residual: nv of balance, and three of each foot that touches.
            nv: Of the robot.
            forces: The feet whose equations of slip are of forces.
        """
        units = np.full(len(residual), self.length)
        units[:3], units[3:nv] = self.weight, self.weight * self.length
        units[nv:].reshape(-1, 3)[forces, :2] = self.weight
        return float(np.abs(residual / units).max())

    def is_too_far(self, step: Array) -> bool:
        """Tells whether a step (nv,) leaves the branch that it begins on."""
        near = np.abs(step[3:]).max() < _TRUST[0]
        return not (near and np.abs(step[:3]).max() < _TRUST[1] * self.length)
