"""Geometry of shapes, used for display, contact and inertia.

The convex hull of each supported shape is the Minkowski sum of a point, line segments (bars), an
ellipse or ellipsoid, a ball and a convex hull (`Terms`). Support function, lowest point and outline
are computed from these terms, independently of the kind of shape.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from typing import Final, NamedTuple
from weakref import WeakValueDictionary

import coal  # comes with pin
import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.base.frozen import ReadOnlyFields

Direction = tuple[float, float, float]
"""Vector or point (x, y, z) as three floats, for scalar arithmetic."""


@dataclass(frozen=True, eq=False)
class Pose(ReadOnlyFields):
    """Rigid transformation x = position + rotation x', from the frame with this pose to its parent.

    Attributes:
        position: Translation (3,) [m].
        rotation: Rotation matrix (3, 3).
    """

    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))

    def __mul__(self, other: Pose) -> Pose:
        return Pose(self.point(other.position), self.rotation @ other.rotation)

    def point(self, local: Array) -> Array:
        """Transform a point, shape (3,), or points, shape (n, 3) [m], to the parent frame.

        x = position + rotation x'.

        Args:
            local: Points in the frame with this pose.
        """
        transformed: Array = local @ self.rotation.T + self.position
        return transformed

    @property
    def placement(self) -> pin.SE3:
        """This pose as a Pinocchio ``SE3``, from the frame with this pose to the parent frame."""
        return pin.SE3(self.rotation, self.position)

    def inverse(self) -> Pose:
        """Return the inverse transformation x' = rotation^T (x - position)."""
        return Pose(-self.rotation.T @ self.position, self.rotation.T)

    @staticmethod
    def of(placement: pin.SE3) -> Pose:
        """Convert a placement of Pinocchio (``pin.SE3``) to a `Pose`."""
        return Pose(np.array(placement.translation), np.array(placement.rotation))

    @staticmethod
    def of_body(data: mujoco.MjData, body: int) -> Pose:
        """Return the world pose of a body from MuJoCo's data; position in m."""
        return Pose(data.xpos[body].copy(), data.xmat[body].reshape(3, 3).copy())


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangle mesh.

    Attributes:
        vertices: Vertices (n, 3) [m].
        faces: Triangles (m, 3), as row indices of ``vertices``.
    """

    vertices: Array
    faces: IntArray

    def select(self, numbers: Array | IntArray, faces: Array | IntArray) -> Mesh:
        """Return the submesh with some vertices and triangles of this mesh.

        Args:
            numbers: Row indices of the kept vertices, shape (k,).
            faces: Kept triangles, shape (m, 3), as vertex indices of this mesh.
        """
        new_numbers = np.full(len(self.vertices), -1, dtype=np.int64)
        new_numbers[numbers] = np.arange(len(numbers))
        return Mesh(self.vertices[numbers], new_numbers[faces])

    def hull(self) -> Mesh:
        """Return the convex hull of this mesh, or the mesh itself if it has no hull (flat).

        Meshes with equal vertices share a hull while it is in use: two versions of a file usually
        have equal meshes, and a hull takes about 30 ms.
        """
        from pupper_analysis.base.qhull import ConvexHull, QhullError  # loads SciPy

        content = hashlib.sha256(self.vertices.tobytes()).digest()
        if (known := _HULLS.get(content)) is not None:
            return known
        try:
            hull = ConvexHull(self.vertices)
        except (QhullError, ValueError):
            return self
        _HULLS[content] = result = self.select(hull.vertices, hull.simplices)
        return result


_HULLS: WeakValueDictionary[bytes, Mesh] = WeakValueDictionary()
"""{SHA-256 of the vertices of a mesh: its convex hull}, of hulls that are in use."""


def _integrate_hull(hull: Mesh) -> pin.Inertia | None:
    """Return the spatial inertia of a convex hull with a density of 1 kg/m^3; None without volume.

    A tetrahedron has the volume V and the edges e_i from the origin. Its integral of x x^T is V/20
    (sum_i e_i e_i^T + s s^T), with s = sum_i e_i.
    """
    middle = hull.vertices.mean(axis=0)
    edges = hull.vertices[hull.faces] - middle
    volumes = np.abs(np.linalg.det(edges)) / 6
    volume, sums = float(volumes.sum()), edges.sum(axis=1)
    if not volume > 0:
        return None
    lever = volumes @ sums / (4 * volume)
    second = (
        np.einsum("n,nki,nkj->ij", volumes, edges, edges)
        + np.einsum("n,ni,nj->ij", volumes, sums, sums)
    ) / 20 - volume * np.outer(lever, lever)
    return pin.Inertia(volume, middle + lever, np.trace(second) * np.eye(3) - second)


class Terms(NamedTuple):
    """Terms of a Minkowski sum that equals the convex hull of a shape, in the body frame [m].

    Attributes:
        centre: Point (3,).
        bars: Vectors (3,) from the middle to one end of each line segment: three for a box, a
            single one for a capsule.
        radii: Vectors (3,) of the semi-axes of an ellipse (two) or of an ellipsoid (three); () if
            there is none.
        ball: Radius of the ball.
        hull: Vertices (n, 3) of a convex hull, relative to the centre; None if there is none.
    """

    centre: Direction
    bars: tuple[Direction, ...]
    radii: tuple[Direction, ...]
    ball: float
    hull: Array | None


@dataclass(frozen=True, eq=False)
class Shape:
    """Visual or collision shape of a body: kind, pose and sizes.

    Attributes:
        name: Name; "" if there is none.
        kind: ``sphere``, ``box``, ``cylinder``, ``capsule``, ``ellipsoid``, ``mesh`` or another.
        pose: Pose in the frame of the body.
        size: One to three numbers [m]: (radius,), (radius, half length), or three half sizes. Empty
            for a mesh and for other kinds.
        collides: Whether the shape can collide. Explicit contact pairs of an MJCF are not counted.
        read: Function that returns the mesh in the frame of the shape, or None if unknown.
        read_volume: Function that returns the volume [m^3] of a mesh; the function returns None if
            the volume is unknown, or the surface is not closed.
        read_solid: Function that returns the spatial inertia of the solid of a mesh with a density
            of 1 kg/m^3, in the frame of the shape; None under the conditions of ``read_volume``.
    """

    name: str
    kind: str
    pose: Pose
    size: tuple[float, ...]
    collides: bool
    read: Callable[[], Mesh | None] = lambda: None
    read_volume: Callable[[], float | None] = lambda: None
    read_solid: Callable[[], pin.Inertia | None] = lambda: None

    @cached_property
    def mesh(self) -> Mesh | None:
        """Convex hull of a mesh, or the mesh itself if it has no hull (flat); None if unknown."""
        return self.read()

    def compute_volume(self) -> float | None:
        """Compute the volume of the solid shape [m^3]; None for an open mesh, for example."""
        size = self.size
        match self.kind:
            case "sphere":
                return 4 / 3 * math.pi * size[0] ** 3
            case "box":
                return 8 * math.prod(size)
            case "ellipsoid":
                return 4 / 3 * math.pi * math.prod(size)
            case "cylinder":
                return 2 * math.pi * size[0] ** 2 * size[1]
            case "capsule":
                return math.pi * size[0] ** 2 * (2 * size[1] + 4 / 3 * size[0])
            case "mesh":
                return self.read_volume()
            case _:
                return None

    def compute_solid_inertia(self) -> pin.Inertia | None:
        """Compute the spatial inertia of the solid shape with a density of 1 kg/m^3.

        The result is expressed in the frame of the body. The convex hull replaces a mesh whose
        solid is unknown (``read_solid``).

        Returns:
            Spatial inertia; None if it cannot be computed, for example for a plane or an ellipsoid.
        """
        size = self.size
        match self.kind:
            case "sphere":
                solid = pin.Inertia.FromSphere(4 / 3 * math.pi * size[0] ** 3, size[0])
            case "box":
                solid = pin.Inertia.FromBox(8 * math.prod(size), *(2 * half for half in size))
            case "cylinder":
                volume = 2 * math.pi * size[0] ** 2 * size[1]
                solid = pin.Inertia.FromCylinder(volume, size[0], 2 * size[1])
            case "capsule":
                volume = math.pi * size[0] ** 2 * (2 * size[1] + 4 / 3 * size[0])
                solid = pin.Inertia.FromCapsule(volume, size[0], 2 * size[1])
            case "mesh":
                solid = self.read_solid()
                if solid is None and self.mesh is not None:
                    solid = _integrate_hull(self.mesh)
            case _:
                solid = None
        return None if solid is None else self.pose.placement.act(solid)

    def placed_in(self, pose: Pose) -> Shape:
        """Return the shape in an outer frame, in which ``pose`` is the pose of the shape's body."""
        return replace(self, pose=pose * self.pose)

    @property
    def diagnostic(self) -> Diagnostic:
        """Diagnostic that describes this shape by kind, sizes [m] and position [m]."""
        x, y, z = (Quantity(float(value), "m") for value in self.pose.position)
        sizes = tuple(Quantity(size, "m") for size in self.size)
        return diagnose("shape", kind=Term(self.kind), sizes=sizes, x=x, y=y, z=z)

    @cached_property
    def minkowski_terms(self) -> Terms | None:
        """Convex sets whose Minkowski sum is the hull of the shape, in the frame of the body [m].

        A capsule, for example, is the sum of a centre, a line segment and a ball. None if the
        extent is unknown (missing mesh, plane).
        """
        rotation, size, hull = self.pose.rotation, self.size, None
        bars, radii, ball = list[tuple[int, float]](), list[tuple[int, float]](), 0.0
        match self.kind:
            case "sphere":
                ball = size[0]
            case "box":
                bars = list(enumerate(size))
            case "ellipsoid" if len({*size}) == 1:
                ball = size[0]
            case "ellipsoid":
                radii = list(enumerate(size))
            case "cylinder":
                bars, radii = [(2, size[1])], [(0, size[0]), (1, size[0])]
            case "capsule":
                bars, ball = [(2, size[1])], size[0]
            case "mesh" if self.mesh is not None:
                hull = np.ascontiguousarray(self.mesh.vertices @ rotation.T)
            case _:
                return None

        def along(axis: int, half_length: float) -> Direction:
            """Return a vector along axis 0, 1 or 2 of the shape, in the frame of the body [m]."""
            x, y, z = (half_length * rotation[:, axis]).tolist()
            return x, y, z

        x, y, z = self.pose.position.tolist()
        return Terms(
            (x, y, z),
            tuple(along(*bar) for bar in bars),
            tuple(along(*radius) for radius in radii),
            ball,
            hull,
        )

    def support(self, directions: Array) -> Array | None:
        """Return the support function of the convex hull, in the frame of the body.

        The support function is h(d) = max over points x of the hull of d^T x.

        Args:
            directions: Unit vectors (n, 3) in the frame of the body.

        Returns:
            Values (n,) [m]; None if the extent is unknown.
        """
        if self.minkowski_terms is None:
            return None
        centre, bars, radii, ball, hull = self.minkowski_terms
        support = directions @ np.array(centre) + ball
        if bars:
            support += np.abs(directions @ np.array(bars).T).sum(axis=1)
        if radii:
            support += np.linalg.norm(directions @ np.array(radii).T, axis=1)
        if hull is not None:
            support += (directions @ hull.T).max(axis=1)
        return np.asarray(support)

    def height(self, link: tuple[Array, Array], normal: Direction) -> float:
        """Return the height [m] of the shape's lowest point above a plane through the world origin.

        The extent of the shape must be known.

        Args:
            link: Rotation (3, 3) and position (3,) [m] of the body in the world.
            normal: Unit normal of the plane in the world; a vertical normal must point upwards.
        """
        rotation, position = link
        a, b, c = normal
        # Normal in the axes of the link, and height of the link's origin.
        if a == 0.0 and b == 0.0:
            (u, v, w), height = rotation[2].tolist(), position.item(2)
        else:
            (xx, xy, xz), (yx, yy, yz), (u, v, w) = rotation.tolist()
            at_x, at_y, height = position.tolist()
            u, v, w = a * xx + b * yx + c * u, a * xy + b * yy + c * v, a * xz + b * yz + c * w
            height = a * at_x + b * at_y + c * height
        (x, y, z), bars, radii, ball, hull = self.minkowski_terms  # type: ignore[misc]
        height += u * x + v * y + w * z - ball
        for x, y, z in bars:
            height -= abs(u * x + v * y + w * z)
        if radii:
            height -= math.hypot(*[u * x + v * y + w * z for x, y, z in radii])
        if hull is not None:
            height += hull.dot((u, v, w)).min()
        return float(height)

    def find_lowest_point(self, link: tuple[Array, Array], normal: Array) -> Array:
        """Return the lowest point of the shape above a plane, shape (3,) [m], in the world.

        The extent of the shape must be known.

        Args:
            link: Rotation (3, 3) and position (3,) [m] of the body in the world.
            normal: Unit normal of the plane in the world, shape (3,).
        """
        rotation, position = link
        local_normal = rotation.T @ normal
        centre, bars, radii, ball, hull = self.minkowski_terms  # type: ignore[misc]
        point = np.array(centre) - ball * local_normal
        for bar in bars:
            point -= math.copysign(1.0, local_normal @ bar) * np.array(bar)
        if radii:
            projections = np.array(radii) @ local_normal
            point -= (
                np.array(radii).T @ projections / max(float(np.linalg.norm(projections)), 1e-300)
            )
        if hull is not None:
            point += hull[(hull @ local_normal).argmin()]
        lowest: Array = rotation @ point + position
        return lowest

    def outline(self, circle: Array, globe: Array) -> Array | None:
        """Return centres of equal balls that together have the same convex hull as the shape.

        The radius of the balls is ``minkowski_terms.ball``, for example 0 for a box. Ellipses (of
        cylinders) and ellipsoids are approximated by points.

        Args:
            circle: Points of the unit circle, shape (n, 2), that represent an ellipse.
            globe: Points of the unit sphere, shape (n, 3), that represent an ellipsoid.

        Returns:
            Centres, shape (n, 3) [m], in the frame of the body; None if the extent is unknown.
        """
        if self.minkowski_terms is None:
            return None
        centre, bars, radii, _, hull = self.minkowski_terms
        points: Array = np.array([centre]) if hull is None else centre + hull
        summands = [np.array([[-1.0], [1.0]]) * bar for bar in bars]
        if radii:
            summands.append((circle if len(radii) == 2 else globe) @ np.array(radii))
        for summand in summands:
            points = (points[:, None] + summand).reshape(-1, 3)
        return points

    @property
    def points(self) -> Array | None:
        """Points (n, 3) [m] in the frame of the body whose hull approximates the shape from inside.

        26 points on the surface replace a ball or an ellipsoid, and a polygon with 16 corners
        replaces an ellipse. None if the extent of the shape is unknown.
        """
        centres = self.outline(_CIRCLE_POINTS, _SPHERE_POINTS)
        if centres is None or self.minkowski_terms is None or not self.minkowski_terms.ball:
            return centres
        return (centres[:, None] + self.minkowski_terms.ball * _SPHERE_POINTS).reshape(-1, 3)

    @cached_property
    def collision(self) -> coal.CollisionGeometry:
        """Collision geometry of the shape for the collision library coal.

        The shape must be a sphere, box, ellipsoid, cylinder, capsule or known mesh.
        """
        match self.kind, self.size:
            case "sphere", (r,):
                return coal.Sphere(r)
            case "capsule", (r, half):
                return coal.Capsule(r, 2 * half)
            case "cylinder", (r, half):
                return coal.Cylinder(r, 2 * half)
            case "ellipsoid", (x, y, z):
                return coal.Ellipsoid(x, y, z)
            case "box", (x, y, z):
                return coal.Box(2 * x, 2 * y, 2 * z)
        assert self.mesh is not None
        corners, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        corners.extend(list(self.mesh.vertices))
        triangles.extend([coal.Triangle(*face) for face in self.mesh.faces.tolist()])
        return coal.Convex(corners, triangles)


