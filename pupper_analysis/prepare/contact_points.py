"""Where a foot of any shape touches the ground: MuJoCo's own contacts of a sole that lies flat.

MuJoCo's contact of a plane and a mesh has up to four points: the mesh's lowest vertex, and others
that are near it on its hull. Of a sole with many vertices these are others when it tilts by
microradians, and so when loads shift: corners take their place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.spatial import ConvexHull, QhullError

from pupper_analysis.models.mjcf import free_joints
from pupper_analysis.models.shapes import Shape, read_shape
from pupper_analysis.robot.contact import ground_geom

BALL_RADIUS = 2e-3
"""Radius of the balls at a sole's corners (m): a tilt of 1 mrad moves their contact by 2 um."""

TILT_DIRECTIONS = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
"""Ways in which a sole is tilted to see whether its contacts jump."""

TILT_ANGLE = 1e-4
"""By how much (rad): a foot of 0.3 m is 30 um lower at one end, and still touches with both."""

_POSES = 3  # random ones: in one, a leg may be stretched

_RANK = 1e-2  # of what a leg can do: soles of meshes are tilted by their vertices' last digits

_MOST_CORNERS = 8
"""The most corners that are kept of a sole: those without which its area is least."""


def find_sole_corners(points: Array, out: Array, flat: float) -> list[int]:
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


def can_keep_sole_flat(model: mujoco.MjModel, body: int, out: Array) -> bool:
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


def compute_osculating_sphere(shape: Shape, down: Array) -> tuple[Array, float]:
    """Compute the sphere that has an ellipsoid's lowest point and its mean radius of curvature.

    With the half axes in S, the support function is h(d) = |S d|, attained at S^2 d / h. The
    principal radii of curvature there are the two non-zero eigenvalues of the second derivative of
    h, which is S^2 / h - S^2 d d^T S^2 / h^3 (Schneider 2014, Convex Bodies, section 2.5). Half of
    its trace is their mean.

    Args:
        shape: An ellipsoid, placed in the world.
        down: shape (3,), unit vector towards the ground, expressed in the world frame.

    Returns:
        The centre, shape (3,) [m], expressed in the world frame, and the radius [m].
    """
    turn, squares = shape.pose.rotation, np.array(shape.size) ** 2
    local = turn.T @ down
    support = math.sqrt(float(local @ (squares * local)))
    tip = squares * local / support
    radius = float((squares.sum() - tip @ tip) / support) / 2
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


Array = NDArray[np.float64]

_STEEPEST = math.radians(25.0)
"""A sole that is tilted by more in the start pose is none: the foot touches with an edge."""

_LEAST_LENGTH = 0.015
"""A flat part that is shorter is no sole (m): facets of a round foot's mesh are millimetres."""

_PRESSED = 1e-4
"""How deep the sole is pressed into the ground to see what touches (m)."""

_JOINTS_OF_A_SOLE = 5
"""A body has six degrees of freedom; a foot that is flat leaves one at most, its yaw."""

_LEAST_JOINTS_OF_A_SOLE = 4
"""Legs of four joints may lay a foot flat: not everywhere, but at any height."""

_AROUND = np.linspace(0, 2 * math.pi, 24, endpoint=False)
_CIRCLE = np.column_stack([np.cos(_AROUND), np.sin(_AROUND)])  # the rim of a cylinder
_UPWARD = np.linspace(-math.pi / 2, math.pi / 2, 12)
_GLOBE = np.array([(*math.cos(up) * point, math.sin(up)) for up in _UPWARD for point in _CIRCLE])

_APEX = 1.0  # m above a sole's points: so that even coplanar ones have a hull in space

_END = 5e-3
"""A sphere that is no further above a foot's lowest point is the foot (m)."""

_LYING = 0.1
"""A cylinder whose axis has less of the vertical lies: it touches with a line of its side."""

_FLAT = 1e-3  # m: facets of a mesh, and spheres, that are no further from a plane make up one sole


