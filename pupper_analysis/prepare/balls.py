"""Balls that feet of other shapes are like where they are lowest."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_CAP = math.radians(50.0)
"""How far from a foot's lowest point, seen from its middle, its shape is compared with a ball's."""

_BALL = 0.1
"""A foot is a ball if no point of that cap is off the sphere by more than this part of it."""


def osculating_sphere(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, down: Array
) -> tuple[Array, float]:
    """Returns centre (3,) and radius of the sphere that an ellipsoid is like where it is lowest.

    With half axes S, it reaches h = |S d| in a direction d, at S^2 d / h. The radii of its
    curvature there are the eigenvalues of the second derivative of h across d, which is
    S^2 / h - S^2 d d^T S^2 / h^3. The sphere has their mean.
    """
    turn, squares = data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom] ** 2
    local = turn.T @ down
    reach = math.sqrt(float(local @ (squares * local)))
    tip = squares * local / reach
    radius = float((squares.sum() - tip @ tip) / reach) / 2  # d itself has the eigenvalue 0
    return data.geom_xpos[geom] + turn @ tip - radius * down, radius


def fit_sphere(points: Array, tip: Array, down: Array) -> tuple[Array, float]:
    """Returns centre (3,) and radius of the sphere at the lower end of points (n, 3), if it is one.

    Else the tip itself, and no radius. A sphere |p - c| = r is linear in c and r^2 - |c|^2.
    """
    found = tip, 0.0
    for size in (0.01, 0.02, 0.03, 0.045):  # m: of the part that is looked at, from the tip up
        near = points[(tip - points) @ down < size]
        if len(near) < 6:
            continue
        table = np.column_stack([2 * near, np.ones(len(near))])
        solution, _, rank, _ = np.linalg.lstsq(table, (near**2).sum(axis=1))
        center = solution[:3]
        radius = math.sqrt(max(0.0, float(solution[3] + center @ center)))
        if rank < 4 or radius == 0.0:
            continue
        away = near - center
        cap = away @ down > math.cos(_CAP) * radius
        off = np.abs(np.linalg.norm(away[cap], axis=1) - radius)
        if cap.sum() >= 6 and off.max() < _BALL * radius and radius > size / 2:
            found = center, float((tip - center) @ down)
    return found
