"""Points of shapes, and convex hulls."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.tools import format_of
from pupper_analysis.models.places import one_line
from pupper_analysis.models.stated.model import (
    Array,
    Link,
    RobotModel,
    Shape,
)

_SIGNS = np.array(list(product((-1.0, 1.0), repeat=3)))
_DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
_CIRCLE = np.array([(np.cos(a), np.sin(a), 0.0) for a in np.linspace(0, 2 * np.pi, 17)[:-1]])
_Z = np.array([0.0, 0.0, 1.0])


_SAMPLES = np.concatenate([np.eye(3), -np.eye(3), np.random.default_rng(0).normal(size=(60, 3))])
DIRECTIONS = _SAMPLES / np.linalg.norm(_SAMPLES, axis=1, keepdims=True)
"""(66, 3) in which the extents of two shapes are compared: axes, and enough others that no turn of
a box or a cylinder hides between them."""


def describe_shape(shape: Shape) -> Diagnostic:
    """Returns a shape as a fact: its kind, sizes and place."""
    return diagnose(
        "shape",
        kind=Term(shape.kind),
        sizes=tuple(Quantity(size, "m") for size in shape.size),
        x=Quantity(float(shape.pose.position[0]), "m"),
        y=Quantity(float(shape.pose.position[1]), "m"),
        z=Quantity(float(shape.pose.position[2]), "m"),
    )


def mesh_vertices(path: Path) -> Array | None:
    """Returns the vertices (n, 3) of an STL or OBJ file's convex hull; None if it cannot be read.

    Other kinds (COLLADA) carry units and poses of their own and are not read.
    """
    if path.suffix.lower() not in (".stl", ".obj"):
        return None
    return _read_vertices(path, path.stat().st_mtime_ns)


def mesh_problem(path: Path) -> Diagnostic | None:
    """Says what keeps a file from being a mesh; None if nothing does, or it is not read here.

    STL and OBJ are read, of COLLADA the start. A file of more than ``LARGEST_MESH`` bytes is not
    opened.
    """
    ending = path.suffix.lower()
    if ending not in _FORMATS and format_of(path) is None:
        return diagnose("mesh-of-no-format", ending=ending)
    if path.stat().st_size > LARGEST_MESH:
        return None
    if ending == ".dae":
        with path.open("rb") as file:
            start = file.read(_PROLOGUE)
        return None if b"COLLADA" in start else diagnose("mesh-no-collada")
    if ending not in (".stl", ".obj"):
        return None
    found = _read(path, path.stat().st_mtime_ns)
    return found if isinstance(found, Diagnostic) else None


_FORMATS = (
    ".stl", ".obj", ".msh", ".dae", ".ply", ".off", ".glb", ".gltf", ".fbx", ".3ds", ".mesh",
    ".wrl", ".iv",
)  # fmt: skip
"""Endings of meshes that MuJoCo, Gazebo, Bullet, Drake or RViz read; whole formats have theirs."""

_PROLOGUE = 4096
"""Bytes of an XML before its first element, with comments."""

LARGEST_MESH = 200_000_000
"""Bytes: the greatest meshes that are published have a quarter of it."""


def _read_vertices(path: Path, changed: int) -> Array | None:
    found = _read(path, changed)
    return None if isinstance(found, Diagnostic) else found


@lru_cache(maxsize=256)
def _read(path: Path, _changed: int) -> Array | Diagnostic:
    """Returns the vertices (n, 3) of a mesh's convex hull (m), or what is wrong with the file."""
    import trimesh  # slow to import; yourdfpy depends on it

    try:
        mesh = trimesh.load(path, force="mesh", process=False, skip_materials=True)
        points = np.asarray(mesh.vertices, dtype=float)
        faces = np.asarray(mesh.faces)
    except Exception as error:  # whatever a broken mesh makes a parser raise
        return diagnose("no-mesh", problem=one_line(error) or type(error).__name__)
    if not len(points) or not len(faces):
        return diagnose("mesh-without-triangle")
    if not np.isfinite(points).all():
        return diagnose("mesh-vertex-not-finite")
    if faces.min() < 0 or faces.max() >= len(points):
        return diagnose("mesh-vertex-unknown", vertex=int(faces.max()) + 1, vertices=len(points))
    return hull_points(points)