@dataclass(frozen=True, eq=False)
class ContactPoint:
    """A place where a foot touches the ground.

    Attributes:
        geom: The id of the geom that touches there.
        center: (3,) in the frame of the geom's body (m): of a sphere, or of the end of a
            capsule or of a cylinder that lies; of other shapes the point itself.
        radius: Of that sphere, or of the capsule, or of a cylinder that lies (m); otherwise 0.
    """

    geom: int
    center: Array
    radius: float


def find_contact_points(
    model: mujoco.MjModel, data: mujoco.MjData, body: int, geoms: Sequence[int], joints: int
) -> tuple[ContactPoint, ...]:
    """Finds the contact points of a foot with level ground.

    The sole is the flat part of its geoms' hull that is lowest, and nearly level, in the pose that
    ``data`` has; without one the foot touches where it is lowest. The foot is laid flat, and what
    MuJoCo then finds in contact are the contact points. A leg of few joints cannot lay a foot flat
    (``can_keep_sole_flat``): it has one contact point, of the sphere that its foot is, or that
    fits to its lower end.

    Args:
        model: The model, with a floor.
        data: After ``mj_kinematics``, in the start pose.
        body: The id of the moving body that the geoms are on.
        geoms: The ids of the foot's geoms.
        joints: How many joints move the foot against the base.
    """
    lean = _STEEPEST if joints >= _LEAST_JOINTS_OF_A_SOLE else 0.0
    geoms = _round_ones(model, data, geoms, lean) or geoms
    rotation, origin = data.xmat[body].reshape(3, 3), data.xpos[body]
    support = [
        (rotation.T @ (point - origin), radius)
        for geom in geoms
        for point, radius in _outline(model, data, geom)
    ]
    if joints < _LEAST_JOINTS_OF_A_SOLE:
        return _tip(model, data, geoms)
    points = np.array([point for point, _ in support])
    radii = np.array([radius for _, radius in support])
    out, flat = _sole(points, radii, -rotation[2])
    if joints < _JOINTS_OF_A_SOLE and not (flat and can_keep_sole_flat(model, body, out)):
        return _tip(model, data, geoms)
    return _touching(model, body, geoms, out)


def _outline(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int
) -> Iterator[tuple[Array, float]]:
    """Yields spheres, (3,) in the world and a radius, whose hull is that of a geom (m)."""
    shape, up = read_shape(model, geom, data), np.array([0.0, 0.0, 1.0])
    points = shape.outline(_CIRCLE, _GLOBE)
    if points is None or shape.terms is None:
        return
    for point in points:
        yield point, shape.terms.ball
    if len(shape.terms.radii) == 3:  # no point of the globe is lowest
        yield shape.lowest((np.eye(3), np.zeros(3)), up), 0.0


def _tip(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int]
) -> tuple[ContactPoint, ...]:
    """Returns the one contact point of a foot that cannot lie flat, where it is lowest.

    A mesh that is not round there has a small ball in the middle of what is lowest.
    """
    down = np.array([0.0, 0.0, -1.0])
    geom = min(geoms, key=lambda geom: compute_lowest_height(model, data, [geom]), default=None)
    if geom is None:
        return ()
    outline = list(_outline(model, data, geom))
    place, radius = min(outline, key=lambda sphere: float(sphere[0][2]) - sphere[1])
    if not radius and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_ELLIPSOID.value:
        place, radius = compute_osculating_sphere(read_shape(model, geom, data), down)
    elif not radius and len(outline) > 3:
        points = np.array([point for point, _ in outline])
        place, radius = fit_sphere(points, place, down)
        if not radius and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH.value:
            on = points[(place - points) @ down < _FLAT]
            radius = BALL_RADIUS
            place = place + (on.mean(axis=0) - place) * (1, 1, 0) - radius * down
    return (_point(data, geom, place, radius),)


