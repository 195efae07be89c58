"""Soles of meshes: where MuJoCo's contacts jump from vertex to vertex, corners take their place.

MuJoCo's contact of a plane and a mesh has up to four points: the mesh's lowest vertex, and others
that are near it on its hull. Of a sole with many vertices these are others when it tilts by
microradians, and so when loads shift.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.spatial import ConvexHull, QhullError

Array = NDArray[np.float64]

BALL = 2e-3
"""Radius of the balls at a sole's corners (m): a tilt of 1 mrad moves their contact by 2 um."""

TILTS = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
"""Ways in which a sole is tilted to see whether its contacts jump."""

TILT = 1e-4
"""By how much (rad): a foot of 0.3 m is 30 um lower at one end, and still touches with both."""

_POSES = 3  # random ones: in one, a leg may be stretched

_RANK = 1e-2  # of what a leg can do: soles of meshes are tilted by their vertices' last digits

_MOST = 8
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
    while len(hull) > _MOST:
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
        ways = moved[:, dofs] @ free
        if not ways.size:
            return False
        found = np.linalg.lstsq(ways, normal, rcond=_RANK)[0]
        if float(np.linalg.norm(ways @ found - normal)) > _RANK:
            return False
    return True
