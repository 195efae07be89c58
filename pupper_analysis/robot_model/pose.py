"""Poses of frames in each other."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose: x = position + rotation x'.

    Attributes:
        position: (3,) (m).
        rotation: (3, 3).
    """

    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))

    def __mul__(self, other: Pose) -> Pose:
        return Pose(self.point(other.position), self.rotation @ other.rotation)

    def point(self, local: Array) -> Array:
        """Returns a point (3,), or points (n, 3), given in this pose's frame, in the outer one."""
        moved: Array = local @ self.rotation.T + self.position
        return moved

    @property
    def placed(self) -> pin.SE3:
        """The same, as Pinocchio has it."""
        return pin.SE3(self.rotation, self.position)

    def inverse(self) -> Pose:
        """Returns the pose of the outer frame in this one."""
        return Pose(-self.rotation.T @ self.position, self.rotation.T)