def hull_points(points: Array) -> Array:
    """Returns those of the points (n, 3) that span the convex hull; all, if they lie in a plane."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        chosen: Array = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return points
    return chosen


def shape_points(shape: Shape) -> Array | None:
    """Returns points (n, 3) in the body's frame whose convex hull is the shape's, nearly (m).

    Returns:
        None if the shape's extent is not known (a missing mesh, a plane).
    """
    size = shape.size
    match shape.kind:
        case "sphere":
            local = size[0] * _DIRECTIONS
        case "box" | "ellipsoid":
            local = np.array(size) * (_SIGNS if shape.kind == "box" else _DIRECTIONS)
        case "cylinder":
            ring = size[0] * _CIRCLE
            local = np.concatenate([ring - size[1] * _Z, ring + size[1] * _Z])
        case "capsule":
            ball = size[0] * _DIRECTIONS
            local = np.concatenate([ball - size[1] * _Z, ball + size[1] * _Z])
        case "mesh":
            vertices = shape.vertices()
            if vertices is None:
                return None
            local = vertices
        case _:
            return None
    return shape.pose.point(local)


def support_of(shape: Shape, directions: Array) -> Array | None:
    """Returns the support function of a shape's convex hull, in its body's frame.

    h(d) = max over points x of the hull of d'x. Two shapes have one hull if their functions are
    the same, wherever their axes point: MuJoCo and most engines touch with the hull.

    Args:
        shape: The shape.
        directions: (n, 3) unit vectors in the body's frame.

    Returns:
        (n,) (m); None if the shape's extent is not known (a missing mesh, a plane).
    """
    local, size = directions @ shape.pose.rotation, shape.size
    match shape.kind:
        case "sphere":
            reach = np.full(len(local), size[0])
        case "box":
            reach = np.abs(local) @ np.array(size)
        case "ellipsoid":
            reach = np.linalg.norm(local * np.array(size), axis=1)
        case "cylinder":
            reach = size[1] * np.abs(local[:, 2]) + size[0] * np.hypot(local[:, 0], local[:, 1])
        case "capsule":
            reach = size[1] * np.abs(local[:, 2]) + size[0]
        case "mesh":
            vertices = shape.vertices()
            if vertices is None:
                return None
            reach = (local @ vertices.T).max(axis=1)
        case _:
            return None
    return np.asarray(directions @ shape.pose.position + reach)


def extent_points(bodies: Sequence[Link], frame: Link) -> Array | None:
    """Returns points (n, 3) that span all shapes of some bodies, in the frame of one of them (m).

    Returns:
        None if they have no shapes, or the extent of one is not known.
    """
    points, whole = known_points(bodies, frame)
    return points if whole else None


def known_points(bodies: Sequence[Link], frame: Link) -> tuple[Array | None, bool]:
    """Returns points of those shapes whose extent is known, and whether that is all of them.

    Returns:
        Points (n, 3) as ``extent_points`` has them, None if no shape is known; and whether none is
        left out, such as a mesh that is not read.
    """
    to_frame, parts, whole = frame.pose.inverse(), [], True
    for body in bodies:
        for shape in body.shapes:
            points = shape_points(shape)
            if points is None:
                whole = False
            else:
                parts.append((to_frame * body.pose).point(points))
    return (np.concatenate(parts) if parts else None), whole


def link_points(robot: RobotModel, body: Link) -> Array:
    """Returns a body's origin, frames and children's origins (n, 3), in its frame (m)."""
    to_frame = body.pose.inverse()
    points = [np.zeros(3), *(frame.position for frame in body.frames)]
    points += [to_frame.point(child.pose.position) for child in robot.children(body.name)]
    return np.array(points)


def outside_hull(points: Array, point: Array) -> float:
    """Returns how far a point is outside the convex hull of others, at least; <= 0 if inside (m).

    Of points that lie in a plane the bounding box is taken.
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        faces = ConvexHull(points).equations
    except (QhullError, ValueError):
        return float(np.max(np.maximum(points.min(0) - point, point - points.max(0))))
    return float(np.max(faces[:, :3] @ point + faces[:, 3]))


@dataclass(frozen=True, eq=False)
class Solid:
    """What a shape would be of a density of 1.

    Attributes:
        volume: m^3.
        com: (3,) in the shape's frame (m).
        inertia: (3, 3) about the com, of 1 kg/m^3 (m^5).
    """

    volume: float
    com: Array
    inertia: Array


def solid_of(kind: str, size: tuple[float, ...]) -> Solid | None:
    """Returns a shape's volume and second moments in closed form, z its axis."""
    middle = np.zeros(3)
    match kind, size:
        case "box", (a, b, c):
            volume = 8 * a * b * c
            moments = np.array([b * b + c * c, a * a + c * c, a * a + b * b]) / 3
        case "sphere", (r,):
            volume, moments = 4 / 3 * math.pi * r**3, np.full(3, 0.4 * r * r)
        case "ellipsoid", (a, b, c):
            volume = 4 / 3 * math.pi * a * b * c
            moments = np.array([b * b + c * c, a * a + c * c, a * a + b * b]) / 5
        case "cylinder", (r, h):
            volume = 2 * math.pi * r * r * h
            across = r * r / 4 + h * h / 3
            moments = np.array([across, across, r * r / 2])
        case "cone", (r, h):
            volume = 2 / 3 * math.pi * r * r * h
            across = 0.15 * (r * r + h * h)  # 3/80 of the height squared, which is 2 h
            moments = np.array([across, across, 0.3 * r * r])
            middle = np.array([0.0, 0.0, -h / 2])  # a quarter of the height above the base
        case "capsule", (r, h):
            tube, ball = 2 * math.pi * r * r * h, 4 / 3 * math.pi * r**3
            volume = tube + ball
            # The two halves of the ball, their coms 3/8 r beyond the ends of the tube.
            across = tube * (r * r / 4 + h * h / 3) + ball * (0.4 * r * r + h * h + 0.75 * h * r)
            moments = np.array([across, across, (tube / 2 + 0.4 * ball) * r * r]) / volume
        case _:
            return None
    return Solid(float(volume), middle, np.diag(volume * moments))
