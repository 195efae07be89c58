"""Find the contact points of a foot of any shape on level ground.

A sole is laid flat on the ground, and MuJoCo's collision detection yields the contact points. For a
plane and a mesh, MuJoCo returns up to four points: the lowest vertex, and nearby vertices on the
convex hull. If a sole has many vertices, these points change with a tilt of microradians, and thus
with the load. The contact points of such a sole are therefore small balls at the corners of the
sole.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from pupper_analysis.base import lapack
from pupper_analysis.base.array_types import Array
from pupper_analysis.models.mjcf import list_free_joints
from pupper_analysis.models.shapes import Shape, read_shape
from pupper_analysis.robot.contact import find_acting_contacts, ground_geom

BALL_RADIUS = 2e-3
"""Radius [m] of the balls that serve as contact points at the corners of a sole, and at the lower
end of a mesh that is neither round nor a sole. Chosen small: a tilt of 1 mrad moves their contact
by 2 um."""

TILT_DIRECTIONS = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
"""Components, along two tangents of a sole, of the tilts of the sole's normal in a test [1]. The
test shows if the contact points change with the tilt. The components are multiplied by
`TILT_ANGLE`. The first entry is no tilt."""

TILT_ANGLE = 1e-4
"""Tilt of a sole in the directions `TILT_DIRECTIONS` [rad], to test if the contact points change.
Chosen: one end of a foot of 0.3 m is raised by 30 um, less than `_TEST_PENETRATION`, so both ends
still touch."""

_NUM_POSES = 3
"""Number of random joint positions that `can_keep_sole_flat` tests. Chosen: with a single sample,
the leg may be straight."""

_RANK_RTOL = 1e-2
"""Tolerance [1] of `can_keep_sole_flat`. A singular value of a Jacobian counts as zero below this
fraction of the largest singular value. A unit velocity along the normal counts as possible if the
error is at most this value. Chosen, not tuned: mesh soles are tilted by rounding of their
vertices."""

_MAX_CORNERS = 8
"""Upper bound of the number of contact points at the corners of a sole. The corner that spans the
smallest triangle with its neighbours is removed first. Chosen, not tuned."""


def find_sole_corners(points: Array, out: Array, flat: float) -> list[int]:
    """Find the points of a foot that are corners of its sole, at most 8 (`_MAX_CORNERS`).

    The corners are vertices of the convex hull of the sole, projected along the normal.

    Args:
        points: Points of the foot, shape (n, 3) [m].
        out: Outward normal of the sole (unit vector), shape (3,), in the frame of the points.
        flat: Distance from the lowest point along the normal [m] within which a point belongs to
            the sole.

    Returns:
        Indices of the corners in ``points``. Empty if the sole has no area.
    """
    height = points @ out
    on = np.flatnonzero(height > height.max() - flat)
    side = np.cross(out, np.eye(3)[np.argmin(np.abs(out))])
    side /= np.linalg.norm(side)
    projected = np.column_stack([points[on] @ side, points[on] @ np.cross(out, side)])
    if len(on) < 3:
        return []
    from pupper_analysis.base.qhull import ConvexHull, QhullError  # loads SciPy

    try:
        hull = [int(number) for number in ConvexHull(projected).vertices]
    except QhullError:
        return []
    while len(hull) > _MAX_CORNERS:
        areas = []
        for index in range(len(hull)):
            before, corner, after = (projected[hull[(index + k) % len(hull)]] for k in (-1, 0, 1))
            (a, b), (c, d) = corner - before, after - before
            areas.append(abs(a * d - b * c))
        del hull[int(np.argmin(areas))]
    return [int(on[number]) for number in hull]


def can_keep_sole_flat(model: mujoco.MjModel, body: int, out: Array) -> bool:
    """Return True if the joints of a leg can move the sole along the normal without a tilt.

    Random joint positions are tested. Rotation about the normal is permitted.

    Args:
        model: Model.
        body: Id of the foot's body.
        out: Outward normal of the sole (unit vector), shape (3,), expressed in the frame of the
            body.
    """
    dofs: list[int] = []
    ancestor = body
    while ancestor and model.body_dofnum[ancestor] != 6:
        first = int(model.body_dofadr[ancestor])
        dofs += range(first, first + int(model.body_dofnum[ancestor]))
        ancestor = int(model.body_parentid[ancestor])
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    jac_pos, jac_rot = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for _ in range(_NUM_POSES):
        for joint in model.dof_jntid[dofs]:
            low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-1.0, 1.0)
            data.qpos[model.jnt_qposadr[joint]] = random.uniform(low, high)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBody(model, data, jac_pos, jac_rot, body)
        normal = data.xmat[body].reshape(3, 3) @ out
        tilting = jac_rot[:, dofs] - np.outer(normal, normal @ jac_rot[:, dofs])
        free = lapack.null_space(tilting, rcond=_RANK_RTOL)
        directions = jac_pos[:, dofs] @ free
        if not directions.size:
            return False
        solution = np.linalg.lstsq(directions, normal, rcond=_RANK_RTOL)[0]
        if float(np.linalg.norm(directions @ solution - normal)) > _RANK_RTOL:
            return False
    return True


_CAP_ANGLE = math.radians(50.0)
"""Half opening angle [rad] of the cap around the lowest point of a fitted sphere. Only the foot's
points in the cap must be near the surface of the sphere (`_MAX_SPHERE_DEVIATION`). Chosen, not
tuned."""

_MAX_SPHERE_DEVIATION = 0.1
"""Upper bound of the distance between a foot's points and the surface of a fitted sphere, divided
by the radius [1], with which the sphere may replace the foot. Only points in the cap of
`_CAP_ANGLE` count. Chosen, not tuned.
"""


def compute_osculating_sphere(shape: Shape, down: Array) -> tuple[Array, float]:
    """Compute the sphere that approximates an ellipsoid at its lowest point.

    The sphere touches the ellipsoid at this point. The radius is the mean of the two principal
    radii of curvature: half of the trace of S^2 / h - S^2 d d^T S^2 / h^3. The diagonal matrix S
    contains the half axes, d is the direction ``down``, and h = |S d|. Source: Schneider, "Convex
    Bodies", 2014.

    Args:
        shape: Ellipsoid, placed in the world.
        down: Unit vector towards the ground, shape (3,), in the world frame.

    Returns:
        Centre, shape (3,) [m], in the world frame, and radius [m].
    """
    turn, squares = shape.pose.rotation, np.array(shape.size) ** 2
    local = turn.T @ down
    support = math.sqrt(float(local @ (squares * local)))
    tip = squares * local / support
    radius = float((squares.sum() - tip @ tip) / support) / 2
    return shape.pose.position + turn @ tip - radius * down, radius


def fit_sphere(points: Array, tip: Array, down: Array) -> tuple[Array, float]:
    """Fit a sphere to the lowest points of a foot, to use the sphere as contact shape.

    The fit is linear least squares: the equation |p - c|^2 = r^2 is linear in c and r^2 - |c|^2.
    Four parts at the lower end of the foot, 10 to 45 mm high, are fitted. A sphere is rejected if
    the points deviate from its surface, for example.

    Args:
        points: Points, shape (n, 3) [m].
        tip: Lowest point, shape (3,) [m], in the frame of the points.
        down: Unit vector towards the ground, shape (3,), in the frame of the points.

    Returns:
        Centre, shape (3,) [m], in the frame of the points, and radius [m], of the sphere that was
        accepted for the highest part. The radius is the distance along ``down`` from the centre to
        the tip. If no sphere is accepted: the tip and 0.
    """
    found = tip, 0.0
    for size in (0.01, 0.02, 0.03, 0.045):  # height of the fitted part [m]
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
        cap = away @ down > math.cos(_CAP_ANGLE) * radius
        off = np.abs(np.linalg.norm(away[cap], axis=1) - radius)
        if cap.sum() >= 6 and off.max() < _MAX_SPHERE_DEVIATION * radius and radius > size / 2:
            found = center, float((tip - center) @ down)
    return found


_MAX_SOLE_TILT = math.radians(25.0)
"""Upper bound of the angle between a sole and the ground, in the pose in which the contact points
are searched [rad]. Chosen, not tuned.
"""

_MIN_SOLE_LENGTH = 0.015
"""Lower bound of the largest extent of a flat part along a coordinate axis [m]. A smaller flat part
is no sole. Chosen, not tuned.
"""

_TEST_PENETRATION = 1e-4
"""Penetration [m] at which MuJoCo's contacts of a sole are evaluated. Points within twice this
height above the lowest point may be corners of a sole. Chosen, not tuned."""

_NUM_SOLE_JOINTS = 5
"""Number of joints between foot and base with which a leg is assumed to lay the sole flat at any
position. Derived: three coordinates and two angles; the yaw angle is not prescribed.
"""

_MIN_SOLE_JOINTS = 4
"""Lower bound of the number of joints between foot and base of a leg with a sole. With fewer
joints, the foot has a single contact point. With this number, a leg may lay the sole flat at any
height, but not at any position."""

_CIRCLE_ANGLES = np.linspace(0, 2 * math.pi, 24, endpoint=False)
"""Angles [rad] of the points at which the rims of cylinders, and circles on a sphere, are sampled.
Chosen, not tuned."""

_CIRCLE_POINTS = np.column_stack([np.cos(_CIRCLE_ANGLES), np.sin(_CIRCLE_ANGLES)])
"""Points of a unit circle, shape (24, 2), with which rims of cylinders are sampled."""

_LATITUDE_ANGLES = np.linspace(-math.pi / 2, math.pi / 2, 12)
"""Latitudes of the points of a unit sphere (`_SPHERE_POINTS`) with which round shapes are sampled
[rad]. Chosen, not tuned."""

_SPHERE_POINTS = np.array(
    [(*math.cos(up) * point, math.sin(up)) for up in _LATITUDE_ANGLES for point in _CIRCLE_POINTS]
)
"""Points of a unit sphere, shape (288, 3), with which round shapes are sampled."""

_APEX_HEIGHT = 1.0
"""Height [m] of an auxiliary point above a sole. With this point, the convex hull of the coplanar
points of a sole has a volume. Chosen, not tuned.
"""

_FOOT_SPHERE_RISE = 5e-3
"""Upper bound of the height [m] of a sphere's lowest point above the lowest point of a level foot,
with which the sphere counts as a contact of the foot. Chosen, not tuned.
"""

_MAX_AXIS_COSINE = 0.1
"""Upper bound of |cos| of the angle between a cylinder's axis and the vertical [1], with which the
cylinder counts as lying on its side (a wheel). Chosen, not tuned."""

_SOLE_ATOL = 1e-3
"""Tolerance [m] of the points of a sole: distance from the plane of the sole, height above the
lowest point of the foot, and displacement of contact points by a small tilt. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class ContactPoint:
    """Contact point of a foot, with the sphere that touches the ground there.

    Attributes:
        geom: MuJoCo id of the geom.
        center: Centre of the contact shape, shape (3,) [m], expressed in the frame of the geom's
            body. The contact shape is a sphere, the end of a capsule or lying cylinder, a fitted
            sphere, or a small ball (`BALL_RADIUS`). Without such a shape, the contact point itself.
        radius: Radius of the contact shape [m]; 0 without such a shape.
    """

    geom: int
    center: Array
    radius: float