def _point(data: mujoco.MjData, geom: int, place: Array, radius: float) -> ContactPoint:
    """Returns a contact point of a place (3,) in the world."""
    own = int(data.model.geom_bodyid[geom])
    return ContactPoint(geom, data.xmat[own].reshape(3, 3).T @ (place - data.xpos[own]), radius)


def compute_lowest_height(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int]
) -> float:
    """Returns the height of the lowest point of some geoms (m); infinite if there is none."""
    return min(
        (
            float(point[2]) - radius
            for geom in geoms
            for point, radius in _outline(model, data, geom)
        ),
        default=math.inf,
    )


def _round_ones(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int], lean: float
) -> list[int]:
    """Returns the spheres at the lower end of a foot: other shapes there are the leg's.

    Spheres that a sole which leans by ``lean`` (rad) has higher up, as they are further away, are
    at the lower end, too.
    """
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE.value
    end = min(geoms, key=lambda geom: compute_lowest_height(model, data, [geom]))
    bottom = compute_lowest_height(model, data, [end])

    def rise(geom: int) -> float:
        away = (data.geom_xpos[geom] - data.geom_xpos[end])[:2]
        return _END + math.tan(lean) * float(np.linalg.norm(away))

    spheres = [geom for geom in geoms if model.geom_type[geom] == sphere]
    return [
        geom for geom in spheres if compute_lowest_height(model, data, [geom]) < bottom + rise(geom)
    ]


def _sole(points: Array, radii: Array, down: Array) -> tuple[Array, bool]:
    """Returns the direction (3,) out of the sole, in the body's frame, and whether there is one.

    Without one it is ``down``.
    """
    surface = points + radii[:, None] * down
    end = float((surface @ down).max())
    candidates = list(_facets(surface, down))
    best, area = down, 0.0
    for normal in candidates:
        height = points @ normal + radii
        on = points[height > height.max() - _FLAT] + np.outer(
            radii[height > height.max() - _FLAT], normal
        )
        # The sole has the foot's lowest point, or one that is as good as it.
        if (on @ down).max() < end - _FLAT:
            continue
        sizes = np.linalg.svd(on - on.mean(axis=0), compute_uv=False)[:2] if len(on) > 1 else [0, 0]
        spread = float(np.ptp(on - on.mean(axis=0), axis=0).max())
        size = float(sizes[0] * (sizes[1] + 1e-6))
        if spread > _LEAST_LENGTH and size > area:
            best, area = normal, size
    return best, area > 0


def _facets(surface: Array, down: Array) -> Iterator[Array]:
    """Yields the outward normals (3,) of a hull's nearly level facets, or of its edge."""
    middle = surface.mean(axis=0)
    spread = surface - middle
    # All axes, also of one or two points; of many not their n x n matrix of the other side.
    _, sizes, axes = np.linalg.svd(spread, full_matrices=len(spread) < 3)
    rank = int((sizes > 1e-6).sum())
    if rank == 1:  # points on a line: as level as the line can lie
        normal = down - (down @ axes[0]) * axes[0]
        length = float(np.linalg.norm(normal))
        if length > math.cos(_STEEPEST):
            yield normal / length
        return
    if rank == 0:
        return
    try:
        hull = ConvexHull(np.vstack([surface, middle - _APEX * down]))
    except QhullError:
        return
    seen: list[Array] = []
    for *normal, _ in hull.equations:
        out = np.array(normal)
        if out @ down < math.cos(_STEEPEST) or any(out @ other > 1 - 1e-9 for other in seen):
            continue
        seen.append(out)
        yield out


def _touching(
    model: mujoco.MjModel, body: int, geoms: Sequence[int], out: Array
) -> tuple[ContactPoint, ...]:
    """Returns where a foot touches that is laid flat, ``out`` (3,) of its frame downwards.

    A sole whose contacts jump from vertex to vertex of a mesh as it tilts has balls at its corners.
    """
    found = _pressed(model, body, geoms, out)
    if not any(model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH.value for geom in geoms):
        return found
    side = np.cross(out, np.eye(3)[np.argmin(np.abs(out))])
    side /= np.linalg.norm(side)
    for one, two in TILT_DIRECTIONS[1:]:
        tilted = out + TILT_ANGLE * (one * side + two * np.cross(out, side))
        if not _alike(found, _pressed(model, body, geoms, tilted / np.linalg.norm(tilted))):
            return _cornered(model, body, geoms, out) or found
    return found