_SPHERE_POINTS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
"""Unit vectors, shape (26, 3), that sample a ball or an ellipsoid: directions from the centre of a
cube to the corners and the middles of edges and faces. The next statement normalises the vectors.
"""

_SPHERE_POINTS /= np.linalg.norm(_SPHERE_POINTS, axis=1, keepdims=True)
_CIRCLE_POINTS = np.array([(np.cos(a), np.sin(a)) for a in np.linspace(0, 2 * np.pi, 17)[:-1]])
"""Unit vectors (16, 2) at equal angles, the sampled points of an ellipse."""

_SAMPLE_VECTORS = np.concatenate(
    [np.eye(3), -np.eye(3), np.random.default_rng(0).normal(size=(60, 3))]
)
"""Vectors of `COMPARISON_DIRECTIONS` before normalisation, shape (66, 3)."""

COMPARISON_DIRECTIONS = _SAMPLE_VECTORS / np.linalg.norm(_SAMPLE_VECTORS, axis=1, keepdims=True)
"""Directions (66, 3) in which the extents of two shapes are compared, or their distance is
estimated: the axes and 60 random directions.
"""

NUM_SIZES: Final = {"sphere": 1, "box": 3, "ellipsoid": 3, "cylinder": 2, "capsule": 2, "mesh": 0}
"""{kind of shape: number of entries in `Shape.size`}, for MuJoCo's shapes whose extent
`Shape.minkowski_terms` computes."""