def find_contact_points(
    model: mujoco.MjModel, data: mujoco.MjData, body: int, geoms: Sequence[int], joints: int
) -> tuple[ContactPoint, ...]:
    """Find the points at which a foot touches level ground, from the shape of its geoms.

    A sole that is nearly level in the pose in ``data`` is laid flat. The contact points are
    MuJoCo's contacts with the floor, or small balls at the corners of the sole. If the leg has few
    joints, the foot may have a single contact point, at the lower end.

    Args:
        model: Model, with a floor and a free joint.
        data: Data after ``mj_kinematics``.
        body: Id of the moving body to which the geoms belong.
        geoms: Ids of the foot's geoms, at least one.
        joints: Number of joints between foot and base.

    Returns:
        Contact points; empty if MuJoCo finds no contact with the floor.
    """
    max_tilt = _MAX_SOLE_TILT if joints >= _MIN_SOLE_JOINTS else 0.0
    geoms = _find_end_spheres(model, data, geoms, max_tilt) or geoms
    rotation, origin = data.xmat[body].reshape(3, 3), data.xpos[body]
    spheres = [
        (rotation.T @ (point - origin), radius)
        for geom in geoms
        for point, radius in _sample_surface(model, data, geom)
    ]
    if joints < _MIN_SOLE_JOINTS:
        return _find_tip_contact(model, data, geoms)
    points = np.array([point for point, _ in spheres])
    radii = np.array([radius for _, radius in spheres])
    out, flat = _find_sole(points, radii, -rotation[2])
    if joints < _NUM_SOLE_JOINTS and not (flat and can_keep_sole_flat(model, body, out)):
        return _find_tip_contact(model, data, geoms)
    return _find_sole_contacts(model, body, geoms, out)