def _alike(one: Sequence[ContactPoint], two: Sequence[ContactPoint]) -> bool:
    """Tells whether a foot touches with the same points."""
    return len(one) == len(two) and all(
        min(float(np.linalg.norm(point.center - other.center)) for other in two) < _FLAT
        for point in one
    )


def _cornered(
    model: mujoco.MjModel, body: int, geoms: Sequence[int], out: Array
) -> tuple[ContactPoint, ...]:
    """Returns balls at the corners of a sole, ``out`` (3,) being the direction out of it.

    All in one plane: a mesh's corners that are a tenth of a millimetre off it would have the foot
    tilt by milliradians to rest on three of them.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    down = data.xmat[body].reshape(3, 3) @ out
    surface = [
        (geom, point + radius * down)
        for geom in geoms
        for point, radius in _outline(model, data, geom)
    ]
    found = []
    level = max(float(point @ down) for _, point in surface)
    for number in find_sole_corners(np.array([point for _, point in surface]), down, 2 * _PRESSED):
        geom, point = surface[number]
        place = point + (level - float(point @ down) - BALL_RADIUS) * down
        found.append(_point(data, geom, place, BALL_RADIUS))
    return tuple(found)


def _pressed(
    model: mujoco.MjModel, body: int, geoms: Sequence[int], out: Array
) -> tuple[ContactPoint, ...]:
    """Presses a foot into the floor, ``out`` (3,) of its frame downwards, and sees what touches."""
    data = mujoco.MjData(model)
    floor = ground_geom(model)
    mujoco.mj_kinematics(model, data)
    turned = _turning(data.xmat[body].reshape(3, 3) @ out, np.array([0.0, 0.0, -1.0]))
    free = free_joints(model)[0]
    at = int(model.jnt_qposadr[free])
    quat = np.zeros(4)
    mujoco.mju_mulQuat(quat, turned, data.qpos[at + 3 : at + 7].copy())
    data.qpos[at + 3 : at + 7] = quat
    mujoco.mj_kinematics(model, data)
    data.qpos[at + 2] -= compute_lowest_height(model, data, geoms) + _PRESSED
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    found: list[ContactPoint] = []
    for number in range(data.ncon):
        touch = data.contact[number]
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
                (point for point, _ in _outline(model, data, geom)),
                key=lambda point: float(np.linalg.norm(point - place)),
            )
        elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER and _lies(data, geom):  # a wheel, which rolls
            radius = float(model.geom_size[geom, 0])
            half = model.geom_size[geom, 1] * data.geom_xmat[geom].reshape(3, 3)[:, 2]
            ends = (data.geom_xpos[geom] - half, data.geom_xpos[geom] + half)
            place = min(ends, key=lambda end: float(np.linalg.norm((end - place)[:2])))
        found.append(_point(data, geom, place, radius))
    return tuple(found)


def _lies(data: mujoco.MjData, geom: int) -> bool:
    """Tells whether a cylinder touches the ground with its side."""
    return bool(abs(data.geom_xmat[geom][8]) < _LYING)


def _turning(one: Array, two: Array) -> Array:
    """Returns the quaternion (w, x, y, z) that turns a unit vector (3,) into another."""
    axis, cosine = np.cross(one, two), float(one @ two)
    if np.linalg.norm(axis) < 1e-12:
        return np.array([1.0, 0, 0, 0]) if cosine > 0 else np.array([0.0, 1.0, 0, 0])
    quat = np.concatenate([[1 + cosine], axis])
    unit: Array = quat / np.linalg.norm(quat)
    return unit
