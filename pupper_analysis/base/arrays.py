"""Arrays that mean something in space."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]


INERTIA_ENTRIES = {
    "ixx": (0, 0),
    "iyy": (1, 1),
    "izz": (2, 2),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyz": (1, 2),
}
"""The six entries of an inertia by their names in a URDF, in the order of an MJCF's fullinertia."""


def inertia_entries(tensor: Array) -> Array:
    """Returns the six entries of an inertia (3, 3), in the order of ``INERTIA_ENTRIES``."""
    return np.array([tensor[place] for place in INERTIA_ENTRIES.values()])


def inertia_tensor(entries: Iterable[float]) -> Array:
    """Returns the inertia (3, 3) of six entries, in the order of ``INERTIA_ENTRIES``."""
    tensor = np.zeros((3, 3))
    for value, (row, column) in zip(entries, INERTIA_ENTRIES.values(), strict=True):
        tensor[row, column] = tensor[column, row] = value
    return tensor


def rotation_from_quaternion(quaternion: Array) -> Array:
    """Returns the (3, 3) rotation matrix of a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion.tolist()
    rotation: Array = pin.Quaternion(w, x, y, z).toRotationMatrix()
    return rotation


def quaternion_from_rotation(rotation: Array) -> Array:
    """Returns the unit quaternion (w, x, y, z) of a rotation (3, 3)."""
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return np.array([w, x, y, z])


def placement_of(quaternion: Array, position: Array) -> pin.SE3:
    """Returns the placement of a unit quaternion (w, x, y, z) and a position (3,)."""
    return pin.SE3(rotation_from_quaternion(quaternion), np.array(position))


def inertia_of(mass: float, com: Array, tensor: Array) -> pin.Inertia:
    """Returns an inertia in the frame in which its com (3,) and the tensor about that are given.

    Pinocchio's constructor refuses what no body has, which a file may state all the same.
    """
    result = pin.Inertia.Zero()
    result.mass, result.lever, result.inertia = float(mass), np.array(com), np.array(tensor)
    return result


def across(vector: Array, direction: Array) -> Array:
    """Returns the part of a vector (3,) that is at right angles to a direction (3,)."""
    part: Array = vector - (vector @ direction) * direction
    return part


def cross_matrices(vectors: Array) -> Array:
    """Returns the matrices (..., 3, 3) that take x to v x x, of vectors v (..., 3)."""
    matrices: Array = (vectors @ _CROSSES).reshape(*vectors.shape, 3)
    return matrices


_CROSSES = np.zeros((3, 9))
_CROSSES[[2, 1, 2, 0, 1, 0], [1, 2, 3, 5, 6, 7]] = -1, 1, 1, -1, -1, 1
"""What ``cross_matrices`` takes unit vectors to: one product is quicker than six columns."""
