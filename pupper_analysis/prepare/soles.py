"""Soles of meshes: where MuJoCo's contacts jump from vertex to vertex, corners take their place.

MuJoCo's contact of a plane and a mesh has up to four points: the mesh's lowest vertex, and others
that are near it on its hull. Of a sole with many vertices these are others when it tilts by
microradians, and so when loads shift.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.spatial import ConvexHull, QhullError

from pupper_analysis.models.shapes import Shape

Array = NDArray[np.float64]

BALL = 2e-3
"""Radius of the balls at a sole's corners (m): a tilt of 1 mrad moves their contact by 2 um."""

TILTS = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
"""Ways in which a sole is tilted to see whether its contacts jump."""

TILT = 1e-4
"""By how much (rad): a foot of 0.3 m is 30 um lower at one end, and still touches with both."""

_POSES = 3  # random ones: in one, a leg may be stretched

_RANK = 1e-2  # of what a leg can do: soles of meshes are tilted by their vertices' last digits

_MOST_CORNERS = 8
"""The most corners that are kept of a sole: those without which its area is least."""


def sole_corners(points: Array, out: Array, flat: float) -> list[int]:
    """Returns the numbers of those points (n, 3) that are the corners of a sole.

    Args:
        points: (n, 3) on the foot.
        out: (3,) the direction out of the sole.
        flat: Points that are no further from the lowest are on the sole (m).

    Returns:
        The corners of the convex hull of what is on the sole, less those that matter least; none
        if it has no area.
    """
    height = points @ out
    on = np.flatnonzero(height > height.max() - flat)
    side = np.cross(out, np.eye(3)[np.argmin(np.abs(out))])
    side /= np.linalg.norm(side)
    seen = np.column_stack([points[on] @ side, points[on] @ np.cross(out, side)])
    if len(on) < 3:
        return []
    try:
        hull = [int(number) for number in ConvexHull(seen).vertices]
    except QhullError:
        return []
    while len(hull) > _MOST_CORNERS:
        lost = []
        for index in range(len(hull)):
            one, two, three = (seen[hull[(index + k) % len(hull)]] for k in (-1, 0, 1))
            (a, b), (c, d) = two - one, three - one
            lost.append(abs(a * d - b * c))
        del hull[int(np.argmin(lost))]
    return [int(on[number]) for number in hull]


def stays_flat(model: mujoco.MjModel, body: int, out: Array) -> bool:
    """Tells whether a leg can lift its sole without tilting it.

    Legs of four joints can, of which three turn about parallel axes (hip, knee and ankle, say), as
    long as the fourth leaves them upright; others of four joints tilt their feet as they bend.

    Args:
        model: The model.
        body: The id of the body that is the foot.
        out: (3,) direction out of the sole, in the body's frame.
    """
    dofs: list[int] = []
    above = body
    while above and model.body_dofnum[above] != 6:
        first = int(model.body_dofadr[above])
        dofs += range(first, first + int(model.body_dofnum[above]))
        above = int(model.body_parentid[above])
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    moved, turned = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for _ in range(_POSES):
        for joint in model.dof_jntid[dofs]:
            low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-1.0, 1.0)
            data.qpos[model.jnt_qposadr[joint]] = random.uniform(low, high)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBody(model, data, moved, turned, body)
        normal = data.xmat[body].reshape(3, 3) @ out
        tilting = turned[:, dofs] - np.outer(normal, normal @ turned[:, dofs])
        free = linalg.null_space(tilting, rcond=_RANK)
        directions = moved[:, dofs] @ free
        if not directions.size:
            return False
        found = np.linalg.lstsq(directions, normal, rcond=_RANK)[0]
        if float(np.linalg.norm(directions @ found - normal)) > _RANK:
            return False
    return True


_CAP = math.radians(50.0)
"""How far from a foot's lowest point, seen from its middle, its shape is compared with a ball's."""

_BALL = 0.1
"""A foot is a ball if no point of that cap is off the sphere by more than this part of it."""


def osculating_sphere(shape: Shape, down: Array) -> tuple[Array, float]:
    """Returns centre (3,) and radius of the sphere that an ellipsoid is like where it is lowest.

    With half axes S, it reaches h = |S d| in a direction d, at S^2 d / h. The radii of its
    curvature there are the eigenvalues of the second derivative of h across d, which is
    S^2 / h - S^2 d d^T S^2 / h^3. The sphere has their mean.
    """
    turn, squares = shape.pose.rotation, np.array(shape.size) ** 2
    local = turn.T @ down
    reach = math.sqrt(float(local @ (squares * local)))
    tip = squares * local / reach
    radius = float((squares.sum() - tip @ tip) / reach) / 2  # d itself has the eigenvalue 0
    return shape.pose.position + turn @ tip - radius * down, radius


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