def _sample_surface(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int
) -> Iterator[tuple[Array, float]]:
    """Yield spheres whose convex hull represents a geom; cylinders and ellipsoids are sampled.

    A sphere is a pair (centre (3,) [m] in the world frame, radius [m]).
    """
    shape, up = read_shape(model, geom, data), np.array([0.0, 0.0, 1.0])
    points = shape.outline(_CIRCLE_POINTS, _SPHERE_POINTS)
    if points is None or shape.minkowski_terms is None:
        return
    for point in points:
        yield point, shape.minkowski_terms.ball
    if len(shape.minkowski_terms.radii) == 3:  # ellipsoid: the lowest point is no sample point
        yield shape.find_lowest_point((np.eye(3), np.zeros(3)), up), 0.0


def _find_tip_contact(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int]
) -> tuple[ContactPoint, ...]:
    """Return a tuple with the contact point at the lowest point of a foot; empty without geoms."""
    down = np.array([0.0, 0.0, -1.0])
    geom = min(geoms, key=lambda geom: compute_lowest_height(model, data, [geom]), default=None)
    if geom is None:
        return ()
    outline = list(_sample_surface(model, data, geom))
    place, radius = min(outline, key=lambda sphere: float(sphere[0][2]) - sphere[1])
    if not radius and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_ELLIPSOID.value:
        place, radius = compute_osculating_sphere(read_shape(model, geom, data), down)
    elif not radius and len(outline) > 3:
        points = np.array([point for point, _ in outline])
        place, radius = fit_sphere(points, place, down)
        if not radius and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH.value:
            on = points[(place - points) @ down < _SOLE_ATOL]
            radius = BALL_RADIUS
            place = place + (on.mean(axis=0) - place) * (1, 1, 0) - radius * down
    return (_make_contact_point(data, geom, place, radius),)


