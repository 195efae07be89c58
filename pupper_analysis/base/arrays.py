"""Conversions between inertias, rotations and quaternions, and products of 3-D vectors.

Arrays are NumPy arrays; placements and inertias are Pinocchio's types. Quaternions are (w, x, y,
z).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array

INERTIA_ENTRIES = {
    "ixx": (0, 0),
    "iyy": (1, 1),
    "izz": (2, 2),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyz": (1, 2),
}
"""{name in a URDF: (row, column)} of the six independent entries of an inertia tensor, in the order
of MJCF's ``fullinertia``."""


def inertia_entries(tensor: Array) -> Array:
    """Return the entries (6,) of an inertia tensor (3, 3), in the order of ``INERTIA_ENTRIES``."""
    return np.array([tensor[index] for index in INERTIA_ENTRIES.values()])


def inertia_tensor(entries: Iterable[float]) -> Array:
    """Return the inertia tensor (3, 3) with six entries in the order of ``INERTIA_ENTRIES``."""
    tensor = np.zeros((3, 3))
    for value, (row, column) in zip(entries, INERTIA_ENTRIES.values(), strict=True):
        tensor[row, column] = tensor[column, row] = value
    return tensor


def rotation_from_quaternion(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3) of a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion.tolist()
    rotation: Array = pin.Quaternion(w, x, y, z).toRotationMatrix()
    return rotation


def rotations_from_quaternions(quaternions: Array) -> Array:
    """Return rotation matrices, shape (..., 3, 3), of unit quaternions wxyz, shape (..., 4)."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_rotation(rotation: Array) -> Array:
    """Return the unit quaternion (w, x, y, z) of a rotation matrix (3, 3)."""
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return np.array([w, x, y, z])


def make_placement(quaternion: Array, position: Array) -> pin.SE3:
    """Return the SE(3) placement of a unit quaternion (w, x, y, z) and a position (3,) [m]."""
    return pin.SE3(rotation_from_quaternion(quaternion), np.array(position))


def make_inertia(mass: float, com: Array, tensor: Array) -> pin.Inertia:
    """Return the spatial inertia of a body, even if a moment of inertia is negative.

    Pinocchio's constructor rejects a negative moment of inertia, which a model file may contain.

    Args:
        mass: Mass [kg].
        com: Centre of mass (3,) [m], in the frame of the result.
        tensor: Symmetric inertia tensor (3, 3) [kg m^2] about the centre of mass, in the axes of
            that frame.
    """
    result = pin.Inertia.Zero()
    result.mass, result.lever, result.inertia = float(mass), np.array(com), np.array(tensor)
    return result


def project_perpendicular(vector: Array, direction: Array) -> Array:
    """Return the component of a vector (3,) perpendicular to a unit vector (3,): v - (v . u) u."""
    part: Array = vector - (vector @ direction) * direction
    return part


def cross_matrices(vectors: Array) -> Array:
    """Return the skew-symmetric matrices (..., 3, 3) [v]x of vectors v (..., 3): [v]x w = v x w."""
    matrices: Array = (vectors @ _UNIT_CROSS_MATRICES).reshape(*vectors.shape, 3)
    return matrices


_UNIT_CROSS_MATRICES = np.zeros((3, 9))
"""Skew-symmetric (cross product) matrices of the unit vectors x, y and z. Each row (9,) is a
flattened matrix (3, 3). `cross_matrices` multiplies the vectors by this array."""

_UNIT_CROSS_MATRICES[[2, 1, 2, 0, 1, 0], [1, 2, 3, 5, 6, 7]] = -1, 1, 1, -1, -1, 1