def read_shape(model: mujoco.MjModel, geom: int, data: mujoco.MjData | None = None) -> Shape:
    """Return the shape of a geom of a MuJoCo model, in the frame of its body or in the world frame.

    Args:
        model: MuJoCo model.
        geom: Id of the geom.
        data: If given, the shape is expressed in the world frame at this state; otherwise in the
            frame of the body.
    """
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    if data is None:
        pose = Pose(np.array(model.geom_pos[geom]), rotation_from_quaternion(model.geom_quat[geom]))
    else:
        pose = Pose(data.geom_xpos[geom].copy(), data.geom_xmat[geom].reshape(3, 3).copy())
    size = tuple(model.geom_size[geom][: NUM_SIZES.get(kind, 0)].tolist())
    collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
    name = model.geom(geom).name
    if kind != "mesh":
        return Shape(name, kind, pose, size, collides)
    read = partial(_read_hull, model, int(model.geom_dataid[geom]))
    return Shape(name, kind, pose, size, collides, read)


def get_mesh(model: mujoco.MjModel, mesh: int) -> Mesh:
    """Return a mesh of a compiled MuJoCo model, with vertices [m] in the frame of the mesh."""
    first_vertex, num_vertices = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    first_face, num_faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return Mesh(
        np.array(model.mesh_vert[first_vertex : first_vertex + num_vertices], dtype=float),
        np.array(model.mesh_face[first_face : first_face + num_faces], dtype=np.int64),
    )


def _read_hull(model: mujoco.MjModel, mesh: int) -> Mesh:
    """Return the convex hull of a mesh: MuJoCo's own if the model contains it, else `Mesh.hull`.

    MuJoCo's compiler defines the layout of ``mesh_graph``: numbers of vertices and faces, address
    of the edges of each vertex, mesh numbers of the vertices, edges, faces as mesh numbers.
    """
    address, mesh_with_all_vertices = int(model.mesh_graphadr[mesh]), get_mesh(model, mesh)
    if address < 0:
        return mesh_with_all_vertices.hull()
    num_corners, num_faces = model.mesh_graph[address : address + 2].tolist()
    numbers = model.mesh_graph[address + 2 + num_corners : address + 2 + 2 * num_corners]
    faces_address = address + 2 + 3 * num_corners + 3 * num_faces
    return mesh_with_all_vertices.select(
        numbers, model.mesh_graph[faces_address : faces_address + 3 * num_faces].reshape(-1, 3)
    )