def _make_contact_point(
    data: mujoco.MjData, geom: int, place: Array, radius: float
) -> ContactPoint:
    """Return the contact point of a geom, a sphere at ``place``, (3,) [m], in the world frame."""
    own = int(data.model.geom_bodyid[geom])
    return ContactPoint(geom, data.xmat[own].reshape(3, 3).T @ (place - data.xpos[own]), radius)


def compute_lowest_height(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int]
) -> float:
    """Compute the height of the lowest point of geoms, in the world frame [m].

    Args:
        model: Model.
        data: Data, with kinematics.
        geoms: Ids of the geoms; the result is infinite without geoms.
    """
    return min(
        (
            float(point[2]) - radius
            for geom in geoms
            for point, radius in _sample_surface(model, data, geom)
        ),
        default=math.inf,
    )


def _find_end_spheres(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int], lean: float
) -> list[int]:
    """Return the ids of the sphere geoms among ``geoms`` that are at the lower end of a foot.

    ``lean`` is the tilt that the foot may have [rad].
    """
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE.value
    lowest = min(geoms, key=lambda geom: compute_lowest_height(model, data, [geom]))
    bottom = compute_lowest_height(model, data, [lowest])

    def rise(geom: int) -> float:
        """Compute how much higher [m] than the foot a sphere may end and still be a contact."""
        away = (data.geom_xpos[geom] - data.geom_xpos[lowest])[:2]
        return _FOOT_SPHERE_RISE + math.tan(lean) * float(np.linalg.norm(away))

    spheres = [geom for geom in geoms if model.geom_type[geom] == sphere]
    return [
        geom for geom in spheres if compute_lowest_height(model, data, [geom]) < bottom + rise(geom)
    ]


def _find_sole(points: Array, radii: Array, down: Array) -> tuple[Array, bool]:
    """Find the sole of a foot: the largest flat part at the lower end that is nearly level.

    Args:
        points: Centres of spheres whose convex hull is the foot, shape (n, 3) [m].
        radii: Radii of the spheres, shape (n,) [m].
        down: Unit vector towards the ground, shape (3,), in the frame of the points.

    Returns:
        Outward normal of the sole, shape (3,), and True; without a sole, ``down`` and False.
    """
    surface = points + radii[:, None] * down
    end = float((surface @ down).max())
    candidates = list(_yield_level_normals(surface, down))
    best, area = down, 0.0
    for normal in candidates:
        height = points @ normal + radii
        on = points[height > height.max() - _SOLE_ATOL] + np.outer(
            radii[height > height.max() - _SOLE_ATOL], normal
        )
        # The sole contains the foot's lowest point, or a point at nearly this height.
        if (on @ down).max() < end - _SOLE_ATOL:
            continue
        sizes = np.linalg.svd(on - on.mean(axis=0), compute_uv=False)[:2] if len(on) > 1 else [0, 0]
        spread = float(np.ptp(on - on.mean(axis=0), axis=0).max())
        size = float(sizes[0] * (sizes[1] + 1e-6))
        if spread > _MIN_SOLE_LENGTH and size > area:
            best, area = normal, size
    return best, area > 0


def _yield_level_normals(surface: Array, down: Array) -> Iterator[Array]:
    """Yield the outward normals (3,) of the nearly level facets of a foot: candidates of a sole.

    If all points are on a line, the facet is the line. ``surface`` are points of the foot, shape
    (n, 3) [m]. ``down`` is a unit vector towards the ground, shape (3,), in the frame of the
    points.
    """
    middle = surface.mean(axis=0)
    spread = surface - middle
    # All three axes, also for one or two points; no n x n matrix for many points.
    _, sizes, axes = np.linalg.svd(spread, full_matrices=len(spread) < 3)
    rank = int((sizes > 1e-6).sum())
    if rank == 1:  # points on a line: the most level normal
        normal = down - (down @ axes[0]) * axes[0]
        length = float(np.linalg.norm(normal))
        if length > math.cos(_MAX_SOLE_TILT):
            yield normal / length
        return
    if rank == 0:
        return
    from pupper_analysis.base.qhull import ConvexHull, QhullError  # loads SciPy

    try:
        hull = ConvexHull(np.vstack([surface, middle - _APEX_HEIGHT * down]))
    except QhullError:
        return
    seen: list[Array] = []
    for *normal, _ in hull.equations:
        out = np.array(normal)
        if out @ down < math.cos(_MAX_SOLE_TILT) or any(
            out @ normal_seen > 1 - 1e-9 for normal_seen in seen
        ):
            continue
        seen.append(out)
        yield out


def _find_sole_contacts(
    model: mujoco.MjModel, body: int, geoms: Sequence[int], out: Array
) -> tuple[ContactPoint, ...]:
    """Find the contact points of a foot whose sole lies flat on the ground.

    ``out`` is the outward normal of the sole, shape (3,), in the frame of the foot's body.
    """
    found = _find_pressed_contacts(model, body, geoms, out)
    if not any(model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH.value for geom in geoms):
        return found
    side = np.cross(out, np.eye(3)[np.argmin(np.abs(out))])
    side /= np.linalg.norm(side)
    for first, second in TILT_DIRECTIONS[1:]:
        tilted = out + TILT_ANGLE * (first * side + second * np.cross(out, side))
        if not _are_same_points(
            found, _find_pressed_contacts(model, body, geoms, tilted / np.linalg.norm(tilted))
        ):
            return _find_corner_balls(model, body, geoms, out) or found
    return found


def _are_same_points(first: Sequence[ContactPoint], second: Sequence[ContactPoint]) -> bool:
    """Return True if contact points of a sole are nearly equal before and after a small tilt."""
    return len(first) == len(second) and all(
        min(float(np.linalg.norm(point.center - candidate.center)) for candidate in second)
        < _SOLE_ATOL
        for point in first
    )


def _find_corner_balls(
    model: mujoco.MjModel, body: int, geoms: Sequence[int], out: Array
) -> tuple[ContactPoint, ...]:
    """Create contact points at the corners of a sole: small spheres that touch a common plane.

    ``out`` is the outward normal of the sole in the body frame, shape (3,).
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    down = data.xmat[body].reshape(3, 3) @ out
    surface = [
        (geom, point + radius * down)
        for geom in geoms
        for point, radius in _sample_surface(model, data, geom)
    ]
    found = []
    level = max(float(point @ down) for _, point in surface)
    for number in find_sole_corners(
        np.array([point for _, point in surface]), down, 2 * _TEST_PENETRATION
    ):
        geom, point = surface[number]
        place = point + (level - float(point @ down) - BALL_RADIUS) * down
        found.append(_make_contact_point(data, geom, place, BALL_RADIUS))
    return tuple(found)


def _find_pressed_contacts(
    model: mujoco.MjModel, body: int, geoms: Sequence[int], out: Array
) -> tuple[ContactPoint, ...]:
    """Find the contacts that MuJoCo's collision detection yields for a sole pressed into the floor.

    The robot is first rotated so that the outward normal ``out`` (3,) of the sole, in the frame of
    the foot's body, points down.
    """
    data = mujoco.MjData(model)
    floor = ground_geom(model)
    mujoco.mj_kinematics(model, data)
    turned = _align_vectors(data.xmat[body].reshape(3, 3) @ out, np.array([0.0, 0.0, -1.0]))
    free = list_free_joints(model)[0]
    at = int(model.jnt_qposadr[free])
    quat = np.zeros(4)
    mujoco.mju_mulQuat(quat, turned, data.qpos[at + 3 : at + 7].copy())
    data.qpos[at + 3 : at + 7] = quat
    mujoco.mj_kinematics(model, data)
    data.qpos[at + 2] -= compute_lowest_height(model, data, geoms) + _TEST_PENETRATION
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    found: list[ContactPoint] = []
    for number in np.flatnonzero(find_acting_contacts(data)):
        touch = data.contact[int(number)]
        pair = [int(geom) for geom in touch.geom]
        if floor not in pair or not set(pair) & set(geoms):
            continue
        geom = pair[0] if pair[1] == floor else pair[1]
        kind = mujoco.mjtGeom(int(model.geom_type[geom]))
        radius = 0.0
        place = touch.pos + np.array([0.0, 0.0, touch.dist / 2])  # on the foot's surface
        if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE):
            radius = float(model.geom_size[geom, 0])
            place = min(
                (point for point, _ in _sample_surface(model, data, geom)),
                key=lambda point: float(np.linalg.norm(point - place)),
            )
        elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER and _is_lying(data, geom):  # wheel
            radius = float(model.geom_size[geom, 0])
            half = model.geom_size[geom, 1] * data.geom_xmat[geom].reshape(3, 3)[:, 2]
            ends = (data.geom_xpos[geom] - half, data.geom_xpos[geom] + half)
            place = min(ends, key=lambda end: float(np.linalg.norm((end - place)[:2])))
        found.append(_make_contact_point(data, geom, place, radius))
    return tuple(found)


def _is_lying(data: mujoco.MjData, geom: int) -> bool:
    """Return True if a cylinder lies on its curved side, like a wheel: its axis is nearly level."""
    return bool(abs(data.geom_xmat[geom][8]) < _MAX_AXIS_COSINE)


def _align_vectors(start: Array, end: Array) -> Array:
    """Compute the quaternion (w, x, y, z) that rotates the unit vector ``start`` (3,) to ``end``.

    Opposite vectors must be perpendicular to the x axis.
    """
    axis, cosine = np.cross(start, end), float(start @ end)
    if np.linalg.norm(axis) < 1e-12:
        return np.array([1.0, 0, 0, 0]) if cosine > 0 else np.array([0.0, 1.0, 0, 0])
    quat = np.concatenate([[1 + cosine], axis])
    unit: Array = quat / np.linalg.norm(quat)
    return unit
